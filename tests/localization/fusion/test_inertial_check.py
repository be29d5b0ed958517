from __future__ import annotations

import math

import numpy as np
import pytest
from figure_eight import FigureEight, perfect_imu

from uav_recon.localization.fusion.imu_integration import InertialTrack
from uav_recon.localization.fusion.inertial_check import InertialCheck
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

MOTION = FigureEight(start_s=100.0)
FAULT_S = 12.0
ALL = np.eye(3)


def fly(
    until_s: float,
    *,
    force_mps2: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rate_radps: tuple[float, float, float] = (0.0, 0.0, 0.0),
    lasts_s: float = 1e9,
    tilt_rad: float = 0.0,
    shown: FloatArray = ALL,
    noise_m: float = 0.003,
    pose_hz: int = 15,
) -> list[tuple[float, bool, bool]]:
    """Return, after each pose, the instant and whether accelerometer and gyro are at fault."""
    track, rng, found = InertialTrack(), np.random.default_rng(1), []
    check = InertialCheck(track.at)
    tilted = Pose.from_rotation_vector(np.array([tilt_rad, 0.0, 0.0]), np.zeros(3))
    for n in range(round(until_s * 200)):
        sample = perfect_imu(MOTION, n)
        since_s = sample.stamp_s - MOTION.start_s
        wrong = FAULT_S <= since_s < FAULT_S + lasts_s
        force = sample.specific_force_mps2 + rng.normal(0.0, 0.1, 3) + wrong * np.array(force_mps2)
        rate = sample.gyro_radps + rng.normal(0.0, 0.005, 3) + wrong * np.array(rate_radps)
        track.push(sample.stamp_s, tuple(rate.tolist()), tuple(force.tolist()))
        if n % (200 // pose_hz) == 0 and n > 0:
            true = MOTION.pose(sample.stamp_s)
            said = Pose((tilted @ true).quat_wxyz, true.translation_m + rng.normal(0.0, noise_m, 3))
            check.update(sample.stamp_s, said, shown, noise_m)
            found.append((since_s, check.accelerometer.fault, check.gyro.fault))
    return found


@pytest.mark.parametrize("pose_hz", [8, 15, 50])
def test_honest_sensors_are_used(pose_hz: int) -> None:
    assert not any(force or rate for _, force, rate in fly(30.0, pose_hz=pose_hz))


def test_a_tilted_track_is_the_usual_error() -> None:
    assert not any(force or rate for _, force, rate in fly(30.0, tilt_rad=math.radians(2.0)))


@pytest.mark.parametrize("error", [(2.0, 0.0, 0.0), (0.0, -4.0, 0.0), (0.0, 0.0, -4.8)])
def test_a_lying_accelerometer_is_left_out_at_once_and_stays_out(error: tuple[float, float, float]) -> None:
    found = fly(30.0, force_mps2=error)
    at_fault = [since_s for since_s, force, _ in found if force]
    assert FAULT_S < at_fault[0] < FAULT_S + 0.8
    assert all(force for since_s, force, _ in found if since_s > at_fault[0])


def test_an_accelerometer_that_is_right_for_seconds_is_used_again() -> None:
    found = fly(30.0, force_mps2=(2.0, 0.0, 0.0), lasts_s=0.5)
    again = [since_s for since_s, force, _ in found if not force and since_s > FAULT_S + 1.0]
    assert any(force for _, force, _ in found)
    assert FAULT_S + 3.0 < again[0] < FAULT_S + 8.0


def test_a_lying_gyro_is_left_out() -> None:
    at_fault = [since_s for since_s, _, rate in fly(20.0, rate_radps=(0.0, 0.0, 0.2)) if rate]
    assert FAULT_S < at_fault[0] < FAULT_S + 1.0


def test_a_direction_that_the_track_has_not_measured_shows_no_error() -> None:
    found = fly(20.0, force_mps2=(0.0, 0.0, -4.0), shown=np.diag([1.0, 1.0, 0.0]))
    assert not any(force for _, force, _ in found)
