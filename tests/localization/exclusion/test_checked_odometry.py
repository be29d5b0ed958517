from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from figure_eight import FigureEight, perfect_imu

from uav_recon.localization.exclusion.checked_odometry import CheckedOdometry
from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.localization.fusion.imu_integration import InertialTrack
from uav_recon.localization.fusion.inertial_check import InertialCheck
from uav_recon.localization.slam.view_odometry import ViewOdometry
from uav_recon.types.camera import ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason_code import ReasonCode

MOTION = FigureEight(start_s=100.0, speed_mps=0.5)
SAMPLES = [perfect_imu(MOTION, n) for n in range(20 * 200)]
TRACKER_FROM_ODOM = Pose.from_yaw(1.2, np.array([0.5, -0.3, 0.1]))
FAULT_S = 8.0
Said = Callable[[float, Pose], Pose]


class Gyro:
    def __init__(self) -> None:
        self.track = InertialTrack()

    def at(self, stamp_s: float) -> Any:
        return self.track.at(stamp_s) if self.track.newest_s + 0.05 >= stamp_s else None


class Tracker:
    def __init__(self) -> None:
        self.gyro = Gyro()
        self.accelerometer_used = True


class View:
    """Tracked images with exact poses, in a frame of their own; 6 Hz, 0.06 s late."""

    def __init__(self, seen: Said, moves: Callable[[float], bool]) -> None:
        self.tracker = Tracker()
        self.check = InertialCheck(self.tracker.gyro.at)
        self.shown: FloatArray = np.eye(3)
        self.newest_pose: StampedPose | None = None
        self.newest_pose_s = -np.inf
        self.health = PoseHealth.GOOD
        self.sure = True
        self.moved_s = -np.inf
        self._moves = moves
        self._seen = seen

    def add_imu(self, samples: list[ImuSample], now_s: float) -> None:
        for sample in samples:
            force = sample.specific_force_mps2.tolist()
            self.tracker.gyro.track.push(sample.stamp_s, tuple(sample.gyro_radps.tolist()), tuple(force))

    def look(self, stamp_s: float) -> None:
        pose = self._pose(stamp_s)
        self.moved_s = stamp_s if self._moves(stamp_s - MOTION.start_s) else self.moved_s
        self.newest_pose, self.newest_pose_s = StampedPose(stamp_s, pose, np.zeros(3)), stamp_s
        self.check.update(stamp_s, pose, self.shown, 0.003)

    def odom_at(self, stamp_s: float) -> StampedPose | None:
        velocity = TRACKER_FROM_ODOM.rotation() @ MOTION.velocity(stamp_s)
        return StampedPose(stamp_s, self._pose(stamp_s), velocity, health=self.health)

    def _pose(self, stamp_s: float) -> Pose:
        return TRACKER_FROM_ODOM @ self._seen(stamp_s - MOTION.start_s, MOTION.pose(stamp_s))


def honest(since_s: float, true: Pose) -> Pose:
    return true


def frozen(lasts_s: float) -> Said:
    """Return a source whose translation stands still for a while."""

    def said(since_s: float, true: Pose) -> Pose:
        stands = FAULT_S <= since_s < FAULT_S + lasts_s
        return Pose(true.quat_wxyz, MOTION.position(MOTION.start_s + FAULT_S) if stands else true.translation_m)

    return said


def restarted(since_s: float, true: Pose) -> Pose:
    """Return the pose by a source that begins again at the identity, without a word."""
    begun = MOTION.pose(MOTION.start_s + FAULT_S)
    return true if since_s < FAULT_S else begun.inverse() @ true


def jumped(since_s: float, true: Pose) -> Pose:
    """Return the pose by a view that stands still from an instant on, as before a surface that moves with the body."""
    return true if since_s < FAULT_S else Pose(true.quat_wxyz, MOTION.position(MOTION.start_s + FAULT_S))


def spiked(since_s: float, true: Pose) -> Pose:
    """Return the pose by a source of which one pose is off by 0.5 m, at five instants."""
    off_m = 0.5 if any(at_s <= since_s < at_s + 0.065 for at_s in (5.0, 6.31, 7.62, 8.93, 10.24)) else 0.0
    return Pose(true.quat_wxyz, true.translation_m + np.array([off_m, 0.0, 0.0]))


def fly(
    said: Said,
    seen: Said = honest,
    until_s: float = 16.0,
    force: Callable[[float], float] = lambda _: 0.0,
    shown_share: float = 1.0,
    moves: Callable[[float], bool] = lambda _: False,
) -> list[tuple[float, StampedPose, float]]:
    """Return the instant, odometry and its error against the truth, 30 times a second from 3 s on."""
    view = View(seen, moves)
    view.shown *= shown_share
    odometry = CheckedOdometry(FusionFilter(), cast(ViewOdometry, view))
    rng, found = np.random.default_rng(4), []
    for n, sample in enumerate(SAMPLES[: round(until_s * 200)]):
        now_s, since_s = sample.stamp_s, sample.stamp_s - MOTION.start_s
        pushed = np.array([force(since_s), 0.0, 0.0]) + rng.normal(0.0, 0.05, 3)
        odometry.add_imu([ImuSample(now_s, sample.gyro_radps, sample.specific_force_mps2 + pushed)], now_s)
        if n % 13 == 0 and n > 20:
            stamp_s = now_s - 0.06
            pose = said(stamp_s - MOTION.start_s, MOTION.pose(stamp_s))
            noisy = Pose(pose.quat_wxyz, pose.translation_m + rng.normal(0.0, 0.002, 3))
            odometry.add_pose(StampedPose(stamp_s, noisy, np.zeros(3)), now_s)
        if n % 33 == 0 and n > 20:
            view.look(now_s - 0.06)
            odometry.add_view(now_s)
        if n % 7 == 0 and since_s > 3.0:
            odom = odometry.odom_at(now_s)
            assert odom is not None
            found.append((since_s, odom, float(np.linalg.norm(odom.odom_from_body.translation_m - MOTION.position(now_s)))))
    return found


