"""Motion between frames: what the accelerometer carries, and an accelerometer that the images contradict."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uav_recon.localization.flow.measured_motion import MeasuredMotion
from uav_recon.localization.fusion.imu_integration import GRAVITY_MPS2, InertialTrack
from uav_recon.localization.slam.motion_filter import BIAS, MotionFilter, PredictedMotion
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

PERIOD_S = 1.0 / 15.0
SIGMA_M = 0.002  # of the place that a frame shows: landmarks and depth together
GRAVITY = np.array([0.0, 0.0, -GRAVITY_MPS2])

Sensor = Callable[[float, FloatArray], FloatArray]


def _honest(_: float, force: FloatArray) -> FloatArray:
    return force


def _attitude(t: float | FloatArray) -> Rotation:
    return Rotation.from_euler("ZYX", np.stack((0.7 * np.asarray(t), 0.08 * np.sin(t), 0.06 * np.cos(1.3 * np.asarray(t))), -1))


def _pose(t: float) -> Pose:
    x, y, z, w = _attitude(t).as_quat()
    return Pose(np.array([w, x, y, z]), np.zeros(3))


class Flight:
    """A body along a path of sines, its inertial track by exact geometry, and its frames' places with noise."""

    def __init__(self, sensor: Sensor = _honest, inertial: bool = True, noise_mps2: float = 0.0) -> None:
        self.filter = MotionFilter(Pose(_pose(0.0).quat_wxyz, self.place(0.0)), np.zeros(3))
        self.track = InertialTrack()
        self.worst_m = 0.0  # error of a predicted place
        self.used: list[bool] = []
        self._inertial = inertial
        self._random = np.random.default_rng(2)
        self._frames = 0
        stamps = np.arange(-0.05, 22.0, 0.01)
        pushed = _attitude(stamps).inv().apply(self.acceleration(stamps[:, None]) - GRAVITY)
        rates = (_attitude(stamps - 5e-4).inv() * _attitude(stamps + 5e-4)).as_rotvec() / 1e-3
        for t, (x, y, z), true in zip(stamps.tolist(), rates.tolist(), pushed, strict=True):
            a, b, c = (sensor(t, true) + noise_mps2 * self._random.standard_normal(3)).tolist()
            self.track.push(t, (x, y, z), (a, b, c))

    @staticmethod
    def place(t: float | FloatArray) -> FloatArray:
        """Return the place (3,), or places (N, 3) of times (N, 1)."""
        return np.asarray(np.array([0.9, 0.8, 0.3]) * (1.0 - np.cos(np.array([0.6, 0.5, 0.7]) * t)))

    @classmethod
    def acceleration(cls, t: float | FloatArray) -> FloatArray:
        return np.asarray((cls.place(t + 1e-3) - 2 * cls.place(t) + cls.place(t - 1e-3)) / 1e-6)

    @classmethod
    def velocity(cls, t: float) -> FloatArray:
        return np.asarray((cls.place(t + 1e-4) - cls.place(t - 1e-4)) / 2e-4)

    @property
    def now_s(self) -> float:
        return self._frames * PERIOD_S

    def predict(self, step_s: float = PERIOD_S) -> PredictedMotion:
        a, b = self.track.at(self.now_s), self.track.at(self.now_s + step_s)
        assert a is not None
        assert b is not None
        return self.filter.predict(step_s, _pose(self.now_s), (a, b) if self._inertial else None)

    def fly(self, until_s: float) -> None:
        while self.now_s + PERIOD_S <= until_s:
            predicted = self.predict()
            self._frames += 1
            true = self.place(self.now_s)
            self.worst_m = max(self.worst_m, float(np.linalg.norm(predicted.place_m - true)))
            seen = true + SIGMA_M * self._random.standard_normal(3)
            joint = self.filter.predicted_errors(predicted).joint(np.empty(0, np.int64))
            gain = joint[:, :3] @ np.linalg.inv(joint[:3, :3] + SIGMA_M**2 * np.eye(3))
            self.filter.update(predicted, np.empty(0, np.int64), gain @ (seen - predicted.place_m), joint - gain @ joint[:3])
            self.used.append(self.filter.accelerometer_used)

    def error_mps(self) -> float:
        return float(np.linalg.norm(self.filter.velocity_mps - self.velocity(self.now_s)))


@pytest.mark.parametrize("acceleration", [0.0, 0.5, -1.5])
def test_a_constant_acceleration_is_carried_exactly(acceleration: float) -> None:
    """From rest, s = a t² / 2 and v = a t; the body is turned by a quarter, so its own axis is another one."""
    motion, track = MotionFilter(Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([1.0, 2.0, 3.0])), np.zeros(3)), InertialTrack()
    for n in range(101):
        track.push(n / 100, (0.0, 0.0, 0.0), (0.0, -acceleration, GRAVITY_MPS2))
    a, b = track.at(0.0), track.at(1.0)
    assert a is not None
    assert b is not None
    moved = motion.predict(1.0, Pose.from_yaw(np.pi / 2, np.zeros(3)), (a, b))
    np.testing.assert_allclose(moved.place_m, [1.0 + 0.5 * acceleration, 2.0, 3.0], atol=1e-9)
    np.testing.assert_allclose(moved.velocity_mps, [acceleration, 0.0, 0.0], atol=1e-9)
    np.testing.assert_array_equal(motion.velocity_mps, np.zeros(3))  # a prediction changes nothing
    motion.coast(moved)
    np.testing.assert_allclose(motion.velocity_mps, [acceleration, 0.0, 0.0], atol=1e-9)
    motion.rest()
    np.testing.assert_array_equal(motion.velocity_mps, np.zeros(3))


