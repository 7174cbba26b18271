"""A ground image and a tile, matched by a run: the answer, and why any pose scores as it does."""

import threading
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from slicemask.images import read_aerial
from slicematch.data.elevations import crop_elevations
from slicematch.localization.estimate import Estimate
from slicematch.localization.localizer import HeadingPrior, Localizer, PlacePrior
from slicematch.localization.tiles import trained_window
from slicematch.scoring.off_grid import JointScorer, PairScorer

Pose = tuple[float, float, float]
# Sessions share one localizer, which keeps the candidates of the last priors.
_localizing = threading.Lock()


@dataclass(frozen=True)
class Match:
    """A pair of images, matched.

    Attributes
    ----------
    tile : PIL.Image.Image
        The part of the tile that is searched.
    ground : PIL.Image.Image
        The part of the ground image that the run looks at.
    estimate : Estimate
        The answer, in the frame of `tile`.
    scorer : PairScorer or JointScorer
        Of any pose in that frame.
    """

    tile: Image.Image
    ground: Image.Image
    estimate: Estimate
    scorer: PairScorer | JointScorer

    def contributions(self, pose: Pose) -> NDArray[np.float32]:
        """What each band of each slice adds to a pose's score, float32 [N, B]; they sum to it."""
        with torch.no_grad():
            found = self.scorer.contributions(torch.tensor([pose], dtype=torch.float64))
        contributions: NDArray[np.float32] = found[0].cpu().numpy()
        return contributions


def match(
    localizer: Localizer,
    ground: Image.Image,
    tile: Image.Image,
    *,
    metres_per_pixel: float | None = None,
    heading_prior: HeadingPrior | None = None,
    place_prior: PlacePrior | None = None,
) -> Match:
    """Find the pose of a ground image in a tile, and keep what its score is made of.

    Parameters
    ----------
    localizer : Localizer
        Of the run.
    ground, tile : PIL.Image.Image
        As `Localizer.localize` takes them.
    metres_per_pixel : float, optional
        Of the tile. Of a tile that is larger on the ground than the run's, only the middle is
        taken.
    heading_prior, place_prior
        As `Localizer.localize` takes them; places in the frame of what is taken of the tile.

    Raises
    ------
    ImageError
        If an image has the wrong proportions.
    ConfigError
        If the priors leave no candidate, or the tile is of quite another size than the run's.
    """
    tile = read_aerial(tile)
    tile = trained_window(tile.width, metres_per_pixel, localizer.tile_side_m).crop(tile)
    with _localizing:
        encoded = localizer.encode_aerial(tile, metres_per_pixel=metres_per_pixel)
        estimate = localizer.localize(ground, encoded, heading_prior, place_prior)
        scorer = localizer.pair_scorer(localizer.encode_ground(ground), encoded)
    config = localizer.config
    seen = crop_elevations(
        localizer.read_ground(ground),
        config.elevations,
        localizer.frustum.projection,
        localizer.frustum.hfov_deg,
    )
    return Match(tile, seen, estimate, scorer)
