"""Rooms of boxes, painted or bare, and a D435i's two cameras that see them from poses that are right or drift."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sitl.scene.texture import noise
from uav_recon.types.camera import Frame, Intrinsics, body_from_camera
from uav_recon.types.frames import ByteArray, Float32Array, FloatArray
from uav_recon.types.pose import Pose

LENS = Intrinsics.from_fov(212, 120, 1.52, 1.01)
RGB_LENS = Intrinsics.from_fov(212, 120, 1.20, 0.73)
CAMERA = np.array([LENS.fx, LENS.fy, LENS.cx, LENS.cy])
RGB_FROM_DEPTH = Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.015, 0.0, 0.0]))
BODY_FROM_DEPTH = body_from_camera(np.zeros(3), 0.26)
NOISE_PER_M = 0.005  # of depth, per square of the range
GONE_M = 6.0
BARE: ByteArray = np.zeros((2, 4, 3), np.uint8)

Paint = Callable[[FloatArray], FloatArray]


def camera_at(x: float, y: float, z: float, yaw_rad: float) -> Pose:
    """The depth camera's pose."""
    return Pose.from_yaw(yaw_rad, np.array([x, y, z])) @ BODY_FROM_DEPTH


def moved(pose: Pose, by_m: FloatArray) -> Pose:
    return Pose(pose.quat_wxyz, pose.translation_m + by_m)


def depth_of(odom_from_depth: Pose, room_m: FloatArray, *boxes_m: FloatArray, seed: int = 0) -> Float32Array:
    """With the noise of a stereo camera: out of the room, and into boxes (2, 3)."""
    depth = ranges_m(odom_from_depth, LENS, room_m, boxes_m)
    depth = 1.0 / (1.0 / depth + NOISE_PER_M * np.random.default_rng(seed).standard_normal(depth.shape))
    return np.where(depth < GONE_M, depth, np.nan).astype(np.float32)


def rgb_of(
    odom_from_depth: Pose, paint: Paint, room_m: FloatArray, *boxes_m: FloatArray, seed: int = 0, lens: Intrinsics = RGB_LENS
) -> ByteArray:
    """With the noise of a small sensor. paint: brightness (N,) in 0..1 of points (N, 3)."""
    pose = odom_from_depth @ RGB_FROM_DEPTH.inverse()
    depth = ranges_m(pose, lens, room_m, boxes_m)
    points = (depth[..., None] * lens.bearings()) @ pose.rotation().T + pose.translation_m
    grey = 255.0 * paint(points.reshape(-1, 3)).reshape(depth.shape)
    grey += 2.0 * np.random.default_rng(seed).standard_normal(depth.shape)
    return np.repeat(np.clip(grey, 0.0, 255.0).astype(np.uint8)[..., None], 3, axis=2)


def plaster(points: FloatArray) -> FloatArray:
    """Blotches of 10 cm, lighter and darker by an eighth."""
    return np.asarray(0.6 * (1.0 + 0.25 * (noise(points, 0.10) - 0.5)))


def frame_of(stamp_s: float, depth_m: Float32Array, rgb: ByteArray = BARE, lens: Intrinsics = RGB_LENS) -> Frame:
    return Frame(stamp_s, 0, depth_m, LENS, rgb, lens, RGB_FROM_DEPTH)


def ranges_m(camera: Pose, lens: Intrinsics, room_m: FloatArray, boxes_m: tuple[FloatArray, ...]) -> FloatArray:
    """True depth (H, W), by slabs: out of the room, and into boxes (2, 3)."""
    rays, start = lens.bearings() @ camera.rotation().T, camera.translation_m
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(rays > 0, (room_m[1] - start) / rays, (room_m[0] - start) / rays).min(axis=-1)
        for box_m in boxes_m:
            near = np.minimum((box_m[0] - start) / rays, (box_m[1] - start) / rays).max(axis=-1)
            far = np.maximum((box_m[0] - start) / rays, (box_m[1] - start) / rays).min(axis=-1)
            depth = np.where((near <= far) & (near > 0), np.minimum(near, depth), depth)
    return np.asarray(depth)
