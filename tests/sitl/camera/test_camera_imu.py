"""IMU of the camera: noise, biases, clock offset and axes, measured on its samples."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sitl.camera.camera_errors import ACCEL_WALK, GYRO_WALK, CameraErrors, ImuErrors, MountErrors
from sitl.camera.camera_imu import CameraImu
from sitl.camera.camera_mount import CameraMount
from sitl.geometry.quaternion import IDENTITY, rotate

F64 = NDArray[np.float64]
RATE_HZ = 200.0
GYRO = (0.1, -0.2, 0.3)
FORCE = (0.4, -0.5, 9.8)


def samples(errors: CameraErrors, seconds: float, motors_on: bool = True, rate_hz: float = RATE_HZ) -> F64:
    """Return gyro and specific force (N, 6) of a vehicle with constant motion."""
    imu, count = CameraImu(errors, rate_hz), round(seconds * rate_hz)
    read = (imu.read(n / rate_hz, GYRO, FORCE, IDENTITY, motors_on) for n in range(count))
    return np.array([[*sample.gyro_radps, *sample.specific_force_mps2] for sample in read])


def allan_deviation(values: F64, tau_s: float, rate_hz: float = RATE_HZ) -> F64:
    """Return the Allan deviation (6,) of the averages over tau_s."""
    length = round(tau_s * rate_hz)
    means = values[: len(values) // length * length].reshape(-1, length, values.shape[1]).mean(axis=1)
    return np.asarray(np.sqrt(0.5 * (np.diff(means, axis=0) ** 2).mean(axis=0)))


@pytest.mark.parametrize("rate_hz", [200.0, 60.0])
def test_white_noise_has_the_density_of_a_flying_frame_at_every_rate(rate_hz: float) -> None:
    """The Allan deviation of white noise of density d is d / sqrt(tau)."""
    e = CameraErrors.drawn(6)
    values = samples(replace(e, imu=replace(e.imu, accel_walk=0.0, gyro_walk=0.0)), 400.0, rate_hz=rate_hz)
    for tau_s in (0.1, 1.0):
        found = allan_deviation(values, tau_s, rate_hz) * math.sqrt(tau_s)
        assert found[:3] == pytest.approx(e.imu.gyro_density_flight, rel=0.12)
        assert found[3:] == pytest.approx(e.imu.accel_density_flight, rel=0.12)
    assert 0.0007 <= e.imu.gyro_density_flight <= 0.0013
    assert 0.049 <= e.imu.accel_density_flight <= 0.091


def test_with_the_motors_off_the_noise_is_that_of_the_device() -> None:
    e = CameraErrors.drawn(6)
    found = allan_deviation(samples(e, 100.0, motors_on=False), 0.1) * math.sqrt(0.1)
    assert found[:3] == pytest.approx(e.imu.gyro_density_flight / 17.0, rel=0.4)
    assert found[3:] == pytest.approx(e.imu.accel_density_flight / 21.0, rel=0.4)


def test_biases_start_where_they_were_drawn_and_walk() -> None:
    """A walk w has a standard deviation of w sqrt(t) after t."""
    quiet = ImuErrors(
        accel_walk=ACCEL_WALK, gyro_walk=GYRO_WALK, accel_bias_mps2=(0.1, 0.0, -0.1), gyro_bias_radps=(0.0, 3e-3, 0.0)
    )
    ends = []
    for seed in range(150):
        values = samples(CameraErrors(seed, imu=quiet), 16.0, rate_hz=60.0) - np.array([*GYRO, *FORCE])
        np.testing.assert_allclose(values[0], (0.0, 3e-3, 0.0, 0.1, 0.0, -0.1), atol=1e-12)
        ends.append(values[-1] - values[0])
    spread = np.std(ends, axis=0)
    assert spread[:3] == pytest.approx(GYRO_WALK * 4.0, rel=0.2)
    assert spread[3:] == pytest.approx(ACCEL_WALK * 4.0, rel=0.2)


def test_stamps_are_off_by_the_clock_offset() -> None:
    imu = CameraImu(CameraErrors(imu=ImuErrors(offset_s=-0.004)), RATE_HZ)
    assert imu.read(12.0, GYRO, FORCE, IDENTITY, True).stamp_s == pytest.approx(11.996)


def test_an_imu_without_errors_reads_the_truth_to_the_bit() -> None:
    axes = CameraMount((0.1, 0.0, 0.0), MountErrors()).imu_from_body(0.26)
    sample = CameraImu(CameraErrors(7), RATE_HZ).read(12.345, GYRO, FORCE, axes, True)
    assert sample.stamp_s == 12.345
    assert tuple(sample.gyro_radps) == GYRO
    assert tuple(sample.specific_force_mps2) == FORCE


def test_equal_seeds_give_equal_samples() -> None:
    first, again, other = (samples(CameraErrors.drawn(seed), 1.0) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()


@pytest.mark.parametrize("pitch_rad", [0.0, 0.3])
def test_the_imu_is_rotated_with_the_camera_that_holds_it(pitch_rad: float) -> None:
    errors = MountErrors((0.012, -0.009, 0.015), gimbal_rad=0.01)
    rdf = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    nominal = Rotation.from_euler("y", pitch_rad) * Rotation.from_matrix(rdf)
    true = Rotation.from_euler("y", pitch_rad + 0.01) * Rotation.from_matrix(rdf) * Rotation.from_rotvec(errors.rotation_rad)
    expected = (nominal * true.inv()).apply(FORCE)
    found = rotate(CameraMount((0.1, 0.0, 0.0), errors).imu_from_body(pitch_rad), FORCE)
    np.testing.assert_allclose(found, expected, atol=9.8 * 2e-4)  # sums of small angles, to second order
