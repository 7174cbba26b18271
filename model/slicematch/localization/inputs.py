"""Pictures as a run's networks take them: read, checked, cut to what the run sees, normalised."""

from dataclasses import dataclass
from typing import cast

import torch
from PIL import Image

from slicemask import Frustum
from slicemask.images import Picture, read_image, resize
from slicematch.data.elevations import crop_elevations, frame_ground
from slicematch.data.images import normalise
from slicematch.data.panoramas import cut_hfov, read_panorama, turn_panorama
from slicematch.runs.config import TrainConfig


@dataclass(frozen=True)
class GroundImages:
    """Ground images of a run.

    Parameters
    ----------
    config : TrainConfig
        The run's settings.
    frustum : Frustum
        Of its ground images.
    """

    config: TrainConfig
    frustum: Frustum

    def read(self, ground: Picture) -> tuple[Image.Image, float | None]:
        """Read a ground image, checked: a panorama as a whole sphere.

        Returns
        -------
        image : PIL image
        heading_deg : float or None
            Of its centre column, by a panorama's own data.

        Raises
        ------
        ImageError
            If it cannot be read or has the wrong proportions.
        """
        if self.frustum.projection == "equirectangular":
            return read_panorama(ground, self.config.ground_fit, self.frustum.hfov_deg)
        return read_image(ground), None

    def pixels(self, image: Image.Image) -> torch.Tensor:
        """What the ground encoders take of an image that was read: float [1, 3, height, width]."""
        config, hfov_deg = self.config, self.frustum.hfov_deg
        size = cast(tuple[int, int], config.ground_size)
        if self.frustum.projection == "equirectangular":
            image = crop_elevations(image, config.elevations, "equirectangular", hfov_deg)
            image = turn_panorama(image, 0.0, size, hfov_deg)
        else:
            image = resize(self._framed(image), size)
        return normalise(image, *config.normalisation())[None]

    def shown(self, image: Image.Image) -> Image.Image:
        """The columns of an image that slices are cut from, for a picture."""
        if self.frustum.projection == "equirectangular":
            return cut_hfov(image, self.frustum.hfov_deg)
        return image

    def _framed(self, image: Image.Image) -> Image.Image:
        """A camera's image, cut to what the run takes."""
        config = self.config
        aspect = config.ground_aspect or image.width / image.height  # runs of before say none
        return frame_ground(
            image,
            aspect,
            config.ground_fit,
            config.elevations,
            self.frustum.hfov_deg,
            self.frustum.left_deg,
            config.horizon,
        )


def aerial_pixels(image: Image.Image, config: TrainConfig) -> torch.Tensor:
    """What the aerial encoders take of the part of a tile that is searched: float [1, 3, A, A]."""
    size = config.aerial_size
    return normalise(resize(image, (size, size)), *config.normalisation())[None]
