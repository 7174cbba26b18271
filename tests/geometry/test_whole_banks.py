"""Both engines on every slice of the paper's two test grids, in float64."""

import numpy as np
import pytest

from slicemask import Frustum, PoseGrid
from slicemask.bank.batches import GridSource
from slicemask.geometry.distinct import Shape, distinct_slices
from slicemask.geometry.masks import engine_fractions

BANKS = {
    "VIGOR": (PoseGrid.parse("21x21x64"), Frustum(360, 16), 28_224, 1e-9),
    "KITTI": (PoseGrid.parse("15x15x64"), Frustum(81.5, 16, "pinhole"), 230_400, 1e-9),
    "VIGOR with bands": (
        PoseGrid.parse("21x21x64"),
        Frustum(360, 16, bands=(0.08, 0.17, 0.33)),
        28_224,
        1e-6,
    ),
    "KITTI with bands": (
        PoseGrid.parse("15x15x64"),
        Frustum(81.5, 16, "pinhole", (0.06, 0.12, 0.24)),
        230_400,
        1e-9,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BANKS)
def test_engines_agree_on_every_sector(name):
    grid, frustum, rows, tolerance = BANKS[name]
    found = slices = 0
    for batch in GridSource(grid).batches(most_poses=2000):
        distinct = distinct_slices(batch.u, batch.v, batch.place, batch.heading_deg, frustum)
        assert (distinct.unanchored.shape == Shape.EMPTY).all()
        orbit = distinct.anchored
        slices += len(orbit.sector)
        found += len(orbit.u)
        for start in range(0, len(orbit.u), 500):
            some = slice(start, start + 500)
            sectors = (
                orbit.u[some], orbit.v[some], orbit.left_deg[some], orbit.right_deg[some],
                orbit.heading_deg[some],
            )  # fmt: skip
            by_polygons, by_rays = (
                engine_fractions(engine, frustum)(*sectors, 32) for engine in ("shapely", "rays")
            )
            assert np.abs(by_polygons - by_rays).max() <= tolerance
    assert slices == rows
    assert found < rows / 7
