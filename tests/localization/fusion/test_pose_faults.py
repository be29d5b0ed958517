"""The rows of the hazard table about poses, on the filter alone: what it says, and what it never says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from faulty_pose_flight import MOTION, ONSET_S, Trouble, fly, shifted
from scipy.spatial.transform import Rotation

from uav_recon.localization.fusion.filter_pose_gates import PoseRejection
from uav_recon.types.camera import ImuSample
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

GOOD, DEGRADED, LOST = PoseHealth.GOOD, PoseHealth.DEGRADED, PoseHealth.LOST


def once(trouble: Trouble, at_s: float = 0.5) -> Trouble:
    done: list[float] = []

    def change(pose: StampedPose, since_s: float) -> StampedPose | None:
        if since_s < at_s or done:
            return pose
        done.append(since_s)
        return trouble(pose, since_s)

    return change


def silent(from_s: float, to_s: float, then: Trouble | None = None) -> Trouble:
    def change(pose: StampedPose, since_s: float) -> StampedPose | None:
        if from_s <= since_s < to_s:
            return None
        return then(pose, since_s) if then and since_s >= to_s else pose

    return change


def undisturbed(pose: StampedPose, since_s: float) -> StampedPose:
    return pose


def test_a_calm_flight_is_good_throughout() -> None:
    flown = fly(undisturbed)
    assert flown.healths(0.0) == {GOOD}
    assert {odom.health_reason for odom in flown.odom} == {None}
    assert flown.fusion.correction.epoch == flown.resets() == 0
    assert not flown.fusion.rejected


def test_b1_a_silent_source_is_lost_within_a_quarter_second() -> None:
    flown = fly(silent(0.0, 1e9))
    assert flown.first(LOST) <= 0.3
    lost = flown.odom[flown.since(0.3)]
    assert lost.health_reason is not None
    assert (lost.health_reason.code, int(lost.health_reason.values[0])) == (ReasonCode.NO_POSE, 0)
    assert flown.odom[flown.since(0.6)].quality == 0
    assert flown.error_m(0.0, 0.5) < 0.05  # what the autopilot is fed meanwhile


@pytest.mark.parametrize("offset_m", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("gone_s", [0.5, 2.0, 10.0])
def test_b2_a_source_that_comes_back_has_to_prove_itself_for_a_second(gone_s: float, offset_m: float) -> None:
    flown = fly(silent(0.0, gone_s, shifted(y=offset_m)), seconds=gone_s + 2.5)
    quiet = flown.odom[flown.since(gone_s) : flown.since(gone_s + 0.99)]
    assert {odom.quality for odom in quiet[2:]} == {0}
    assert flown.healths(gone_s + 1.4) == {GOOD}
    if gone_s < 1.0 and offset_m < 0.5:  # a flying IMU explains 0.3 m after 1.5 s: odom moves there without a step
        assert flown.step_m() < 0.05
        assert flown.resets() == flown.fusion.correction.epoch == 0
    if gone_s > 5.0 or offset_m > 0.5:
        assert flown.resets() == 1  # odom jumped, once, and says so


@pytest.mark.parametrize("trouble", [shifted(x=0.5), shifted(y=-0.12), shifted(z=0.3), shifted(x=40.0)])
def test_b3_a_spike_is_not_seen_in_odometry(trouble: Trouble) -> None:
    flown, calm = fly(once(trouble)), fly(undisturbed)
    differences = [
        np.linalg.norm(a.odom_from_body.translation_m - b.odom_from_body.translation_m)
        for a, b in zip(flown.odom, calm.odom, strict=True)
    ]
    assert max(differences) < 0.01
    assert flown.fusion.rejected.total() == 1
    assert flown.fusion.correction.epoch == flown.resets() == 0


@pytest.mark.parametrize("turn_deg", [180.0, 90.0, 15.0, -9.0])
def test_b9_a_flipped_heading_is_not_seen_once(turn_deg: float) -> None:
    flown = fly(once(shifted(yaw_deg=turn_deg, about_origin=False)))
    assert flown.fusion.rejected == {PoseRejection.TURN: 1}
    assert math.degrees(max(flown.turns_rad[flown.since(0.0) :])) < 0.6


@pytest.mark.parametrize("trouble", [shifted(x=0.5), shifted(y=2.0), shifted(yaw_deg=10.0), shifted(x=-1.0, yaw_deg=-10.0)])
def test_b4_a_closed_loop_moves_the_world_and_never_odom(trouble: Trouble) -> None:
    flown = fly(trouble)
    assert flown.step_m() < 0.02  # 0.05 is allowed
    assert flown.error_m(0.0) < 0.05
    assert flown.resets() == 0
    correction = flown.odom[-1].correction
    assert correction.epoch == 1
    moved = trouble(StampedPose(ONSET_S, Pose.identity(), np.zeros(3)), 0.0)
    assert moved
    apart = correction.world_from_odom @ moved.odom_from_body.inverse()
    assert np.linalg.norm(apart.translation_m) < 0.03
    assert math.degrees(abs(apart.yaw_rad())) < 0.7
    assert DEGRADED in flown.healths(0.0, 0.6)
    assert flown.healths(0.6) == {GOOD}


def test_b4_two_closed_loops_are_two_epochs() -> None:
    first, second = shifted(x=0.6), shifted(x=0.6, y=-0.7)
    flown = fly(lambda pose, since_s: (second if since_s > 2.0 else first)(pose, since_s), seconds=4.0)
    assert flown.odom[-1].correction.epoch == 2
    np.testing.assert_allclose(flown.odom[-1].correction.world_from_odom.translation_m, [0.6, -0.7, 0.0], atol=0.03)
    assert flown.step_m() < 0.02


def test_b4_a_tracker_that_begins_again_is_accepted_once_it_has_proven_itself() -> None:
    again = shifted(x=-3.0, y=1.0, yaw_deg=140.0)

    def reset(pose: StampedPose, since_s: float) -> StampedPose | None:
        changed = again(pose, since_s)
        assert changed
        return replace(changed, reset_counter=7)

    flown = fly(reset)
    assert flown.fusion.rejected[PoseRejection.RESET] == 3  # poses until four agreed
    assert flown.odom[-1].correction.epoch == 1
    assert flown.step_m() < 0.02
    assert flown.resets() == 0
    assert flown.healths(0.6) == {GOOD}


@pytest.mark.parametrize("turn_deg", [180.0, 90.0, 15.0])
def test_b9_a_heading_lost_for_good_is_never_flown_on(turn_deg: float) -> None:
    """Nor once the place is lost and odom could restart: the gyro knows better, and an autopilot that lands would follow."""
    flown = fly(shifted(yaw_deg=turn_deg, about_origin=False), seconds=8.0)
    assert flown.first(LOST) <= 0.3
    assert flown.healths(0.3) == {LOST}
    assert flown.resets() == 0
    assert flown.odom[flown.since(0.6)].quality == 0
    why = flown.odom[-1].health_reason
    assert why is not None
    assert why.code is ReasonCode.POSES_DISAGREE
    assert math.degrees(max(flown.turns_rad)) < 1.5


def test_b5_a_slow_drift_is_followed_without_a_step() -> None:
    """0.05 m/s is nothing that an IMU can tell from flight; depth against the map shows it (guard, mapper)."""
    flown = fly(lambda pose, since_s: shifted(x=0.05 * since_s)(pose, since_s), seconds=10.0)
    assert flown.step_m() < 0.015
    assert flown.odom[-1].correction.epoch == flown.resets() == 0
    assert flown.odom[-1].quality == 100
    lag_m = flown.errors_m[-1][0] - 0.5
    assert abs(lag_m) < 0.03


def test_b6_a_wrong_scale_is_followed_without_a_step() -> None:
    def grown(pose: StampedPose, _: float) -> StampedPose:
        return replace(pose, odom_from_body=Pose(pose.odom_from_body.quat_wxyz, 1.1 * pose.odom_from_body.translation_m))

    flown = fly(grown, seconds=8.0)
    assert flown.step_m() < 0.03
    assert flown.resets() == 0


def test_b7_a_broken_source_is_a_silent_one() -> None:
    flown = fly(lambda pose, _: replace(pose, covariance=np.full((6, 6), np.nan)), seconds=1.5)
    assert flown.first(LOST) <= 0.3
    assert flown.fusion.rejected[PoseRejection.NOT_FINITE] > 10
    assert np.isfinite(flown.errors_m).all()


def test_b8_a_frozen_source_is_a_silent_one() -> None:
    frozen: list[StampedPose] = []

    def change(pose: StampedPose, _: float) -> StampedPose:
        frozen.append(frozen[0] if frozen else pose)
        return frozen[0]

    flown = fly(change, seconds=1.5)
    assert flown.first(LOST) <= 0.4  # the first one was good
    assert flown.fusion.rejected[PoseRejection.DUPLICATE] > 10


def test_b8_a_picture_that_stands_still_is_not_accepted() -> None:
    """The stamp goes on, the pose does not: at 0.8 m/s the IMU knows better within a few poses."""
    frozen: list[StampedPose] = []

    def change(pose: StampedPose, _: float) -> StampedPose:
        frozen.append(pose)
        return replace(pose, odom_from_body=frozen[0].odom_from_body)

    flown = fly(change, seconds=1.5)
    assert flown.first(LOST) <= 0.6
    assert flown.error_m(0.0, 0.6) < 0.12
    assert flown.odom[-1].quality == 0


@pytest.mark.parametrize("late_s", [0.1, 0.2])
def test_b8_poses_that_come_later_still_count_at_their_own_stamp(late_s: float) -> None:
    """The row's 0.1 s, and 0.2 s: 260 ms in all."""
    flown = fly(undisturbed, late_s=late_s)
    assert flown.error_m(1.0) < 0.03
    assert flown.step_m() < 0.02
    assert not flown.fusion.rejected
    assert flown.odom[-1].quality > 0


