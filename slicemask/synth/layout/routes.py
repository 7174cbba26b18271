"""Drives through a generated city: routes along its streets with turns, and speeds along them."""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from slicemask.synth.layout.city import City
from slicemask.synth.layout.streets import LANE_M

Floats = NDArray[np.float64]

STEP_M = 0.25  # between points of a route
# A corner is rounded by this much, so that a right angle is driven with a radius of 6 m.
ROUNDING_M = 4.0
# No turn at a junction is sharper: such a one would be a turn back.
SHARPEST_DEG = 120.0
TURN_CHANCE = 0.5  # at a junction where one can turn
CRUISE_MPS = (6.0, 11.0)
ACCELERATION_MPS2, LATERAL_MPS2 = 1.5, 2.0
STOP_CHANCE, STOP_S = 0.3, (1.5, 5.0)  # at a junction
TRIES = 400


@dataclass(frozen=True)
class Route:
    """A way through the city.

    Parameters
    ----------
    points : float64 [n, 2]
        Metres east and north, `STEP_M` apart along it, smooth, in the lane to the right.
    junctions_m : float64 [j]
        How far along it junctions lie.
    """

    points: Floats
    junctions_m: Floats


@dataclass(frozen=True)
class Motion:
    """A drive, at its frames' times.

    Parameters
    ----------
    times_s : float64 [F]
        From 0.
    places : float64 [F, 2]
        Metres east and north of the city's centre.
    headings_deg : float64 [F]
        Along the way, clockwise from north, in [0, 360).
    speeds_mps, yaw_rates_dps : float64 [F]
        Forward, and clockwise.
    accelerations_mps2 : float64 [F]
        Forward.
    """

    times_s: Floats
    places: Floats
    headings_deg: Floats
    speeds_mps: Floats
    yaw_rates_dps: Floats
    accelerations_mps2: Floats


def draw_route(
    city: City, reach_m: float, length_m: float, rng: np.random.Generator
) -> Route | None:
    """Draw a way along the streets, from junction to junction and never back.

    Parameters
    ----------
    city : City
    reach_m : float
        It stays in the square that reaches so far from the city's centre.
    length_m : float
        It is at least so long.
    rng : numpy.random.Generator

    Returns
    -------
    Route or None
        None if the streets within reach allow none.
    """
    edges, ends = _network(city, reach_m)
    for _ in range(TRIES if edges else 0):
        walk = _walk(edges, ends, length_m + 6 * ROUNDING_M, rng)
        if walk is not None:
            return _smooth(*walk)
    return None


def drive_along(
    route: Route, seconds: float, rate_hz: float, rng: np.random.Generator
) -> Motion | None:
    """Drive along a route: slower in turns, with stops at some junctions.

    Returns
    -------
    Motion or None
        None if the route ends before the time is over.
    """
    points = route.points
    along = np.arange(len(points)) * STEP_M
    direction = np.gradient(points, STEP_M, axis=0)
    heading = np.unwrap(np.arctan2(direction[:, 0], direction[:, 1]))
    curvature = np.gradient(heading, STEP_M)
    most = np.minimum(
        rng.uniform(*CRUISE_MPS), np.sqrt(LATERAL_MPS2 / np.maximum(np.abs(curvature), 1e-6))
    )
    stops = route.junctions_m[rng.random(len(route.junctions_m)) < STOP_CHANCE] - 8.0
    at = np.unique((stops[stops > 10.0] / STEP_M).astype(int))
    most[at] = 0.0
    speed = _reachable(_reachable(most)[::-1])[::-1]
    # Time at each point; a stop lasts while the time jumps.
    steps_s = 2 * STEP_M / np.maximum(speed[1:] + speed[:-1], 1e-3)
    time = np.concatenate([[0.0], np.cumsum(steps_s)])
    waits = np.zeros(len(time))
    waits[at] = rng.uniform(*STOP_S, len(at))
    arrive = time + np.cumsum(waits) - waits
    leave = arrive + waits
    times = np.arange(round(seconds * rate_hz)) / rate_hz
    if arrive[-1] <= times[-1]:
        return None
    before = np.clip(np.searchsorted(leave, times, side="right") - 1, 0, len(along) - 2)
    # Between two points it slows down or speeds up evenly; at a stop it waits at the second one.
    passed_s = np.clip(times, None, arrive[before + 1]) - leave[before]
    gain = (speed[before + 1] ** 2 - speed[before] ** 2) / (2 * STEP_M)
    there = along[before] + speed[before] * passed_s + gain * passed_s**2 / 2
    waits_now = times >= arrive[before + 1]
    there = np.where(waits_now, along[before + 1], there)
    speeds = np.where(waits_now, 0.0, speed[before] + gain * passed_s)
    return Motion(
        times,
        np.stack([np.interp(there, along, points[:, k]) for k in (0, 1)], axis=1),
        np.degrees(np.interp(there, along, heading)) % 360.0,
        speeds,
        np.degrees(np.interp(there, along, curvature)) * speeds,
        np.where(waits_now, 0.0, gain),
    )


