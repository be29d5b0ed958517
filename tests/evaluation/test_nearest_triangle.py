"""The box tree against numbers worked out by hand and against trimesh's brute force."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from uav_recon.evaluation.nearest_triangle import TriangleIndex, warm_up


def test_distances_to_one_triangle_worked_out_by_hand() -> None:
    index = TriangleIndex(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    points = np.array(
        [
            [0.2, 0.2, 0.5],  # over the face
            [-3.0, -4.0, 0.0],  # corner a
            [2.0, 0.0, 0.0],  # corner b
            [0.0, 3.0, 0.0],  # corner c
            [0.5, -0.25, 0.0],  # edge ab
            [-0.25, 0.5, 0.0],  # edge ac
            [1.0, 1.0, 0.0],  # edge bc
        ]
    )
    assert index.distance(points) == pytest.approx([0.5, 5.0, 1.0, 2.0, 0.25, 0.25, np.sqrt(0.5)])


def test_agrees_with_brute_force_on_a_random_soup() -> None:
    rng = np.random.default_rng(3)
    vertices = rng.uniform(-2, 2, (600, 3)) * [1.0, 1.0, 0.2]
    faces = rng.integers(0, 600, (300, 3))
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])]
    points = rng.uniform(-3, 3, (200, 3))
    found = TriangleIndex(vertices, faces).distance(points)
    for point, distance in zip(points, found, strict=True):
        nearest = trimesh.triangles.closest_point(vertices[faces], np.repeat(point[None], len(faces), axis=0))
        assert distance == pytest.approx(np.linalg.norm(nearest - point, axis=1).min(), abs=1e-9)


def test_degenerate_triangles_are_segments_and_points() -> None:
    index = TriangleIndex(np.array([[0.0, 0, 0], [2, 0, 0], [1, 0, 0], [0, 5, 0]]), np.array([[0, 1, 2], [3, 3, 3]]))
    assert index.distance(np.array([[1.5, 1.0, 0.0], [0.0, 7.0, 0.0]])) == pytest.approx([1.0, 2.0])


def test_a_point_on_the_surface_is_at_zero() -> None:
    box = trimesh.creation.box((1, 1, 1)).subdivide().subdivide()
    assert TriangleIndex(box.vertices, box.faces).distance(box.triangles_center).max() < 1e-9


def test_refuses_what_has_no_distance() -> None:
    with pytest.raises(ValueError, match="finite triangles"):
        TriangleIndex(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    with pytest.raises(ValueError, match="finite triangles"):
        TriangleIndex(np.full((3, 3), np.nan), np.array([[0, 1, 2]]))
    with pytest.raises(ValueError, match="not finite"):
        TriangleIndex(np.eye(3), np.array([[0, 1, 2]])).distance(np.array([[np.nan, 0, 0]]))


def test_warm_up_compiles() -> None:
    warm_up()
