"""Masks written out by hand, in coordinates that binary holds exactly, compared with ==.

Both engines must give them. Cases are named by their geometry.
"""

import numpy as np
import pytest

from slicemask import Frustum, slice_masks

ENGINES = ("shapely", "rays")

# (u, v, heading_deg), hfov_deg, slices, masks
CASES = {
    "centre_facing_north_east_quarter": (
        (0.5, 0.5, 45.0),
        90.0,
        1,
        [[[0, 1], [0, 0]]],
    ),
    "centre_four_quarters_clockwise_from_behind": (
        (0.5, 0.5, 0.0),
        360.0,
        4,
        [
            [[0, 0], [1, 0]],  # slice 0 starts behind the camera: south to west
            [[1, 0], [0, 0]],
            [[0, 1], [0, 0]],
            [[0, 0], [0, 1]],
        ],
    ),
    "diagonals_from_the_centre_halve_the_corner_cells": (
        (0.5, 0.5, 0.0),
        90.0,
        1,
        [
            [
                [0.5, 1, 1, 0.5],
                [0, 0.5, 0.5, 0],
                [0, 0, 0, 0],
                [0, 0, 0, 0],
            ]
        ],
    ),
    "diagonal_from_a_corner_halves_the_diagonal_cells": (
        (0.0, 0.0, 112.5),
        45.0,
        1,
        [[[0.5, 1, 1, 1], [0, 0.5, 1, 1], [0, 0, 0.5, 1], [0, 0, 0, 0.5]]],
    ),
    "whole_circle_is_everything": (
        (0.25, 0.75, 33.0),
        360.0,
        1,
        [[[1, 1], [1, 1]]],
    ),
    "half_plane_through_cell_middles": (
        (0.25, 0.25, 90.0),
        180.0,
        1,
        [[[0.5, 1], [0.5, 1]]],
    ),
    "three_quarters_in_one_reflex_slice": (
        (0.5, 0.5, 0.0),
        270.0,
        1,
        [[[1, 1], [0.5, 0.5]]],
    ),
    "camera_inside_a_cell": (
        (0.25, 0.25, 45.0),
        90.0,
        2,
        [
            [[0.125, 0.0], [0, 0]],
            [[0.125, 0.5], [0, 0]],
        ],
    ),
    "standing_on_the_left_edge_looking_out": (
        (0.0, 0.5, 270.0),
        90.0,
        1,
        [[[0, 0], [0, 0]]],
    ),
    "standing_on_the_left_edge_looking_in": (
        (0.0, 0.5, 90.0),
        180.0,
        2,
        [
            [[1, 1], [0, 0]],
            [[0, 0], [1, 1]],
        ],
    ),
    "standing_on_a_corner_looking_out": (
        (1.0, 1.0, 135.0),
        90.0,
        1,
        [[[0, 0], [0, 0]]],
    ),
    "one_cell_only": (
        (0.5, 0.5, 0.0),
        180.0,
        2,
        [[[0.25]], [[0.25]]],
    ),
}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("case", CASES)
def test_masks_are_those_written_out(case, engine):
    pose, hfov_deg, slices, expected = CASES[case]
    expected = np.array(expected, dtype=float)
    masks = slice_masks([pose], Frustum(hfov_deg, slices), expected.shape[-1], engine)
    assert masks.dtype == np.float64
    assert masks[0].tolist() == expected.tolist()


@pytest.mark.parametrize("engine", ENGINES)
def test_pinhole_slices_have_equal_widths_in_the_image(engine):
    # A 90-degree pinhole on the south edge, facing north: at the tile's middle line its picture
    # is as wide as the tile, and the five slice edges meet that line at u = 0, 1/4, ..., 1.
    masks = slice_masks([[0.5, 1.0, 0.0]], Frustum(90.0, 4, "pinhole"), 4, engine)[0]
    left_half = [
        [[0.25, 0, 0, 0], [0.75, 0, 0, 0], [0.5, 0.25, 0, 0], [0, 0.25, 0, 0]],
        [[0.75, 1, 0, 0], [0.25, 1, 0, 0], [0, 0.75, 0, 0], [0, 0.25, 0, 0]],
    ]
    # The edges come from an arc tangent, which rounds.
    assert np.abs(masks[:2] - left_half).max() < 1e-15
    assert np.abs(masks[:1:-1, :, ::-1] - left_half).max() < 1e-15
