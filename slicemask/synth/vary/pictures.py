"""Pictures of a scene under the switches that are on; with none, they are what they always were."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slicemask.synth.render.cameras import Aerial, Panorama
from slicemask.synth.render.grade import Grade
from slicemask.synth.render.light import Light
from slicemask.synth.render.patterns import Floats
from slicemask.synth.render.render import render
from slicemask.synth.render.scene import Scene
from slicemask.synth.vary import camera as cameras
from slicemask.synth.vary import imagery
from slicemask.synth.vary.exposure import Exposure
from slicemask.synth.vary.light import Weather, add_glare, draw_weather
from slicemask.synth.vary.switches import Variation

Pixels = NDArray[np.uint8]
NONE = Variation((), ())
# Which picture a switch's random numbers are for.
GROUND, AERIAL = 0, 1


def panorama_pixels(
    scene: Scene,
    camera: Panorama,
    heading_deg: float,
    variation: Variation,
    number: int,
    rng: np.random.Generator,
) -> Pixels:
    """Take a panorama, uint8 [H, W, 3].

    Parameters
    ----------
    scene : Scene
    camera : Panorama
        Level, where nothing varies it.
    heading_deg
        Of the car that holds it, clockwise from north.
    variation
        The switches that are on.
    number
        Of the panorama in its place.
    rng
        Random numbers of its own light and sensor.
    """
    light = Light.draw(rng)
    if "camera" in variation:
        camera = cameras.mount(camera, variation.random("camera", GROUND, number))
    glare = None
    if "light" in variation:
        glare = variation.random("light", GROUND, number)
        light = draw_weather(glare)
    image = render(scene, camera, light)
    if isinstance(light, Weather) and glare is not None:
        image = add_glare(image, camera, light, glare)
    if "exposure" in variation:
        image = Exposure.draw(variation.random("exposure", GROUND, number)).apply(image)
    pixels = Grade.draw(rng).apply(image, rng)
    if "camera" in variation:
        own = variation.random("camera", GROUND, number, 1)
        pixels = cameras.develop(pixels, heading_deg, own)
    return pixels


@dataclass(frozen=True)
class AerialLook:
    """Light and sensor of pictures from above, and what the switches that are on make of them.

    Parameters
    ----------
    light, grade
        The same for all tiles that are rendered at once.
    variation
        The switches that are on; none by default.
    block
        Number of the tiles that are rendered at once.
    """

    light: Light
    grade: Grade
    variation: Variation = NONE
    block: int = 0

    def varied_light(self) -> Light:
        """The light of these tiles."""
        if "light" not in self.variation:
            return self.light
        return draw_weather(self.variation.random("light", AERIAL, self.block), aerial=True)

    def aim(self, camera: Aerial) -> Aerial:
        """The camera of these tiles."""
        if "imagery" not in self.variation:
            return camera
        return imagery.lean(camera, self.variation.random("imagery", AERIAL, self.block))

    def pixels(
        self, image: Floats, metres_per_pixel: float, number: int, rng: np.random.Generator
    ) -> Pixels:
        """A tile's picture, uint8 [H, W, 3], of the light float32 [H, W, 3] that reaches it."""
        if "exposure" in self.variation:
            own = self.variation.random("exposure", AERIAL, number)
            image = Exposure.draw(own, aerial=True).apply(image)
        pixels = self.grade.apply(image, rng)
        if "imagery" in self.variation:
            own = self.variation.random("imagery", AERIAL, number, 1)
            pixels = imagery.develop(pixels, metres_per_pixel, own)
        return pixels
