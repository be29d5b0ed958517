from __future__ import annotations

import pytest

from uav_recon.localization.fusion.pose_stream_health import OdometryHealthMonitor
from uav_recon.types.pose import PoseHealth
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

GOOD, DEGRADED, LOST = PoseHealth.GOOD, PoseHealth.DEGRADED, PoseHealth.LOST


def _watch(rate_hz: float = 15.0, nis: float = 6.0, seconds: float = 3.0) -> OdometryHealthMonitor:
    watch = OdometryHealthMonitor(pose_lost_s=0.5)
    watch.begin(0.0)
    for k in range(int(rate_hz * seconds)):
        watch.fused(k / rate_hz, nis)
    return watch


@pytest.mark.parametrize(
    ("age_s", "health", "reason"),
    [
        (0.19, GOOD, None),
        (0.21, DEGRADED, Reason(ReasonCode.NO_POSE, (0.2,))),
        (0.26, LOST, Reason(ReasonCode.NO_POSE, (0.3,))),
        (5.0, LOST, Reason(ReasonCode.NO_POSE, (5.0,))),
    ],
)
def test_silence_is_reported_by_its_length(age_s: float, health: PoseHealth, reason: Reason | None) -> None:
    assert _watch().health(age_s, imu_fault=None, on_trial=False) == (health, reason)


@pytest.mark.parametrize(("rate_hz", "health"), [(30.0, GOOD), (8.5, GOOD), (7.0, DEGRADED), (4.5, DEGRADED), (3.0, LOST)])
def test_few_poses_are_reported_by_their_number(rate_hz: float, health: PoseHealth) -> None:
    reported, reason = _watch(rate_hz).health(0.05, imu_fault=None, on_trial=False)
    assert reported is health
    assert (reason and reason.code) is (None if health is GOOD else ReasonCode.FEW_POSES)


def test_the_usual_pause_between_few_poses_is_no_silence() -> None:
    watch = _watch(5.0)
    assert watch.health(0.30, imu_fault=None, on_trial=False)[1] == Reason(ReasonCode.FEW_POSES, (5.0,))
    assert watch.health(0.46, imu_fault=None, on_trial=False)[0] is LOST


def test_the_first_second_is_not_held_against_the_source() -> None:
    watch = _watch(15.0, seconds=0.2)
    assert watch.health(0.05, imu_fault=None, on_trial=False) == (GOOD, None)


def test_what_the_imu_does_not_bear_out_is_degraded() -> None:
    assert _watch(nis=14.0).health(0.05, imu_fault=None, on_trial=False)[0] is GOOD
    health, reason = _watch(nis=40.0).health(0.05, imu_fault=None, on_trial=False)
    assert (health, reason) == (DEGRADED, Reason(ReasonCode.IMU_DISAGREES, (40.0,)))


def test_refused_poses_are_reported_as_such() -> None:
    assert _watch().health(0.1, imu_fault=None, on_trial=True) == (DEGRADED, Reason(ReasonCode.POSES_DISAGREE, (0.1,)))
    assert _watch().health(0.4, imu_fault=None, on_trial=True) == (LOST, Reason(ReasonCode.POSES_DISAGREE, (0.4,)))


def test_without_an_imu_nothing_contradicts_the_poses() -> None:
    assert _watch().health(0.1, imu_fault=Reason(ReasonCode.NO_IMU), on_trial=False) == (DEGRADED, Reason(ReasonCode.NO_IMU))


@pytest.mark.parametrize(
    ("health", "age_s", "source", "quality"),
    [
        (GOOD, 0.1, 100, 100),
        (GOOD, 0.1, 30, 30),
        (DEGRADED, 0.1, 100, 60),
        (LOST, 0.3, 100, 20),
        (LOST, 0.5, 100, 0),
        (LOST, 9.0, 100, 0),
    ],
)
def test_quality_is_the_least_of_source_health_and_age(health: PoseHealth, age_s: float, source: int, quality: int) -> None:
    assert _watch().quality(health, age_s, source) == quality
