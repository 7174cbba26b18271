"""The closed form on torch: same values, and gradients through u, v and heading."""

import array_api_strict
import numpy as np
import pytest

from slicemask import Frustum, PoseError, SpecError, slice_masks

torch = pytest.importorskip("torch")

FRUSTA = [Frustum(360, 5), Frustum(81.5, 4, "pinhole"), Frustum(300, 1), Frustum(360, 1)]


def _poses(count, seed):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.random((count, 2)), rng.uniform(0, 360, count)])


@pytest.mark.parametrize("frustum", FRUSTA)
def test_a_tensor_gives_the_masks_that_an_array_does(frustum):
    poses = _poses(20, 0)
    masks = slice_masks(torch.tensor(poses), frustum, 8, "rays")
    assert masks.dtype == torch.float64
    assert np.abs(masks.numpy() - slice_masks(poses, frustum, 8)).max() <= 1e-9
    single = slice_masks(torch.tensor(poses, dtype=torch.float32), frustum, 8, "rays")
    assert single.dtype == torch.float32
    # What rounding the poses moves the edges by: the arithmetic itself is in float64.
    rounded = poses.astype(np.float32).astype(np.float64)
    assert np.abs(single.numpy() - slice_masks(rounded, frustum, 8)).max() < 1e-7


@pytest.mark.parametrize("frustum", FRUSTA)
def test_gradients_are_those_of_finite_differences(frustum):
    # Random poses stand away from the kinks, where an edge passes over a lattice point.
    poses = torch.tensor(_poses(4, 1), requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda some: slice_masks(some, frustum, 6, "rays"), poses, eps=1e-7, atol=1e-5
    )


@pytest.mark.parametrize("heading", [0.0, 45.0, 90.0, 112.5, 202.5, 315.0])
def test_gradients_hold_where_an_edge_is_a_diagonal_or_along_the_axes(heading):
    # Nothing is special about these azimuths while no edge passes over a lattice point.
    poses = torch.tensor([[0.37, 0.41, heading]], dtype=torch.float64, requires_grad=True)
    for frustum in (Frustum(90, 1), Frustum(360, 16)):
        assert torch.autograd.gradcheck(
            lambda some, frustum=frustum: slice_masks(some, frustum, 5, "rays"),
            poses,
            eps=1e-7,
            atol=1e-5,
        )


@pytest.mark.parametrize("hfov", [180.0, 360.0])
def test_slices_a_hair_narrower_than_a_half_turn_are_whole(hfov):
    # Adding a heading to their edges rounds them to 180 degrees.
    poses = np.array([[0.5, 0.5, heading] for heading in np.arange(0.0, 360.0, 22.5)])
    for slices in {1, round(hfov / 180.0)}:
        frustum = Frustum(np.nextafter(hfov, 0.0), slices)
        masks = slice_masks(torch.tensor(poses), frustum, 4, "rays").numpy()
        assert np.abs(masks - slice_masks(poses, frustum, 4)).max() <= 1e-9


def test_a_slice_that_misses_the_tile_is_empty_and_not_noise():
    # From the tile's edge, looking away from it.
    rng = np.random.default_rng(3)
    poses = np.column_stack([rng.random(200), np.zeros(200), rng.uniform(-40, 40, 200)])
    frustum = Frustum(81.5, 16, "pinhole")
    masks = slice_masks(torch.tensor(poses), frustum, 16, "rays")
    assert torch.equal(masks == 0, torch.tensor(slice_masks(poses, frustum, 16) == 0))
    assert (masks == 0).all(dim=(2, 3)).sum() > 2000


@pytest.mark.parametrize("dtype", [torch.int64, torch.float16])
def test_tensors_that_are_not_fine_enough_are_refused(dtype):
    with pytest.raises(PoseError, match="float32 or float64"):
        slice_masks(torch.zeros((1, 3), dtype=dtype), Frustum(), 4, "rays")


@pytest.mark.parametrize(
    "pose", [[0.5, 0.5, 0.0], [0.0, 0.0, 45.0], [0.25, 1.0, 90.0], [0.5, 0.25, 180.0]]
)
def test_gradients_are_finite_at_the_kinks(pose):
    poses = torch.tensor([pose], dtype=torch.float64, requires_grad=True)
    masks = slice_masks(poses, Frustum(360, 8), 4, "rays")
    weights = torch.arange(masks.numel(), dtype=torch.float64).reshape(masks.shape)
    (masks * weights).sum().backward()
    assert torch.isfinite(poses.grad).all()


def test_turning_the_camera_moves_area_from_slice_to_slice():
    poses = torch.tensor([[0.4, 0.6, 10.0]], dtype=torch.float64, requires_grad=True)
    areas = slice_masks(poses, Frustum(90, 2), 16, "rays")[0].mean(dim=(1, 2))
    (turned,) = torch.autograd.grad(areas.sum(), poses)
    # The change of a sector's area with heading is (r_right^2 - r_left^2) / 2 per radian, with r
    # the lengths of its outer edges within the tile.
    heading = np.radians(10.0)
    right, left = heading + np.pi / 4, heading - np.pi / 4
    r_right = min(0.6 / np.sin(right), 0.6 / np.cos(right))
    r_left = min(0.4 / -np.sin(left), 0.6 / np.cos(left))
    expected = (r_right**2 - r_left**2) / 2 * np.pi / 180
    assert turned[0, 2].item() == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("frustum", FRUSTA)
def test_nothing_but_the_array_api_standard_is_used(frustum):
    poses = _poses(40, 2)
    masks = slice_masks(array_api_strict.asarray(poses), frustum, 9, "rays")
    assert np.abs(np.asarray(masks) - slice_masks(poses, frustum, 9)).max() <= 1e-9


def test_tensors_that_are_no_poses():
    with pytest.raises(PoseError, match="pose 1 is outside the tile"):
        slice_masks(torch.tensor([[0.5, 0.5, 0.0], [0.5, 2.0, 0.0]]), Frustum(), 4, "rays")
    with pytest.raises(PoseError, match=r"shape \[3\]"):
        slice_masks(torch.zeros(3), Frustum(), 4, "rays")
    with pytest.raises(SpecError, match="takes NumPy arrays"):
        slice_masks(torch.zeros(1, 3), Frustum(), 4)
