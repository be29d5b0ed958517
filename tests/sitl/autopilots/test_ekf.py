from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace

import pytest

from sitl.autopilots.ekf import (
    CONST_POS_MODE,
    POS_HORIZ_ABS,
    POS_HORIZ_REL,
    PRED_POS_HORIZ_REL,
    VELOCITY_HORIZ,
    Estimator,
    ExternalPose,
)
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.autopilots.px4.tuning import estimator_tuning
from sitl.geometry.ned_frd import frd_from_flu, ned_frd_from_enu_flu, ned_from_enu
from sitl.geometry.quaternion import Quat, Vec3, from_yaw, multiply, wrapped, yaw_of
from sitl.world.imu import SimulatedImu
from sitl.world.quadrotor import GRAVITY_MPS2, Quadrotor

DT = 0.004
LOOSE = {"EKF2_EV_CTRL": 11, "EKF2_EV_QMIN": 20, "EKF2_EVP_NOISE": 0.1, "EKF2_EVP_GATE": 5.0, "EKF2_NOAID_TOUT": 5_000_000}


class Rig:
    """Vehicle that flies a figure of eight, with its IMU and poses at 50 Hz of a given age."""

    def __init__(self, age_s: float = 0.04, parameters: Px4Parameters | None = None, move: float = 1.0) -> None:
        self.vehicle = Quadrotor(5, wind_mps=0.1, start=(0.0, 0.0, 0.0))
        self.vehicle.position = (0.0, 0.0, 50.0)
        self.resets: list[tuple[Vec3, float]] = []
        tuning = estimator_tuning(parameters or Px4Parameters.load())
        self.estimator = Estimator(tuning, lambda d, t: self.resets.append((d, t)))
        self.imu = SimulatedImu(5)
        self.noise = random.Random(5)
        self.now_s = 40.0
        self.age_s = age_s
        self.move = move
        self.pose_on = True
        self.change: Callable[[ExternalPose], ExternalPose] = lambda pose: pose
        self.past: list[ExternalPose] = []
        self.steps = 0

    def run(self, seconds: float) -> float:
        """Advance, and return the greatest horizontal error."""
        worst = 0.0
        v, e = self.vehicle, self.estimator
        for _ in range(round(seconds / DT)):
            self.steps += 1
            self.now_s += DT
            t = self.now_s
            lift = GRAVITY_MPS2 + 0.25 * v.velocity[2] * -4.0 + 0.5 * (50.0 - v.position[2])
            v.step(DT, (self.move * math.sin(t), self.move * math.cos(1.7 * t), lift), 0.3 * math.sin(0.4 * t), True)
            gyro, force = self.imu.read(frd_from_flu(v.gyro), frd_from_flu(v.specific_force))
            e.predict(t, DT, gyro, force, False)
            if self.steps % 5 == 0:
                e.correct_baro(self.imu.altitude(v.position[2]), 0.02)
                self._pose()
            worst = max(worst, self.error())
        return worst

    def _pose(self) -> None:
        n = ned_from_enu(self.vehicle.position)
        g = self.noise.gauss
        q: Quat = multiply(from_yaw(g(0.0, 0.002)), ned_frd_from_enu_flu(self.vehicle.quat_wxyz))
        noisy = (n[0] + g(0.0, 0.002), n[1] + g(0.0, 0.002), n[2] + g(0.0, 0.002))
        self.past.append(ExternalPose(self.now_s, noisy, q, 1e-4, 1e-5, 90, 0))
        due = [p for p in self.past if p.stamp_s <= self.now_s - self.age_s + 1e-9]
        if due:
            self.past = [p for p in self.past if p.stamp_s > due[-1].stamp_s]
            if self.pose_on:
                for pose in due:
                    self.estimator.take(self.change(pose))

    def valid(self) -> bool:
        return self.estimator.horizontal_valid

    def follows(self) -> bool:
        return self.estimator.started

    def error(self) -> float:
        n = ned_from_enu(self.vehicle.position)
        return math.hypot(self.estimator.position[0] - n[0], self.estimator.position[1] - n[1])

    def moved(self, x: float, y: float = 0.0, counter: int = 0) -> None:
        self.change = lambda p: replace(
            p, position=(p.position[0] + x, p.position[1] + y, p.position[2]), reset_counter=counter
        )


@pytest.mark.parametrize("age_s", [0.0, 0.06, 0.18])
def test_late_poses_are_fused_at_their_own_time(age_s: float) -> None:
    rig = Rig(age_s)
    rig.run(6.0)
    assert rig.run(10.0) < 0.03
    n = ned_from_enu(rig.vehicle.velocity)
    assert math.dist(rig.estimator.velocity, n) < 0.08
    assert abs(rig.estimator.position[2] - ned_from_enu(rig.vehicle.position)[2]) < 0.05
    assert rig.estimator.ignored == {}


