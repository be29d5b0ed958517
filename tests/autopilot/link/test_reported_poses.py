"""Poses of an autopilot that navigates by itself: real bytes of ODOMETRY, and positions joined with attitudes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as wire

from uav_recon.autopilot.link.local_frame import LocalFrame, moved
from uav_recon.autopilot.link.reported_poses import LocalPositionPoses, OdometryPoses
from uav_recon.autopilot.mavlink.codec import Decoder
from uav_recon.autopilot.mavlink.messages import Attitude, LocalPosition, OdometryMessage
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.trajectory import Setpoint

NAN = math.nan
HALF = math.sqrt(0.5)


def odometry(**changes: Any) -> Any:
    """1 m north, 2 m east, 3 m up, heading east, and 0.5 m/s ahead."""
    covariance = [NAN] * 21
    for place, variance in zip((0, 6, 11, 15, 18, 20), (0.01, 0.02, 0.03, 0.04, 0.05, 0.06), strict=True):
        covariance[place] = variance
    values = {
        "time_usec": 5_000_000, "frame_id": 20, "child_frame_id": 12, "x": 1.0, "y": 2.0, "z": -3.0, "q": [HALF, 0, 0, HALF],
        "vx": 0.5, "vy": 0.0, "vz": 0.0, "rollspeed": NAN, "pitchspeed": NAN, "yawspeed": NAN, "pose_covariance": covariance,
        "velocity_covariance": [NAN] * 21, "reset_counter": 7, "estimator_type": 2, "quality": 80,
    }  # fmt: skip
    return wire.MAVLink_odometry_message(**values | changes)


def decoded(message: Any) -> OdometryMessage | None:
    (received,) = Decoder().feed(bytes(message.pack(wire.MAVLink(None, 1, 1))))
    assert received.message is None or isinstance(received.message, OdometryMessage)
    return received.message


def test_odometry_is_read_in_our_axes() -> None:
    message = decoded(odometry())
    assert message is not None
    (pose,) = OdometryPoses().poses(message, 12.0)
    assert pose.stamp_s == 12.0
    assert np.allclose(pose.odom_from_body.translation_m, (2.0, 1.0, 3.0))  # east, north, up
    assert abs(pose.odom_from_body.yaw_rad()) < 1e-6  # east is our x
    assert np.allclose(pose.velocity_odom_mps, (0.5, 0.0, 0.0), atol=1e-6)
    assert np.allclose(pose.covariance.diagonal(), (0.02, 0.01, 0.03, 0.05, 0.04, 0.06))
    assert (pose.reset_counter, pose.quality, message.boot_us) == (7, 80, 5_000_000)


@pytest.mark.parametrize(
    ("changes", "velocity_mps"),
    [
        ({"child_frame_id": 1}, (0.0, 0.5, 0.0)),  # along north
        ({"child_frame_id": 20}, (0.0, 0.5, 0.0)),
        ({"child_frame_id": 12, "vx": 0.0, "vy": 0.5}, (0.0, -0.5, 0.0)),  # to the right of a body that looks east
        ({"vz": NAN}, (0.0, 0.0, 0.0)),
        ({"child_frame_id": 99}, (0.0, 0.0, 0.0)),
    ],
)
def test_its_velocity_may_be_in_either_frame(changes: dict[str, Any], velocity_mps: tuple[float, ...]) -> None:
    message = decoded(odometry(**changes))
    assert message is not None
    assert np.allclose(message.velocity_mps, velocity_mps, atol=1e-6)


@pytest.mark.parametrize(
    "changes",
    [{"frame_id": 0}, {"x": NAN}, {"q": [NAN, 0, 0, 0]}, {"q": [0.5, 0, 0, 0]}, {"estimator_type": 4}, {"estimator_type": 5}],
    ids=str,
)
def test_odometry_that_is_no_local_pose_is_not_read(changes: dict[str, Any]) -> None:
    assert decoded(odometry(**changes)) is None


def test_quality_and_covariance_may_be_unknown_or_bad() -> None:
    unknown = decoded(odometry(quality=0, pose_covariance=[NAN] * 21))
    failed = decoded(odometry(quality=-1))
    assert unknown is not None
    assert failed is not None
    assert unknown.variance is None
    assert (unknown.quality, failed.quality) == (100, 0)
    assert np.diagonal(OdometryPoses().poses(unknown, 1.0)[0].covariance).max() < 0.001


def position(stamp_s: float, x_m: float, speed_mps: float = 1.0) -> LocalPosition:
    return LocalPosition(round(1000 * stamp_s), np.array([x_m, 0.0, 1.0]), np.array([speed_mps, 0.0, 0.0]))


def attitude(stamp_s: float, yaw_rad: float, rate_radps: float = 0.5) -> Attitude:
    quat = Pose.from_yaw(yaw_rad, np.zeros(3)).quat_wxyz
    return Attitude(quat, round(1000 * stamp_s), np.array([0.0, 0.0, rate_radps]))


def test_a_position_waits_for_its_attitude_and_gets_it_at_its_own_instant() -> None:
    poses = LocalPositionPoses()
    assert poses.poses(attitude(1.0, 0.5), 1.0) == []
    assert poses.poses(position(1.02, 0.02), 1.02) == []
    (pose,) = poses.poses(attitude(1.03, 0.515), 1.03)
    assert pose.stamp_s == 1.02
    assert pose.odom_from_body.yaw_rad() == pytest.approx(0.51)
    assert poses.poses(position(1.25, 0.25), 1.25) == []
    assert poses.poses(attitude(1.4, 0.7), 1.4) == []  # no attitude near 1.25
    assert poses.poses(position(1.02, 0.02), 1.02) == []  # repeated


@pytest.mark.parametrize(
    ("x_m", "yaw_rad", "resets"), [(0.1, 0.05, 0), (0.19, 0.05, 0), (0.21, 0.05, 1), (0.1, 0.18, 0), (0.1, 0.2, 1)]
)
def test_a_step_that_no_motion_explains_is_a_reset(x_m: float, yaw_rad: float, resets: int) -> None:
    poses, found = LocalPositionPoses(), []
    for stamp_s, x, yaw in ((1.0, 0.0, 0.0), (1.1, x_m, yaw_rad), (1.2, x_m + 0.1, yaw_rad + 0.05)):
        found += [*poses.poses(attitude(stamp_s, yaw), stamp_s), *poses.poses(position(stamp_s, x), stamp_s)]
    assert [pose.reset_counter for pose in found] == [0, resets, resets]


def stamped(stamp_s: float, pose: Pose, resets: int = 0) -> StampedPose:
    return StampedPose(stamp_s, pose, np.zeros(3), reset_counter=resets)


def test_the_local_frame_is_measured_at_the_stamps_of_the_estimates() -> None:
    frame, local_from_odom = LocalFrame(), Pose.from_yaw(2.0, np.array([3.0, -1.0, 0.2]))
    for number in range(90):
        stamp_s = number / 30
        body = Pose.from_yaw(0.5 * stamp_s, np.array([stamp_s, 0.0, 1.0]))  # odometry arrives first, the estimate is older
        frame.add_odometry(stamped(stamp_s, body))
        late_s = stamp_s - 0.045
        frame.add_estimate(stamped(late_s, local_from_odom @ Pose.from_yaw(0.5 * late_s, np.array([late_s, 0.0, 1.0]))))
    assert frame.local_from_odom is not None
    apart = local_from_odom.inverse() @ frame.local_from_odom
    assert np.linalg.norm(apart.translation_m) < 0.001
    assert np.linalg.norm(apart.rotation_vector()) < 0.001


def test_a_slow_drift_is_followed_slowly_and_a_step_at_once() -> None:
    frame, body = LocalFrame(), Pose.identity()
    offsets: list[float] = []
    for number in range(120):
        stamp_s = number / 30
        place_m = 0.0 if number < 60 else 0.05 if number < 90 else 0.5
        frame.add_odometry(stamped(stamp_s, body))
        frame.add_estimate(stamped(stamp_s, Pose.from_yaw(0.0, np.array([place_m, 0.0, 0.0]))))
        found = frame.local_from_odom
        offsets.append(0.0 if found is None else float(found.translation_m[0]))
    assert 0.0 < offsets[62] < 0.01
    assert 0.02 < offsets[89] < 0.05
    assert offsets[92] == pytest.approx(0.5)


def test_a_setpoint_is_the_same_place_and_motion_in_the_local_frame() -> None:
    local_from_odom = Pose.from_yaw(math.pi / 2, np.array([10.0, 0.0, 1.0]))
    setpoint = Setpoint(np.array([2.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.5]), np.array([0.0, 1.0, 0.0]), 0.3, 0.1, 0.2)
    there = moved(setpoint, local_from_odom)
    assert np.allclose(there.position_m, (10.0, 2.0, 2.0))
    assert np.allclose(there.velocity_mps, (0.0, 1.0, 0.5))
    assert np.allclose(there.acceleration_mps2, (-1.0, 0.0, 0.0))
    assert there.yaw_rad == pytest.approx(0.3 + math.pi / 2)
    assert (there.yaw_rate_radps, there.camera_pitch_down_rad) == (0.1, 0.2)