def test_place_and_velocity_follow_a_flight() -> None:
    flight = Flight(noise_mps2=0.6)
    flight.fly(10.0)
    assert flight.worst_m < 0.03
    assert flight.error_mps() < 0.06
    assert all(flight.used)


def test_the_uncertainty_covers_the_errors_of_a_second_without_frames() -> None:
    flight = Flight(noise_mps2=0.6)
    flight.fly(8.0)
    later = flight.predict(1.0)
    off = later.place_m - flight.place(flight.now_s + 1.0)
    assert off @ np.linalg.solve(later.place_covariance, off) < 16.0
    assert np.sqrt(np.diagonal(later.place_covariance).max()) < 0.3


def test_the_offset_of_the_accelerometer_is_found() -> None:
    """An offset of 0.3 m/s² would carry the place off by 15 cm in a second."""
    flight = Flight(lambda _t, force: force + np.array([0.3, -0.2, 0.1]))
    flight.fly(12.0)
    assert all(flight.used)
    off = flight.predict(1.0).place_m - flight.place(flight.now_s + 1.0)
    assert np.linalg.norm(off) < 0.05


def test_bias_and_tilt_are_kept_apart_over_a_turn() -> None:
    """The map is tilted by 0.7 degrees, levelled by an accelerometer with the opposite bias: at rest nothing shows."""
    tilt = Rotation.from_euler("y", 0.7, degrees=True)
    leaned = GRAVITY_MPS2 * tilt.inv().apply([0.0, 0.0, 1.0]) - np.array([0.0, 0.0, GRAVITY_MPS2])  # in the tilted map
    start = _attitude(0.0).inv().apply(leaned)

    def sensor(t: float, force: FloatArray) -> FloatArray:
        return np.asarray(force + _attitude(t).inv().apply(leaned) - start)

    flight = Flight(sensor)
    flight.fly(20.0)
    assert all(flight.used)
    off = flight.predict(1.0).place_m - flight.place(flight.now_s + 1.0)
    assert np.linalg.norm(off) < 0.03
    np.testing.assert_allclose(flight.filter.now.state[BIAS], -start, atol=0.05)


def _half(t: float, force: FloatArray) -> FloatArray:
    return 0.5 * force if 5.0 <= t < 9.0 else force


def _shifted(t: float, force: FloatArray) -> FloatArray:
    return force + np.array([2.0, 0.0, 0.0]) if 5.0 <= t < 9.0 else force


@pytest.mark.parametrize("lying", [_half, _shifted])
def test_an_accelerometer_that_lies_is_left_out_until_it_is_told_to_be_right(lying: Sensor) -> None:
    flight = Flight(lying)
    flight.fly(5.0)
    assert all(flight.used)
    flight.fly(7.0)
    assert False in flight.used
    assert flight.used.index(False) - 75 < 25  # frames
    flight.fly(9.0)
    assert flight.worst_m < 0.1
    flight.fly(12.0)
    assert not flight.used[-1]
    flight.filter.accelerometer_used = True
    flight.fly(20.0)
    assert all(flight.used[-5:])
    assert flight.error_mps() < 0.1


@pytest.mark.parametrize(("share", "used"), [(0.5, False), (0.6, False), (0.7, True), (1.0, True), (1.45, True), (1.55, False)])
def test_a_specific_force_that_no_flight_has_is_left_out_before_any_frame(share: float, used: bool) -> None:
    motion, track = MotionFilter(Pose.identity(), np.zeros(3)), InertialTrack()
    for n in range(-2, 13):
        track.push(0.01 * n, (0.0, 0.0, 0.0), (0.0, 0.0, share * GRAVITY_MPS2))
    a, b = track.at(0.0), track.at(0.1)
    assert a is not None and b is not None
    moved = motion.predict(0.1, Pose.identity(), (a, b))
    assert motion.accelerometer_used is used
    if not used:
        np.testing.assert_array_equal(moved.place_m, np.zeros(3))


def test_without_inertial_samples_the_velocity_comes_from_the_frames() -> None:
    flight = Flight(inertial=False)
    flight.fly(6.0)
    assert flight.error_mps() < 0.15
    assert flight.worst_m < 0.05
    blind, carried = flight.predict(1.0), Flight()
    carried.fly(6.0)
    assert np.trace(blind.place_covariance) > 10.0 * np.trace(carried.predict(1.0).place_covariance)


def test_a_measured_step_carries_the_place_without_an_accelerometer() -> None:
    motion = MotionFilter(Pose.identity(), np.zeros(3))
    for _ in range(30):
        moved = motion.predict(0.1, Pose.identity(), None, MeasuredMotion(np.array([0.05, 0.0, 0.0]), 0.003**2 * np.eye(3)))
        motion.coast(moved)
    np.testing.assert_allclose(moved.place_m, (1.5, 0.0, 0.0), atol=0.02)
    assert math.sqrt(moved.place_covariance[0, 0]) < 0.05
    assert np.linalg.eigvalsh(moved.covariance).min() > -1e-12


def test_a_step_that_the_prediction_contradicts_is_left_out() -> None:
    motion = MotionFilter(Pose.identity(), np.zeros(3))
    moved = motion.predict(0.1, Pose.identity(), None, MeasuredMotion(np.array([0.5, 0.0, 0.0]), 0.003**2 * np.eye(3)))
    assert abs(moved.place_m[0]) < 1e-9
