"""Sampling points from a triangle surface."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.evaluation.triangle_surface import TriangleSurface


def two_squares() -> TriangleSurface:
    """Return a unit square at z = 0 and, far away, one of area 3 at z = 1: shares 1/4 and 3/4."""
    s = np.sqrt(3.0)
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    vertices = np.concatenate([square, square * s + [10, 0, 1]])
    return TriangleSurface(vertices, np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]))


def test_samples_follow_the_area() -> None:
    points = two_squares().sample(40_000, seed=1)
    assert np.mean(points[:, 2] > 0.5) == pytest.approx(0.75, abs=1e-3)
    first = points[points[:, 2] < 0.5]
    assert first[:, :2].mean(axis=0) == pytest.approx([0.5, 0.5], abs=0.02)
    assert np.histogram(first[:, 0], 4, (0, 1))[0] == pytest.approx([2500] * 4, rel=0.08)  # uniform, not clustered
    assert first[:, :2].min() >= 0 and first[:, :2].max() <= 1 + 1e-12


def test_equal_seeds_give_equal_samples() -> None:
    surface = two_squares()
    assert np.array_equal(surface.sample(100, 5), surface.sample(100, 5))
    assert not np.array_equal(surface.sample(100, 5), surface.sample(100, 6))


def test_areas() -> None:
    assert two_squares().areas_m2() == pytest.approx([0.5, 0.5, 1.5, 1.5])


def test_an_empty_surface_is_at_infinite_distance() -> None:
    nothing = TriangleSurface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    assert nothing.sample(10, 0).shape == (0, 3)
    assert np.isinf(nothing.distance_m(np.zeros((2, 3)))).all()


def test_a_face_with_a_missing_vertex_is_refused() -> None:
    with pytest.raises(ValueError, match="0 to 3 of 3"):
        TriangleSurface(np.zeros((3, 3)), np.array([[0, 1, 3]]))
