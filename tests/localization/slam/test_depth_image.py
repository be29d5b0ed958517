"""Depth image of the tracker: mean depths of cells, and normals of planes, edges and noisy walls."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from textured_room import LENS, frame_of

from uav_recon.localization.slam.depth_image import REACH_M, WIDTH, DepthImage, cell_depths, grid_points, write_normals
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray
from uav_recon.types.pose import Pose


def _plane_depth(normal: FloatArray, away_m: float) -> Float32Array:
    """Depth (H, W) of the plane normal . p = away_m in the camera's frame, NaN where it is not in front."""
    with np.errstate(divide="ignore"):
        depth = away_m / (LENS.bearings() @ normal)
    return np.where((depth > 0.0) & (depth < REACH_M), depth, np.nan).astype(np.float32)


def _normals(image: DepthImage) -> AnyArray:
    out = np.zeros((*image.depth_m.shape, 3), np.float32)
    write_normals(image.depth_m, image.camera, out)
    return out


@settings(max_examples=25, deadline=None)
@given(tilt=st.floats(0.0, math.radians(70.0)), around=st.floats(-math.pi, math.pi), away=st.floats(0.5, 2.0))
def test_normals_of_a_plane_are_its_own_towards_the_camera(tilt: float, around: float, away: float) -> None:
    across = math.sin(tilt)
    normal = np.array([across * math.cos(around), across * math.sin(around), math.cos(tilt)])
    found = _normals(DepthImage.of(frame_of(0.0, _plane_depth(normal, away * math.cos(tilt)))))
    shown = found[found[..., 2] != 0.0]
    assert len(shown) > 0.2 * found[..., 2].size
    np.testing.assert_allclose(shown, np.tile(-normal, (len(shown), 1)), atol=0.02)


def test_an_edge_has_no_normal() -> None:
    depth = np.full((LENS.height, LENS.width), 3.0, np.float32)
    middle = LENS.width // 2
    depth[:, :middle] = 1.5
    found = _normals(DepthImage.of(frame_of(0.0, depth)))
    assert not found[:, middle - 1 : middle + 1].any()
    np.testing.assert_allclose(found[LENS.height // 2, [20, -20]], [[0.0, 0.0, -1.0]] * 2, atol=0.01)


@pytest.mark.parametrize("away_m", [0.6, 1.5, 2.5])
def test_a_noisy_plain_wall_says_next_to_nothing_of_the_way_along_it(away_m: float) -> None:
    """Noise as of a D435i; single normals scatter by several degrees, and would seem to show the place."""
    noise = np.random.default_rng(3).standard_normal((LENS.height, LENS.width))
    depth = (away_m + (0.001 + 0.0019 * away_m**2) * noise).astype(np.float32)
    found = _normals(DepthImage.of(frame_of(0.0, depth)))
    shown = found[found[..., 2] != 0.0].astype(np.float64)
    values = np.linalg.eigvalsh(shown.T @ shown)
    assert values[1] < 0.003 * values[2]


def test_two_walls_keep_their_normals_beside_the_corner() -> None:
    """The mean of normals is not taken across it."""
    left, right = np.array([math.sqrt(0.5), 0.0, -math.sqrt(0.5)]), np.array([-math.sqrt(0.5), 0.0, -math.sqrt(0.5)])
    bearings = LENS.bearings()
    depth = np.minimum(1.2 / np.maximum(-bearings @ left, 1e-3), 1.2 / np.maximum(-bearings @ right, 1e-3)).astype(np.float32)
    found = _normals(DepthImage.of(frame_of(0.0, depth)))[LENS.height // 2]
    middle = LENS.width // 2
    np.testing.assert_allclose(found[middle - 12], found[middle // 2], atol=0.05)
    np.testing.assert_allclose(found[middle + 12], found[middle + middle // 2], atol=0.05)
    assert abs(float(found[middle - 12] @ found[middle + 12])) < 0.1


def test_a_cell_holds_the_mean_of_its_nearest_surface() -> None:
    depth = np.array([[1.0, 1.01, 2.0, np.nan], [3.0, 1.02, np.inf, -1.0], [0.0, np.nan, 5.0, 9.0], [0.0, 0.0, 4.9, 6.0]])
    out = cell_depths(depth.astype(np.float32), 2, np.full((2, 2), -1.0, np.float32))
    np.testing.assert_allclose(out, [[1.01, 2.0], [0.0, 0.0]], rtol=1e-6)


@pytest.mark.parametrize(("width", "height"), [(212, 120), (424, 240), (640, 480), (848, 480)])
def test_the_smaller_image_keeps_the_rays_of_the_frame(width: int, height: int) -> None:
    lens = Intrinsics.from_fov(width, height, 1.2, 0.8)
    frame = Frame(0.0, 0, np.full((height, width), 2.0, np.float32), lens, np.zeros((2, 2, 3), np.uint8), lens, Pose.identity())
    image = DepthImage.of(frame)
    rows, columns = image.depth_m.shape
    cell = width // columns
    assert columns <= WIDTH
    # the middle of a cell is that of its pixels
    x = (10 - image.camera[2]) / image.camera[0]
    assert x == pytest.approx((10 * cell + (cell - 1) / 2 - lens.cx) / lens.fx)
    y = (rows - 1 - image.camera[3]) / image.camera[1]
    assert y == pytest.approx(((rows - 1) * cell + (cell - 1) / 2 - lens.cy) / lens.fy)


def test_grid_points_lie_on_the_rays_of_their_pixels() -> None:
    depth = np.full((60, 100), 2.0, np.float32)
    depth[:, :40] = 0.0
    camera = np.array([80.0, 80.0, 49.5, 29.5])
    points = grid_points(depth, camera, 400)
    assert 100 < len(points) <= 400
    u, v = (points[:, :2] / points[:, 2:] * camera[:2] + camera[2:]).T
    np.testing.assert_allclose(u, np.rint(u), atol=1e-9)
    assert u.min() >= 40.0
    assert v.max() < 60.0
    assert not len(grid_points(np.zeros((60, 100), np.float32), camera, 400))
