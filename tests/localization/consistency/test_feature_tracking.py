"""Points followed through painted pictures: how far odom has moved against them, and what is no picture to go by."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from textured_room import RGB_LENS, camera_at, depth_of, frame_of, moved, plaster, rgb_of

from uav_recon.localization.consistency.feature_tracking import FeatureTracker, TrackedPoints
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.camera_calibration import CameraMotion
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

ROOM_M = np.array([[-3.0, -2.0, 0.0], [3.0, 2.5, 2.6]])
HERE = camera_at(0.0, 0.0, 1.2, 0.3)
STILL = CameraMotion.at_rest(HERE)
PERIOD_S = 1.0 / 6.0


def _frame(n: int, camera: Pose, lens: Intrinsics = RGB_LENS) -> Frame:
    rgb = rgb_of(camera, plaster, ROOM_M, seed=n, lens=lens)
    return frame_of(n * PERIOD_S, depth_of(camera, ROOM_M, seed=n), rgb, lens)


def _flown(
    flow: FeatureTracker, pictures: int, drift: FloatArray | None = None, lens: Intrinsics = RGB_LENS
) -> TrackedPoints | None:
    """Sideways and turning; odom moves off by a drift (3,) m/s."""
    seen = None
    for n in range(pictures):
        camera = camera_at(0.03 * n, 0.05 * n, 1.2, 0.3 + 0.04 * n)
        reported = moved(camera, n * PERIOD_S * (np.zeros(3) if drift is None else drift))
        seen = flow.update(_frame(n, camera, lens), CameraMotion.at_rest(reported))
    return seen


def _shift(seen: TrackedPoints) -> FloatArray:
    """Velocity (3,) by all points, least squares."""
    rows = (seen.along * seen.age_s[:, None, None]).reshape(-1, 3)
    return np.asarray(np.linalg.lstsq(rows, seen.off_m.ravel(), rcond=None)[0])


@pytest.mark.parametrize("drift", [(0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, -0.05, 0.0), (0.03, 0.03, 0.05)])
def test_points_tell_how_odom_moves_off(drift: tuple[float, float, float]) -> None:
    seen = _flown(FeatureTracker(), 10, np.array(drift))
    assert seen is not None and len(seen.age_s) > 40
    np.testing.assert_allclose(_shift(seen), drift, atol=0.008)
    off_m = seen.off_m - (seen.along @ np.array(drift)) * seen.age_s[:, None]
    assert np.median(np.abs(off_m)) < 0.01


def test_a_large_picture_is_made_smaller_and_tells_the_same() -> None:
    drift, lens = np.array([0.0, 0.05, 0.0]), Intrinsics.from_fov(848, 479, 1.20, 0.73)
    seen = _flown(FeatureTracker(), 10, drift, lens)
    assert seen is not None and len(seen.age_s) > 40
    np.testing.assert_allclose(_shift(seen), drift, atol=0.008)


def test_points_are_given_up_after_two_seconds() -> None:
    seen = _flown(FeatureTracker(), 30)
    assert seen is not None
    assert PERIOD_S <= seen.age_s.max() <= 2.0
    assert len(seen.age_s) <= 120


def test_what_is_farther_off_than_the_window_is_still_found() -> None:
    """Odom stays behind by more than the points' windows reach; each picture only adds a little."""
    seen = _flown(FeatureTracker(), 12, np.array([0.0, 0.2, 0.0]))
    assert seen is not None and len(seen.age_s) > 20
    np.testing.assert_allclose(_shift(seen), (0.0, 0.2, 0.0), atol=0.02)


def test_a_frozen_picture_tells_nothing() -> None:
    flow = FeatureTracker()
    frame = _frame(0, HERE)
    for n in range(8):
        shown = dataclasses.replace(frame, stamp_s=n * PERIOD_S)
        assert flow.update(shown, CameraMotion.at_rest(moved(HERE, np.array([0.0, 0.01 * n, 0.0])))) is None


@pytest.mark.parametrize("wrong", ["stamp", "empty", "black", "of noise"])
def test_what_is_no_picture_tells_nothing(wrong: str) -> None:
    flow, rng = FeatureTracker(), np.random.default_rng(1)
    for n in range(6):
        frame = _frame(n, HERE)
        rgb = {
            "stamp": np.zeros((2, 4, 3), np.uint8),
            "empty": np.zeros((0, 0, 3), np.uint8),
            "black": rng.integers(0, 2, frame.rgb.shape, dtype=np.uint8),
            "of noise": rng.integers(0, 255, frame.rgb.shape, dtype=np.uint8),
        }[wrong]
        seen = flow.update(dataclasses.replace(frame, rgb=rgb), STILL)
        assert seen is None or (seen.age_s >= 0.3).sum() < 10


@pytest.mark.parametrize("cause", ["a pause", "odometry restarts"])
def test_nothing_is_compared_across(cause: str) -> None:
    flow = FeatureTracker()
    assert flow.update(_frame(0, HERE), STILL) is None
    assert flow.update(_frame(1, HERE), STILL) is not None
    if cause == "odometry restarts":
        flow.forget()
    assert flow.update(_frame(2 if cause == "odometry restarts" else 5, HERE), STILL) is None


def test_what_has_no_depth_is_not_followed() -> None:
    flow = FeatureTracker()
    for n in range(3):
        blank = dataclasses.replace(_frame(n, HERE), depth_m=np.full((120, 212), np.nan, np.float32))
        assert flow.update(blank, STILL) is None
