"""From odometry to the autopilot: what is fed once, and which resets it hears of."""

from __future__ import annotations

import itertools
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uav_recon.autopilot.pilot.situation.pose_feed import PoseFeed
from uav_recon.channels import FileChannel, MemoryChannel, ReadOnlyFileChannel
from uav_recon.safety.pose_gate import PoseGate
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import AXES, ReasonCode

STEP_S = 1 / 30


class Fed:
    """In the link's place."""

    def __init__(self) -> None:
        self.poses: list[StampedPose] = []

    def feed_pose(self, pose: StampedPose, now_s: float) -> None:
        self.poses.append(pose)


def _pose(stamp_s: float, x_m: float = 0.0, resets: int = 0) -> StampedPose:
    return StampedPose(stamp_s, Pose.from_yaw(0.0, np.array([x_m, 0.0, 1.0])), np.zeros(3), reset_counter=resets)


def _feed(odom: Any) -> tuple[PoseFeed, list[StampedPose]]:
    link: Any = Fed()
    return PoseFeed(odom, link, PoseGate(0.8)), link.poses


@pytest.mark.parametrize("resets", [0, 7, 255])
def test_the_autopilot_hears_of_a_jump_that_the_source_did_not_count(resets: int) -> None:
    """Perception was started again, counts from where it did, and its odom lies 0.4 m beside the old one."""
    odom = MemoryChannel(StampedPose)
    feed, fed = _feed(odom)
    again = []
    for n in range(90):
        t = n * STEP_S
        odom.publish(_pose(t, 0.4 * (n >= 30), resets))
        again.append(feed.step(t + 0.01))
    steps = [(b.odom_from_body.translation_m[0] - a.odom_from_body.translation_m[0]) for a, b in itertools.pairwise(fed)]
    counted = [b.reset_counter - a.reset_counter for a, b in itertools.pairwise(fed)]
    assert max(steps) == pytest.approx(0.4)
    assert [step % 256 for step in counted] == [int(step > 0.1) for step in steps]
    assert sum(again) == 1
    assert feed.pose is not None
    assert feed.pose.reset_counter == resets


def test_a_reset_that_the_source_counts_is_counted_once() -> None:
    odom = MemoryChannel(StampedPose)
    feed, fed = _feed(odom)
    for n in range(60):
        odom.publish(_pose(n * STEP_S, 0.4 * (n >= 30), int(n >= 30)))
        feed.step(n * STEP_S + 0.01)
    assert [pose.reset_counter for pose in fed] == [0] * 30 + [1] * 30


@pytest.mark.parametrize(
    ("health", "code", "fed"),
    [
        (PoseHealth.GOOD, None, True),
        (PoseHealth.DEGRADED, ReasonCode.NO_POSE, True),
        (PoseHealth.DEGRADED, ReasonCode.POSES_DISAGREE, True),
        (PoseHealth.LOST, ReasonCode.NO_POSE, False),
        (PoseHealth.LOST, ReasonCode.POSES_DISAGREE, False),
        (PoseHealth.DEGRADED, ReasonCode.PLACE_UNSURE, True),
        (PoseHealth.LOST, ReasonCode.PLACE_UNSURE, False),
        (PoseHealth.LOST, ReasonCode.FEW_POSES, True),
        (PoseHealth.WRONG, ReasonCode.ODOMETRY_DRIFT, True),
    ],
)
def test_dead_reckoning_is_not_fed_once_the_pose_is_lost(health: PoseHealth, code: ReasonCode | None, fed: bool) -> None:
    odom = MemoryChannel(StampedPose)
    feed, sent = _feed(odom)
    odom.publish(replace(_pose(0.0), health=health, health_reason=None if code is None else Reason(code, (0.3,))))
    feed.step(0.01)
    assert (len(sent) == 1) is fed
    assert feed.pose is not None, "the failsafe reads its health"


@pytest.mark.parametrize(
    ("health", "code", "late"),
    [
        (PoseHealth.DEGRADED, ReasonCode.NO_POSE, True),
        (PoseHealth.DEGRADED, ReasonCode.PLACE_UNSURE, False),
        (PoseHealth.DEGRADED, ReasonCode.NO_IMU, False),
        (PoseHealth.LOST, ReasonCode.NO_POSE, False),
    ],
)
def test_a_pose_that_is_carried_on_without_the_view_is_late(health: PoseHealth, code: ReasonCode, late: bool) -> None:
    odom = MemoryChannel(StampedPose)
    feed, _ = _feed(odom)
    odom.publish(replace(_pose(0.0), health=health, health_reason=Reason(code, (0.3,))))
    feed.step(0.01)
    assert (feed.late is not None) is late


def test_a_record_that_is_being_written_is_fed_once_it_is_whole(tmp_path: Path) -> None:
    """Its writer was preempted between the head and the data."""
    path = tmp_path / "odom.channel"
    writer, reader = FileChannel(path, StampedPose), ReadOnlyFileChannel(path, StampedPose)
    feed, fed = _feed(reader)
    for n in range(4):
        writer.publish(_pose(n * STEP_S))
        whole = bytes(writer._own)
        writer._own[32:40] = struct.pack("<q", -1)
        assert not feed.step(n * STEP_S + 0.001)
        assert len(fed) == n
        writer._own[:] = whole
        for _ in range(3):
            feed.step(n * STEP_S + 0.01)
        assert [pose.stamp_s for pose in fed] == [k * STEP_S for k in range(n + 1)]
    assert feed.refused == 0


def test_poses_with_wrong_axes_are_not_fed_and_those_that_drift_are() -> None:
    """With a height of the wrong sign an autopilot in LAND climbs; a drift is better than nothing."""
    odom = MemoryChannel(StampedPose)
    feed, fed = _feed(odom)
    for n, code in enumerate((None, ReasonCode.ODOMETRY_DRIFT, *sorted(AXES))):
        health = PoseHealth.GOOD if code is None else PoseHealth.WRONG
        why = None if code is None else Reason(code, code.example)
        odom.publish(replace(_pose(n * STEP_S), health=health, health_reason=why))
        feed.step(n * STEP_S + 0.01)
        assert feed.misleads == (n >= 2)
        assert feed.wrong == why
    assert len(fed) == 2
