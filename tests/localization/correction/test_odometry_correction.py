"""Odom with a tracker beside it: what is corrected, and what is left alone."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from uav_recon.localization.correction.odometry_correction import TrackedCorrection
from uav_recon.types.camera import Frame, ImuSample, Intrinsics
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose

LENS = Intrinsics.from_fov(32, 24, 1.5, 1.2)
HZ = 15.0
Motion = Callable[[float], FloatArray]


def _place(stamp_s: float) -> FloatArray:
    angle = 0.3 * max(stamp_s - 2.0, 0.0)
    return np.array([2.0 * math.sin(angle), 2.0 * (1.0 - math.cos(angle)), 1.0])


def _velocity(stamp_s: float) -> FloatArray:
    return (_place(stamp_s + 0.01) - _place(stamp_s - 0.01)) / 0.02


class World:
    """Odom with an error, and a tracker without one until it is lost."""

    def __init__(self, error_m: Motion, lost_from_s: float = math.inf, rate_mps: FloatArray | None = None) -> None:
        self.error_m = error_m
        self.lost_from_s = lost_from_s
        self.rate_mps = np.zeros(3) if rate_mps is None else rate_mps
        self.reset_from_s = math.inf
        self.correction = TrackedCorrection(self.odom, lambda outside: self)
        self.now_s = 0.0

    def odom(self, stamp_s: float) -> StampedPose:
        place_m = _place(stamp_s) + self.error_m(stamp_s)
        moving = self.error_m(stamp_s).any()
        counter = int(stamp_s >= self.reset_from_s)
        velocity = _velocity(stamp_s) + self.rate_mps * moving
        return StampedPose(stamp_s, Pose.from_yaw(0.0, place_m), velocity, reset_counter=counter)

    determined = np.eye(3)

    def add_imu(self, samples: list[ImuSample]) -> None: ...

    def track(self, frame: Frame, body_from_depth: Pose) -> StampedPose | None:
        if frame.stamp_s > self.lost_from_s:
            return None
        return StampedPose(
            frame.stamp_s, Pose.from_yaw(0.5, np.zeros(3)) @ Pose.from_yaw(0.0, _place(frame.stamp_s)), np.zeros(3)
        )

    def fly(self, until_s: float, confirmed: bool = False) -> StampedPose:
        """Return corrected odom at the end."""
        while self.now_s < until_s:
            self.now_s += 1.0 / HZ
            depth_m, rgb = np.full((24, 32), 2.0, np.float32), np.zeros((2, 2, 3), np.uint8)
            self.correction.add_frame(Frame(self.now_s, 0, depth_m, LENS, rgb, LENS, Pose.identity()), Pose.identity())
            self.correction.advance(self.now_s, lambda drift_mps: confirmed)
        return self.correction.corrected(self.odom(self.now_s))

    @property
    def off_m(self) -> float:
        """Error of corrected odom now."""
        found = self.correction.corrected(self.odom(self.now_s))
        return float(np.linalg.norm(found.odom_from_body.translation_m - _place(self.now_s)))


def _drift(mps: FloatArray, from_s: float = 10.0) -> Motion:
    return lambda stamp_s: mps * max(stamp_s - from_s, 0.0)


@pytest.mark.parametrize("mps", [(0.05, 0.0, 0.0), (0.0, -0.2, 0.0), (0.0, 0.0, 0.02)])
def test_a_drift_is_corrected_in_place_and_velocity(mps: tuple[float, float, float]) -> None:
    world = World(_drift(np.array(mps)), rate_mps=np.array(mps))
    found = world.fly(30.0)
    assert world.off_m < 0.1
    assert np.linalg.norm(found.velocity_odom_mps - _velocity(world.now_s)) < 0.05
    assert world.correction.reason is not None
    back = found.correction.world_from_odom @ found.odom_from_body
    np.testing.assert_allclose(back.translation_m, world.odom(world.now_s).odom_from_body.translation_m, atol=1e-9)


def test_the_error_stays_small_from_the_onset_on() -> None:
    world, worst_m = World(_drift(np.array([0.1, 0.0, 0.0]))), 0.0
    for k in range(1, 300):
        world.fly(k / 10.0)
        worst_m = max(worst_m, world.off_m)
    assert worst_m < 0.3


def test_honest_odom_stays_as_it_is_to_the_last_bit() -> None:
    world = World(lambda stamp_s: 0.02 * np.array([math.sin(0.3 * stamp_s), math.cos(0.2 * stamp_s), 0.0]) * (stamp_s > 2.0))
    found = world.fly(40.0)
    assert found.odom_from_body.translation_m.tolist() == world.odom(world.now_s).odom_from_body.translation_m.tolist()
    assert world.correction.reason is None


def test_a_drift_that_depth_confirms_is_corrected_further() -> None:
    off_m = []
    for confirmed in (False, True):
        world = World(_drift(np.array([0.03, 0.0, 0.0])))
        world.fly(17.0, confirmed)
        off_m.append(world.off_m)
    assert off_m[1] < off_m[0] - 0.02


def test_the_correction_holds_while_the_tracker_is_lost() -> None:
    world = World(_drift(np.array([0.05, 0.0, 0.0])), lost_from_s=30.0)
    at_loss_m = world.fly(30.0).odom_from_body.translation_m - world.odom(30.0).odom_from_body.translation_m
    later = world.fly(35.0)
    held_m = later.odom_from_body.translation_m - world.odom(world.now_s).odom_from_body.translation_m
    np.testing.assert_allclose(held_m, at_loss_m, atol=0.06)
    assert not world.correction.drift_mps(world.now_s).any()


def test_the_correction_never_jumps() -> None:
    world = World(_drift(np.array([0.2, 0.0, 0.0])))
    world.fly(9.0)
    before_m, worst_m = np.zeros(3), 0.0
    while world.now_s < 25.0:
        place_m = world.fly(world.now_s + 0.01).odom_from_body.translation_m
        shift_m = place_m - world.odom(world.now_s).odom_from_body.translation_m
        worst_m, before_m = max(worst_m, float(np.linalg.norm(shift_m - before_m))), shift_m
    assert 0.2 / HZ < worst_m < 0.4 / HZ


def test_a_restart_of_odom_begins_again_without_correction() -> None:
    world = World(_drift(np.array([0.05, 0.0, 0.0])))
    world.fly(30.0)
    world.reset_from_s = world.now_s
    world.fly(31.0)
    assert world.correction.reason is None
