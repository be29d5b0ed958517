"""Captures of a scene: consistent with their poses and repeatable for a seed.

The points that they saw are known.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from sitl.apps.scene_captures import capture, held_out_pixels, seen
from sitl.camera.camera_errors import CameraErrors
from sitl.camera.d435i import stream_header
from sitl.scene.scene import Scene

HALF_M = 1.5
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32) * np.float32(HALF_M)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
POSITIONS = np.array([[0.0, 0.0, 0.0], [0.2, -0.1, 0.1]], np.float32)


def box() -> Scene:
    """Return a closed cube in which each wall has one colour: its number times 40."""
    vertices = np.concatenate([CORNERS[list(quad)] for quad in QUADS])
    faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * n for n in range(6)]).astype(np.int32)
    rgb = np.repeat(np.arange(6) * 40, 4).astype(np.uint8)[:, None].repeat(3, axis=1)
    return Scene("box", vertices, faces, rgb, 0.0, np.full(3, -HALF_M), np.full(3, HALF_M), np.zeros(3))


def test_depth_ends_on_the_walls() -> None:
    taken = capture(box(), POSITIONS, 0.2, "wide", "none", 5, 3)
    lens = taken.header.depth
    for depth_mm, pose in zip(taken.depth_mm, taken.world_from_depth, strict=True):
        v, u = np.nonzero(depth_mm)
        z = depth_mm[v, u] * 1e-3
        points = np.stack([(u - lens.cx) / lens.fx * z, (v - lens.cy) / lens.fy * z, z], axis=1)
        world = points @ pose[:3, :3].T + pose[:3, 3]
        assert len(u) > 50_000
        assert np.abs(np.abs(world).max(axis=1) - HALF_M).max() < 2e-3
        away_m = np.linalg.norm(pose[:3, 3] - POSITIONS, axis=1).min()
        assert away_m == pytest.approx(0.10)  # the camera is 0.10 m in front of the body


def test_equal_seeds_give_equal_captures_and_others_do_not() -> None:
    first, again, other = (capture(box(), POSITIONS, None, "d435i", "d435i", 3, seed) for seed in (1, 1, 2))
    assert np.array_equal(first.depth_mm, again.depth_mm)
    assert np.array_equal(first.world_from_depth, again.world_from_depth)
    assert not np.array_equal(first.world_from_depth, other.world_from_depth)


def test_captures_with_camera_errors_have_the_poses_of_the_exact_camera() -> None:
    """What the images show is off, what the benchmark is told is not."""
    exact = capture(box(), POSITIONS, 0.2, "d435i", "none", 3, 3)
    off = capture(box(), POSITIONS, 0.2, "d435i", "none", 3, 3, CameraErrors.drawn(3))
    again = capture(box(), POSITIONS, 0.2, "d435i", "none", 3, 3, CameraErrors.drawn(3))
    np.testing.assert_array_equal(exact.world_from_depth, off.world_from_depth)
    assert exact.header == off.header
    for a, b, c in ((exact.depth_mm, off.depth_mm, again.depth_mm), (exact.rgb, off.rgb, again.rgb)):
        assert (a != b).mean() > 0.3
        np.testing.assert_array_equal(b, c)


def test_a_gimbal_has_many_pitch_angles_and_a_fixed_mount_one() -> None:
    for pitch, spread in ((None, 0.1), (0.3, None)):
        poses = capture(box(), POSITIONS, pitch, "d435i", "none", 12, 0).world_from_depth
        down = np.arcsin(-poses[:, 2, 2])
        if spread is None:
            assert np.allclose(down, 0.3)
        else:
            assert down.std() > spread


def test_points_behind_the_camera_are_not_seen() -> None:
    taken = capture(box(), POSITIONS[:1], 0.0, "d435i", "none", 1, 0)
    ahead = taken.world_from_depth[0, :3, 2]
    wall = ahead * (HALF_M / np.abs(ahead).max())
    normal = np.where(np.abs(ahead) == np.abs(ahead).max(), np.sign(ahead), 0.0)
    points, normals = np.array([wall, -wall], np.float32), np.array([normal, -normal], np.float32)
    looks, coloured = seen(box(), taken, points, normals)
    assert looks.tolist() == [1, 0]
    assert coloured.tolist() == [True, False]


def test_colour_is_narrower_than_depth() -> None:
    scene = box()
    taken = capture(scene, POSITIONS[:1], 0.0, "d435i", "none", 1, 0)
    pose, lens = taken.world_from_depth[0], taken.header.depth
    bearing = np.array([(3.0 - lens.cx) / lens.fx, 0.02, 1.0])
    direction = pose[:3, :3] @ bearing
    reach = (np.sign(direction) * HALF_M - pose[:3, 3]) / direction
    axis = int(np.argmin(reach))
    point = pose[:3, 3] + reach[axis] * direction
    looks, coloured = seen(scene, taken, point[None].astype(np.float32), np.eye(3, dtype=np.float32)[axis][None])
    assert looks[0] == 1
    assert not coloured[0]


def test_held_out_pixels_have_the_colour_of_the_wall_that_their_rays_meet() -> None:
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looks along x
    spec = stream_header("d435i").rgb
    pixels = held_out_pixels(box(), pose[None], spec, 8)
    assert len(pixels.rgb) == math.ceil((spec.width - 4) / 8) * math.ceil((spec.height - 4) / 8)
    reach = np.einsum("nc,nc->n", pixels.point - pixels.origin, pixels.direction)
    assert np.allclose(pixels.origin + reach[:, None] * pixels.direction, pixels.point, atol=1e-5)
    assert np.abs(np.abs(pixels.point).max(axis=1) - HALF_M).max() < 1e-4
    ahead = pixels.point[:, 0] > HALF_M - 1e-4
    assert ahead.mean() > 0.5
    assert (pixels.rgb[ahead] == 40).all()
    assert (pixels.picture == 0).all()
