from __future__ import annotations

import math
import statistics

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sitl.world.quadrotor import GRAVITY_MPS2, Quadrotor

DT = 0.004
HOVER = (0.0, 0.0, GRAVITY_MPS2)


def matrix(quat_wxyz: tuple[float, ...]) -> Rotation:
    return Rotation.from_quat(np.roll(quat_wxyz, -1))


def calm(seed: int = 0) -> Quadrotor:
    return Quadrotor(seed, wind_mps=0.0)


def lifted(vehicle: Quadrotor, seconds: float = 2.0) -> Quadrotor:
    for _ in range(round(seconds / DT)):
        vehicle.step(DT, (0.0, 0.0, GRAVITY_MPS2 + 1.0), 0.0, True)
    return vehicle


def test_on_the_pad_the_accelerometer_reads_gravity() -> None:
    vehicle = calm()
    for _ in range(100):
        vehicle.step(DT, (0.0, 0.0, 0.0), 0.0, False)
    assert vehicle.position == (0.0, 0.0, 0.0)
    assert vehicle.on_ground
    assert vehicle.specific_force == pytest.approx((0.0, 0.0, GRAVITY_MPS2), abs=1e-9)
    assert vehicle.touchdowns == []


def test_thrust_below_the_weight_does_not_lift_the_vehicle() -> None:
    vehicle = calm()
    for _ in range(500):
        vehicle.step(DT, (1.0, 0.0, GRAVITY_MPS2 - 0.1), 0.5, True)
    assert vehicle.position[2] == 0.0
    assert vehicle.on_ground


def test_tilt_follows_a_step_with_a_lag_of_80_ms() -> None:
    vehicle = lifted(calm())
    wanted = math.radians(10.0)
    force = (math.tan(wanted) * GRAVITY_MPS2, 0.0, GRAVITY_MPS2)
    for _ in range(20):  # 80 ms
        vehicle.step(DT, force, 0.0, True)
    tilt = math.acos(matrix(vehicle.quat_wxyz).as_matrix()[2, 2])
    assert tilt / wanted == pytest.approx(1.0 - math.exp(-1.0), abs=0.03)


def test_the_body_tilts_into_its_acceleration() -> None:
    vehicle = lifted(Quadrotor(0, wind_mps=0.0, yaw_rad=0.7))
    for _ in range(100):
        vehicle.step(DT, (0.0, 2.0, GRAVITY_MPS2), 0.0, True)
    up = matrix(vehicle.quat_wxyz).apply([0.0, 0.0, 1.0])
    assert up[1] == pytest.approx(2.0 / math.hypot(2.0, GRAVITY_MPS2), abs=0.01)
    assert abs(up[0]) < 1e-3
    assert vehicle.velocity[1] > 0.4


def test_the_gyro_integrates_to_the_attitude() -> None:
    vehicle = lifted(calm())
    attitude = matrix(vehicle.quat_wxyz)
    for i in range(1000):
        phase = i * 0.01
        force = (1.5 * math.sin(phase), 1.5 * math.cos(1.3 * phase), GRAVITY_MPS2)
        vehicle.step(DT, force, 0.6 * math.sin(0.5 * phase), True)
        attitude = attitude * Rotation.from_rotvec(np.array(vehicle.gyro) * DT)
    assert (attitude.inv() * matrix(vehicle.quat_wxyz)).magnitude() < 1e-3


def test_specific_force_is_acceleration_minus_gravity_in_body_axes() -> None:
    vehicle = Quadrotor(3, wind_mps=0.3)
    lifted(vehicle)
    for i in range(200):
        before = np.array(vehicle.velocity)
        vehicle.step(DT, (1.0, -0.5, GRAVITY_MPS2 + math.sin(0.1 * i)), 0.3, True)
        acceleration = (np.array(vehicle.velocity) - before) / DT
        expected = matrix(vehicle.quat_wxyz).inv().apply(acceleration + np.array([0.0, 0.0, GRAVITY_MPS2]))
        assert vehicle.specific_force == pytest.approx(tuple(expected), abs=1e-6)


