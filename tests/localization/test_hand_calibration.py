"""Views that a calibration by hand keeps: of the whole walk, rather in motion, and not too many."""

from __future__ import annotations

import math

import numpy as np
import pytest
from textured_room import BODY_FROM_DEPTH, frame_of

from uav_recon.clock import ManualClock
from uav_recon.localization.calibration.camera_mount import FixedMount
from uav_recon.localization.hand_calibration import (
    MOST_VIEWS,
    MOTIONS,
    CameraCalibrator,
    known_elements,
    missing_motions,
)
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.camera_calibration import ERROR_SIGMAS
from uav_recon.types.pose import Pose, StampedPose

REST_S = 60.0
END_S = 120.0
BLIND = np.full((120, 212), np.nan, np.float32)


class Carried:
    """Camera and poses of a body that rests for REST_S and is turned to and fro then; frames at 4 Hz, poses at 20 Hz."""

    def __init__(self, clock: ManualClock) -> None:
        self._clock = clock
        self._frames = self._poses = 0

    def poll(self) -> Frame | None:
        if self._clock.now_s() < 0.25 * (self._frames + 1):
            return None
        self._frames += 1
        return frame_of(0.25 * self._frames, BLIND)

    def imu(self) -> list[ImuSample]:
        return []

    def poses(self) -> list[StampedPose]:
        found = []
        while 0.05 * (self._poses + 1) <= self._clock.now_s():
            self._poses += 1
            t = 0.05 * self._poses
            yaw = math.sin(max(t - REST_S, 0.0))
            found.append(StampedPose(t, Pose.from_yaw(yaw, np.zeros(3)), np.zeros(3)))
        return found

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def calibrator() -> CameraCalibrator:
    clock = ManualClock(0.0)
    carried = Carried(clock)
    calibrator = CameraCalibrator(carried, carried, FixedMount(BODY_FROM_DEPTH), clock)
    for step in range(round(20 * END_S) + 2):
        clock.advance_to(0.05 * step)
        calibrator.step()
    return calibrator


def test_views_are_kept_of_the_whole_walk(calibrator: CameraCalibrator) -> None:
    stamp_s = np.array([view.frame.stamp_s for view in calibrator.views])
    assert len(stamp_s) == MOST_VIEWS
    assert calibrator.frames > 3 * MOST_VIEWS
    assert stamp_s[0] < 2.0
    assert stamp_s[-1] > END_S - 2.0
    assert np.diff(stamp_s).min() > 0.0
    assert np.diff(stamp_s).max() < 3.0


def test_more_views_are_kept_of_motion_than_of_rest(calibrator: CameraCalibrator) -> None:
    moving = sum(view.frame.stamp_s > REST_S for view in calibrator.views)
    assert moving > 1.3 * (MOST_VIEWS - moving) > 20
    fastest = max(calibrator.views, key=lambda view: float(np.linalg.norm(view.rate_radps)))
    assert np.linalg.norm(fastest.rate_radps) == pytest.approx(1.0, abs=0.15)


def test_an_error_is_known_at_half_its_prior_deviation() -> None:
    for share, known in ((0.499, True), (0.501, False)):
        elements = tuple((name, 0.001, share * sigma) for name, sigma in ERROR_SIGMAS.items())
        assert known_elements(elements) == (elements if known else ())
        assert missing_motions(elements) == ({} if known else MOTIONS)
