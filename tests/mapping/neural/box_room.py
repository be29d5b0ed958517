"""Analytic box room: simulated views of the inside of a box whose walls have known colours."""

from __future__ import annotations

import dataclasses

import numpy as np

from uav_recon.types.camera import Frame, Intrinsics, PosedFrame, body_from_camera
from uav_recon.types.frames import ByteArray, FloatArray
from uav_recon.types.pose import MapCorrection, Pose

LOW, HIGH = np.array([0.0, 0.0, 0.0]), np.array([3.0, 2.4, 2.0])
WALL_RGB = np.array(
    [[200, 60, 60], [60, 200, 60], [60, 60, 200], [200, 200, 60], [120, 120, 120], [230, 230, 230]], dtype=np.uint8
)
DEPTH_LENS = Intrinsics.from_fov(106, 60, np.deg2rad(87), np.deg2rad(58))
RGB_LENS = Intrinsics.from_fov(106, 60, np.deg2rad(69), np.deg2rad(42))
RGB_FROM_DEPTH = Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.015, 0.0, 0.0]))
NOISE_PX, BASELINE_M = 0.02, 0.05


def look(position: tuple[float, float, float], yaw_deg: float, sequence: int = 0, sigma_px: float = 0.0) -> PosedFrame:
    """Return a view from a position in the room, pitched 15° down."""
    world_from_depth = Pose.from_yaw(np.deg2rad(yaw_deg), np.array(position)) @ body_from_camera(np.zeros(3), np.deg2rad(15))
    return view_from(world_from_depth, DEPTH_LENS, sequence, sigma_px)


def view_from(world_from_depth: Pose, lens: Intrinsics, sequence: int = 0, sigma_px: float = 0.0) -> PosedFrame:
    """Return a view from a pose."""
    depth, _ = _cast(world_from_depth, lens)
    if sigma_px:
        scale = lens.fx * BASELINE_M
        depth = scale / (scale / depth + sigma_px * np.random.default_rng(sequence).standard_normal(depth.shape))
    _, rgb = _cast(world_from_depth @ RGB_FROM_DEPTH.inverse(), RGB_LENS)
    frame = Frame(0.5 * sequence, sequence, depth.astype(np.float32), lens, rgb, RGB_LENS, RGB_FROM_DEPTH)
    return PosedFrame(frame, world_from_depth)


def tour(count: int, sigma_px: float = 0.0) -> list[PosedFrame]:
    """Return views from a circle around the centre of the room, looking outwards and across."""
    views = []
    for n in range(count):
        angle = 2 * np.pi * n / count
        position = (1.5 + 0.6 * np.cos(angle), 1.2 + 0.5 * np.sin(angle), 0.8 + 0.4 * (n % 2))
        views.append(look(position, np.rad2deg(angle) + 40.0 * (n % 3), n, sigma_px))
    return views


def bent(views: list[PosedFrame]) -> list[PosedFrame]:
    """Return the views at the poses that a drifting heading would give them."""
    turns = [Pose.from_yaw(np.deg2rad(2.0) * n / len(views), np.zeros(3)) for n in range(len(views))]
    return [dataclasses.replace(v, world_from_depth=turn @ v.world_from_depth) for v, turn in zip(views, turns, strict=True)]


def correction(views: list[PosedFrame], epoch: int) -> MapCorrection:
    """Return a map correction that gives each view the pose in world_from_depth.

    It undoes bent() when the views are the original ones.
    """
    return MapCorrection(epoch, np.array([v.frame.stamp_s for v in views]), tuple(v.world_from_depth for v in views))


def distance_to_walls(points: FloatArray) -> FloatArray:
    """Return the unsigned distance (N,) of points to the surface of the box."""
    outside = np.maximum(np.maximum(LOW - points, points - HIGH), 0.0)
    inside = np.minimum(points - LOW, HIGH - points).min(axis=1)
    distance: FloatArray = np.where(inside >= 0, inside, np.linalg.norm(outside, axis=1))
    return distance


def _cast(world_from_camera: Pose, lens: Intrinsics) -> tuple[FloatArray, ByteArray]:
    ray = lens.bearings().reshape(-1, 3) @ world_from_camera.rotation().T
    origin = world_from_camera.translation_m
    with np.errstate(divide="ignore"):
        to_plane = np.concatenate([(LOW - origin) / ray, (HIGH - origin) / ray], axis=1)
    to_plane[to_plane <= 0] = np.inf
    wall = to_plane.argmin(axis=1)
    z = to_plane.min(axis=1)
    return z.reshape(lens.height, lens.width), WALL_RGB[wall].reshape(lens.height, lens.width, 3)
