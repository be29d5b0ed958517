"""What a camera that is not as the config says does to the drift rate, and how well its errors are separated from a drift.

The frames are rendered with the error, by the exact geometry; the filter sees them with the nominal one.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from textured_room import BARE, LENS, camera_at, depth_of, frame_of, moved, plaster, rgb_of

from uav_recon.localization.calibration.calibration_filter import (
    COLOUR_DELAY,
    DELAY,
    ROTATION,
    SCALE,
    CalibrationFilter,
)
from uav_recon.localization.consistency.odometry_drift_rate import DriftRateEstimator
from uav_recon.types.camera import Frame
from uav_recon.types.camera_calibration import CameraCalibration, CameraMotion
from uav_recon.types.frames import Float32Array, FloatArray
from uav_recon.types.pose import Pose

PERIOD_S = 1.0 / 6.0
ROOM_M = np.array([[-3.5, -2.5, 0.0], [3.5, 2.5, 2.6]])
CABINET_M = np.array([[1.8, 0.9, 0.0], [2.4, 1.6, 1.9]])
TABLE_M = np.array([[-2.2, -1.8, 0.0], [-1.2, -1.0, 0.8]])


def _path(t: float) -> Pose:
    """Up to 0.7 m/s and 0.9 rad/s, with stops."""
    yaw = 1.5 * math.sin(0.45 * t) + 0.35 * t
    return camera_at(1.6 * math.sin(0.35 * t), 1.0 * math.sin(0.51 * t + 0.7), 1.2 + 0.35 * math.sin(0.6 * t), yaw)


@dataclass(frozen=True)
class Errors:
    delay_s: float = 0.0
    rotation_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)  # nominal_from_true, axes of the imager
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 0.0
    colour_delay_s: float = 0.0
    drift_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)


def _depth(camera: Pose, scale: float, seed: int) -> Float32Array:
    return np.asarray((1.0 + scale) * depth_of(camera, ROOM_M, CABINET_M, TABLE_M, seed=seed), dtype=np.float32)


def flown_frames(errors: Errors, seconds: float, painted: bool = False) -> Iterator[tuple[Frame, CameraMotion]]:
    """Yield the frames of a flight as rendered with the errors, with the motion as the poses tell it."""
    wrong = Pose.from_rotation_vector(np.array(errors.rotation_rad), np.array(errors.offset_m))
    for n in range(round(seconds / PERIOD_S)):
        t = n * PERIOD_S
        true = _path(t - errors.delay_s) @ wrong.inverse()
        rgb = BARE
        if painted:
            coloured = _path(t - errors.colour_delay_s) @ wrong.inverse()
            rgb = rgb_of(coloured, plaster, ROOM_M, CABINET_M, TABLE_M, seed=n)
        by_m = np.array(errors.drift_mps) * max(t - 20.0, 0.0)
        reported, moment = moved(_path(t), by_m), moved(_path(t - 0.03), by_m)
        yield frame_of(t, _depth(true, errors.scale, n), rgb), CameraMotion.between(moment, reported, 0.03)


def _fly(errors: Errors, seconds: float, painted: bool = False) -> tuple[DriftRateEstimator, list[bool], list[float]]:
    """Returns the estimator, and at each frame whether it says that odom drifts, and by how much."""
    estimator, drifts, drift_mps = DriftRateEstimator(), list[bool](), list[float]()
    for frame, motion in flown_frames(errors, seconds, painted):
        estimator.update(frame, motion)
        drifts.append(estimator.drifts)
        drift_mps.append(float(np.linalg.norm(estimator.velocity_mps)))
    return estimator, drifts, drift_mps


def _state(estimator: DriftRateEstimator) -> FloatArray:
    return estimator.calibration.state


@pytest.mark.parametrize(
    "delay_s", [pytest.param(0.0, marks=pytest.mark.nightly), pytest.param(0.015, marks=pytest.mark.nightly), 0.03, -0.02]
)
def test_the_age_of_frames_is_measured(delay_s: float) -> None:
    estimator, drifts, _ = _fly(Errors(delay_s=delay_s), 45.0)
    assert _state(estimator)[DELAY] == pytest.approx(delay_s, abs=0.006)
    assert not any(drifts)


@pytest.mark.parametrize("axis", [pytest.param(0, marks=pytest.mark.nightly), 1, pytest.param(2, marks=pytest.mark.nightly)])
def test_the_rotation_of_the_mount_is_measured(axis: int) -> None:
    rotation = np.radians(1.0) * np.eye(3)[axis]
    estimator, drifts, _ = _fly(Errors(rotation_rad=tuple(rotation.tolist())), 60.0)
    # the true pose is the nominal one times the inverse of the error, so points appear turned by its inverse
    np.testing.assert_allclose(_state(estimator)[ROTATION], rotation, atol=math.radians(0.5))
    assert not any(drifts)


@pytest.mark.parametrize("scale", [0.015, pytest.param(-0.015, marks=pytest.mark.nightly)])
def test_the_scale_of_depth_is_measured(scale: float) -> None:
    estimator, drifts, _ = _fly(Errors(scale=scale), 60.0)
    assert _state(estimator)[SCALE] == pytest.approx(scale, abs=0.008)
    assert not any(drifts)


def test_the_delay_of_the_colour_imager_is_its_own() -> None:
    """The plaster shows little: a good third of it is measured, and little is taken for the delay of depth."""
    estimator, drifts, _ = _fly(Errors(colour_delay_s=0.025), 30.0, painted=True)
    assert 0.008 < _state(estimator)[COLOUR_DELAY] < 0.03
    assert _state(estimator)[DELAY] == pytest.approx(0.0, abs=0.012)
    assert not any(drifts)


ALL = Errors(0.03, (0.015, -0.012, 0.010), (0.008, -0.008, 0.008), 0.012)


OPPOSITE = Errors(-0.03, (-0.015, 0.012, -0.010), (-0.008, 0.008, -0.008), -0.012)


@pytest.mark.parametrize("errors", [pytest.param(ALL, marks=pytest.mark.nightly), OPPOSITE])
def test_all_errors_together_are_no_drift(errors: Errors) -> None:
    _, drifts, drift_mps = _fly(errors, 60.0)
    assert not any(drifts)
    assert np.quantile(drift_mps, 0.9) < 0.02


@pytest.mark.parametrize(
    "drift",
    [
        (0.06, 0.0, 0.0),
        pytest.param((0.0, -0.06, 0.0), marks=pytest.mark.nightly),
        (0.0, 0.0, 0.06),
        pytest.param((0.2, 0.0, 0.0), marks=pytest.mark.nightly),
    ],
)
def test_a_drift_is_reported_among_the_errors(drift: tuple[float, float, float]) -> None:
    _, drifts, _ = _fly(dataclasses.replace(ALL, drift_mps=drift), 40.0)
    begun = round(20.0 / PERIOD_S)
    first = drifts.index(True)
    assert 0.0 < (first - begun) * PERIOD_S < (15.0 if drift[2] else 8.0)  # a mount that nods may explain a height


def test_what_no_motion_shows_stays_at_its_prior() -> None:
    """A camera that hangs still: a wrong mount cannot be seen, and nothing is claimed."""
    estimator, still = DriftRateEstimator(), _path(3.0)
    for n in range(120):
        estimator.update(frame_of(n * PERIOD_S, _depth(still, 0.0, n)), CameraMotion.at_rest(still))
    sigma = np.sqrt(np.diagonal(estimator.calibration.covariance))
    prior = np.sqrt(np.diagonal(CalibrationFilter().covariance))
    assert np.all(sigma[3:] > 0.9 * prior[3:])
    assert np.all(np.abs(_state(estimator)[3:]) < 0.2 * prior[3:])
    assert LENS.width == 212


def test_a_correction_is_bounded_and_needs_to_be_observed() -> None:
    known, unknown = CalibrationFilter(), CalibrationFilter()
    known.covariance = 0.04 * known.covariance
    for each in (known, unknown):
        each.state[DELAY] = 1.0
        each.state[ROTATION] = 1.0
        each.state[SCALE] = -1.0
    correction = known.calibration()
    assert correction.delay_s == pytest.approx(0.0625)
    assert correction.scale == pytest.approx(-0.03)
    turned_rad = 2.0 * math.acos(min(abs(correction.nominal_from_true.quat_wxyz[0]), 1.0))
    assert math.degrees(turned_rad) == pytest.approx(2.0 * math.sqrt(3.0), abs=0.01)
    untouched = unknown.calibration()
    assert (untouched.delay_s, untouched.scale) == (0.0, 0.0)
    np.testing.assert_array_equal(untouched.nominal_from_true.matrix(), np.eye(4))


def test_the_summary_names_units_and_uncertainty() -> None:
    named = {name: (value, sigma) for name, value, sigma in CalibrationFilter().summary()}
    assert named["delay_s"][0] == 0.0
    assert named["delay_s"][1] == pytest.approx(0.025)
    assert set(named) >= {"rotation_x_rad", "rotation_y_rad", "rotation_z_rad", "depth_scale", "colour_delay_s"}


def test_the_pose_of_a_late_frame_is_that_of_a_moment_before() -> None:
    """The imager turns at 1 rad/s and flies 0.5 m/s; what the frame shows is 30 ms old."""
    now, before = _path(7.0), _path(6.97)
    motion = CameraMotion.between(before, now, 0.03)
    then = motion.earlier(0.03)
    np.testing.assert_allclose(then.translation_m, before.translation_m, atol=1e-9)
    turn = then.rotation().T @ before.rotation()
    assert math.acos(min((np.trace(turn) - 1.0) / 2.0, 1.0)) < 1e-4


def test_the_true_pose_of_a_known_camera_is_found() -> None:
    """Delay and mount known exactly: the pose is that of the camera which took the frame."""
    wrong = Pose.from_rotation_vector(np.array([0.015, -0.012, 0.010]), np.array([0.008, -0.008, 0.008]))
    calibration = CameraCalibration(0.03, wrong.inverse(), 0.0)
    found = calibration.pose(CameraMotion.between(_path(6.97), _path(7.0), 0.03))
    true = _path(6.97) @ wrong.inverse()
    np.testing.assert_allclose(found.matrix(), true.matrix(), atol=1e-4)