def test_yaw_rate_lags_and_turns_counter_clockwise() -> None:
    vehicle = lifted(calm())
    for _ in range(25):  # 100 ms
        vehicle.step(DT, HOVER, 0.5, True)
    assert vehicle.gyro[2] == pytest.approx(0.5 * (1.0 - math.exp(-1.0)), abs=0.01)
    assert matrix(vehicle.quat_wxyz).as_euler("ZYX")[0] > 0.0


def test_tilt_and_thrust_are_limited() -> None:
    vehicle = lifted(calm())
    for _ in range(400):
        vehicle.step(DT, (500.0, 0.0, 5.0), 0.0, True)
    tilt = math.acos(matrix(vehicle.quat_wxyz).as_matrix()[2, 2])
    assert tilt <= math.radians(45.0) + 1e-6
    assert math.hypot(*vehicle.specific_force) <= 2.2 * GRAVITY_MPS2
    assert math.dist(vehicle.velocity, (0.0, 0.0, 0.0)) <= 8.0 + 1e-9


def test_with_motors_off_it_falls_until_the_floor() -> None:
    vehicle = lifted(calm())
    height = vehicle.position[2]
    for _ in range(1000):
        vehicle.step(DT, HOVER, 0.0, False)
        assert vehicle.position[2] >= 0.0
    assert vehicle.on_ground
    assert vehicle.position[2] == 0.0
    assert len(vehicle.touchdowns) == 1
    # It first rises a little more; drag reduces the speed.
    assert vehicle.touchdowns[0] == pytest.approx(math.sqrt(2 * GRAVITY_MPS2 * height), rel=0.25)


def test_it_stands_on_the_surface_below_and_falls_off_its_edge() -> None:
    """A table 0.5 m high covers x below 1 m."""
    vehicle = Quadrotor(0, 0.0, start=(0.0, 0.0, 0.0), support_height_m=lambda p: 0.5 if p[0] < 1.0 and p[2] >= 0.5 else 0.0)
    lifted(vehicle, 2.0)
    for _ in range(1000):
        vehicle.step(DT, HOVER, 0.0, False)
    assert vehicle.on_ground
    assert vehicle.position[2] == 0.5
    assert len(vehicle.touchdowns) == 1
    vehicle.push((8.0, 0.0, 0.0))
    for _ in range(1000):
        vehicle.step(DT, HOVER, 0.0, False)
    assert vehicle.position[0] > 1.0
    assert vehicle.position[2] == 0.0


def test_gusts_have_the_requested_rms() -> None:
    vehicle = Quadrotor(1, wind_mps=0.2)
    vehicle.step(DT, HOVER, 0.0, True)
    samples = [vehicle._blow()[0] for _ in range(100_000)]
    assert statistics.pstdev(samples) == pytest.approx(0.2, rel=0.2)


def test_equal_seeds_fly_equal_paths() -> None:
    def end(seed: int) -> tuple[float, ...]:
        return lifted(Quadrotor(seed, wind_mps=0.3), 4.0).position

    assert end(7) == end(7)
    assert end(7) != end(8)


def test_a_push_changes_the_velocity() -> None:
    vehicle = lifted(calm())
    before = vehicle.velocity[0]
    vehicle.push((0.5, 0.0, 0.0))
    assert vehicle.velocity[0] == pytest.approx(before + 0.5)


def test_an_external_force_is_measured_by_the_accelerometer() -> None:
    still, pushed = Quadrotor(1, 0.0), Quadrotor(1, 0.0)
    for n in range(300):
        pushed.external_acceleration_mps2 = (2.0 if n >= 250 else 0.0, 0.0, 0.0)
        for vehicle in (still, pushed):
            vehicle.step(0.004, (0.0, 0.0, 12.0), 0.0, motors_on=True)
    assert pushed.velocity[0] - still.velocity[0] == pytest.approx(0.4, abs=0.02)
    assert pushed.specific_force[0] - still.specific_force[0] == pytest.approx(2.0, abs=0.1)
