from __future__ import annotations

import numpy as np
import pytest

from uav_recon.channels import MemoryChannel
from uav_recon.clock import RateKeeper
from uav_recon.config import LocalizationConfig
from uav_recon.localization.calibration.camera_mount import FixedMount
from uav_recon.localization.consistency.depth_consistency import DepthConsistencyMonitor
from uav_recon.localization.perception.fused_odometry import FusedOdometry
from uav_recon.localization.perception.odometry_publisher import OdometryPublisher
from uav_recon.localization.perception.sensor_checks import SensorChecks
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

CONFIG = LocalizationConfig()


def published(poses: int, steps: int) -> list[StampedPose]:
    """Return what is published at 30 Hz of steps at 100 Hz, of poses at 30 Hz that end."""
    channel, odometry, checks = (
        MemoryChannel(StampedPose), FusedOdometry.of(CONFIG, FixedMount(Pose.identity())), SensorChecks(CONFIG)
    )  # fmt: skip
    publisher, out, sent = OdometryPublisher(channel, RateKeeper(30.0, 0.0)), list[StampedPose](), 0
    for step in range(steps):
        now_s, before = step / 100, channel.sequence()
        while sent < poses and sent / 30 <= now_s:
            odometry.add_pose(StampedPose(sent / 30, Pose.identity(), np.zeros(3)), now_s)
            sent += 1
        publisher.step(now_s, odometry, checks)
        newest = channel.latest()
        if channel.sequence() > before and newest is not None:
            out.append(newest)
    assert publisher.published == len(out)
    return out


def test_nothing_is_published_before_the_first_pose() -> None:
    assert published(0, 50) == []


def test_odometry_is_stamped_now_at_its_rate() -> None:
    assert [odom.stamp_s for odom in published(60, 100)][:4] == [0.0, 0.04, 0.07, 0.1]


def test_lost_odometry_is_published_once() -> None:
    qualities = [odom.quality for odom in published(30, 200)]
    assert qualities[-1] == 0
    assert qualities.count(0) == 1


def test_odometry_with_a_fault_is_wrong_and_keeps_its_quality(monkeypatch: pytest.MonkeyPatch) -> None:
    usual, drift = published(60, 50)[-1], Reason(ReasonCode.ODOMETRY_DRIFT, (0.05,))
    monkeypatch.setattr(DepthConsistencyMonitor, "drift", lambda *_: drift)
    newest = published(60, 50)[-1]
    assert (newest.health, newest.health_reason) == (PoseHealth.WRONG, drift)
    assert newest.quality == usual.quality > 0