def test_a_wrong_heading_is_kept_while_the_position_is_right() -> None:
    rig = Rig()
    rig.estimator.heading_error_rad = math.pi
    rig.run(6.0)
    rig.estimator.heading_error_rad = math.pi - 0.1
    rig.run(6.0)
    yaw = yaw_of(ned_frd_from_enu_flu(rig.vehicle.quat_wxyz))
    assert wrapped(rig.estimator.yaw - yaw - math.pi + 0.1) == pytest.approx(0.0, abs=0.03)


def test_late_poses_with_new_stamps_degrade_the_estimate() -> None:
    """Negative control: without their stamps, late poses make the estimate lag."""
    rig = Rig(0.18)
    rig.change = lambda p: replace(p, stamp_s=rig.now_s)
    rig.run(6.0)
    assert rig.run(10.0) > 0.06


def test_the_estimate_is_valid_after_half_a_second_of_poses() -> None:
    rig = Rig(0.0)
    rig.run(0.4)
    assert not rig.follows()
    assert rig.estimator.flags & CONST_POS_MODE
    rig.run(0.4)
    assert rig.follows()
    assert rig.estimator.flags & (POS_HORIZ_REL | VELOCITY_HORIZ) == POS_HORIZ_REL | VELOCITY_HORIZ
    assert not rig.estimator.flags & POS_HORIZ_ABS
    rig.estimator.origin_set = True
    assert rig.estimator.flags & POS_HORIZ_ABS


def test_with_vision_disabled_poses_are_never_fused() -> None:
    rig = Rig(0.0, Px4Parameters())  # EKF2_EV_CTRL 0 since v1.16
    rig.run(3.0)
    assert not rig.follows()


@pytest.mark.parametrize(("timeout_us", "falls_s"), [(5_000_000, 4.7), (1_000_000, 0.7), (500_000, 0.6)])
def test_when_poses_stop_the_flags_fall_in_two_steps(timeout_us: int, falls_s: float) -> None:
    p = Px4Parameters.load()
    p.set("EKF2_NOAID_TOUT", timeout_us)
    rig = Rig(0.0, p)
    rig.run(4.0)
    rig.pose_on = False
    rig.run(0.55)
    assert rig.estimator.flags & PRED_POS_HORIZ_REL
    rig.run(0.1)
    assert not rig.estimator.flags & PRED_POS_HORIZ_REL
    rig.run(max(falls_s - 0.65 - 0.05, 0.0))
    assert bool(rig.estimator.flags & POS_HORIZ_REL) == (falls_s > 0.65)
    rig.run(0.1)
    assert not rig.estimator.flags & POS_HORIZ_REL
    assert not rig.valid()


def test_dead_reckoning_drifts_about_a_metre_in_five_seconds() -> None:
    p = Px4Parameters.load()
    p.set("EKF2_NOAID_TOUT", 5_000_000)
    rig = Rig(0.0, p)
    rig.run(6.0)
    rig.pose_on = False
    drift = rig.run(5.0)
    assert 0.05 < drift < 2.0


def test_a_jump_is_rejected_silently_and_accepted_after_a_second() -> None:
    p = Px4Parameters.load()
    p.set("EKF2_NOAID_TOUT", 5_000_000)
    rig = Rig(0.0, p)
    rig.run(4.0)
    rig.moved(0.5)
    assert rig.run(0.9) < 0.1
    assert rig.estimator.ignored["position gate"] > 20
    assert rig.estimator.position_test_ratio > 1.0
    assert rig.estimator.flags & POS_HORIZ_REL
    assert len(rig.resets) == 1  # only the one at the start
    rig.run(0.3)
    assert rig.error() == pytest.approx(0.5, abs=0.1)
    assert rig.resets[-1][0][0] == pytest.approx(0.5, abs=0.1)


def test_at_most_five_resets_happen_in_the_air() -> None:
    rig = Rig(0.0)
    rig.run(4.0)
    for jump in range(1, 8):
        rig.moved(2.0 * jump)
        rig.run(1.5)
    assert len(rig.resets) == 1 + 5


def test_the_indoor_gate_rejects_a_jump_that_the_default_gate_accepts() -> None:
    loose = Px4Parameters()
    for name, value in LOOSE.items():
        loose.set(name, value)
    for parameters, swallowed in ((loose, True), (Px4Parameters.load(), False)):
        rig = Rig(0.0, parameters)
        rig.run(4.0)
        rig.moved(0.4)
        rig.run(0.5)
        assert ("position gate" in rig.estimator.ignored) is not swallowed