def _reachable(most: Floats) -> Floats:
    """Speeds at points, none above the most, if a car speeds up no faster than it can."""
    speed = most.copy()
    for k in range(1, len(speed)):
        speed[k] = min(speed[k], np.sqrt(speed[k - 1] ** 2 + 2 * ACCELERATION_MPS2 * STEP_M))
    return speed


def _network(
    city: City, reach_m: float
) -> tuple[list[Floats], dict[tuple[int, int], list[tuple[int, bool]]]]:
    """Streets cut at junctions, float64 [n, 2] each; and which begin or end at a point.

    Points are decimetres; an edge is named by its number and whether it is driven backwards.
    """
    square = shapely.box(-reach_m, -reach_m, reach_m, reach_m)
    lines = shapely.union_all([street.line for street in city.streets]).intersection(square)
    edges = [
        shapely.get_coordinates(part)
        for part in shapely.get_parts(shapely.line_merge(lines))
        if isinstance(part, shapely.LineString) and part.length > 6.0
    ]
    ends: dict[tuple[int, int], list[tuple[int, bool]]] = defaultdict(list)
    for number, edge in enumerate(edges):
        ends[_node(edge[0])].append((number, False))
        ends[_node(edge[-1])].append((number, True))
    return edges, ends


def _node(point: Floats) -> tuple[int, int]:
    x, y = np.rint(point * 10.0).astype(int).tolist()
    return x, y


def _walk(
    edges: list[Floats],
    ends: dict[tuple[int, int], list[tuple[int, bool]]],
    length_m: float,
    rng: np.random.Generator,
) -> tuple[Floats, list[Floats]] | None:
    """A chain of edges as one line, and its junctions; None if it comes to a dead end too soon."""
    number, backwards = int(rng.integers(len(edges))), bool(rng.random() < 0.5)
    parts: list[Floats] = []
    junctions: list[Floats] = []
    total = 0.0
    while True:
        edge = edges[number][::-1] if backwards else edges[number]
        parts.append(edge if not parts else edge[1:])
        total += float(np.hypot(*np.diff(edge, axis=0).T).sum())
        if total >= length_m:
            return np.concatenate(parts), junctions
        arriving = _direction(edge[-2:])
        onward = []
        for other, reverse in ends[_node(edge[-1])]:
            if other == number:
                continue
            line = edges[other][::-1] if reverse else edges[other]
            turn = np.degrees(np.arccos(np.clip(arriving @ _direction(line[:2]), -1, 1)))
            if turn < SHARPEST_DEG:
                onward.append((other, reverse, bool(turn > 45.0)))
        if not onward:
            return None
        if len(onward) > 1:
            junctions.append(edge[-1])
        turns = [choice for choice in onward if choice[2]]
        rest = [choice for choice in onward if not choice[2]] or turns
        wanted = turns if turns and rng.random() < TURN_CHANCE else rest
        number, backwards, _ = wanted[int(rng.integers(len(wanted)))]


def _direction(ends: Floats) -> Floats:
    along = ends[-1] - ends[0]
    return np.asarray(along / np.hypot(*along))


def _smooth(line: Floats, junctions: list[Floats]) -> Route:
    """A line as it is driven: corners rounded, in the lane to the right of the middle."""
    points = _rounded(_evenly(line), ROUNDING_M)
    along = np.gradient(points, axis=0)
    along /= np.hypot(*along.T)[:, None]
    beside = points + LANE_M / 2 * along[:, ::-1] * [1.0, -1.0]
    # Again, where a short way between two turns brings the lane to a point.
    lane = _evenly(_rounded(_evenly(beside), ROUNDING_M / 2))
    path = shapely.LineString(lane)
    found = [path.project(shapely.Point(place)) for place in junctions]
    return Route(lane, np.array(sorted(found)))


def _rounded(points: Floats, radius_m: float) -> Floats:
    """Points of a line, smoothed, but for those near its ends."""
    spare = round(2 * radius_m / STEP_M)
    smooth = [gaussian_filter1d(points[:, k], radius_m / STEP_M, mode="nearest") for k in (0, 1)]
    return np.stack(smooth, axis=1)[spare:-spare]


def _evenly(line: Floats) -> Floats:
    """Points of a line, `STEP_M` apart along it."""
    path = shapely.LineString(line)
    at = np.arange(0.0, path.length, STEP_M)
    return np.asarray(shapely.get_coordinates(shapely.line_interpolate_point(path, at)))
