"""Interpolation of recent true poses."""

from __future__ import annotations

import math

import pytest

from sitl.geometry.quaternion import from_yaw, yaw_of
from sitl.world.pose_history import LENGTH_S, PastPose, PoseHistory


def turning(stamp_s: float) -> PastPose:
    """Return the pose of a vehicle at 1 m/s and 1 rad/s, whose gimbal turns at 0.5 rad/s."""
    return PastPose(stamp_s, (stamp_s, -stamp_s, 0.0), from_yaw(stamp_s), 0.5 * stamp_s)


def history(until_s: float, step_s: float = 0.01) -> PoseHistory:
    poses = PoseHistory()
    for n in range(round(until_s / step_s) + 1):
        poses.add(turning(n * step_s))
    return poses


def test_between_two_poses_position_heading_and_gimbal_are_interpolated() -> None:
    pose = history(1.0).at(0.8234)
    assert pose.position == pytest.approx((0.8234, -0.8234, 0.0))
    assert yaw_of(pose.quat_wxyz) == pytest.approx(0.8234, abs=1e-6)
    assert pose.gimbal_pitch_down_rad == pytest.approx(0.4117)


def test_quaternions_of_opposite_sign_are_the_same_rotation() -> None:
    poses = PoseHistory()
    poses.add(PastPose(0.0, (0.0, 0.0, 0.0), from_yaw(0.1), 0.0))
    w, x, y, z = from_yaw(0.2)
    poses.add(PastPose(1.0, (0.0, 0.0, 0.0), (-w, -x, -y, -z), 0.0))
    turned = yaw_of(poses.at(0.5).quat_wxyz)
    assert math.cos(turned - 0.15) == pytest.approx(1.0)


def test_from_the_newest_pose_on_it_is_returned_unchanged() -> None:
    poses, newest = history(0.3), turning(0.3)
    poses.add(newest)
    assert poses.at(0.3) is newest
    assert poses.at(9.0) is newest
    assert poses.at(0.3 - 1e-7) is newest  # a clock that rounds differently


def test_before_the_oldest_pose_it_is_returned() -> None:
    assert history(0.1).at(-1.0).stamp_s == 0.0


def test_poses_are_kept_for_half_a_second_and_not_for_ever() -> None:
    poses = history(20.0)
    assert poses.at(20.0 - LENGTH_S).stamp_s == pytest.approx(20.0 - LENGTH_S)
    assert poses.at(0.0).stamp_s > 18.9


def test_a_pose_of_the_same_time_replaces_the_last() -> None:
    poses = history(0.1)
    poses.add(PastPose(0.1, (5.0, 0.0, 0.0), from_yaw(0.0), 0.0))
    assert poses.at(0.1).position == (5.0, 0.0, 0.0)
