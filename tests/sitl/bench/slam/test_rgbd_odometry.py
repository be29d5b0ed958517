from __future__ import annotations

import math

import numpy as np
import pytest

from sitl.bench.slam import rgbd_odometry
from sitl.bench.slam.rgbd_odometry import RgbdOdometry, registered_depth_m
from sitl.camera.d435i import MOUNT_M, SimulatedD435i
from sitl.geometry.transform import body_from_camera, world_from_body
from sitl.scene.rasterizer import Renderer
from sitl.scene.scene import load_scene
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.pose import Pose

PITCH_RAD = math.radians(15.0)


def frames(bodies: list[np.ndarray]) -> list[Frame]:
    scene = load_scene(None)
    camera = SimulatedD435i(Renderer(scene.vertices, scene.faces, scene.rgb), noise="none")
    header = camera.header
    depth, rgb = (Intrinsics(s.fx, s.fy, s.cx, s.cy, s.width, s.height) for s in (header.depth, header.rgb))
    shift = Pose(np.array(header.rgb_from_depth[:4]), np.array(header.rgb_from_depth[4:]))
    made = []
    for n, body in enumerate(bodies):
        depth_mm, image = camera.capture(body, PITCH_RAD)
        depth_m = np.where(depth_mm > 0, 1e-3 * depth_mm, np.nan).astype(np.float32)
        made.append(Frame(10.0 + n / 15.0, n, depth_m, depth, image, rgb, shift))
    return made


def test_it_follows_the_body_with_its_mount() -> None:
    bodies = [world_from_body([0.03 * n, 0.01 * n, 1.0], math.radians(1.5 * n)) for n in range(6)]
    odometry, mount = RgbdOdometry(), Pose.from_matrix(body_from_camera(MOUNT_M, PITCH_RAD))
    for body, frame in zip(bodies, frames(bodies), strict=True):
        found = odometry.track(frame, mount)
        assert found is not None
        assert found.quality > 30
        truly = np.linalg.inv(bodies[0]) @ body
        assert found.odom_from_body.translation_m == pytest.approx(truly[:3, 3], abs=0.012)
        assert math.degrees(found.odom_from_body.yaw_rad()) == pytest.approx(1.5 * frame.sequence, abs=0.4)


def test_a_covered_camera_is_lost_and_the_next_image_is_matched_with_the_last_good_one() -> None:
    bodies = [world_from_body([0.03 * n, 0.0, 1.0], 0.0) for n in range(3)]
    first, middle, last = frames(bodies)
    nothing = Frame(
        middle.stamp_s, 1, np.full_like(middle.depth_m, np.nan), middle.depth_intrinsics, np.zeros_like(middle.rgb),
        middle.rgb_intrinsics, middle.rgb_from_depth,
    )  # fmt: skip
    odometry, mount = RgbdOdometry(), Pose.from_matrix(body_from_camera(MOUNT_M, PITCH_RAD))
    odometry.track(first, mount)
    lost, back = odometry.track(nothing, mount), odometry.track(last, mount)
    assert lost is not None
    assert lost.quality == 0
    assert back is not None
    assert back.quality > 30
    assert back.odom_from_body.translation_m == pytest.approx([0.06, 0.0, 0.0], abs=0.012)


def test_motion_of_the_colour_imager_becomes_that_of_the_body(monkeypatch: pytest.MonkeyPatch) -> None:
    lens = Intrinsics.from_fov(8, 6, 1.2, 0.9)
    away = Pose.from_rotation_vector(np.array([0.0, 0.2, 0.0]), np.array([0.5, 0.1, 0.0]))
    frame = Frame(0.0, 0, np.ones((6, 8), np.float32), lens, np.zeros((6, 8, 3), np.uint8), lens, away)
    body_from_depth = Pose.from_matrix(body_from_camera(MOUNT_M, PITCH_RAD))
    body_moves = Pose.from_yaw(1.0, np.array([0.3, 0.2, 0.1]))
    body_from_rgb = body_from_depth.matrix() @ np.linalg.inv(away.matrix())
    rgb_moves = Pose.from_matrix(np.linalg.inv(body_from_rgb) @ body_moves.matrix() @ body_from_rgb)
    monkeypatch.setattr(rgbd_odometry, "_motion", lambda *_: (0.8, rgb_moves))
    odometry = RgbdOdometry()
    odometry.track(frame, body_from_depth)
    for turns in (1, 2):
        found = odometry.track(frame, body_from_depth)
        assert found is not None
        assert found.odom_from_body.matrix() == pytest.approx(np.linalg.matrix_power(body_moves.matrix(), turns), abs=1e-9)
        assert found.quality == 80


def test_the_nearest_return_is_seen_where_several_fall_into_one_pixel() -> None:
    rng = np.random.default_rng(0)
    depth_m = rng.choice(np.array([1.0, 2.0, 3.0], np.float32), (22, 30))
    fine, coarse = Intrinsics.from_fov(30, 22, 1.0, 0.8), Intrinsics.from_fov(20, 15, 1.0, 0.8)
    image = registered_depth_m(Frame(0.0, 0, depth_m, fine, np.zeros((15, 20, 3), np.uint8), coarse, Pose.identity()))
    u, v = np.meshgrid(np.arange(30), np.arange(22))
    column = np.floor(coarse.fx * (u - fine.cx) / fine.fx + coarse.cx).astype(int)
    row = np.floor(coarse.fy * (v - fine.cy) / fine.fy + coarse.cy).astype(int)
    inside = (column >= 0) & (column < 20) & (row >= 0) & (row < 15)
    nearest = np.full((15, 20), np.inf)
    np.minimum.at(nearest, (row[inside], column[inside]), depth_m[inside])
    assert (image <= nearest).all(), "a neighbour's return may lie before it, never behind it"
    assert (image == nearest).mean() > 0.3


def test_registered_depth_is_the_depth_of_the_colour_pixels() -> None:
    lens = Intrinsics.from_fov(40, 30, 1.2, 0.9)
    narrow = Intrinsics.from_fov(40, 30, 0.8, 0.6)
    depth_m = np.full((30, 40), 3.0, np.float32)
    depth_m[10:20, 15:25] = 1.0
    depth_m[0] = np.nan
    shift = Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.1, 0.0, 0.0]))
    image = registered_depth_m(Frame(0.0, 0, depth_m, lens, np.zeros((30, 40, 3), np.uint8), narrow, shift))
    assert set(np.unique(image)) <= {np.float32(0.0), np.float32(1.0), np.float32(3.0)}
    u, v = np.meshgrid(np.arange(40), np.arange(30))
    for depth in (1.0, 3.0):
        seen = image == depth
        back = (u[seen] - narrow.cx) / narrow.fx * depth - 0.1, (v[seen] - narrow.cy) / narrow.fy * depth
        source = np.rint(lens.fx * back[0] / depth + lens.cx), np.rint(lens.fy * back[1] / depth + lens.cy)
        close = [
            np.isin(depth, depth_m[max(int(y) - 1, 0) : int(y) + 2, max(int(x) - 1, 0) : int(x) + 2])
            for x, y in zip(*source, strict=True)
        ]
        assert np.mean(close) == 1.0
    assert (image > 0).mean() > 0.9