def excluded(found: list[tuple[float, StampedPose, float]]) -> list[float]:
    """Return the instants at which the source was excluded, at first with an error that is not yet out of odometry."""
    codes = (ReasonCode.SOURCE_EXCLUDED, ReasonCode.PLACE_UNSURE)
    return [since_s for since_s, odom, _ in found if odom.health_reason is not None and odom.health_reason.code in codes]


def test_an_honest_source_is_never_excluded() -> None:
    found = fly(honest)
    assert excluded(found) == []
    assert max(error for _, _, error in found) < 0.03


@pytest.mark.parametrize("lasts_s", [0.5, 2.0, 5.0])
def test_a_source_that_stands_still_is_excluded_and_used_again(lasts_s: float) -> None:
    found = fly(frozen(lasts_s))
    out = excluded(found)
    assert FAULT_S < out[0] < FAULT_S + 0.6
    assert FAULT_S + lasts_s + 2.5 < out[-1] < FAULT_S + lasts_s + 5.0
    assert max(error for _, _, error in found) < 0.3
    late = [error for since_s, _, error in found if since_s > FAULT_S + 2.0]
    assert max(late) < 0.06


def test_odometry_neither_jumps_nor_restarts_when_the_source_is_excluded() -> None:
    found = fly(frozen(2.0))
    steps = [
        float(np.linalg.norm(after.odom_from_body.translation_m - before.odom_from_body.translation_m))
        for (_, before, _), (_, after, _) in itertools.pairwise(found)
    ]
    assert max(steps) < 0.08
    assert {odom.reset_counter for _, odom, _ in found} == {0}


def test_a_source_that_starts_again_elsewhere_moves_the_world_and_not_odometry() -> None:
    found = fly(restarted)
    assert excluded(found)[0] < FAULT_S + 0.6
    since_s, odom, error = found[-1]
    assert since_s - excluded(found)[-1] > 1.0
    assert odom.health is PoseHealth.GOOD
    assert error < 0.08
    begun = MOTION.pose(MOTION.start_s + FAULT_S).inverse()
    np.testing.assert_allclose(odom.correction.world_from_odom.translation_m, begun.translation_m, atol=0.1)


def sliding(speed_mps: float, lasts_s: float) -> Said:
    """Return a source that slides at a constant speed for a while, which no accelerometer shows."""

    def said(since_s: float, true: Pose) -> Pose:
        way_m = speed_mps * min(max(since_s - FAULT_S, 0.0), lasts_s)
        return Pose(true.quat_wxyz, true.translation_m + way_m * np.eye(3)[0])

    return said


def test_where_the_inertial_samples_contradict_neither_the_ways_differ_by_twice_as_much() -> None:
    """Tracked images are off by this far in honest flights."""
    assert excluded(fly(sliding(0.08, 1.0))) == []
    assert excluded(fly(sliding(0.2, 1.0))) != []


def test_a_source_that_drifts_slowly_is_excluded() -> None:
    out = excluded(fly(sliding(0.05, 60.0), until_s=18.0))
    assert FAULT_S + 5.0 < out[0] < FAULT_S + 8.5


def test_a_source_that_still_drifts_is_not_used_again() -> None:
    """The view determines too little for the short windows, in which the source would look right."""
    out = excluded(fly(sliding(0.05, 60.0), until_s=19.0, shown_share=0.8))
    assert FAULT_S + 5.0 < out[0] < FAULT_S + 8.5
    assert np.diff(out).max() < 0.1
    assert out[-1] > 18.9


def test_each_exclusion_doubles_the_time_of_the_next_one() -> None:
    def twice(since_s: float, true: Pose) -> Pose:
        first = frozen(0.5)(since_s, true)
        return first if since_s < FAULT_S + 5.0 else frozen(0.5)(since_s - 5.5, first)

    out = np.array(excluded(fly(twice, until_s=19.9)))
    gap = int(np.argmax(np.diff(out)))
    assert np.diff(out)[gap] > 0.5
    assert out[gap] - out[0] < 4.5
    assert out[-1] - out[gap + 1] > 5.5, "until the flight ends"


def test_a_view_that_a_person_moves_does_not_exclude_an_honest_source() -> None:
    """The track of the view is carried along at 0.3 m/s for 2 s; nothing but the view tells that something moves in it."""
    carried = sliding(0.3, 2.0)
    assert excluded(fly(honest, carried)) != []
    assert excluded(fly(honest, carried, moves=lambda since_s: FAULT_S <= since_s <= FAULT_S + 2.0)) == []


def test_a_view_that_stands_still_does_not_exclude_an_honest_source() -> None:
    found = fly(honest, jumped)
    assert excluded(found) == []
    assert max(error for _, _, error in found) < 0.05


def test_a_lying_accelerometer_excludes_nothing_else() -> None:
    found = fly(honest, force=lambda since_s: 2.0 * (FAULT_S <= since_s < FAULT_S + 0.5))
    assert excluded(found) == []
    assert max(error for _, _, error in found) < 0.1


def test_one_wrong_pose_excludes_nothing() -> None:
    found = fly(spiked)
    assert excluded(found) == []
    assert max(error_m for _, _, error_m in found) < 0.05
