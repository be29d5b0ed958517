"""The camera's errors that a flight leaves in a file are where the next one begins."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from test_calibration_filter import PERIOD_S, Errors, flown_frames
from textured_room import BARE, LENS, frame_of

from uav_recon.clock import InlineExecutor, ManualClock
from uav_recon.localization.calibration.calibration_filter import DELAY, ROTATION, CalibrationFilter, observed
from uav_recon.localization.calibration.kept_calibration import KeptCalibration, camera_id, write
from uav_recon.localization.consistency.odometry_drift_rate import DriftRateEstimator
from uav_recon.types.camera import Frame
from uav_recon.types.reason_code import ReasonCode

FRAME = frame_of(0.0, np.full((LENS.height, LENS.width), 2.0, dtype=np.float32), BARE)
LATE = Errors(delay_s=0.03, rotation_rad=(0.012, -0.008, 0.006))
TOUCHED = Errors(delay_s=0.0, rotation_rad=(-0.008, 0.010, -0.010))
MOUNT = "fixed 15 (0.1, 0.0, 0.0)"


def _kept(file: Path, mount: str = MOUNT) -> KeptCalibration:
    return KeptCalibration(file, mount, InlineExecutor(ManualClock(0.0)))


def _fly(file: Path, errors: Errors, seconds: float) -> tuple[list[float], list[bool], KeptCalibration]:
    """Return the delay known at each frame, whether odometry drifts there, and the file's object."""
    estimator, kept = DriftRateEstimator(), _kept(file)
    delays_s, drifts = list[float](), list[bool]()
    for n, (frame, motion) in enumerate(flown_frames(errors, seconds)):
        kept.begin(frame, estimator.calibration)
        estimator.update(frame, motion)
        if n % round(1.0 / PERIOD_S) == 0:
            kept.update(frame.stamp_s, estimator.calibration, at_rest=estimator.at_rest, wrong=estimator.drifts)
        delays_s.append(float(estimator.calibration.calibration().delay_s))
        drifts.append(estimator.drifts)
    kept.close(estimator.calibration)
    return delays_s, drifts, kept


def _fail(file: Path, mount: str = MOUNT) -> str:
    """Return why a file is not used; it must change nothing."""
    calibration, kept = CalibrationFilter(), _kept(file, mount)
    kept.begin(FRAME, calibration)
    np.testing.assert_array_equal(calibration.state, CalibrationFilter().state)
    np.testing.assert_array_equal(calibration.covariance, CalibrationFilter().covariance)
    assert kept.reason is not None
    assert kept.reason.code is ReasonCode.CALIBRATION_IGNORED
    assert "\n" not in kept.reason.text()
    return str(kept.reason.values[0])


