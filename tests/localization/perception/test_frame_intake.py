from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.localization.perception.frame_intake import FrameIntake
from uav_recon.types.camera import Frame, ImuSample, Intrinsics
from uav_recon.types.pose import Pose
from uav_recon.types.reason_code import ReasonCode

LENS = Intrinsics(10.0, 10.0, 3.5, 2.5, 8, 6)


class Camera:
    """Gives frames of these stamps, one a poll."""

    def __init__(self, *stamps_s: float) -> None:
        self._stamps_s = list(stamps_s)

    def poll(self) -> Frame | None:
        if not self._stamps_s:
            return None
        depth_m, rgb = np.ones((6, 8), np.float32), np.zeros((6, 8, 3), np.uint8)
        return Frame(self._stamps_s.pop(0), 0, depth_m, LENS, rgb, LENS, Pose.identity())

    def imu(self) -> list[ImuSample]:
        return []

    def close(self) -> None: ...


def admitted(*stamps_s: float, now_s: float = 10.0) -> FrameIntake:
    intake = FrameIntake(Camera(*stamps_s), pose_wait_s=0.2)
    for _ in stamps_s:
        intake.admit(now_s)
    return intake


def accepted(*stamps_s: float) -> FrameIntake:
    intake = admitted(*stamps_s)
    for _ in stamps_s:
        frame = intake.next_measured(10.0, math.inf)
        assert frame is not None
        intake.accept(10.0, frame)
    return intake


@pytest.mark.parametrize("stamp_s", [8.99, 10.02, 9.8, 9.9])
def test_a_frame_that_is_old_early_or_not_newer_is_dropped(stamp_s: float) -> None:
    intake = admitted(9.9, stamp_s)
    assert intake.dropped == {ReasonCode.DEPTH_FRAME_STAMP: 1}
    assert intake.newest_drop[0] == 10.0
    first, second = intake.next_measured(10.0, math.inf), intake.next_measured(10.0, math.inf)
    assert first is not None
    assert first.stamp_s == 9.9
    assert second is None


def test_an_impossible_stamp_shuts_out_no_later_frame() -> None:
    intake = admitted(3600.0, 9.95)
    frame = intake.next_measured(10.0, math.inf)
    assert frame is not None
    assert frame.stamp_s == 9.95


def test_a_frame_waits_for_the_angle_of_the_mount_for_a_limited_time() -> None:
    intake = admitted(9.95)
    assert intake.next_measured(10.0, 9.94) is None
    assert intake.next_measured(10.029, 9.94) is None
    assert intake.next_measured(10.031, 9.94) is not None


def test_a_frame_waits_for_a_pose_for_a_limited_time() -> None:
    assert accepted(9.95).next_placed(10.0, newest_pose_s=9.95) is not None
    intake = accepted(9.95)
    assert intake.next_placed(10.14, newest_pose_s=9.94) is None
    assert intake.next_placed(10.16, newest_pose_s=9.94) is not None


def test_of_five_frames_without_a_pose_the_oldest_is_dropped() -> None:
    intake = accepted(9.91, 9.92, 9.93, 9.94, 9.95)
    assert intake.dropped == {ReasonCode.DEPTH_FRAME_UNPLACED: 1}
    placed = [intake.next_placed(10.0, newest_pose_s=10.0) for _ in range(5)]
    assert [None if frame is None else frame.stamp_s for frame in placed] == [9.92, 9.93, 9.94, 9.95, None]
