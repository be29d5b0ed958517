"""Level by the floor: the map stands upright although the accelerometer does not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.localization.slam.floor_level import level_by_floor
from uav_recon.types.camera import Frame, Intrinsics, body_from_camera
from uav_recon.types.frames import Float32Array
from uav_recon.types.pose import Pose

LENS = Intrinsics.from_fov(424, 240, math.radians(87.0), math.radians(58.0))
MOUNT = body_from_camera(np.array([0.1, 0.0, 0.0]), math.radians(15.0))
FLOOR_M = -0.1


def seen_from(odom_from_body: Pose, slope: float = 0.0, floor_m: float = FLOOR_M) -> Frame:
    """Depth of a floor with a slope along x, and of a wall 2 m ahead."""
    odom_from_depth = odom_from_body @ MOUNT
    v, u = np.mgrid[0 : LENS.height, 0 : LENS.width]
    rays = (
        np.stack([(u - LENS.cx) / LENS.fx, (v - LENS.cy) / LENS.fy, np.ones(u.shape)], axis=-1) @ odom_from_depth.rotation().T
    )
    eye_m = odom_from_depth.translation_m
    with np.errstate(divide="ignore"):
        floor = (floor_m + slope * eye_m[0] - eye_m[2]) / (rays[..., 2] - slope * rays[..., 0])
        wall = (2.0 - eye_m[0]) / rays[..., 0]
    depth_m = np.minimum(np.where(floor > 0.0, floor, np.inf), np.where(wall > 0.0, wall, np.inf))
    depth_m = np.where((depth_m > 0.28) & (depth_m < 4.0), depth_m, np.nan)
    return frame_of(depth_m.astype(np.float32))


def frame_of(depth_m: Float32Array) -> Frame:
    return Frame(1.0, 1, depth_m, LENS, np.zeros((*depth_m.shape, 3), np.uint8), LENS, Pose.identity())


def tilt_rad(odom_from_body: Pose, true: Pose) -> float:
    return math.acos(min(1.0, float((odom_from_body @ true.inverse()).rotation()[2, 2])))


def turned(roll_rad: float, pitch_rad: float) -> Pose:
    return Pose.from_rotation_vector(np.array([roll_rad, pitch_rad, 0.0]), np.zeros(3))


ANGLE = st.floats(-math.radians(1.0), math.radians(1.0))


@settings(max_examples=20, deadline=None)
@given(roll=ANGLE, pitch=ANGLE, lean=ANGLE)
def test_the_floor_corrects_the_accelerometer(roll: float, pitch: float, lean: float) -> None:
    true = turned(lean, -lean)
    found = level_by_floor(seen_from(true), turned(roll, pitch) @ true, MOUNT)
    assert tilt_rad(found, true) < math.radians(0.1)
    assert found.yaw_rad() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "frame",
    [
        seen_from(Pose.identity(), slope=math.tan(math.radians(3.0))),  # a ramp
        seen_from(Pose.identity(), floor_m=-5.0),  # only the wall is near
        frame_of(np.full((240, 424), np.nan, np.float32)),
    ],
    ids=["ramp", "no floor", "no depth"],
)
def test_without_a_level_floor_the_accelerometer_is_kept(frame: Frame) -> None:
    level = turned(0.01, -0.01)
    assert level_by_floor(frame, level, MOUNT) is level
