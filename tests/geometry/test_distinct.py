"""Equal slices and images, found by codes, against brute force over the masks themselves."""

import math
from dataclasses import replace

import numpy as np
import pytest

from slicemask import Frustum, PoseGrid, slice_masks
from slicemask.geometry.distinct import distinct_slices, distinct_unanchored
from slicemask.geometry.masks import engine_fractions
from slicemask.geometry.rays import sector_fractions
from slicemask.geometry.symmetry import SYMMETRIES, azimuth_codes, offset_codes

# Fine enough that distinct slices have distinct masks in the cases below. (In coarse cells they
# need not: two narrow slices within one column of cells that mirror each other about the camera.)
CELLS = 29


def _expanded(orbit, frustum):
    """Masks of a `SectorOrbit`, [rows, L, L]."""
    masks = np.zeros((*orbit.in_tile.shape, CELLS, CELLS))
    if orbit.in_tile.shape[1] == 1:
        frustum = replace(frustum, bands=())
    for r in range(len(orbit.u)):
        names = ("u", "v", "left_deg", "right_deg", "heading_deg")
        sector = [getattr(orbit, name)[r : r + 1] for name in names]
        if sector[3] - sector[2] == 360.0 and not frustum.bands:
            masks[r] = 1.0
        elif sector[3] > sector[2]:
            masks[r] = engine_fractions("rays", frustum)(*sector, CELLS)[0]
    pairs = zip(orbit.sector, orbit.symmetry, strict=True)
    rows = [SYMMETRIES[g].masks(masks[r])[orbit.in_tile[r]] for r, g in pairs]
    return np.concatenate([np.empty((0, CELLS, CELLS)), *rows])


def _reduced(poses, frustum):
    """(masks [K, N, L, L] by way of the distinct ones, rows, sectors computed)."""
    places, place = np.unique(poses[:, :2], axis=0, return_inverse=True)
    found = distinct_slices(places[:, 0], places[:, 1], place.ravel(), poses[:, 2], frustum)
    orbit, row = distinct_unanchored(found.unanchored)
    masks = np.concatenate([_expanded(found.anchored, frustum), _expanded(orbit, frustum)])
    number = found.mask_of.copy()
    free = number < 0
    number[free] = found.anchored.rows + row[-1 - number[free]]
    used = np.unique(number)  # the empty mask of bands beyond the tile may not be
    masks_of = masks[number].reshape(len(poses), *frustum.mask_axes, CELLS, CELLS)
    return masks_of, len(used), len(found.anchored.u) + len(orbit.u)


