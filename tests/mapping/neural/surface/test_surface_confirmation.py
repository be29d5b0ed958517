from __future__ import annotations

import numpy as np

from uav_recon.mapping.neural.keyframes import depth_visibility
from uav_recon.mapping.neural.surface.extraction import MeasuredCells, confirmed_by_depth
from uav_recon.types.frames import Float32Array

WALL_M = 1.52
LENS = np.array([40.0, 40.0, 19.5, 19.5])
MEASURED, BESIDE, BEHIND = [0.02, 0.02, WALL_M], [0.32, 0.32, WALL_M], [0.32, 0.32, WALL_M + 0.12]


def evidence() -> MeasuredCells:
    """Return the evidence of one end point, on a wall across the z axis."""
    found, one = MeasuredCells(np.array([-2.0, -2.0, 0.0]), np.array([2.0, 2.0, 3.0])), np.zeros(1, dtype=np.float32)
    found.add(np.zeros(3), as_array(MEASURED), as_array([0.0, 0.0, -1.0]), one, one)
    return found


def images(depth_m: float) -> depth_visibility.DepthVisibility:
    """Return one depth image, taken from the origin, of a wall at a distance."""
    found = depth_visibility.DepthVisibility()
    found.add(np.full((40, 40), depth_m, dtype=np.float32), LENS, np.eye(3), np.zeros(3), 0.001, np.ones(2))
    return found


def as_array(*rows: list[float]) -> Float32Array:
    return np.array(rows, dtype=np.float32)


def supported(depths: depth_visibility.DepthVisibility) -> list[bool]:
    points = as_array(MEASURED, BESIDE, BEHIND)
    facing = np.tile(as_array([0.0, 0.0, -1.0]), (3, 1))
    return [bool(it) for it in confirmed_by_depth(evidence(), depths, points, facing)]


def test_surface_is_confirmed_by_an_end_point_or_a_depth_image() -> None:
    assert supported(images(WALL_M)) == [True, True, False]  # nothing was seen behind the wall


def test_without_a_depth_image_only_end_points_confirm() -> None:
    assert supported(depth_visibility.DepthVisibility()) == [True, False, False]


def test_a_depth_image_that_sees_beyond_outweighs_an_end_point() -> None:
    assert supported(images(2.5)) == [False, False, False]