def test_b8_a_second_late_is_a_silent_source() -> None:
    flown = fly(undisturbed, late_s=1.0, seconds=1.9)
    assert flown.first(LOST) <= 0.3
    assert flown.odom[flown.since(0.9)].quality == 0
    assert flown.fusion.rejected[PoseRejection.STAMP] > 5


def test_b8_stamps_of_the_future_are_a_silent_source() -> None:
    flown = fly(lambda pose, _: replace(pose, stamp_s=pose.stamp_s + 5.0), seconds=1.5)
    assert flown.first(LOST) <= 0.3
    assert flown.fusion.rejected[PoseRejection.STAMP] > 10


@pytest.mark.parametrize(("rate_hz", "health"), [(6.0, DEGRADED), (3.0, LOST)])
def test_b10_few_poses_are_reported_within_a_second_and_odometry_goes_on(rate_hz: float, health: PoseHealth) -> None:
    next_s = [0.0]

    def thinned(pose: StampedPose, since_s: float) -> StampedPose | None:
        if since_s < next_s[0]:
            return None
        next_s[0] = since_s + 1.0 / rate_hz
        return pose

    flown = fly(thinned, seconds=4.0)
    assert flown.first(DEGRADED) <= 1.2
    assert flown.healths(1.5) <= {health, LOST}
    assert health in flown.healths(1.5)
    assert min(odom.quality for odom in flown.odom) > 0
    assert flown.error_m(0.0) < 0.06
    assert flown.step_m() < 0.03


