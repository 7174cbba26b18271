"""Exposure, white balance, contrast and saturation, as cameras and their processing choose them."""

from dataclasses import dataclass

import numpy as np

from slicemask.synth.render.patterns import Floats, as_float32


@dataclass(frozen=True)
class Exposure:
    """What a camera and its processing make of the light, before the sensor's own grade.

    Parameters
    ----------
    brightness
        The mean that the picture is brought to.
    balance : (red, green, blue)
        Gains of the channels.
    gamma
        Power of the middle tones; above 1 they get darker.
    black
        Brightness that is added to black, as stray light and haze do.
    saturation
        0 is grey.
    """

    brightness: float
    balance: tuple[float, float, float]
    gamma: float
    black: float
    saturation: float

    @classmethod
    def draw(cls, rng: np.random.Generator, aerial: bool = False) -> "Exposure":
        """Draw an exposure; aerial mosaics are darker than street pictures."""
        bright = rng.normal(-1.1, 0.35) if aerial else rng.normal(-0.75, 0.22)
        warmth, tint = rng.normal(0, 0.06), rng.normal(0, 0.025)
        return cls(
            brightness=float(np.exp(np.clip(bright, -1.75, -0.35))),
            balance=(1 + warmth, 1 + tint, 1 - warmth),
            gamma=float(np.exp(rng.normal(0.05, 0.22))),
            black=float(np.clip(rng.normal(0.0, 0.04), 0, 0.12)),
            saturation=float(rng.uniform(0.45, 1.45)),
        )

    def apply(self, image: Floats) -> Floats:
        """Change float32 [H, W, 3] light."""
        lit = np.clip(image * as_float32(self.balance), 0, None) ** self.gamma
        grey = lit.mean(axis=-1, keepdims=True)
        lit = grey + self.saturation * (lit - grey)
        lit *= self.brightness / max(float(np.clip(grey, 0, 1.2).mean()), 0.02)
        return as_float32(self.black + (1 - self.black) * np.clip(lit, 0, 2))
