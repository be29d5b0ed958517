from __future__ import annotations

import numpy as np
import pytest

from uav_recon.mapping.neural.sdf_numba.ray_rendering import EDGE_M, FARTHEST_M, render_rays
from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.types.frames import BoolArray, Float32Array

RADIUS_M = 2.0


def everywhere(points: Float32Array) -> BoolArray:
    return np.ones(len(points), dtype=np.bool_)


class Hollow(NumbaSdfField):
    """A spherical room around the origin; the colour of a point encodes its direction."""

    def __init__(self) -> None:
        """Skip the base class, which would make a grid."""

    def distance_m(self, points: Float32Array) -> Float32Array:
        distance: Float32Array = (RADIUS_M - np.linalg.norm(points, axis=1)).astype(np.float32)
        return distance

    def rgb(self, points: Float32Array) -> Float32Array:
        rgb: Float32Array = (0.5 + 0.5 * points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)
        return rgb


def test_rays_end_on_the_first_surface() -> None:
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(500, 3))
    direction = (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)
    origin = rng.uniform(-0.8, 0.8, (500, 3)).astype(np.float32)
    rgb, reach, found = render_rays(Hollow(), everywhere, origin, direction)
    assert found.all()
    along = np.einsum("nc,nc->n", origin, direction)
    exact = -along + np.sqrt(along**2 + RADIUS_M**2 - np.einsum("nc,nc->n", origin, origin))
    assert reach == pytest.approx(exact, abs=0.003)
    assert rgb == pytest.approx(0.5 + 0.5 * (origin + exact[:, None] * direction) / RADIUS_M, abs=0.002)


def test_a_ray_that_meets_nothing_is_black() -> None:
    class Air(Hollow):
        def distance_m(self, points: Float32Array) -> Float32Array:
            return np.full(len(points), 0.1, dtype=np.float32)

    ray = np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
    rgb, reach, found = render_rays(Air(), everywhere, 0 * ray, ray)
    assert not found.any()
    assert (rgb == 0).all()
    assert reach[0] == np.float32(FARTHEST_M)


def test_rays_pass_through_a_surface_without_measurements() -> None:
    class Onion(Hollow):
        """A thin shell of unmeasured surface at one metre, inside the room."""

        def distance_m(self, points: Float32Array) -> Float32Array:
            shell = np.abs(np.linalg.norm(points, axis=1) - 1.0) - 0.05
            nearer: Float32Array = np.minimum(super().distance_m(points), shell).astype(np.float32)
            return nearer

    def beyond(points: Float32Array) -> BoolArray:
        return np.asarray(np.linalg.norm(points, axis=1) > 1.5, dtype=np.bool_)

    ray = np.array([[1.0, 0.0, 0.0]], dtype=np.float32)
    assert render_rays(Onion(), everywhere, 0 * ray, ray)[1][0] == pytest.approx(0.95, abs=0.005)
    assert render_rays(Onion(), beyond, 0 * ray, ray)[1][0] == pytest.approx(RADIUS_M, abs=0.005)


def test_a_ray_along_an_edge_blends_foreground_and_background_equally() -> None:
    class Post(Hollow):
        """A red post 0.1 m wide, 1 m away along x, below the plane y = 0."""

        def distance_m(self, points: Float32Array) -> Float32Array:
            post = np.hypot(points[:, 0] - 1.0, points[:, 1] + 0.05) - 0.05
            nearer: Float32Array = np.minimum(super().distance_m(points), post).astype(np.float32)
            return nearer

        def rgb(self, points: Float32Array) -> Float32Array:
            red: Float32Array = np.array([1.0, 0.0, 0.0], dtype=np.float32) * (points[:, :1] < 1.5)
            return red

    y = np.array([-0.05, -3.0 * EDGE_M, 0.0, 3.0 * EDGE_M], dtype=np.float32)
    origin = np.stack([0 * y, y, 0 * y], axis=1)
    along = np.tile(np.array([[1.0, 0.0, 0.0]], dtype=np.float32), (len(y), 1))
    red = render_rays(Post(), everywhere, origin, along)[0][:, 0]
    assert red == pytest.approx([1.0, 1.0, 0.5, 0.0], abs=0.06)


def test_rendering_no_rays_returns_empty_arrays() -> None:
    none = np.zeros((0, 3), dtype=np.float32)
    assert render_rays(Hollow(), everywhere, none, none)[0].shape == (0, 3)
