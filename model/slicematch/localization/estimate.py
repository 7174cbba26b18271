"""An answer: where a ground image was taken, and how sure that is."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slicemask import PoseGrid
from slicematch.errors import ConfigError
from slicematch.localization.modes import Mode, within_reach
from slicematch.localization.probabilities import covariance, probabilities
from slicematch.localization.tiles import check_resolution


@dataclass(frozen=True, repr=False)
class Estimate:
    """Where a ground image was taken, and how sure that is.

    Attributes
    ----------
    modes : tuple of Mode
        Best first, each beyond reach of every better one; the first one is the answer. Means are
        in the order of their probabilities, others in that of their scores.
    scores : float32 [rows, columns, headings]
        Scores of all candidates; -inf where a prior left one out.
    grid : PoseGrid
        Where the candidates stand.
    tile_pixels : int
        Side of the aerial tile as it was handed in.
    temperature : float
        That makes the scores probabilities (`slicematch.localization.probabilities`).
    metres_per_pixel : float or None
        Of the tile as it was handed in, if it was told.
    searched : float
        Side of the part of the tile that was searched, in shares of the tile's side.

    Examples
    --------
    >>> mode = Mode(np.array([0.75, 0.25, 90.0]), score=0.5, probability=0.8)
    >>> print(Estimate((mode,), np.zeros((1, 1, 1)), PoseGrid(1, 1, 1), 640, 0.1, 0.1))
    u 0.7500, v 0.2500, heading 90.00 degrees, score 0.5000; 16.00 m east and 16.00 m north of the \
centre; probability 80.0%
    """

    modes: tuple[Mode, ...]
    scores: NDArray[np.float32]
    grid: PoseGrid
    tile_pixels: int
    temperature: float
    metres_per_pixel: float | None = None
    searched: float = 1.0

    def __str__(self) -> str:
        probability = f"probability {self.modes[0].probability:.1%}"
        return f"{self.place_text(self.metres_per_pixel)}; {probability}"

    def __repr__(self) -> str:
        return f"<Estimate: {self}>"

    def place_text(self, metres_per_pixel: float | None = None) -> str:
        """The answer's pose and score, for people; with a resolution also its offset in metres."""
        u, v, heading_deg = self.pose
        text = f"u {u:.4f}, v {v:.4f}, heading {heading_deg:.2f} degrees, score {self.score:.4f}"
        if metres_per_pixel is None:
            return text
        east_m, north_m = self.offset_m(metres_per_pixel)
        return (
            f"{text}; {abs(east_m):.2f} m {'west' if east_m < 0 else 'east'} and "
            f"{abs(north_m):.2f} m {'south' if north_m < 0 else 'north'} of the centre"
        )

    @property
    def pose(self) -> NDArray[np.float64]:
        """u, v, heading_deg of the answer, float64 [3]."""
        return self.modes[0].pose

    @property
    def score(self) -> float:
        """The answer's score, a cosine in [-1, 1]."""
        return self.modes[0].score

    @property
    def heat_map(self) -> NDArray[np.float32]:
        """Best score at each place over the headings, float32 [rows, columns]."""
        return self.scores.max(axis=-1)

    @cached_property
    def probabilities(self) -> NDArray[np.float64]:
        """Probabilities of all candidates, 1 in all: float64 [rows, columns, headings]."""
        return probabilities(self.scores, self.temperature)

    @property
    def place_map(self) -> NDArray[np.float64]:
        """Probabilities of the places, over all headings: float64 [rows, columns]."""
        return self.probabilities.sum(axis=-1)

    def covariance(self, metres_per_pixel: float | None = None) -> NDArray[np.float64]:
        """How candidates within reach of the answer spread about it: float64 [3, 3].

        Parameters
        ----------
        metres_per_pixel : float, optional
            Of the tile as it was handed in.

        Returns
        -------
        covariance : float64 [3, 3]
            Of east, north (metres, or shares of the tile's side if no resolution is given) and
            heading (degrees).
        """
        poses = self.grid.poses()
        around = within_reach(self.pose, poses, self.grid, self.searched)
        moments = covariance(
            self.pose, poses[around], self.probabilities.ravel()[around], self.grid
        )
        scale = np.ones(3)
        if metres_per_pixel is not None:
            scale[:2] = self._side_m(metres_per_pixel)
        return moments * np.outer(scale, scale)

    def offset_m(self, metres_per_pixel: float) -> tuple[float, float]:
        """Metres (east, north) from the tile's centre to the camera.

        Parameters
        ----------
        metres_per_pixel : float
            Of the tile as it was handed in, north up.
        """
        return self._offset_m(self.pose, metres_per_pixel)

    def as_dict(
        self,
        metres_per_pixel: float | None = None,
        centre: tuple[float, float] | None = None,
    ) -> dict[str, Any]:
        """The estimate as plain values, for JSON.

        Parameters
        ----------
        metres_per_pixel : float, optional
            Of the tile as it was handed in, north up: adds east_m and north_m.
        centre : (latitude, longitude), optional
            Of the tile, degrees; with a resolution it adds latitude and longitude.

        Returns
        -------
        content : dict
            u, v, heading_deg, score and probability of the answer, what was asked to be added,
            its covariance (`covariance`), the temperature, and the same of the other_modes.
        """
        best, *others = (self._mode_dict(mode, metres_per_pixel, centre) for mode in self.modes)
        return {
            **best,
            "covariance": self.covariance(metres_per_pixel).tolist(),
            "temperature": self.temperature,
            "other_modes": others,
        }

    def _mode_dict(
        self, mode: Mode, metres_per_pixel: float | None, centre: tuple[float, float] | None
    ) -> dict[str, float]:
        u, v, heading_deg = (float(value) for value in mode.pose)
        content = {"u": u, "v": v, "heading_deg": heading_deg}
        content |= {"score": mode.score, "probability": mode.probability}
        if metres_per_pixel is not None:
            east_m, north_m = self._offset_m(mode.pose, metres_per_pixel)
            content |= {"east_m": east_m, "north_m": north_m}
            if centre is not None:
                # Here: pyproj takes long to import, and few ask for it.
                from slicematch.localization.geodesy import offset_position

                latitude, longitude = offset_position(centre, east_m, north_m)
                content |= {"latitude": latitude, "longitude": longitude}
        elif centre is not None:
            raise ConfigError(
                "the tile's centre alone gives no latitude and longitude; give its metres per "
                "pixel too"
            )
        return content

    def _offset_m(self, pose: NDArray[np.float64], metres_per_pixel: float) -> tuple[float, float]:
        side_m = self._side_m(metres_per_pixel)
        return float((pose[0] - 0.5) * side_m), float((0.5 - pose[1]) * side_m)

    def _side_m(self, metres_per_pixel: float) -> float:
        return self.tile_pixels * check_resolution(metres_per_pixel)