@pytest.mark.parametrize("tilt_deg", [6.0, 10.0, 20.0])
def test_a_track_that_lost_where_down_is_does_not_stand_against_the_poses(tilt_deg: float) -> None:
    """Inertial samples that repeat while a computer stalls: what follows is gravity, taken for a push to the side."""

    def stalled(sample: ImuSample, since_s: float) -> ImuSample:
        turned = np.array([math.radians(tilt_deg) / 0.14, 0.0, 0.0]) if 0.0 <= since_s < 0.14 else np.zeros(3)
        return replace(sample, gyro_radps=sample.gyro_radps + turned)

    flown = fly(undisturbed, seconds=6.0, inertial=stalled)
    assert flown.error_m(0.0) < 0.15
    assert flown.error_m(0.6) < 0.05
    assert flown.healths(0.8) <= {GOOD, DEGRADED}
    assert flown.healths(5.0) == {GOOD}
    assert flown.fusion.correction.epoch == 0  # no map turns about the horizon


@pytest.mark.parametrize(("force_mps2", "lasts_s"), [(39.0, 0.02), (78.0, 0.01), (150.0, 0.005), (1e6, 0.005)])
def test_a_force_that_no_propeller_has_is_doubted_by_as_much(force_mps2: float, lasts_s: float) -> None:
    """An accelerometer that lies, with poses that are right: odometry bends for a tenth of a second and goes on."""

    def struck(sample: ImuSample, since_s: float) -> ImuSample:
        lies = 0.5 - 1e-6 <= since_s < 0.5 + lasts_s - 1e-6
        return replace(sample, specific_force_mps2=np.array([force_mps2, 0.0, 9.8])) if lies else sample

    flown = fly(undisturbed, inertial=struck)
    assert flown.error_m(0.0) < 0.12
    assert flown.error_m(0.8) < 0.05
    assert flown.healths(0.0) == {GOOD}
    assert flown.resets() == flown.fusion.correction.epoch == 0


