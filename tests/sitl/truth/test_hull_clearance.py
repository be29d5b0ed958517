from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sitl.scene.mesh_sampling import F32, I32, area_weighted_samples, dense_points, height_below, row_points
from sitl.scene.scene import Scene
from sitl.truth.hull_clearance import CAP_M, HullClearance


def scene_of(vertices: list[list[float]], faces: list[list[int]]) -> Scene:
    points = np.array(vertices, np.float32)
    rgb = np.zeros((len(points), 3), np.uint8)
    return Scene("test", points, np.array(faces, np.int32), rgb, 0.0, points.min(axis=0), points.max(axis=0), np.zeros(3))


WALL = scene_of([[2, -3, -3], [2, 3, -3], [2, 3, 3], [2, -3, 3]], [[0, 1, 2], [0, 2, 3]])
FLOOR = scene_of([[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]], [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("x", [0.0, 0.79, 0.81, 1.0, 1.5, 1.7, 1.78])
def test_the_distance_to_a_wall_is_from_the_side_of_the_hull(x: float) -> None:
    assert HullClearance(WALL).hull_m((x, 0.33, 0.1)) == pytest.approx(min(1.8 - x, CAP_M), abs=0.002)


@pytest.mark.parametrize("z", [0.12, 0.15, 0.3, 1.0, 1.2])
def test_the_distance_to_the_floor_is_from_the_bottom_of_the_hull(z: float) -> None:
    assert HullClearance(FLOOR).hull_m((0.1, 0.2, z)) == pytest.approx(min(z - 0.1, CAP_M), abs=0.002)


def test_contact_is_zero_on_either_side_of_a_thin_wall() -> None:
    clearance = HullClearance(WALL)
    assert clearance.hull_m((1.81, 0, 0)) == 0.0
    assert clearance.hull_m((2.0, 0, 0)) == 0.0
    assert clearance.hull_m((2.3, 0, 0)) == pytest.approx(0.1, abs=0.005)


def test_the_distance_to_an_edge_above_and_beside_is_diagonal() -> None:
    """A shelf's edge is 0.3 m beside the hull's rim and 0.4 m above its top."""
    shelf = scene_of([[0.5, -1, 0.5], [1.5, -1, 0.5], [1.5, 1, 0.5], [0.5, 1, 0.5]], [[0, 1, 2], [0, 2, 3]])
    assert HullClearance(shelf).hull_m((0, 0, 0)) == pytest.approx(0.5, abs=0.002)


def test_far_outside_the_mesh_the_distance_is_capped() -> None:
    assert HullClearance(WALL).hull_m((-50.0, 80.0, 9.0)) == CAP_M


def test_batch_agrees_with_brute_force() -> None:
    rng = np.random.default_rng(3)
    corners = rng.uniform(-1.5, 1.5, (12, 1, 3)) + rng.normal(0, 0.2, (12, 3, 3))
    scene = scene_of(corners.reshape(-1, 3).tolist(), np.arange(36).reshape(-1, 3).tolist())
    positions = rng.uniform(-2.0, 2.0, (60, 3))
    i, j = (index.ravel() for index in np.meshgrid(np.arange(201), np.arange(201)))
    weights = np.stack([i, j, 200 - i - j], axis=1)[i + j <= 200] / 200.0
    points = np.einsum("wk,tkc->twc", weights, corners).reshape(-1, 3)
    d = points[None] - positions[:, None]
    radial = np.maximum(np.hypot(d[..., 0], d[..., 1]) - 0.2, 0)
    axial = np.maximum(np.abs(d[..., 2]) - 0.1, 0)
    expected = np.minimum(np.hypot(radial, axial).min(axis=1), CAP_M)
    clearance = HullClearance(scene)
    got = clearance.batch(positions)
    np.testing.assert_allclose(got, expected, atol=0.01)
    assert np.abs(got - expected)[expected > 0.1].max() < 0.006
    assert got[7] == clearance.hull_m(positions[7])


@pytest.mark.parametrize("z", [0.85, 0.9, 1.0, 3.0])
def test_the_vehicle_stands_on_the_surface_straight_below_its_centre(z: float) -> None:
    """Table of 0.75 m above a floor.

    The positions are above the table, beside it above the floor, and below the table top.
    """
    table = [[0.0, 0.0, 0.75], [1.0, 0.0, 0.75], [1.0, 1.0, 0.75], [0.0, 1.0, 0.75]]
    corners = FLOOR.vertices.tolist() + table
    clearance = HullClearance(scene_of(corners, [*FLOOR.faces.tolist(), [4, 5, 6], [4, 6, 7]]))
    assert clearance.standing_m((0.03, 0.5, z)) == pytest.approx(0.85, abs=1e-6)
    assert clearance.standing_m((-0.03, 0.5, z)) == pytest.approx(0.10, abs=1e-6)
    assert clearance.standing_m((0.5, 0.5, 0.8)) == pytest.approx(0.10, abs=1e-6)
    assert clearance.standing_m((9.0, 0.5, z)) == -math.inf


def test_the_standing_height_agrees_with_a_ray_straight_down() -> None:
    corners = np.array([[-2, -2, -0.4], [2, -2, 0.4], [2, 2, 0.6], [-2, 2, -0.2]], np.float32)
    scene = scene_of(corners.tolist(), [[0, 1, 2], [0, 2, 3]])
    clearance = HullClearance(scene)
    for x, y in np.random.default_rng(8).uniform(-1.9, 1.9, (200, 2)):
        below = height_below(scene.vertices, scene.faces, np.array([x, y, 2.0]))
        assert clearance.standing_m((x, y, 2.0)) - 0.1 == pytest.approx(below, abs=0.005)


@pytest.mark.parametrize("points", [dense_points, row_points])
def test_dense_points_leave_no_gap(points: Callable[[F32, I32, float], F32]) -> None:
    rng = np.random.default_rng(5)
    vertices = rng.uniform(-0.5, 0.5, (60, 3)).astype(np.float32)
    faces = np.arange(60, dtype=np.int32).reshape(-1, 3)
    everywhere, _ = area_weighted_samples(vertices, faces, 100_000, 2)
    distance, _ = cKDTree(points(vertices, faces, 0.01)).query(everywhere)
    assert distance.max() < 0.0135
    assert np.sqrt((distance**2).mean()) < 0.006


def test_samples_are_uniform_over_area() -> None:
    """A triangle of three times the area gets three times the points, all in its plane."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 5], [3, 0, 5], [0, 1, 5]], np.float32)
    points, _ = area_weighted_samples(vertices, np.array([[0, 1, 2], [3, 4, 5]], np.int32), 40_000, 9)
    upper = points[:, 2] > 2.5
    assert upper.mean() == pytest.approx(0.75, abs=0.01)
    np.testing.assert_allclose(points[~upper].mean(axis=0), (1 / 3, 1 / 3, 0), atol=0.01)
    assert (points[~upper, 0] + points[~upper, 1] <= 1 + 1e-5).all()


def test_height_below_returns_the_highest_surface_under_the_point() -> None:
    vertices = np.concatenate([FLOOR.vertices, FLOOR.vertices * 0.1 + np.array([0, 0, 0.7], np.float32)])
    faces = np.concatenate([FLOOR.faces, FLOOR.faces + 4])
    assert height_below(vertices, faces, np.array([0.1, 0.05, 1.0])) == pytest.approx(0.7)
    assert height_below(vertices, faces, np.array([0.1, 0.05, 0.5])) == pytest.approx(0.0)
    assert height_below(vertices, faces, np.array([1.0, 1.0, 1.0])) == pytest.approx(0.0)
    assert height_below(vertices, faces, np.array([9.0, 0.0, 1.0])) is None
    assert math.isclose(float(FLOOR.vertices[:, 2].max()), 0.0)


def test_a_scene_is_sampled_once_for_all_vehicles_in_it() -> None:
    scene = scene_of(FLOOR.vertices.tolist(), FLOOR.faces.tolist())
    assert HullClearance(scene, 0.2).bins is HullClearance(scene, 0.3).bins
    assert HullClearance(FLOOR).bins is not HullClearance(scene).bins
