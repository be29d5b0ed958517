from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.localization.fusion.filter_pose_gates import PoseMeasurement
from uav_recon.localization.fusion.imu_integration import exponential, multiply, rotate
from uav_recon.localization.fusion.relocalization_check import AFTER_LOSS, MAP_STEP, RelocalizationCheck
from uav_recon.types.pose import Pose, StampedPose

SOURCE = StampedPose(0.0, Pose.identity(), np.zeros(3))
MAP_TURN = exponential((0.0, 0.0, 2.0))


def _track(k: int) -> PoseMeasurement:
    """0.6 m/s while turning at 0.5 rad/s, at 15 Hz."""
    t = k / 15
    return PoseMeasurement(t, (0.6 * t, 0.0, 1.0), exponential((0.0, 0.0, 0.5 * t)), SOURCE)


def _measurement(k: int, slip_m: float = 0.0, slip_rad: float = 0.0) -> PoseMeasurement:
    """The same motion in a map that is turned and elsewhere."""
    track = _track(k)
    x, y, z = rotate(MAP_TURN, track.position_m)
    attitude = multiply(multiply(MAP_TURN, track.odom_from_body), exponential((0.0, 0.0, slip_rad)))
    return PoseMeasurement(track.stamp_s, (x + 5.0 + slip_m, y, z), attitude, SOURCE)


def _run(reported: list[PoseMeasurement], *, inertial: bool = True) -> RelocalizationCheck:
    trial = RelocalizationCheck()
    for measurement in reported:
        trial.update(measurement, _track(round(measurement.stamp_s * 15)), inertial)
    return trial


def test_four_poses_that_move_as_the_track_does_are_a_step_of_the_map() -> None:
    assert not _run([_measurement(k) for k in range(3)]).satisfies(MAP_STEP)
    assert _run([_measurement(k) for k in range(4)]).satisfies(MAP_STEP)


def test_after_a_loss_it_takes_a_second() -> None:
    assert not _run([_measurement(k) for k in range(15)]).satisfies(AFTER_LOSS)
    assert _run([_measurement(k) for k in range(16)]).satisfies(AFTER_LOSS)
    assert not _run([_measurement(2 * k) for k in range(11)]).satisfies(AFTER_LOSS)  # long enough, but too few


@pytest.mark.parametrize(("slip_m", "slip_rad"), [(0.06, 0.0), (0.0, math.radians(3.2)), (-3.0, 0.0)])
def test_one_that_slips_begins_again(slip_m: float, slip_rad: float) -> None:
    trial = _run([_measurement(0), _measurement(1), _measurement(2), _measurement(3, slip_m, slip_rad)])
    assert len(trial) == 1
    assert not trial.satisfies(MAP_STEP)


def test_a_velocity_that_differs_from_the_tracks_is_no_step_of_the_map() -> None:
    """2 cm from pose to pose, 0.3 m/s: within the slip of two poses, not within that of the run."""
    assert not _run([_measurement(k, slip_m=0.02 * k) for k in range(8)]).satisfies(MAP_STEP)


def test_a_small_slip_is_noise() -> None:
    assert _run([_measurement(k, slip_m=0.04 * (k % 2), slip_rad=0.03 * (k % 2)) for k in range(4)]).satisfies(MAP_STEP)


def test_without_a_second_sensor_it_is_enough_to_move_as_a_vehicle_can() -> None:
    def steps(way_m: float) -> list[PoseMeasurement]:
        return [PoseMeasurement(k / 15, (way_m * k, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), SOURCE) for k in range(4)]

    assert _run(steps(0.13), inertial=False).satisfies(MAP_STEP)
    assert not _run(steps(0.13)).satisfies(MAP_STEP)
    assert not _run(steps(0.2), inertial=False).satisfies(MAP_STEP)


def test_an_older_pose_says_nothing_of_the_run() -> None:
    trial = _run([_measurement(0), _measurement(2), _measurement(1), _measurement(3)])
    assert len(trial) == 3
    trial.clear()
    assert len(trial) == 0
