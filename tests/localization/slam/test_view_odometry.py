"""Odometry by the tracked frames, between them and through gaps."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest
from slam_flight import BODY_FROM_DEPTH, RATE_HZ, colourless, covered, frames, imu, truth

from uav_recon.localization.flow.measured_motion import MeasuredMotion
from uav_recon.localization.slam.outside_motion import NoOutsideMotion, OutsideMotion
from uav_recon.localization.slam.slam_tracker import SlamTracker
from uav_recon.localization.slam.view_odometry import ViewOdometry
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason_code import ReasonCode

FAULT_S = 5.0
Sensor = Callable[[ImuSample], ImuSample]


def fly(
    seen: Iterable[Frame],
    gap_s: float = 0.0,
    sensor: Sensor = lambda sample: sample,
    outside: OutsideMotion | None = None,
) -> tuple[ViewOdometry, list[tuple[float, StampedPose, float]]]:
    """Return the odometry of a flight, and its answers at 30 Hz from 2 s on: instant, odometry, error.

    gap_s: time from FAULT_S on without a frame. sensor: changes the inertial samples. outside: measures the motion, too.
    """
    view, found = ViewOdometry(SlamTracker(outside), Pose.identity()), list[tuple[float, StampedPose, float]]()
    samples, added = [sensor(sample) for sample in imu()], 0
    for frame in seen:
        for now_s in (frame.stamp_s, frame.stamp_s + 0.5 / RATE_HZ):
            start = added
            while added < len(samples) and samples[added].stamp_s <= now_s + 0.02:
                added += 1
            view.add_imu(samples[start:added], math.inf)
            if now_s == frame.stamp_s and not FAULT_S <= now_s < FAULT_S + gap_s:
                view.track(frame, BODY_FROM_DEPTH)
            odom = view.odom_at(now_s)
            if odom is not None and now_s > 2.0:
                off_m = odom.odom_from_body.translation_m - truth(now_s).translation_m
                found.append((now_s, odom, float(np.linalg.norm(off_m))))
    return view, found


def steps_m(found: list[tuple[float, StampedPose, float]]) -> float:
    """Return the longest way beyond what the velocity explains, from answer to answer."""
    ways = []
    for (a_s, a, _), (b_s, b, _) in itertools.pairwise(found):
        way = b.odom_from_body.translation_m - a.odom_from_body.translation_m - (b_s - a_s) * a.velocity_odom_mps
        ways.append(float(np.linalg.norm(way)))
    return max(ways)


def test_odometry_is_right_between_the_frames_and_of_late_instants() -> None:
    view, found = fly(frames(6.0))
    assert max(error for _, _, error in found) < 0.06
    assert {odom.health for _, odom, _ in found} == {PoseHealth.GOOD}
    late = view.odom_at(5.03)
    assert late is not None
    assert np.linalg.norm(late.odom_from_body.translation_m - truth(5.03).translation_m) < 0.04
    assert view.odom_at(2.0) is None


@pytest.mark.parametrize("gap_s", [0.6, 1.2])
def test_a_gap_is_bridged_without_a_jump(gap_s: float) -> None:
    _, found = fly(frames(9.0), gap_s)
    during = [odom.health for now_s, odom, _ in found if FAULT_S + 0.3 < now_s < FAULT_S + gap_s]
    assert set(during) == {PoseHealth.DEGRADED}
    assert found[-1][1].health is PoseHealth.GOOD
    assert max(error for _, _, error in found) < 0.3
    assert found[-1][2] < 0.06
    assert steps_m(found) < 0.07
    assert {odom.reset_counter for _, odom, _ in found} == {0}


def test_its_covariance_grows_while_the_view_does_not_show_the_place() -> None:
    """Without colour the depth of a wall leaves its directions open, and each frame is accepted."""
    _, found = fly(frames(7.0, lambda true: colourless(true) if true.stamp_s >= FAULT_S else true))
    assert max(odom.place_sigma_m for now_s, odom, _ in found if now_s < FAULT_S) < 0.015
    assert found[-1][1].place_sigma_m > 0.05


def test_after_a_longer_gap_the_place_is_lost_and_found_again() -> None:
    _, found = fly(frames(18.0), 3.0)
    lost = [now_s for now_s, odom, _ in found if odom.health is PoseHealth.LOST]
    assert FAULT_S + 1.4 < lost[0] < FAULT_S + 1.7
    assert found[-1][1].health is PoseHealth.GOOD
    assert found[-1][2] < 0.1


class Flow(NoOutsideMotion):
    """The true way from frame to frame, with noise."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(1)

    def moved(self, from_s: float, to_s: float, odom_from_body: Pose) -> MeasuredMotion:
        way_m = truth(to_s).translation_m - truth(from_s).translation_m
        return MeasuredMotion(way_m + self._random.normal(0.0, 0.005, 3), 0.005**2 * np.eye(3))


def _covered_for_seconds(true: Frame) -> Frame:
    return covered(true) if FAULT_S <= true.stamp_s < FAULT_S + 2.5 else true


def test_optical_flow_carries_odometry_through_seconds_without_a_view() -> None:
    _, found = fly(frames(11.0, _covered_for_seconds), outside=Flow())
    assert PoseHealth.LOST not in {odom.health for _, odom, _ in found}
    assert max(error for _, _, error in found) < 0.2
    assert found[-1][1].health is PoseHealth.GOOD
    _, without = fly(frames(11.0, _covered_for_seconds))
    assert PoseHealth.LOST in {odom.health for _, odom, _ in without}


def test_optical_flow_does_not_outlast_the_frames() -> None:
    """It is read with the frames: a camera that is gone shows neither."""
    _, found = fly(frames(9.0), 3.0, outside=Flow())
    assert PoseHealth.LOST in {odom.health for _, odom, _ in found}


@pytest.mark.parametrize("error_mps2", [2.0, 4.0])
def test_a_lying_accelerometer_is_left_out(error_mps2: float) -> None:
    def lies(sample: ImuSample) -> ImuSample:
        wrong = np.array([error_mps2 * (sample.stamp_s > FAULT_S), 0.0, 0.0])
        return replace(sample, specific_force_mps2=sample.specific_force_mps2 + wrong)

    view, found = fly(frames(10.0), sensor=lies)
    assert not view.tracker.accelerometer_used
    assert max(error for _, _, error in found) < 0.12
    reason = found[-1][1].health_reason
    assert reason is not None
    assert reason.code is ReasonCode.ACCELEROMETER_REJECTED


def test_frozen_inertial_values_are_left_out() -> None:
    last = next(sample for sample in imu() if sample.stamp_s > FAULT_S)

    def frozen(sample: ImuSample) -> ImuSample:
        return sample if sample.stamp_s <= last.stamp_s else replace(last, stamp_s=sample.stamp_s)

    _, found = fly(frames(8.0), sensor=frozen)
    assert max(error for _, _, error in found) < 0.12
    reason = found[-1][1].health_reason
    assert reason is not None
    assert reason.code is ReasonCode.IMU_FROZEN
