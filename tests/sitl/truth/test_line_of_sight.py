"""Exact lines of sight: hidden layers, grazing surface, limits of range and image."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sitl.camera.d435i import DEPTH_SPEC
from sitl.scene.scene import Scene
from sitl.truth.line_of_sight import LineOfSight

WALL = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def wall(z: float, half_m: float = 2.0) -> NDArray[np.float32]:
    """Return a square across the optical axis of a camera at the origin that looks along z."""
    corners = [(-half_m, -half_m, z), (half_m, -half_m, z), (half_m, half_m, z), (-half_m, half_m, z)]
    return np.array(corners, np.float32)


def sight(
    points: list[tuple[float, float, float]], normal: tuple[float, float, float], *walls: NDArray[np.float32]
) -> LineOfSight:
    vertices = np.concatenate(walls)
    faces = np.concatenate([WALL + 4 * i for i in range(len(walls))]).astype(np.int32)
    grey = np.full((len(vertices), 3), 128, np.uint8)
    scene = Scene("walls", vertices, faces, grey, 0.0, np.full(3, -9.0), np.full(3, 9.0), np.zeros(3))
    return LineOfSight(scene, np.array(points, np.float32), np.tile(np.array(normal, np.float32), (len(points), 1)))


def seen(what: LineOfSight, count: int) -> list[int]:
    return [int(i) for i in what.returns(np.arange(count), np.eye(4))]


def test_a_layer_behind_a_wall_is_hidden_at_any_distance() -> None:
    for gap_m, visible in ((0.01, [0]), (0.06, [0])):
        layers = sight([(0, 0, 2.0), (0, 0, 2.0 + gap_m)], (0, 0, -1), wall(2.0), wall(2.0 + gap_m))
        assert seen(layers, 2) == visible


def test_either_side_of_a_triangle_can_be_seen() -> None:
    for side in (-1.0, 1.0):
        assert seen(sight([(0.1, 0.1, 2.0)], (0, 0, side), wall(2.0)), 1) == [0]


@pytest.mark.parametrize(("z", "visible"), [(0.29, []), (0.31, [0]), (5.99, [0]), (6.01, [])])
def test_the_range_limits_are_those_of_the_camera(z: float, visible: list[int]) -> None:
    assert seen(sight([(0, 0, z)], (0, 0, -1), wall(z)), 1) == visible


def test_points_outside_the_image_are_not_seen() -> None:
    edge = (DEPTH_SPEC.width - 0.5 - DEPTH_SPEC.cx) / DEPTH_SPEC.fx * 2.0
    assert seen(sight([(edge - 0.01, 0, 2.0), (edge + 0.01, 0, 2.0)], (0, 0, -1), wall(2.0)), 2) == [0]


def test_grazing_surface_gives_no_return() -> None:
    """Points at one position whose normals are increasingly perpendicular to the ray."""
    for degrees, visible in ((75.0, [0]), (79.0, [0]), (81.0, []), (90.0, [])):
        tilt = np.radians(degrees)
        assert seen(sight([(0, 0, 2.0)], (float(np.sin(tilt)), 0, -float(np.cos(tilt))), wall(2.0)), 1) == visible
