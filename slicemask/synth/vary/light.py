"""Light of any hour and weather: low and high sun, broken clouds, haze, glare."""

from dataclasses import dataclass, replace

import numpy as np

from slicemask.synth.render.cameras import Camera
from slicemask.synth.render.light import Light
from slicemask.synth.render.patterns import Floats, as_float32, noise


@dataclass(frozen=True)
class Weather(Light):
    """Light whose sky shows the sun and clouds of several sizes.

    Parameters
    ----------
    glow
        Brightness of the sky around the sun.
    glow_deg, disc_deg
        Widths of that, and of the sun's disc as the sensor sees it.
    gradient
        Power by which the horizon's colour gives way to the zenith's.
    cloud_size, cloud_base
        Size of the clouds against a unit of height, and the brightness of their undersides.
    drift : (x, y)
        Where the pattern of clouds starts.
    """

    glow: float = 0.0
    glow_deg: float = 10.0
    disc_deg: float = 3.0
    gradient: float = 0.5
    cloud_size: float = 1.0
    cloud_base: float = 0.7
    drift: tuple[float, float] = (0.0, 0.0)

    def sky(self, directions: Floats) -> Floats:
        """Colours of the sky, float32 [n, 3], in directions [n, 3]."""
        x, y, z = directions.T
        up = np.clip(z, 0.0, 1.0)
        colour = as_float32(self.horizon) + (up**self.gradient)[:, None] * as_float32(
            np.subtract(self.zenith, self.horizon)
        )
        glow = self.glow_at(directions)
        colour = colour + glow[:, None]
        reach = 1.0 / (up + 0.10) / self.cloud_size
        a, b = x * reach + self.drift[0], y * reach + self.drift[1]
        # Patterns that are finer than the sky is sampled near the horizon fade there.
        fine = 0.03 * reach
        cover = sum(
            noise(a * size, b * size, 1.0, as_float32(fine * size)) * strength
            for size, strength in ((0.9, 0.8), (2.1, 0.5), (4.7, 0.3), (10.3, 0.16))
        )
        cloud = np.clip((cover + 2.2 * self.clouds - 1.1) * 1.6, 0, 1) * np.clip(z * 9, 0, 1)
        thick = np.clip(cover + 2.2 * self.clouds - 1.3, 0, 1)
        white = 0.96 - (0.96 - self.cloud_base) * thick + 0.5 * glow
        return as_float32(
            colour + cloud[:, None] * (white[:, None] * as_float32([0.98, 0.99, 1.0]) - colour)
        )

    def glow_at(self, directions: Floats) -> Floats:
        """Brightness that the sun adds in directions [n, 3], float32 [n]."""
        near = np.clip(directions @ self.towards_sun, -1, 1)
        angle_deg = np.degrees(np.arccos(near))
        return as_float32(
            self.glow * np.exp(-angle_deg / self.glow_deg)
            + self.sun * 2.5 * np.exp(-((angle_deg / self.disc_deg) ** 4))
        )


def draw_weather(rng: np.random.Generator, aerial: bool = False) -> Weather:
    """Draw an hour and a weather; pictures from above are taken in clear air, with a higher sun."""
    base = Light.draw(rng, aerial)
    kind = rng.choice(4, p=[0.5, 0.2, 0.2, 0.1] if not aerial else [0.75, 0.15, 0.1, 0.0])
    elevation = (
        rng.uniform(22, 70) if aerial else 90 - np.degrees(np.arccos(rng.uniform(0.2, 0.93)))
    )
    pale = rng.uniform(0, 1)
    zenith = np.array([0.16, 0.34, 0.62]) * rng.uniform(0.8, 1.25) + pale * np.array(
        [0.26, 0.22, 0.16]
    )
    horizon = np.array([0.74, 0.82, 0.90]) * rng.uniform(0.8, 1.1) + rng.normal(0, 0.015, 3)
    sun, ambient = rng.uniform(0.65, 1.15), rng.uniform(0.35, 0.62)
    clouds = rng.uniform(0.0, 0.55)
    glow = rng.uniform(0.1, 0.7)
    if kind == 1:  # broken, thick clouds, with or without sun
        clouds, sun = rng.uniform(0.5, 0.8), rng.choice([0.1, rng.uniform(0.5, 0.9)])
        ambient = rng.uniform(0.55, 0.85)
    if kind == 2:  # overcast
        grey = rng.uniform(0.55, 0.95)
        zenith, horizon = (
            np.array([grey, grey, grey * 1.02]),
            np.full(3, grey * rng.uniform(0.95, 1.1)),
        )
        clouds, sun, ambient = rng.uniform(0.1, 1.0), rng.uniform(0, 0.2), rng.uniform(0.75, 0.98)
        glow *= 0.3
    haze_m = float(np.exp(rng.uniform(np.log(250), np.log(3000))))
    if kind == 3:  # haze or mist
        grey = rng.uniform(0.7, 0.95)
        horizon = np.array([grey, grey, grey])
        haze_m, sun, ambient = float(rng.uniform(60, 250)), rng.uniform(0.1, 0.6), 0.8
    return Weather(
        **{
            **base.__dict__,
            "sun_azimuth_deg": float(rng.uniform(0, 360)),
            "sun_elevation_deg": float(elevation),
            "sun": float(sun),
            "ambient": float(ambient),
            "zenith": _triple(zenith),
            "horizon": _triple(horizon),
            "clouds": float(clouds),
            "haze_m": haze_m * (10 if aerial else 1),
        },
        glow=float(glow),
        glow_deg=float(rng.uniform(5, 22)),
        disc_deg=float(rng.uniform(2.5, 9)),
        gradient=float(rng.uniform(0.35, 0.8)),
        cloud_size=float(np.exp(rng.uniform(np.log(0.5), np.log(2.5)))),
        cloud_base=float(rng.uniform(0.4, 0.9)),
        drift=(float(rng.uniform(0, 200)), float(rng.uniform(0, 200))),
    )


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    red, green, blue = np.clip(values, 0.02, 1.0).tolist()
    return red, green, blue


def add_glare(image: Floats, camera: Camera, weather: Weather, rng: np.random.Generator) -> Floats:
    """Add to a picture, float32 [H, W, 3], what the sun adds to all around it, trees too."""
    if weather.sun < 0.3 or rng.random() < 0.5:
        return image
    wide = replace(
        weather, sun=0.0, glow=float(rng.uniform(0.05, 0.45)), glow_deg=float(rng.uniform(8, 30))
    )
    row, column = np.mgrid[: image.shape[0], : image.shape[1]] + 0.5
    rays = as_float32(camera.rays(row, column)[1])
    veil = wide.glow_at(rays.reshape(-1, 3)).reshape(image.shape[:2])
    return as_float32(image + np.clip(veil, 0, 1.0)[..., None])