def test_a_blow_that_was_one_is_followed_at_once() -> None:
    """0.6 m/s within 20 ms, seen by the accelerometer and by the poses."""
    push, blow_s, lasts_s = np.array([0.6, 0.0, 0.0]), ONSET_S + 0.5, 0.02

    def felt(sample: ImuSample, since_s: float) -> ImuSample:
        during = 0.5 - 1e-6 <= since_s < 0.5 + lasts_s - 1e-6
        force = MOTION.attitude(sample.stamp_s).inv().apply(push / lasts_s)
        return replace(sample, specific_force_mps2=sample.specific_force_mps2 + during * force)

    def moved_m(stamp_s: float) -> np.ndarray:
        return push * max(stamp_s - blow_s - 0.5 * lasts_s, 0.0)

    def seen(pose: StampedPose, since_s: float) -> StampedPose:
        place_m = pose.odom_from_body.translation_m + moved_m(pose.stamp_s)
        return replace(pose, odom_from_body=Pose(pose.odom_from_body.quat_wxyz, place_m))

    flown = fly(seen, inertial=felt, seconds=2.0)
    errors_m = [
        np.linalg.norm(error_m - moved_m(stamp_s)) for error_m, stamp_s in zip(flown.errors_m, flown.stamps_s, strict=True)
    ]
    assert max(errors_m) < 0.06
    assert flown.healths(0.0) == {GOOD}
    assert flown.resets() == flown.fusion.correction.epoch == 0


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("rate_radps", "lasts_s"), [(11.0, 0.005), (30.0, 0.005), (-34.0, 0.005), (30.0, 0.015), (30.0, 0.02)])
def test_a_rate_that_no_vehicle_has_is_doubted_by_as_much(axis: int, rate_radps: float, lasts_s: float) -> None:
    """A gyro that lies, with poses that are right: odometry is silent until the next of them, and goes on."""

    def whirled(sample: ImuSample, since_s: float) -> ImuSample:
        lies = 0.5 - 1e-6 <= since_s < 0.5 + lasts_s - 1e-6
        return replace(sample, gyro_radps=np.where(lies & (np.arange(3) == axis), rate_radps, sample.gyro_radps))

    flown = fly(undisturbed, inertial=whirled, may_be_silent=True)
    assert flown.error_m(0.0) < 0.03
    assert math.degrees(max(flown.turns_rad)) < 0.6
    assert 0.5 <= min(flown.silent_s) <= max(flown.silent_s) < 0.65  # poses come 15 times a second, 0.06 s late
    assert flown.healths(0.0) == {GOOD}
    assert flown.resets() == flown.fusion.correction.epoch == flown.fusion.rejected.total() == 0


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_blow_that_turned_it_is_followed(axis: int) -> None:
    """12 rad/s for 50 ms, 34 degrees, felt by the gyro and seen by the poses."""
    blow_s, rate_radps, lasts_s = ONSET_S + 0.5, 12.0 * np.eye(3)[axis], 0.05
    ramp_s = np.array([-0.005, 0.0, lasts_s - 0.005, lasts_s])  # as the samples beside it have it

    def turned(stamp_s: float) -> Rotation:
        at_s = np.clip(stamp_s - blow_s, ramp_s[0], ramp_s[-1])
        fine_s = np.linspace(ramp_s[0], at_s, 200)
        share = np.trapezoid(np.interp(fine_s, ramp_s, [0.0, 1.0, 1.0, 0.0]), fine_s)
        return Rotation.from_rotvec(rate_radps * share)

    def felt(sample: ImuSample, since_s: float) -> ImuSample:
        during, turn = 0.5 - 1e-6 <= since_s < 0.5 + lasts_s - 1e-6, turned(sample.stamp_s).inv()
        rate, force = turn.apply(sample.gyro_radps) + during * rate_radps, turn.apply(sample.specific_force_mps2)
        return replace(sample, gyro_radps=rate, specific_force_mps2=force)

    def seen(pose: StampedPose, since_s: float) -> StampedPose:
        attitude = Rotation.from_quat(pose.odom_from_body.quat_wxyz, scalar_first=True) * turned(pose.stamp_s)
        return replace(pose, odom_from_body=Pose(attitude.as_quat(scalar_first=True), pose.odom_from_body.translation_m))

    flown = fly(seen, inertial=felt, seconds=2.0, may_be_silent=True)
    off_rad = [
        (Rotation.from_quat(odom.odom_from_body.quat_wxyz, scalar_first=True)
         * (MOTION.attitude(odom.stamp_s) * turned(odom.stamp_s)).inv()).magnitude()
        for odom in flown.odom
    ]  # fmt: skip
    assert math.degrees(max(off_rad)) < 3.0  # its own noise and drift among it, once only a pose tells
    assert flown.error_m(0.0) < 0.05
    assert 0.5 <= min(flown.silent_s) <= max(flown.silent_s) < 0.7
    assert flown.healths(0.0) == {GOOD}
    assert flown.resets() == flown.fusion.correction.epoch == flown.fusion.rejected.total() == 0


def test_without_inertial_samples_nothing_contradicts_them_and_it_says_so() -> None:
    flown = fly(undisturbed, imu=False)
    assert flown.healths(0.0) == {DEGRADED}
    assert flown.odom[-1].health_reason == Reason(ReasonCode.NO_IMU)
    assert MOTION.start_s < flown.stamps_s[0]