def test_the_second_flight_knows_the_delay_from_the_first_second(tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    first, _, kept = _fly(file, LATE, 45.0)
    assert kept.reason is None
    assert abs(first[0] - LATE.delay_s) > 0.02
    second, drifts, kept = _fly(file, LATE, 10.0)
    assert kept.reason is not None
    assert kept.reason.code is ReasonCode.CALIBRATION_KEPT
    errors_s = [abs(delay_s - LATE.delay_s) for delay_s in second]
    assert max(errors_s[: round(2.0 / PERIOD_S)]) < 0.008
    assert max(errors_s) < 0.012
    assert not any(drifts)


def test_a_camera_that_was_touched_between_flights_raises_no_alarm(tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    _fly(file, LATE, 45.0)
    delays_s, drifts, _ = _fly(file, TOUCHED, 45.0)
    assert not any(drifts)
    assert delays_s[-1] == pytest.approx(TOUCHED.delay_s, abs=0.008)


def test_only_what_motion_has_shown_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    _fly(file, LATE, 45.0)
    kept = json.loads(file.read_text())["elements"]
    assert "delay_s" in kept
    assert "colour_rotation_x_rad" not in kept  # no colour in these frames
    assert observed(CalibrationFilter().summary()) == ()


def test_a_kept_error_is_less_sure_than_it_was(tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    write(file, camera_id(FRAME, MOUNT), (("delay_s", 0.02, 0.004), ("rotation_x_rad", 0.01, 0.0139)))
    calibration = CalibrationFilter()
    _kept(file).begin(FRAME, calibration)
    assert calibration.state[DELAY] == pytest.approx(0.02)
    assert math.sqrt(calibration.covariance[DELAY, DELAY]) == pytest.approx(math.hypot(0.004, 0.0075))
    prior = CalibrationFilter().covariance
    assert calibration.covariance[ROTATION.start, ROTATION.start] == prior[ROTATION.start, ROTATION.start]  # at most the prior


def test_a_file_that_is_broken_is_not_used(tmp_path: Path) -> None:
    file, camera = tmp_path / "calibration.json", camera_id(FRAME, MOUNT)
    texts = ("", "null", "[]", "{}", '{"format": 1}', "\xff", '{"format": 1, "camera": "x", "elements": {"delay_s": 3}}')
    for text in texts:
        file.write_text(text, encoding="latin-1")
        assert _fail(file) == "no calibration file"
    for name, value, sigma in (
        ("delay_s", 1.0, 0.01),
        ("delay_s", math.nan, 0.01),
        ("speed", 0.0, 0.1),
        ("width", 0.0, math.inf),
    ):
        write(file, camera, ((name, value, sigma),))
        assert name in _fail(file)


@pytest.mark.parametrize("text", ["notes\n", '{"my": "settings"}'])
def test_a_file_that_is_no_calibration_is_not_replaced(tmp_path: Path, text: str) -> None:
    file, calibration = tmp_path / "notes.txt", _observed()
    file.write_text(text, encoding="ascii")
    kept = _kept(file)
    kept.begin(FRAME, calibration)
    kept.update(0.0, calibration, at_rest=False, wrong=False)
    kept.close(calibration)
    assert file.read_text(encoding="ascii") == text


def test_a_file_of_another_camera_is_not_used(tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    write(file, camera_id(FRAME, MOUNT), (("delay_s", 0.02, 0.004),))
    assert "another camera" in _fail(file, "gimbal (0.1, 0.0, 0.0)")
    lens = dataclasses.replace(LENS, fx=LENS.fx + 1.0)
    write(file, camera_id(dataclasses.replace(FRAME, depth_intrinsics=lens), MOUNT), (("delay_s", 0.02, 0.004),))
    assert "another camera" in _fail(file)


def test_the_error_is_exactly_at_its_bound(tmp_path: Path) -> None:
    file, camera = tmp_path / "calibration.json", camera_id(FRAME, MOUNT)
    write(file, camera, (("delay_s", 0.0625, 0.01),))
    calibration = CalibrationFilter()
    _kept(file).begin(FRAME, calibration)
    assert calibration.state[DELAY] == 0.0625
    write(file, camera, (("delay_s", 0.0626, 0.01),))
    assert "delay_s" in _fail(file)


def test_a_flight_with_wrong_odometry_leaves_nothing(tmp_path: Path) -> None:
    file, calibration = tmp_path / "calibration.json", _observed()
    kept = _kept(file)
    kept.begin(FRAME, calibration)
    for second in range(60):
        kept.update(float(second), calibration, at_rest=False, wrong=second == 20)
    kept.update(61.0, calibration, at_rest=True, wrong=False)
    kept.close(calibration)
    assert not file.exists()


def test_it_is_written_in_flight_after_a_while_and_at_rest_at_once(tmp_path: Path) -> None:
    file, calibration, clock = tmp_path / "calibration.json", _observed(), ManualClock(0.0)
    kept = KeptCalibration(file, MOUNT, InlineExecutor(clock))
    kept.begin(FRAME, calibration)
    kept.update(0.0, calibration, at_rest=True, wrong=False)
    assert not file.exists()
    for second in range(1, 31):
        kept.update(float(second), calibration, at_rest=False, wrong=False)
    assert not file.exists()
    kept.update(31.0, calibration, at_rest=False, wrong=False)
    assert file.exists()
    file.unlink()
    kept.update(31.5, calibration, at_rest=True, wrong=False)
    assert not file.exists()  # the write before is not done
    clock.advance_to(32.0)
    kept.update(32.0, calibration, at_rest=True, wrong=False)
    assert file.exists()
    file.unlink()
    kept.update(33.0, calibration, at_rest=True, wrong=False)
    kept.close(calibration)
    assert not file.exists()  # nothing new since


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path: Path) -> None:
    calibration, kept = _observed(), _kept(tmp_path / "missing" / "calibration.json")
    kept.begin(FRAME, calibration)
    kept.update(0.0, calibration, at_rest=False, wrong=False)
    kept.close(calibration)


def test_a_camera_at_rest_forgets_nothing() -> None:
    calibration = _observed()
    before = calibration.covariance[3:, 3:].copy()
    for _ in range(600):
        calibration.predict(0.5, at_rest=True)
    np.testing.assert_array_equal(calibration.covariance[3:, 3:], before)
    calibration.predict(0.5)
    assert np.all(np.diagonal(calibration.covariance)[3:] > np.diagonal(before))


def _observed() -> CalibrationFilter:
    calibration = CalibrationFilter()
    calibration.covariance = 0.04 * calibration.covariance
    return calibration


def test_the_frame_is_of_the_flown_camera() -> None:
    frames: list[Frame] = [frame for frame, _ in flown_frames(LATE, 1.0)]
    assert {camera_id(frame, MOUNT) for frame in frames} == {camera_id(FRAME, MOUNT)}
