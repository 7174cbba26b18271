"""Both engines on every slice of the paper's two test grids, in float64."""

import numpy as np
import pytest

from slicemask import Frustum, PoseGrid
from slicemask.bank.batches import GridSource
from slicemask.geometry.distinct import distinct_slices
from slicemask.geometry.masks import engine_fractions

BANKS = {
    "VIGOR": (PoseGrid.parse("21x21x64"), Frustum(360, 16), 28_224),
    "KITTI": (PoseGrid.parse("15x15x64"), Frustum(81.5, 16, "pinhole"), 230_400),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BANKS)
def test_engines_agree_on_every_sector(name):
    grid, frustum, rows = BANKS[name]
    found = slices = 0
    for batch in GridSource(grid).batches(most_poses=2000):
        distinct = distinct_slices(batch.u, batch.v, batch.place, batch.heading_deg, frustum)
        assert len(distinct.loose.shape) == 0
        wedges = distinct.wedges
        slices += len(wedges.sector)
        found += len(wedges.u)
        for start in range(0, len(wedges.u), 500):
            some = slice(start, start + 500)
            sectors = (
                wedges.u[some], wedges.v[some], wedges.left_deg[some], wedges.right_deg[some],
            )  # fmt: skip
            by_polygons, by_rays = (
                engine_fractions(engine)(*sectors, 32) for engine in ("shapely", "rays")
            )
            assert np.abs(by_polygons - by_rays).max() <= 1e-9
    assert slices == rows
    assert found < rows / 7
