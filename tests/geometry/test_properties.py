"""What holds for every pose, field of view and number of cells, hunted by hypothesis."""

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from slicemask import Frustum, PoseGrid, slice_masks
from slicemask.geometry.coverage import sector_polygons

ENGINES = ("shapely", "rays")

# Places and angles where things go wrong are as likely as any others: lattice lines, the tile's
# edges and corners, its centre, azimuths along the axes and diagonals, and values next to them.
_coordinate = st.one_of(
    st.floats(0, 1),
    st.sampled_from([0.0, 1.0, 0.5, 0.25, 0.125, 1 / 3, 1e-12, 1 - 1e-12, 5e-324]),
    st.integers(0, 12).map(lambda k: k / 12),
)
_angle = st.one_of(
    st.floats(-720, 720),
    st.integers(-16, 16).map(lambda k: k * 22.5),
    st.sampled_from([45.0, 90 - 1e-13, 90 + 1e-13, 1e-13, -1e-14, 179.99999999999997]),
)
_hfov = st.one_of(
    st.floats(1e-3, 360),
    st.sampled_from(
        [90.0, 180.0, 270.0, 360.0, 359.9999999999999, 180.00000000000003, 179.99999999999997, 1e-9]
    ),
)
_frusta = st.one_of(
    st.builds(Frustum, _hfov, st.integers(1, 9)),
    st.builds(
        lambda hfov, n: Frustum(hfov, n, "pinhole"), st.floats(1e-3, 179.9), st.integers(1, 9)
    ),
)
_poses = st.tuples(_coordinate, _coordinate, _angle)
_cells = st.integers(1, 12)


@settings(max_examples=300, deadline=None)
@given(_poses, _frusta, _cells)
@example((0.0, 0.0, 1.1125369292536007e-308), Frustum(1.0, 2), 1)  # a direction that is denormal
def test_engines_agree_and_fractions_are_shares(pose, frustum, cells):
    by_polygons = slice_masks([pose], frustum, cells, "shapely")
    by_rays = slice_masks([pose], frustum, cells, "rays")
    assert np.abs(by_polygons - by_rays).max() <= 1e-9
    for masks in (by_polygons, by_rays):
        assert masks.min() >= 0.0
        assert masks.max() <= 1.0


@settings(max_examples=200, deadline=None)
@given(_poses, _frusta, _cells)
def test_a_tensor_gives_the_masks_that_an_array_does(pose, frustum, cells):
    torch = pytest.importorskip("torch")
    tensor = slice_masks(torch.tensor([pose], dtype=torch.float64), frustum, cells, "rays")
    # Where adding a heading rounds a slice's edges, it does so in other ways than for arrays.
    assert np.abs(tensor.numpy() - slice_masks([pose], frustum, cells)).max() <= 1e-9


@settings(max_examples=100, deadline=None)
@given(_poses, _frusta, st.integers(1, 6))
def test_masks_are_those_of_the_plain_loop(plain_masks, pose, frustum, cells):
    expected = plain_masks([pose], frustum, cells)
    assert np.abs(slice_masks([pose], frustum, cells) - expected).max() <= 1e-9


@settings(max_examples=100, deadline=None)
@given(_poses, _frusta, _cells)
def test_fractions_sum_to_the_area_of_the_slice_in_the_tile(pose, frustum, cells):
    masks = slice_masks([pose], frustum, cells, "rays")[0]
    u, v, heading = (np.full(frustum.slices, value) for value in pose)
    edges = frustum.edges_deg(heading[:1])[0]
    polygons = sector_polygons(u, v, edges[:-1], edges[1:])
    areas = shapely.area(shapely.intersection(polygons, shapely.box(0, 0, 1, 1)))
    # Shares under 1e-10 count as none, in each of the cells.
    assert np.abs(masks.mean(axis=(1, 2)) - areas).max() <= 2e-10


@settings(max_examples=100, deadline=None)
@given(_poses, st.integers(1, 16), _cells, st.sampled_from(ENGINES))
def test_slices_of_a_panorama_cover_every_cell_once(pose, slices, cells, engine):
    masks = slice_masks([pose], Frustum(360.0, slices), cells, engine)[0]
    assert np.abs(masks.sum(axis=0) - 1.0).max() <= 1e-9


@settings(max_examples=100, deadline=None)
@given(_poses, _frusta, _cells)
def test_slices_side_by_side_make_the_undivided_frustum(pose, frustum, cells):
    whole = Frustum(frustum.hfov_deg, 1, frustum.projection)
    parts = slice_masks([pose], frustum, cells, "rays")[0].sum(axis=0)
    assert np.abs(parts - slice_masks([pose], whole, cells, "rays")[0, 0]).max() <= 1e-9


@settings(max_examples=100, deadline=None)
@given(_poses, _frusta, st.integers(1, 4), st.integers(1, 3))
def test_coarse_cells_are_means_of_fine_ones(pose, frustum, cells, factor):
    fine = slice_masks([pose], frustum, cells * factor)[0]
    pooled = fine.reshape(-1, cells, factor, cells, factor).mean(axis=(2, 4))
    assert np.abs(pooled - slice_masks([pose], frustum, cells)[0]).max() <= 1e-9


@pytest.mark.parametrize("tiny", [5e-324, 1e-323, 1e-310, 1e-300])
@pytest.mark.parametrize("projection", ["pinhole", "equirectangular"])
@pytest.mark.parametrize("bands", [(), (0.2,)])
def test_places_next_to_zero_are_zero(tiny, projection, bands):
    # A camera 1e-300 of the tile off its edge stands on it.
    frustum = Frustum(1.0, 2, projection, bands=bands)
    edge = np.array([[0.0, 0.5, 45], [0.5, 0.0, 135], [0.0, 0.0, 135], [0.0, 0.5, 135]])
    beside = np.where(edge == 0.0, tiny, edge)
    for engine in ("shapely", "rays"):
        expected = slice_masks(edge, frustum, 4, engine)
        assert np.abs(slice_masks(beside, frustum, 4, engine) - expected).max() <= 1e-12


@settings(max_examples=200, deadline=None)
@given(
    st.integers(1, 40), st.integers(1, 40), st.integers(1, 40),
    st.sampled_from(["centres", "endpoints"]), st.data(),
)  # fmt: skip
def test_a_pose_index_comes_back(rows, columns, headings, places, data):
    grid = PoseGrid(rows, columns, headings, extent=(0.1, 0.2, 0.7, 0.9), places=places)
    k = data.draw(st.integers(0, len(grid) - 1))
    row, column, heading = map(int, np.unravel_index(k, grid.shape))
    assert grid.index(row, column, heading) == k
    assert grid.poses(k, k + 1)[0].tolist() == [
        grid.u[column], grid.v[row], grid.headings_deg[heading],
    ]  # fmt: skip


@pytest.mark.slow
def test_engines_agree_on_20_000_random_poses():
    rng = np.random.default_rng(20)
    worst = 0.0
    for _ in range(1000):
        pinhole = rng.random() < 0.3
        frustum = Frustum(
            rng.uniform(1.0, 179.0 if pinhole else 360.0),
            int(rng.integers(1, 7)),
            "pinhole" if pinhole else "equirectangular",
        )
        poses = np.column_stack([rng.random((20, 2)), rng.uniform(0, 360, 20)])
        cells = int(rng.integers(1, 21))
        difference = slice_masks(poses, frustum, cells) - slice_masks(poses, frustum, cells, "rays")
        worst = max(worst, float(np.abs(difference).max()))
    assert worst <= 1e-9
