"""Frames with a wrong stamp: each costs itself, and the track goes on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from slam_flight import BODY_FROM_DEPTH, REST_S, Tracked, fly, frames
from test_slam_source import Camera

from uav_recon.localization.calibration.camera_mount import FixedMount
from uav_recon.localization.slam.slam_source import SlamSource
from uav_recon.localization.slam.slam_tracker import SlamTracker
from uav_recon.localization.slam.tracking_monitor import TrackingFault
from uav_recon.localization.slam.view_odometry import ViewOdometry
from uav_recon.types.camera import Frame

MOVING = 45  # number of a frame in flight


def _flown(stamp_off_s: float) -> list[Tracked]:
    flight = list(frames(REST_S + 4.0))
    wrong = flight[MOVING]
    flight[MOVING] = replace(wrong, stamp_s=wrong.stamp_s + stamp_off_s)
    return fly(SlamTracker(), flight)


@pytest.mark.parametrize("stamp_off_s", [-0.2, -3600.0, -1.0 / 15.0])
def test_a_frame_that_is_not_newer_changes_nothing(stamp_off_s: float) -> None:
    answers = _flown(stamp_off_s)
    assert answers[MOVING].pose is None
    assert answers[MOVING].fault is TrackingFault.STAMP
    assert all(answer.pose is not None for answer in answers[MOVING + 1 :])
    assert max(answer.error_m or 0.0 for answer in answers[MOVING + 1 :]) < 0.06


def test_a_frame_from_the_future_is_not_tracked() -> None:
    flight = list(frames(REST_S + 4.0))
    now_s, tracker = [0.0], SlamTracker()
    camera = Camera([replace(f, stamp_s=f.stamp_s + 5.0 * (n == MOVING)) for n, f in enumerate(flight)])
    source = SlamSource(camera, FixedMount(BODY_FROM_DEPTH), ViewOdometry(tracker), now_s=lambda: now_s[0])
    given: list[Frame] = []
    counts: list[int] = []
    for true in flight:
        now_s[0] = true.stamp_s + 0.02
        source.imu()
        found = source.poll()
        assert found is not None
        given.append(found)
        counts.append(len(source.poses()))
    assert counts[MOVING] == 0
    assert all(counts[MOVING + 1 :])
    assert given[MOVING].stamp_s == pytest.approx(flight[MOVING].stamp_s + 5.0, abs=0.1)  # perception says that it is wrong
    assert np.isfinite(tracker.delay_s)
