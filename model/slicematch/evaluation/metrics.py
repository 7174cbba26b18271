"""How far estimated poses are from the true ones, and how near a grid of candidates can come."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from slicemask.errors import PoseError
from slicematch.angles import angle_difference_deg

# Metres and degrees below which recalls count by default.
RECALLS = (1.0, 3.0, 5.0)


@dataclass(frozen=True)
class PoseErrors:
    """Errors of n estimated poses, each float64 [n] and not negative.

    Parameters
    ----------
    place_m : float64 [n]
        Distance from the true place, metres.
    lateral_m, longitudinal_m : float64 [n]
        That distance across and along the true heading, metres.
    heading_deg : float64 [n]
        Angle from the true heading, degrees from 0 to 180.
    """

    place_m: np.ndarray
    lateral_m: np.ndarray
    longitudinal_m: np.ndarray
    heading_deg: np.ndarray

    def summary(self, recalls: Sequence[float] = RECALLS) -> dict[str, float]:
        """Mean and median of place and heading, and recalls.

        Parameters
        ----------
        recalls : sequence of float
            Thresholds in metres and degrees.

        Returns
        -------
        figures : dict
            Metres and degrees. Recalls, such as "lateral_recall_3m", are shares in [0, 1] of
            lateral, longitudinal and heading errors below (strictly) the threshold.
        """
        found = {
            recall_name(name, threshold, unit): recall(errors, threshold)
            for name, unit, errors in (
                ("lateral", "m", self.lateral_m),
                ("longitudinal", "m", self.longitudinal_m),
                ("heading", "deg", self.heading_deg),
            )
            for threshold in recalls
        }
        return {**_mean_and_median(self.place_m, self.heading_deg), **found}


@dataclass(frozen=True)
class OracleError:
    """What candidates alone cost: the least error that any choice among them leaves.

    Place and heading count by themselves: no single candidate need reach both.

    Parameters
    ----------
    place_m : float64 [n]
        Distance from each true place to the nearest candidate's, metres.
    heading_deg : float64 [n]
        Angle from each true heading to the nearest candidate's, degrees.
    """

    place_m: np.ndarray
    heading_deg: np.ndarray

    def summary(self) -> dict[str, float]:
        """Mean and median of place (metres) and heading (degrees)."""
        return _mean_and_median(self.place_m, self.heading_deg)


def pose_errors(estimates: ArrayLike, truths: ArrayLike, tile_metres: ArrayLike) -> PoseErrors:
    """Errors of estimated poses.

    Lateral and longitudinal errors are the signed error vector turned into the true heading's
    frame, and only then made absolute.

    Parameters
    ----------
    estimates, truths : float [n, 3]
        u, v, heading_deg.
    tile_metres : float [n] or float
        Side of the aerial images on the ground, metres.

    Raises
    ------
    PoseError
        If the shapes differ, there is no pose, or one is not finite.

    Examples
    --------
    Facing north-east on a 100 m tile, estimated 3 m too far east and 3 m too far north:

    >>> errors = pose_errors([[0.53, 0.47, 50.0]], [[0.5, 0.5, 45.0]], 100.0)
    >>> errors.longitudinal_m.round(3), errors.lateral_m.round(3), errors.heading_deg
    (array([4.243]), array([0.]), array([5.]))
    """
    truths = _as_poses(truths, "true poses")
    estimates = _as_poses(estimates, "estimated poses")
    if len(estimates) != len(truths):
        raise PoseError(f"{len(estimates)} estimated poses for {len(truths)} true ones")
    east, south = ((estimates - truths)[:, :2] * _as_column(tile_metres, len(truths))).T
    heading = np.radians(truths[:, 2])
    return PoseErrors(
        place_m=np.hypot(east, south),
        lateral_m=np.abs(east * np.cos(heading) + south * np.sin(heading)),
        longitudinal_m=np.abs(east * np.sin(heading) - south * np.cos(heading)),
        heading_deg=heading_error_deg(estimates[:, 2], truths[:, 2]),
    )


def heading_error_deg(estimates: ArrayLike, truths: ArrayLike) -> np.ndarray:
    """Angle between headings, the short way round: float64, degrees from 0 to 180.

    Examples
    --------
    >>> float(heading_error_deg(359.0, 2.0))
    3.0
    """
    return np.abs(angle_difference_deg(np.asarray(estimates, float), np.asarray(truths, float)))


def recall_name(error: str, threshold: float, unit: str) -> str:
    """The name of a recall, such as "lateral_recall_3m"."""
    return f"{error}_recall_{threshold:g}{unit}"


def recall(errors: ArrayLike, threshold: float) -> float:
    """Share of errors strictly below a threshold, in [0, 1].

    Raises
    ------
    PoseError
        If there is no error to count.
    """
    errors = np.asarray(errors)
    if errors.size == 0:
        raise PoseError("there are no errors to count; at least one sample is needed")
    return float(np.mean(errors < threshold))


def oracle_error(candidates: ArrayLike, truths: ArrayLike, tile_metres: ArrayLike) -> OracleError:
    """How near the candidates come to the true poses at best.

    Parameters
    ----------
    candidates : float [K, 3]
        u, v, heading_deg of the poses that are scored.
    truths : float [n, 3]
        u, v, heading_deg.
    tile_metres : float [n] or float
        Side of the aerial images on the ground, metres.

    Raises
    ------
    PoseError
        If there is no pose or one is not finite.

    Examples
    --------
    >>> oracle = oracle_error([[0.5, 0.5, 0.0], [0.5, 0.5, 90.0]], [[0.5, 0.53, 350.0]], 100.0)
    >>> oracle.place_m.round(6), oracle.heading_deg
    (array([3.]), array([10.]))
    """
    candidates = _as_poses(candidates, "candidate poses")
    truths = _as_poses(truths, "true poses")
    distance, _ = cKDTree(np.unique(candidates[:, :2], axis=0)).query(truths[:, :2])
    # On a circle, the nearest of sorted headings is the next or the one before, with the last one
    # before the first.
    headings = np.unique(candidates[:, 2] % 360.0)
    after = np.searchsorted(headings, truths[:, 2] % 360.0) % len(headings)
    return OracleError(
        place_m=distance * _as_column(tile_metres, len(truths))[:, 0],
        heading_deg=np.minimum(
            heading_error_deg(headings[after], truths[:, 2]),
            heading_error_deg(headings[after - 1], truths[:, 2]),
        ),
    )


def nearest_candidates(candidates: ArrayLike, truths: ArrayLike) -> np.ndarray:
    """The candidate whose cell of the grid each true pose lies in: int64 [n].

    It is the one of the nearest heading among those of the nearest place.

    Parameters
    ----------
    candidates : float [K, 3]
        u, v, heading_deg.
    truths : float [n, 3]
        u, v, heading_deg.

    Examples
    --------
    >>> nearest_candidates([[0.5, 0.5, 0.0], [0.5, 0.5, 90.0], [0.9, 0.5, 0.0]], [[0.6, 0.5, 350]])
    array([0])
    """
    candidates = _as_poses(candidates, "candidate poses")
    truths = _as_poses(truths, "true poses")
    places, place = np.unique(candidates[:, :2], axis=0, return_inverse=True)
    place = place.ravel()
    order = np.argsort(place, kind="stable")
    starts = np.searchsorted(place[order], np.arange(len(places) + 1))
    _, nearest = cKDTree(places).query(truths[:, :2])
    found = np.empty(len(truths), dtype=np.int64)
    for n, at in enumerate(nearest):
        there = order[starts[at] : starts[at + 1]]
        found[n] = there[heading_error_deg(candidates[there, 2], truths[n, 2]).argmin()]
    return found


def _mean_and_median(place_m: np.ndarray, heading_deg: np.ndarray) -> dict[str, float]:
    return {
        "place_mean_m": float(np.mean(place_m)),
        "place_median_m": float(np.median(place_m)),
        "heading_mean_deg": float(np.mean(heading_deg)),
        "heading_median_deg": float(np.median(heading_deg)),
    }


def _as_poses(poses: ArrayLike, what: str) -> np.ndarray:
    poses = np.asarray(poses, dtype=np.float64)
    if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) == 0:
        raise PoseError(
            f"{what} have shape {poses.shape}; expected one row (u, v, heading_deg) a pose"
        )
    if not np.isfinite(poses).all():
        row = int(np.flatnonzero(~np.isfinite(poses).all(axis=1))[0])
        raise PoseError(f"{what} have {poses[row].tolist()} in row {row}; expected finite numbers")
    return poses


def _as_column(tile_metres: ArrayLike, count: int) -> np.ndarray:
    """Sides of tiles as float64 [count, 1]."""
    return np.broadcast_to(np.asarray(tile_metres, dtype=np.float64), (count,))[:, None]
