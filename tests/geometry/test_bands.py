"""Slices cut into bands of range: written out by hand, and held against each other.

Circles around the camera are polygons to the shapely engine, good to 1e-6 of a cell; everything
else agrees to 1e-9.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slicemask import Frustum, SpecError, slice_masks

ENGINES = ("shapely", "rays")
QUARTER = math.pi / 4  # the share of a unit cell that a quarter disc of radius 1 covers

# Pose, frustum, cells, masks [N, B, L, L]; exact in binary, so compared with ==.
PLANES = {
    "a plane along a lattice line, ahead to the north": (
        (0.5, 1.0, 0.0), Frustum(90, 1, "pinhole", (0.5,)), 4,
        [[[[0, 0, 0, 0], [0, 0, 0, 0], [0.5, 1, 1, 0.5], [0, 0.5, 0.5, 0]],
          [[1, 1, 1, 1], [1, 1, 1, 1], [0, 0, 0, 0], [0, 0, 0, 0]]]],
    ),
    "to the south": (
        (0.5, 0.0, 180.0), Frustum(90, 1, "pinhole", (0.5,)), 4,
        [[[[0, 0.5, 0.5, 0], [0.5, 1, 1, 0.5], [0, 0, 0, 0], [0, 0, 0, 0]],
          [[0, 0, 0, 0], [0, 0, 0, 0], [1, 1, 1, 1], [1, 1, 1, 1]]]],
    ),
    "to the east": (
        (0.0, 0.5, 90.0), Frustum(90, 1, "pinhole", (0.5,)), 2,
        [[[[0.5, 0], [0.5, 0]], [[0, 1], [0, 1]]]],
    ),
    "to the west": (
        (1.0, 0.5, 270.0), Frustum(90, 1, "pinhole", (0.5,)), 2,
        [[[[0, 0.5], [0, 0.5]], [[1, 0], [1, 0]]]],
    ),
    "a plane through the middle of cells": (
        (0.5, 0.5, 0.0), Frustum(90, 1, "pinhole", (0.25,)), 2,
        [[[[0.125, 0.125], [0, 0]], [[0.375, 0.375], [0, 0]]]],
    ),
    "a plane beyond the tile": (
        (0.5, 0.5, 0.0), Frustum(90, 1, "pinhole", (0.75,)), 2,
        [[[[0.5, 0.5], [0, 0]], [[0, 0], [0, 0]]]],
    ),
}  # fmt: skip
# The same with circles, where shares hold a multiple of pi: compared to 1e-14.
CIRCLES = {
    "a circle that touches the lattice lines, in the four cells around it": (
        (0.5, 0.5, 0.0), Frustum(360, 4, bands=(0.5,)), 2,
        [[[[0, 0], [QUARTER, 0]], [[0, 0], [1 - QUARTER, 0]]],
         [[[QUARTER, 0], [0, 0]], [[1 - QUARTER, 0], [0, 0]]],
         [[[0, QUARTER], [0, 0]], [[0, 1 - QUARTER], [0, 0]]],
         [[[0, 0], [0, QUARTER]], [[0, 0], [0, 1 - QUARTER]]]],
    ),
    "a camera in a corner": (
        (0.0, 0.0, 135.0), Frustum(90, 1, bands=(1.0,)), 1,
        [[[[QUARTER]], [[1 - QUARTER]]]],
    ),
    "a circle that the tile's corners lie on": (
        (0.5, 0.5, 0.0), Frustum(360, 1, bands=(math.sqrt(0.5),)), 1,
        [[[[1.0]], [[0.0]]]],
    ),
    "a whole circle within one cell": (
        (0.25, 0.25, 0.0), Frustum(360, 1, bands=(0.125,)), 2,
        [[[[math.pi / 16, 0], [0, 0]], [[1 - math.pi / 16, 1], [1, 1]]]],
    ),
    "a circle beyond the tile": (
        (0.5, 0.5, 90.0), Frustum(180, 1, bands=(2.0, 7.0)), 2,
        [[[[0, 1], [0, 1]], [[0, 0], [0, 0]], [[0, 0], [0, 0]]]],
    ),
}  # fmt: skip


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("case", PLANES)
def test_depth_bands_written_out_by_hand(case, engine):
    pose, frustum, cells, expected = PLANES[case]
    assert slice_masks([pose], frustum, cells, engine)[0].tolist() == expected


@pytest.mark.parametrize("case", CIRCLES)
def test_circles_written_out_by_hand(case):
    pose, frustum, cells, expected = CIRCLES[case]
    masks = slice_masks([pose], frustum, cells, "rays")[0]
    assert masks == pytest.approx(np.array(expected), abs=1e-14)
    assert slice_masks([pose], frustum, cells)[0] == pytest.approx(np.array(expected), abs=1e-6)


# Places, ranges and angles where things go wrong are as likely as others.
_coordinate = st.one_of(
    st.floats(0, 1),
    st.sampled_from([0.0, 1.0, 0.5, 0.25, 1 / 3, 1e-12, 1 - 1e-12]),
    st.integers(0, 12).map(lambda k: k / 12),
)
_angle = st.one_of(
    st.floats(-720, 720),
    st.integers(-16, 16).map(lambda k: k * 22.5),
    st.sampled_from([45.0, 90 - 1e-13, 90 + 1e-13, 1e-13, -1e-14]),
)
_bands = st.lists(
    st.one_of(
        st.floats(1e-3, 1.6),
        st.sampled_from([0.25, 0.5, 1 / 12, 1 / 3, math.sqrt(0.5), math.sqrt(2), 1e-6, 1e6]),
    ),
    min_size=1, max_size=4, unique=True,
).map(lambda ranges: tuple(sorted(ranges)))  # fmt: skip
_circles = st.builds(
    lambda hfov, n, bands: Frustum(hfov, n, bands=bands),
    st.one_of(st.floats(1e-3, 360), st.sampled_from([90.0, 180.0, 270.0, 360.0])),
    st.integers(1, 7),
    _bands,
)
_planes = st.builds(
    lambda hfov, n, bands: Frustum(hfov, n, "pinhole", bands),
    st.one_of(st.floats(1e-3, 179.9), st.just(90.0)),
    st.integers(1, 7),
    _bands,
)
_poses = st.tuples(_coordinate, _coordinate, _angle)
_cells = st.integers(1, 12)


@settings(max_examples=150, deadline=None)
@given(_poses, _circles, _cells)
def test_engines_agree_on_circles(pose, frustum, cells):
    by_polygons, by_rays = (slice_masks([pose], frustum, cells, engine) for engine in ENGINES)
    assert np.abs(by_polygons - by_rays).max() <= 1e-6
    for masks in (by_polygons, by_rays):
        assert masks.min() >= 0.0
        assert masks.max() <= 1.0


@settings(max_examples=150, deadline=None)
@given(_poses, _planes, _cells)
def test_engines_agree_on_depth_planes(pose, frustum, cells):
    by_polygons, by_rays = (slice_masks([pose], frustum, cells, engine) for engine in ENGINES)
    assert np.abs(by_polygons - by_rays).max() <= 1e-9


@settings(max_examples=150, deadline=None)
@given(_poses, st.one_of(_circles, _planes), _cells, st.sampled_from(ENGINES))
def test_bands_of_a_slice_sum_to_the_slice(pose, frustum, cells, engine):
    whole = Frustum(frustum.hfov_deg, frustum.slices, frustum.projection)
    masks = slice_masks([pose], frustum, cells, engine)
    assert masks.shape == (1, frustum.slices, frustum.band_count, cells, cells)
    # Shares under 1e-10 count as none, in each of the bands.
    expected = slice_masks([pose], whole, cells, engine)
    assert np.abs(masks.sum(axis=2) - expected).max() <= 1e-9


@settings(max_examples=100, deadline=None)
@given(_poses, st.one_of(_circles, _planes), _cells)
def test_a_tensor_gives_the_bands_that_an_array_does(pose, frustum, cells):
    torch = pytest.importorskip("torch")
    tensor = slice_masks(torch.tensor([pose], dtype=torch.float64), frustum, cells, "rays")
    assert np.abs(tensor.numpy() - slice_masks([pose], frustum, cells, "rays")).max() <= 1e-9


@settings(max_examples=25, deadline=None)
@given(_poses, st.one_of(_circles, _planes), st.integers(1, 4))
def test_bands_are_those_of_the_plain_loop(plain_masks, pose, frustum, cells):
    expected = plain_masks([pose], frustum, cells)
    assert np.abs(slice_masks([pose], frustum, cells, "rays") - expected).max() <= 1e-6


@settings(max_examples=60, deadline=None)
@given(_poses, st.one_of(_circles, _planes), st.integers(1, 4), st.integers(1, 3))
def test_coarse_cells_are_means_of_fine_ones(pose, frustum, cells, factor):
    fine = slice_masks([pose], frustum, cells * factor, "rays")[0]
    pooled = fine.reshape(*fine.shape[:2], cells, factor, cells, factor).mean(axis=(3, 5))
    assert np.abs(pooled - slice_masks([pose], frustum, cells, "rays")[0]).max() <= 1e-9


@pytest.mark.parametrize(
    "frustum",
    [
        Frustum(360, 5, bands=(0.1, 0.3)),
        Frustum(300, 1, bands=(0.2,)),
        Frustum(360, 1, bands=(0.01, 2.0)),
        Frustum(81.5, 4, "pinhole", (0.1, 0.3)),
    ],
)
def test_gradients_are_those_of_finite_differences(frustum):
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(1)
    poses = np.column_stack([rng.random((2, 2)), rng.uniform(0, 360, 2)])
    assert torch.autograd.gradcheck(
        lambda some: slice_masks(some, frustum, 4, "rays"),
        torch.tensor(poses, requires_grad=True), eps=1e-7, atol=1e-5,
    )  # fmt: skip


@pytest.mark.parametrize("bands", [(0.25, 0.5), (0.125,)])
@pytest.mark.parametrize("pose", [(0.5, 0.5, 0.0), (0.25, 0.25, 45.0), (0.0, 0.0, 90.0)])
def test_gradients_are_finite_where_circles_and_planes_touch_the_lattice(pose, bands):
    torch = pytest.importorskip("torch")
    for frustum in (Frustum(360, 4, bands=bands), Frustum(90, 4, "pinhole", bands)):
        poses = torch.tensor([pose], dtype=torch.float64, requires_grad=True)
        slice_masks(poses, frustum, 8, "rays").square().sum().backward()
        assert torch.isfinite(poses.grad).all()


def test_any_array_of_the_standard_is_taken():
    strict = pytest.importorskip("array_api_strict")
    poses = [[0.3, 0.6, 200.0], [0.5, 0.5, 0.0]]
    for frustum in (Frustum(bands=(0.1, 0.3)), Frustum(80, 4, "pinhole", (0.1, 0.3))):
        masks = slice_masks(strict.asarray(poses), frustum, 8, "rays")
        expected = slice_masks(poses, frustum, 8, "rays")
        assert np.abs(np.from_dlpack(masks) - expected).max() <= 1e-12


@pytest.mark.parametrize(
    "bands",
    [(0.2, 0.1), (0.1, 0.1), (0.0, 0.1), (-0.1,), (math.nan,), (math.inf,), "ab", 0.1, (True,)],
)
def test_bands_that_are_no_increasing_ranges_are_refused(bands):
    with pytest.raises(SpecError, match=r"bands are .* they must be increasing ranges above 0"):
        Frustum(bands=bands)


def test_too_many_bands_are_refused():
    with pytest.raises(SpecError, match="there are 65 bands; there may be at most 64"):
        Frustum(bands=np.arange(1, 65) / 64)