CASES = {
    "odd grid, overlapping slices": (PoseGrid(5, 5, 8), Frustum(360, 4)),
    "even grid, headings that no power of two divides": (PoseGrid(4, 4, 21), Frustum(100, 7)),
    "slices as far apart as headings, thirds of degrees": (PoseGrid(3, 3, 27), Frustum(360, 27)),
    "half-planes, whose cameras slide along their line": (PoseGrid(5, 5, 8), Frustum(360, 2)),
    "everything, whatever the camera": (PoseGrid(3, 3, 4), Frustum(360, 1)),
    "one slice wider than 180": (PoseGrid(3, 4, 12), Frustum(300, 1)),
    "cameras on the tile's edges and corners": (
        PoseGrid(4, 5, 12, places="endpoints"), Frustum(360, 6),
    ),
    "edges, wide slices that wrap around": (
        PoseGrid(3, 3, 12, places="endpoints"), Frustum(330, 2),
    ),
    "edges, one slice": (PoseGrid(4, 4, 12, places="endpoints"), Frustum(250, 1)),
    "pinhole": (PoseGrid(4, 4, 16), Frustum(81.5, 3, "pinhole")),
    "pinhole, the axis off the centre": (
        PoseGrid(4, 4, 16), Frustum.from_intrinsics(math.pi, 1.9, 5.0, 3),
    ),
    "pinhole, the axis on the image's edge, and headings a slice apart": (
        PoseGrid(3, 3, 8, places="endpoints"), Frustum.from_intrinsics(1.0, 0.0, 1.0, 1),
    ),
    "extent off the centre": (PoseGrid(3, 4, 8, extent=(0.1, 0.2, 0.5, 0.9)), Frustum(360, 8)),
}  # fmt: skip
BANDED_CASES = {
    "odd grid": (PoseGrid(5, 5, 8), Frustum(360, 4, bands=(0.13, 0.4))),
    "a last band that few slices reach": (PoseGrid(4, 4, 8), Frustum(360, 8, bands=(0.2, 0.9))),
    "bands that no slice reaches": (PoseGrid(3, 3, 8), Frustum(360, 4, bands=(0.2, 1.4, 1.6))),
    "half-planes": (PoseGrid(3, 3, 8), Frustum(360, 2, bands=(0.3,))),
    "whole circles": (PoseGrid(3, 3, 4), Frustum(360, 1, bands=(0.1, 0.6))),
    "edges and corners": (
        PoseGrid(4, 5, 12, places="endpoints"), Frustum(360, 6, bands=(0.15, 0.5)),
    ),
    "edges, whole circles": (
        PoseGrid(3, 3, 4, places="endpoints"), Frustum(360, 1, bands=(0.15, 0.5)),
    ),
    "edges, wide slices that wrap around": (
        PoseGrid(3, 3, 12, places="endpoints"), Frustum(330, 2, bands=(0.2,)),
    ),
    "edges, one slice": (
        PoseGrid(4, 4, 12, places="endpoints"), Frustum(250, 1, bands=(0.3,)),
    ),
    # Off the centre, where no two cameras share the plane in front of which both see a corner.
    "pinhole": (
        PoseGrid(4, 4, 16, extent=(0.1, 0.2, 0.73, 0.91)),
        Frustum(81.5, 3, "pinhole", (0.1, 0.35)),
    ),
    "pinhole with headings a slice apart": (
        PoseGrid(3, 3, 24), Frustum(90, 2, "pinhole", (0.25,)),
    ),
    "pinhole, the axis off the centre": (
        PoseGrid(4, 4, 16, extent=(0.1, 0.2, 0.73, 0.91)),
        Frustum.from_intrinsics(1.0, 0.6, 1.7, 3, (0.1, 0.35)),
    ),
    "pinhole, some of whose slices mirror one another": (
        PoseGrid(4, 4, 8, extent=(0.1, 0.2, 0.73, 0.91)),
        Frustum.from_intrinsics(1.0, 0.5, 1.5, 3, (0.1, 0.35)),
    ),
    "pinhole, the axis on the image's edge": (
        PoseGrid(3, 3, 8, extent=(0.1, 0.2, 0.73, 0.91)),
        Frustum.from_intrinsics(1.0, 0.0, 1.0, 2, (0.25,)),
    ),
    "pinhole, the axis in the middle of a slice": (
        PoseGrid(4, 4, 16), Frustum.from_intrinsics(1.0, 0.5, 2.0, 2, (0.25,)),
    ),
    "pinhole on edges": (
        PoseGrid(3, 3, 8, places="endpoints"), Frustum(90, 2, "pinhole", (0.25,)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BANDED_CASES)
def test_equal_bands_are_one_row_and_empty_ones_are_one(case):
    grid, frustum = BANDED_CASES[case]
    poses = grid.poses()
    masks, rows, _ = _reduced(poses, frustum)
    expected = slice_masks(poses, frustum, CELLS, "rays")
    assert np.abs(masks - expected).max() <= 1e-9
    assert rows == len(np.unique(np.round(expected.reshape(-1, CELLS**2), 8) + 0.0, axis=0))


@pytest.mark.parametrize("case", CASES)
def test_equal_masks_are_one_row_and_rows_expand_to_the_masks(case):
    grid, frustum = CASES[case]
    poses = grid.poses()
    masks, rows, sectors = _reduced(poses, frustum)
    expected = slice_masks(poses, frustum, CELLS)
    assert np.abs(masks - expected).max() <= 1e-9
    distinct = len(np.unique(np.round(expected.reshape(-1, CELLS**2), 8), axis=0))
    assert rows == distinct
    orbits = {
        min(np.round(g.masks(mask), 8).tobytes() for g in SYMMETRIES)
        for mask in expected.reshape(-1, CELLS, CELLS) + 0.0  # + 0.0: no negative zeros
    }
    assert sectors == len(orbits)


def test_slices_that_mirror_one_another_about_the_axis_are_computed_once():
    # Slices 0 and 1 of three mirror each other; nothing mirrors slice 2.
    frustum = Frustum.from_intrinsics(math.pi, 1.0, 3.0, 3, (0.1, 0.3))
    poses = np.array([[0.3, 0.1, 20.0], [0.7, 0.1, 340.0], [0.1, 0.7, 290.0]])
    masks, rows, sectors = _reduced(poses, frustum)
    assert np.abs(masks - slice_masks(poses, frustum, CELLS, "rays")).max() <= 1e-9
    assert sectors == 2 + 2 + 1  # slices 0 and 1, slice 2 in two senses, and the empty mask
    assert rows == 3 * 3 * 3 - np.count_nonzero(~masks.any(axis=(-2, -1))) + 1


def test_a_shuffled_list_of_the_same_poses_reduces_as_the_grid_does():
    grid, frustum = PoseGrid(5, 5, 16), Frustum(360, 8)
    poses = grid.poses()
    order = np.random.default_rng(3).permutation(len(poses))
    masks, rows, sectors = _reduced(poses[order], frustum)
    in_order, *counts = _reduced(poses, frustum)
    assert counts == [rows, sectors]
    assert np.array_equal(masks, in_order[order])


def test_random_poses_share_nothing():
    rng = np.random.default_rng(4)
    poses = np.column_stack([rng.random((40, 2)), rng.uniform(0, 360, 40)])
    masks, rows, sectors = _reduced(poses, Frustum(300, 5))
    assert rows == sectors == 200
    assert np.abs(masks - slice_masks(poses, Frustum(300, 5), CELLS)).max() <= 1e-9


def test_mirrored_and_turned_poses_are_computed_once():
    pose = np.array([[0.3, 0.1, 20.0]])
    images = np.array(
        [
            [0.3, 0.1, 20], [0.7, 0.1, 340], [0.3, 0.9, 160], [0.7, 0.9, 200],
            [0.1, 0.3, 250], [0.1, 0.7, 290], [0.9, 0.3, 110], [0.9, 0.7, 70],
        ]
    )  # fmt: skip
    _, rows, sectors = _reduced(np.concatenate([pose, images]), Frustum(90, 3))
    assert (rows, sectors) == (24, 3)


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_a_symmetry_permutes_the_masks_of_the_slices_it_moves(symmetry):
    rng = np.random.default_rng(5)
    u, v = rng.random((2, 20))
    left = rng.uniform(0, 360, 20)
    right = left + rng.uniform(1, 350, 20)
    p, q = symmetry.places(u - 0.5, v - 0.5)
    image = sector_fractions(p + 0.5, q + 0.5, *symmetry.slices(left, right, 90.0), 7)
    masks = sector_fractions(u, v, left, right, 7)
    assert np.abs(symmetry.masks(masks) - image).max() < 1e-12
    assert np.array_equal(symmetry.inverse.masks(symmetry.masks(masks)), masks)


def test_a_chain_of_near_neighbours_is_not_one_value():
    headings = np.arange(2000) * 9e-12
    codes, _ = azimuth_codes(headings)
    values = np.array([headings[codes == code].mean() for code in np.unique(codes)])
    assert np.abs(values[np.unique(codes, return_inverse=True)[1]] - headings).max() < 2e-11


def test_codes_see_through_rounding():
    thirds = np.array([1 / 3, 0.1 + 0.2 + 1 / 30, 2 / 3, 1 - 1 / 3, 0.5, 0.0, 1.0])
    p, q, edge = offset_codes(thirds, thirds)
    assert np.array_equal(p, q)
    assert p[0] == p[1] == -p[2] == -p[3] != 0
    assert p[4] == 0
    assert (p[5], p[6]) == (-edge, edge)

    angles = np.array([7.2 * 25, 180.0, 0.1 * 3 * 600, -180.0, 540 + 1e-13])
    codes, quarter = azimuth_codes(angles)
    assert set(codes.tolist()) == {2 * quarter}
    codes, quarter = azimuth_codes(np.array([10.0, 80.0, 100.0, 350.0, 359.9999999999999]))
    assert codes[1] == quarter - codes[0]
    assert codes[2] == quarter + codes[0]
    assert codes[3] == 4 * quarter - codes[0]
    assert codes[4] == 0
