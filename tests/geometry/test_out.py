"""slice_masks into an array that is there already."""

import numpy as np
import pytest

from slicemask import Frustum, slice_masks
from slicemask.errors import SpecError
from slicemask.geometry import masks as module

POSES = np.column_stack([*np.random.default_rng(0).random((2, 90)), np.arange(90) * 4.0])


@pytest.fixture(params=["compiled", "arrays"], autouse=True)
def loops(request, monkeypatch):
    """With numba and without."""
    if request.param == "arrays":
        monkeypatch.setattr(module, "_compiled", lambda: None)


@pytest.mark.parametrize("engine", ["rays", "shapely"])
@pytest.mark.parametrize(
    "frustum",
    [
        Frustum(),
        Frustum(300, 1),
        Frustum(bands=(0.1, 0.3, 2.0)),
        Frustum(80, 4, "pinhole", (0.1, 0.3)),
    ],
)
def test_masks_are_written_to_the_array(frustum, engine):
    poses = POSES if engine == "rays" else POSES[:6]
    out = np.full((len(poses), *frustum.mask_axes, 16, 16), np.nan)
    assert slice_masks(poses, frustum, 16, engine, out=out) is out
    assert np.array_equal(out, slice_masks(poses, frustum, 16, engine))


def test_poses_do_not_depend_on_their_company():
    frustum = Frustum(bands=(0.1, 0.3))
    whole = slice_masks(POSES, frustum, 16, "rays")
    alone = np.concatenate([slice_masks(pose[None], frustum, 16, "rays") for pose in POSES])
    assert np.abs(whole - alone).max() < 1e-12


@pytest.mark.parametrize(
    ("out", "said"),
    [
        (np.empty((90, 16, 16, 16), np.float32), "it must be float64"),
        (np.empty((89, 16, 16, 16)), "out is float64"),
        (np.empty((16, 90, 16, 16)).transpose(1, 0, 2, 3), "in C order"),
        ([], "it must be a NumPy array"),
    ],
)
def test_an_array_that_does_not_fit_is_refused(out, said):
    with pytest.raises(SpecError, match=said):
        slice_masks(POSES, Frustum(), 16, "rays", out=out)
