"""What a sensor makes of the light that reaches it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slicemask.synth.render.patterns import Floats, as_float32


@dataclass(frozen=True)
class Grade:
    """What a sensor makes of the light: gains of the channels, contrast, saturation, noise."""

    gains: tuple[float, float, float]
    contrast: float
    saturation: float
    noise: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Grade":
        """Draw a sensor's colours."""
        exposure = rng.uniform(0.9, 1.15)
        red, green, blue = (exposure * (1 + rng.normal(0, (0.035, 0.015, 0.04)))).tolist()
        return cls(
            gains=(red, green, blue),
            contrast=float(rng.uniform(0.85, 1.12)),
            saturation=float(rng.uniform(0.7, 1.15)),
            noise=float(rng.uniform(0.004, 0.014)),
        )

    def apply(self, image: Floats, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Turn float32 [H, W, 3] light into uint8."""
        graded = image * as_float32(self.gains)
        grey = graded.mean(axis=-1, keepdims=True)
        graded = grey + self.saturation * (graded - grey)
        graded = 0.5 + self.contrast * (graded - 0.5)
        # What is too bright for the sensor nears white instead of being cut off.
        graded = np.where(graded > 0.7, 0.7 + 0.3 * np.tanh((graded - 0.7) / 0.3), graded)
        graded += rng.standard_normal(graded.shape, dtype=np.float32) * self.noise
        return np.asarray(np.clip(graded, 0, 1) * 255 + 0.5, dtype=np.uint8)