def test_a_new_reset_counter_moves_the_estimate_at_once() -> None:
    rig = Rig(0.04)
    rig.run(4.0)
    rig.moved(2.0, -1.0, counter=1)
    rig.run(0.08)
    assert rig.error() == pytest.approx(math.hypot(2.0, 1.0), abs=0.1)
    assert len(rig.resets) == 2
    rig.run(1.0)
    assert len(rig.resets) == 2


def test_low_quality_is_not_fused() -> None:
    rig = Rig(0.0)
    rig.run(3.0)
    rig.change = lambda p: replace(p, quality=19)
    rig.run(3.0)
    assert rig.estimator.ignored == {"quality": 150}
    assert not rig.valid()


def test_stale_repeated_and_future_stamps_are_never_fused() -> None:
    rig = Rig(0.0)
    rig.run(3.0)
    rig.change = lambda p: replace(p, stamp_s=p.stamp_s - 0.5)
    rig.run(0.1)
    assert rig.estimator.ignored == {"repeated": 5}
    rig.age_s = 0.0
    rig.change = lambda p: replace(p, stamp_s=p.stamp_s + 5.0)
    rig.run(0.1)
    assert rig.estimator.ignored["future"] == 5
    late = Rig(0.4)
    late.run(3.0)
    assert not late.follows()
    assert set(late.estimator.ignored) == {"late"}


def test_only_the_fields_that_are_not_numbers_are_ignored() -> None:
    rig = Rig(0.0)
    rig.run(3.0)
    rig.change = lambda p: replace(p, quat_wxyz=(math.nan, 0.0, 0.0, 0.0))
    assert rig.run(1.0) < 0.05
    assert rig.valid()
    rig.change = lambda p: replace(p, position=(math.nan, 0.0, 0.0))
    rig.run(3.0)
    assert not rig.valid()
    rig.change = lambda p: replace(p, quat_wxyz=(2.0, 0.0, 0.0, 0.0))
    rig.run(0.5)
    assert all(math.isfinite(c) for c in (*rig.estimator.position, *rig.estimator.quat_wxyz))


def test_a_persistent_yaw_step_is_rejected_and_accepted_later() -> None:
    rig = Rig(0.0)
    rig.run(4.0)
    turned = from_yaw(math.radians(30.0))
    rig.change = lambda p: replace(p, quat_wxyz=multiply(turned, p.quat_wxyz))
    before = rig.estimator.ignored.get("yaw gate", 0)
    rig.run(0.9)
    assert rig.estimator.ignored["yaw gate"] > before
    assert len(rig.resets) == 1
    rig.run(0.3)
    assert len(rig.resets) == 2
    assert rig.resets[-1][1] == pytest.approx(math.radians(30.0), abs=0.05)


def test_an_origin_before_the_first_pose_adds_its_altitude_to_the_height() -> None:
    rig = Rig(0.0)
    rig.estimator.offset_height(488.0)
    rig.run(3.0)
    assert rig.estimator.position[2] == pytest.approx(488.0 - rig.vehicle.position[2], abs=0.1)


def test_the_barometer_gives_the_height_when_poses_stop() -> None:
    rig = Rig(0.0)
    rig.run(4.0)
    rig.pose_on = False
    rig.run(10.0)
    assert abs(rig.estimator.position[2] + rig.vehicle.position[2]) < 0.3


def test_a_velocity_error_is_published_and_leaves_height_and_its_rate_right() -> None:
    rig = Rig(move=0.0)
    rig.run(3.0)
    rig.resets.clear()
    rig.estimator.velocity_error = (0.0, 0.0, -0.5)
    rig.run(3.0)
    e, (north, east, down) = rig.estimator, ned_from_enu(rig.vehicle.velocity)
    assert math.dist(e.velocity, (north, east, down - 0.5)) < 0.1
    assert abs(e.height_rate - down) < 0.1
    assert abs(e.position[2] + rig.vehicle.position[2]) < 0.05
    assert rig.resets == []


@pytest.mark.parametrize("up_m", [0.5, -0.5])
def test_a_height_datum_that_moves_is_a_jump_that_stays(up_m: float) -> None:
    rig = Rig(move=0.0)
    rig.run(3.0)
    rig.resets.clear()
    rig.estimator.move_height_datum(up_m)
    assert rig.resets == [((0.0, 0.0, -up_m), 0.0)]
    for _ in range(10):
        rig.run(1.0)
        assert abs(rig.estimator.position[2] + rig.vehicle.position[2] + up_m) < 0.05
    assert len(rig.resets) == 1
