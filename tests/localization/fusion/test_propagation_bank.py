"""An IMU that lies while the poses are honest: the filter carries on without the lying sensor, and says so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from faulty_pose_flight import MOTION, ONSET_S, FlownOdometry, fly
from numpy.typing import NDArray

from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.localization.fusion.imu_integration import GRAVITY_MPS2
from uav_recon.types.camera import ImuSample
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason_code import ReasonCode

F64 = NDArray[np.float64]
GOOD, DEGRADED = PoseHealth.GOOD, PoseHealth.DEGRADED
ALL_S = 1e9
SEEDS = [0, pytest.param(1, marks=pytest.mark.nightly), pytest.param(2, marks=pytest.mark.nightly)]


def undisturbed(pose: StampedPose, since_s: float) -> StampedPose:
    return pose


def _force(change: Callable[[F64, float], F64]) -> Callable[[ImuSample, float], ImuSample]:
    def changed(sample: ImuSample, since_s: float) -> ImuSample:
        return replace(sample, specific_force_mps2=change(sample.specific_force_mps2, max(since_s, 0.0)))

    return lambda sample, since_s: changed(sample, since_s) if since_s >= 0.0 else sample


def _offset(mps2: float, lasts_s: float = ALL_S) -> Callable[[ImuSample, float], ImuSample]:
    return _force(lambda force, since_s: force + np.array([mps2, 0.0, 0.0]) * (since_s < lasts_s))


def _frozen(*, gyro: bool, accelerometer: bool) -> Callable[[ImuSample, float], ImuSample]:
    kept: list[ImuSample] = []

    def change(sample: ImuSample, since_s: float) -> ImuSample:
        if since_s < 0.0:
            return sample
        kept.append(sample)
        gyro_radps = kept[0].gyro_radps if gyro else sample.gyro_radps
        return replace(
            sample,
            gyro_radps=gyro_radps,
            specific_force_mps2=kept[0].specific_force_mps2 if accelerometer else sample.specific_force_mps2,
        )

    return change


def _reasons(flown: FlownOdometry, from_s: float = 0.0, to_s: float = ALL_S) -> set[ReasonCode | None]:
    return {
        odom.health_reason.code if odom.health_reason else None for odom in flown.odom[flown.since(from_s) : flown.since(to_s)]
    }


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("fault", "error_m", "error_after_m"),
    [
        (_force(lambda force, since_s: force * (1.0 - 0.49 * min(since_s, 1.0))), 0.09, 0.03),  # clipped by vibration
        (_force(lambda force, _: 0.51 * force), 0.15, 0.03),
        (_force(lambda force, _: 0.8 * force), 0.07, 0.03),
        (_offset(1.0), 0.04, 0.04),
        (_offset(2.0), 0.07, 0.05),
        (_offset(4.0), 0.12, 0.03),
        (_offset(8.0), 0.17, 0.03),
        (_offset(4.0, 1.0), 0.12, 0.03),
        (_offset(8.0, 0.5), 0.17, 0.03),
    ],
)
def test_a_lying_accelerometer_does_not_carry_odometry_away(
    fault: Callable[[ImuSample, float], ImuSample], error_m: float, error_after_m: float, seed: int
) -> None:
    flown = fly(undisturbed, seconds=6.0, seed=seed, inertial=fault)
    assert flown.error_m(0.0) < error_m
    assert flown.error_m(1.5) < error_after_m
    assert flown.healths(0.0) <= {GOOD, DEGRADED}
    assert flown.resets() == flown.odom[-1].correction.epoch == flown.fusion.rejected.total() == 0


@pytest.mark.parametrize("mps2", [4.0, 8.0])
def test_a_large_offset_is_named_and_forgiven_once_it_is_gone(mps2: float) -> None:
    flown = fly(undisturbed, seconds=9.0, inertial=_offset(mps2, 1.0))
    assert _reasons(flown, 0.5, 1.0) == {ReasonCode.ACCELEROMETER_REJECTED}
    assert _reasons(flown, 7.0) == {None}


def test_the_step_at_the_change_of_the_model_is_in_the_covariance() -> None:
    """Three published standard deviations cover each step of odometry, so that no gate takes it for a jump."""
    flown = fly(undisturbed, seconds=3.0, inertial=_offset(8.0))
    steps_m = np.linalg.norm(np.diff(flown.errors_m, axis=0), axis=1)
    k = int(np.argmax(steps_m))
    assert steps_m[k] > 0.05
    assert steps_m[k] < 3.0 * np.sqrt(flown.odom[k + 1].covariance[0, 0])
    assert np.sqrt(flown.odom[-1].covariance[0, 0]) < 0.015


def test_vibration_beyond_all_measure_stays_within_centimetres() -> None:
    rng = np.random.default_rng(3)
    flown = fly(undisturbed, seconds=5.0, inertial=_force(lambda force, _: force + rng.normal(0.0, 3.0, 3)))
    assert flown.error_m(0.0) < 0.07


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (_frozen(gyro=True, accelerometer=True), ReasonCode.IMU_FROZEN),
        (_frozen(gyro=True, accelerometer=False), ReasonCode.IMU_FROZEN),
        (_frozen(gyro=False, accelerometer=True), ReasonCode.ACCELEROMETER_FROZEN),
    ],
)
def test_values_that_repeat_are_noticed_within_a_fifth_of_a_second(
    fault: Callable[[ImuSample, float], ImuSample], code: ReasonCode
) -> None:
    flown = fly(undisturbed, seconds=4.0, inertial=fault)
    assert flown.first(DEGRADED) <= 0.3  # at the next pose after 0.1 s
    assert _reasons(flown, 0.35) == {code}
    assert flown.error_m(0.0) < 0.04
    assert flown.resets() == flown.odom[-1].correction.epoch == 0


@pytest.mark.parametrize("fault", [lambda rate: rate + np.array([0.0, 0.0, 0.3]), lambda rate: 0.5 * rate])
def test_a_lying_gyro_is_named_and_flown_without(fault: Callable[[F64], F64]) -> None:
    def changed(sample: ImuSample, since_s: float) -> ImuSample:
        return replace(sample, gyro_radps=fault(sample.gyro_radps)) if since_s >= 0.0 else sample

    flown = fly(undisturbed, seconds=5.0, inertial=changed)
    assert _reasons(flown, 1.0, 3.0) == {ReasonCode.GYRO_REJECTED}  # later its offset may have been learned
    assert flown.error_m(0.0) < 0.04
    assert np.degrees(max(flown.turns_rad)) < 6.0


@pytest.mark.parametrize("seed", SEEDS)
def test_the_noise_of_a_flying_camera_is_no_lie(seed: int) -> None:
    """KAIST VIO, a D435i on a quadrotor: 0.07 m/s² and 0.001 rad/s per root Hz, and a mount off by a degree."""
    rng, root = np.random.default_rng(seed), 200.0**0.5

    def flying(sample: ImuSample, _: float) -> ImuSample:
        force = sample.specific_force_mps2 + np.array([0.17, 0.0, 0.0]) + rng.normal(0.0, 0.07 * root, 3)
        return replace(sample, gyro_radps=sample.gyro_radps + rng.normal(0.0, 0.001 * root, 3), specific_force_mps2=force)

    flown = fly(undisturbed, seconds=10.0, seed=seed, inertial=flying)
    assert flown.healths(0.0) == {GOOD}
    assert flown.error_m(0.0) < 0.03
    assert flown.resets() == flown.odom[-1].correction.epoch == flown.fusion.rejected.total() == 0


@pytest.mark.parametrize(("jitter_m", "error_m"), [(0.01, 0.08), (0.02, 0.12)])
def test_poses_that_scatter_more_than_they_claim_do_not_disown_the_imu_for_good(jitter_m: float, error_m: float) -> None:
    """White noise of 1 and 2 cm per axis where the source claims 4 mm, from one pose to the next."""
    rng = np.random.default_rng(4)

    def scattered(pose: StampedPose, _: float) -> StampedPose:
        place_m = pose.odom_from_body.translation_m + rng.normal(0.0, jitter_m, 3)
        return replace(pose, odom_from_body=Pose(pose.odom_from_body.quat_wxyz, place_m))

    flown = fly(scattered, seconds=12.0)
    assert flown.error_m(0.0) < error_m
    assert None in _reasons(flown, 6.0)
    assert flown.resets() == flown.odom[-1].correction.epoch == 0


def test_at_rest_half_an_accelerometer_moves_nothing() -> None:
    """The smallest input of the report: perfect poses 15 times a second, the force along z from 9.8 to 5 within a second."""
    fusion, rng, flown = FusionFilter(), np.random.default_rng(2), []
    for n in range(20 * 200):
        t = n / 200
        force = 9.80665 - 4.8 * min(max(t - 4.0, 0.0), 1.0)
        fusion.add_imu([ImuSample(t, rng.normal(0.0, 0.002, 3), np.array([0.0, 0.0, force]) + rng.normal(0.0, 0.02, 3))])
        if n % 13 == 0:
            place_m = np.array([0.0, 0.0, 1.0]) + rng.normal(0.0, 0.002, 3)
            fusion.add_pose(StampedPose(t, Pose.from_yaw(0.0, place_m), np.zeros(3)), t)
        if n % 7 == 0 and t > 4.0 and (odom := fusion.odom_at(t)):
            flown.append((odom.odom_from_body.translation_m[2], odom.velocity_odom_mps[2], odom.reset_counter))
    heights_m, climbs_mps, resets = np.array(flown).T
    assert np.abs(heights_m - 1.0).max() < 0.10
    assert np.abs(climbs_mps).max() < 0.8
    assert np.abs(climbs_mps[len(climbs_mps) // 2 :]).max() < 0.15
    assert resets.max() == 0


def test_a_pose_source_that_stands_still_in_flight_is_not_accepted_however_long() -> None:
    kept: list[StampedPose] = []

    def frozen(pose: StampedPose, _: float) -> StampedPose:
        kept.append(pose)
        return replace(pose, odom_from_body=kept[0].odom_from_body)

    flown = fly(frozen, seconds=6.0)
    assert flown.first(PoseHealth.LOST) <= 0.4
    assert flown.healths(0.4) == {PoseHealth.LOST}
    assert flown.odom[-1].quality == 0


def test_no_frozen_imu_is_seen_in_a_body_at_rest() -> None:
    fusion, rng = FusionFilter(), np.random.default_rng(5)
    hover = np.array([0.0, 0.0, GRAVITY_MPS2])
    for n in range(600):
        t = MOTION.start_s + n / 200
        fusion.add_imu([ImuSample(t, rng.normal(0.0, 1e-5, 3), hover + rng.normal(0.0, 1e-4, 3))])
        if n % 13 == 0:
            place_m = np.array([0.0, 0.0, 1.0]) + rng.normal(0.0, 0.001, 3)
            fusion.add_pose(StampedPose(t, Pose.from_yaw(0.0, place_m), np.zeros(3)), t)
    odom = fusion.odom_at(ONSET_S - 1.02)
    assert odom
    assert odom.health is GOOD
