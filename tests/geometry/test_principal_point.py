"""Pinhole cameras whose optical axis is off the centre of their images."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slicemask import Frustum, SpecError, slice_masks

ENGINES = ("shapely", "rays")

# Pose, frustum, cells, masks [N, L, L] or [N, B, L, L].
MASKS = {
    "the axis on the left edge, which runs along the lattice": (
        (0.5, 0.5, 0.0), Frustum.from_intrinsics(100, 0, 100, 1), 2,
        [[[0, 0.5], [0, 0]]],
    ),
    "the axis on the right edge": (
        (0.5, 0.5, 0.0), Frustum.from_intrinsics(100, 100, 100, 1), 2,
        [[[0.5, 0], [0, 0]]],
    ),
    "the axis on an edge between slices": (
        (0.5, 1.0, 0.0), Frustum.from_intrinsics(2, 1, 3, 3), 2,
        [[[0.75, 0], [0.25, 0]],
         [[0, 0.75], [0, 0.25]],
         [[0, 0.25], [0, 0.25]]],
    ),
    "the axis left of the image": (
        (0.0, 1.0, 0.0), Frustum.from_intrinsics(1, -1, 1, 1), 1,
        [[[0.25]]],
    ),
    "depth bands on one side of the axis": (
        (0.0, 1.0, 0.0), Frustum.from_intrinsics(1, 0, 1, 1, bands=(0.5,)), 2,
        [[[[0, 0], [0.5, 0]], [[1, 0.5], [0, 0]]]],
    ),
}  # fmt: skip


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("case", MASKS)
def test_masks_written_out_by_hand(case, engine):
    pose, frustum, cells, expected = MASKS[case]
    masks = slice_masks([pose], frustum, cells, engine)[0]
    assert masks == pytest.approx(np.array(expected), abs=1e-15)
    assert np.array_equal(masks == 0.0, np.array(expected) == 0.0)


def test_slices_are_equal_parts_of_the_image():
    # KITTI's left colour camera, 2011_09_26.
    frustum = Frustum.from_intrinsics(721.5377, 609.5593, 1242, 6)
    columns = 609.5593 + 721.5377 * np.tan(np.radians(frustum.edge_offsets_deg()))
    assert columns == pytest.approx(np.arange(7) * 207.0, abs=1e-9)
    assert frustum.left_deg == pytest.approx(math.degrees(math.atan(-609.5593 / 721.5377)))
    assert frustum.principal_point == pytest.approx(609.5593 / 1242)
    assert frustum.edge_offsets_deg()[0] == frustum.left_deg
    assert frustum.edge_offsets_deg()[-1] == frustum.right_deg


def test_a_principal_point_in_the_centre_is_no_news():
    centred = Frustum.from_intrinsics(500, 320, 640, 8, (0.1,))
    assert centred.left_deg is None
    assert centred.principal_point == 0.5
    assert centred.right_deg == centred.hfov_deg / 2
    assert centred.hfov_deg == math.degrees(2 * math.atan(320 / 500))
    assert centred == Frustum(centred.hfov_deg, 8, "pinhole", (0.1,))
    assert Frustum(90, 8, "pinhole", left_deg=-45.0) == Frustum(90, 8, "pinhole")
    assert Frustum(360, 8, left_deg=-180.0) == Frustum(360, 8)


# The axis on the image's edges, on edges of slices and outside the image; fields of view up to
# almost 180 degrees.
_shares = st.one_of(
    st.floats(-2, 3), st.sampled_from([0.0, 1.0, 0.25, 0.5, 1 / 3, -1.0, 1e-13, 1 - 1e-13])
)
_focal = st.one_of(st.floats(0.05, 20), st.sampled_from([0.5, 1.0, 0.01]))
_bands = st.sampled_from([(), (0.25,), (0.1, 1 / 3, 1.0)])
_frusta = st.builds(
    lambda f, c, n, bands: Frustum.from_intrinsics(f, c, 1.0, n, bands),
    _focal, _shares, st.integers(1, 7), _bands,
)  # fmt: skip
_coordinate = st.one_of(st.floats(0, 1), st.sampled_from([0.0, 1.0, 0.5, 0.25, 1 / 3]))
_angle = st.one_of(st.floats(-360, 360), st.integers(-8, 8).map(lambda k: k * 45.0))
_poses = st.tuples(_coordinate, _coordinate, _angle)
_cells = st.integers(1, 10)


@settings(max_examples=60, deadline=None)
@given(_poses, _frusta, _cells)
def test_engines_agree(pose, frustum, cells):
    by_polygons, by_rays = (slice_masks([pose], frustum, cells, engine) for engine in ENGINES)
    assert np.abs(by_polygons - by_rays).max() <= 1e-9


@settings(max_examples=20, deadline=None)
@given(_poses, _frusta, st.integers(1, 4))
def test_masks_are_those_of_the_plain_loop(plain_masks, pose, frustum, cells):
    expected = plain_masks([pose], frustum, cells)
    assert np.abs(slice_masks([pose], frustum, cells, "rays") - expected).max() <= 1e-6


@settings(max_examples=40, deadline=None)
@given(_poses, _frusta, _cells)
def test_a_tensor_gives_the_masks_that_an_array_does(pose, frustum, cells):
    torch = pytest.importorskip("torch")
    tensor = slice_masks(torch.tensor([pose], dtype=torch.float64), frustum, cells, "rays")
    assert np.abs(tensor.numpy() - slice_masks([pose], frustum, cells, "rays")).max() <= 1e-9


@settings(max_examples=40, deadline=None)
@given(_poses, st.integers(1, 3), st.integers(1, 3), st.integers(1, 3), _focal, _bands, _cells)
def test_an_image_cut_at_an_edge_of_slices_shows_the_slices_that_are_left(
    pose, left, kept, right, focal, bands, cells
):
    # Cropping columns moves the principal point and nothing else.
    total = left + kept + right
    whole = Frustum.from_intrinsics(focal * total, total / 2, total, total, bands)
    part = Frustum.from_intrinsics(focal * total, total / 2 - left, kept, kept, bands)
    expected = slice_masks([pose], whole, cells, "rays")[:, left : left + kept]
    assert np.abs(slice_masks([pose], part, cells, "rays") - expected).max() <= 1e-9


@settings(max_examples=40, deadline=None)
@given(_poses, _frusta, _cells)
def test_a_mirrored_image_gives_mirrored_masks(pose, frustum, cells):
    u, v, heading_deg = pose
    mirrored = Frustum(
        frustum.hfov_deg, frustum.slices, "pinhole", frustum.bands, -frustum.right_deg
    )
    expected = slice_masks([pose], frustum, cells, "rays")[:, ::-1, ..., ::-1]
    found = slice_masks([(1.0 - u, v, -heading_deg)], mirrored, cells, "rays")
    assert np.abs(found - expected).max() <= 1e-9


@pytest.mark.parametrize("bands", [(), (0.1, 0.3)])
def test_gradients_are_those_of_finite_differences(bands):
    torch = pytest.importorskip("torch")
    frustum = Frustum.from_intrinsics(1.0, 0.3, 1.7, 4, bands)
    rng = np.random.default_rng(1)
    poses = np.column_stack([rng.random((2, 2)), rng.uniform(0, 360, 2)])
    assert torch.autograd.gradcheck(
        lambda some: slice_masks(some, frustum, 4, "rays"),
        torch.tensor(poses, requires_grad=True), eps=1e-7, atol=1e-5,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"fx": 0, "cx": 50, "width": 100}, "fx is 0; it must be a number of pixels above 0"),
        ({"fx": 100, "cx": math.nan, "width": 100}, "cx is nan; it must be a number of pixels"),
        ({"fx": 100, "cx": 50, "width": -1}, "width is -1; it must be a number of pixels above 0"),
        ({"fx": 1e-320, "cx": 30, "width": 100}, "a pinhole camera sees less than 180"),
        ({"fx": 1.0, "cx": 1e20, "width": 100}, "hfov is 0.0 degrees"),
    ],
)
def test_no_camera_has_such_parameters(arguments, message):
    with pytest.raises(SpecError, match=message):
        Frustum.from_intrinsics(**arguments)


@pytest.mark.parametrize(
    ("projection", "left_deg", "message"),
    [
        ("equirectangular", 0.0, "only a pinhole camera has a principal point"),
        ("pinhole", math.inf, "left_deg is inf; it must be an azimuth"),
        ("pinhole", "0", "left_deg is '0'; it must be an azimuth"),
        ("pinhole", 10.0, "from 10 to 100 degrees"),
        ("pinhole", -90.0, "from -90 to -10 degrees"),
    ],
)
def test_a_left_edge_where_there_is_none_is_refused(projection, left_deg, message):
    hfov_deg = 80 if left_deg == -90.0 else 90
    with pytest.raises(SpecError, match=message):
        Frustum(hfov_deg, 4, projection, left_deg=left_deg)
