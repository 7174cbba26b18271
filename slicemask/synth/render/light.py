"""Sun, sky and haze."""

from dataclasses import dataclass

import numpy as np

from slicemask.synth.render.patterns import Floats, as_float32, noise


@dataclass(frozen=True)
class Light:
    """Sun and sky.

    Parameters
    ----------
    sun_azimuth_deg, sun_elevation_deg
        Where the sun stands, clockwise from north and above the horizon.
    sun
        Its strength; 0 is an overcast day.
    ambient
        Strength of the sky's light.
    zenith, horizon
        Colours of the sky.
    clouds
        Share of clouds, in [0, 1].
    haze_m
        Distance at which haze has taken two thirds of a colour.
    """

    sun_azimuth_deg: float
    sun_elevation_deg: float
    sun: float
    ambient: float
    zenith: tuple[float, float, float]
    horizon: tuple[float, float, float]
    clouds: float
    haze_m: float

    @classmethod
    def draw(cls, rng: np.random.Generator, aerial: bool = False) -> "Light":
        """Draw the light of a day and hour; pictures from above are taken in clear air."""
        overcast = rng.random() < 0.25
        sun = rng.uniform(0.0, 0.25) if overcast else rng.uniform(0.7, 1.1)
        blue = rng.uniform(0.0, 1.0)
        zenith = (0.30 + 0.2 * blue, 0.50 + 0.1 * blue, 0.78)
        grey = rng.uniform(0.68, 0.82)
        return cls(
            sun_azimuth_deg=float(rng.uniform(90, 270)),
            sun_elevation_deg=float(rng.uniform(28, 65)),
            sun=float(sun),
            ambient=float(rng.uniform(0.85, 0.98) if overcast else rng.uniform(0.5, 0.66)),
            zenith=(grey, grey, grey + 0.03) if overcast else zenith,
            horizon=(0.86, 0.88, 0.90),
            clouds=1.0 if overcast else float(rng.uniform(0.0, 0.7)),
            haze_m=float(rng.uniform(350, 900) * (10 if aerial else 1)),
        )

    @property
    def towards_sun(self) -> Floats:
        """Unit vector to the sun, float32 [3]."""
        azimuth, elevation = np.radians([self.sun_azimuth_deg, self.sun_elevation_deg])
        level = np.cos(elevation)
        return as_float32([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)])

    def sky(self, directions: Floats) -> Floats:
        """Colours of the sky, float32 [n, 3], in directions [n, 3]."""
        x, y, z = directions.T
        up = np.clip(z, 0.0, 1.0)[:, None]
        colour = as_float32(self.horizon) + np.sqrt(up) * as_float32(
            np.subtract(self.zenith, self.horizon)
        )
        reach = 1.0 / (up[:, 0] + 0.12)
        zero = np.zeros_like(reach)
        cover = sum(
            noise(x * reach * size, y * reach * size, 1.0, zero) / size for size in (1.1, 2.3, 5.1)
        )
        cloud = np.clip((cover + self.clouds - 0.55) * 1.4, 0, 1) * np.clip(z * 6, 0, 1)
        return np.asarray(colour + cloud[:, None] * (as_float32([0.93, 0.94, 0.95]) - colour))
