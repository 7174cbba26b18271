"""Other ways to the same masks: a plain Shapely loop, and exactextract."""

import time

import numpy as np
import shapely
from exactextract import exact_extract
from exactextract.raster import NumPyRasterSource

from slicemask.geometry.coverage import cell_boxes, sector_polygons


def random_slices(count: int, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Slices of the default bank, drawn at random: u, v, left_deg, right_deg [count]."""
    rng = np.random.default_rng(seed)
    u, v = (rng.integers(0, 21, (2, count)) + 0.5) / 21
    left_deg = rng.integers(0, 64, count) * 5.625
    return u, v, left_deg, left_deg + 22.5


def plain_loop_seconds(count: int, cells: int = 32) -> float:
    """Seconds a mask of ``polygon.intersection(cell).area`` over every cell, in a Python loop."""
    boxes = cell_boxes(np.arange(cells**2), cells)
    polygons = sector_polygons(*random_slices(count))
    start = time.perf_counter()
    for polygon in polygons:
        for box in boxes:
            polygon.intersection(box).area  # noqa: B018
    return (time.perf_counter() - start) / count


def exactextract_masks(count: int, cells: int = 32) -> tuple[float, np.ndarray]:
    """Processor seconds a mask of exactextract's coverage, and the masks [count, L, L]."""
    raster = NumPyRasterSource(np.zeros((cells, cells)), xmin=0, ymin=0, xmax=1, ymax=1)
    tile = shapely.box(0, 0, 1, 1)
    polygons = shapely.intersection(sector_polygons(*random_slices(count)), tile)
    # Its rows count down from y = 1, so v is 1 - y.
    features = [
        {
            "type": "Feature",
            "properties": {},
            "geometry": shapely.geometry.mapping(
                shapely.transform(polygon, lambda xy: np.c_[xy[:, 0], 1 - xy[:, 1]])
            ),
        }
        for polygon in polygons
    ]
    start = time.process_time()
    found = exact_extract(raster, features, ["cell_id", "coverage"])
    seconds = (time.process_time() - start) / count
    masks = np.zeros((count, cells * cells))
    for mask, feature in zip(masks, found, strict=True):
        mask[feature["properties"]["cell_id"]] = feature["properties"]["coverage"]
    return seconds, masks.reshape(count, cells, cells)
