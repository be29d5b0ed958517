"""Attitude: stamps that are off move what the frames show, and not the attitude that is carried on."""

from __future__ import annotations

import numpy as np

from uav_recon.localization.slam.attitude_filter import AttitudeFilter
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

PERIOD_S = 1.0 / 15.0
RATE_RADPS = np.array([0.0, 0.0, 0.8])


def _yaw(yaw_rad: float) -> Pose:
    return Pose.from_yaw(yaw_rad, np.zeros(3))


def test_frames_with_wrong_stamps_do_not_shake_the_attitude() -> None:
    """5 ms at 0.8 rad/s are 0.23 degrees in each frame; what is carried on stays within a third of that."""
    random, filtered = np.random.default_rng(3), AttitudeFilter(Pose.identity(), 1e-8 * np.eye(3))
    shown, kept = [], []
    for n in range(1, 120):
        predicted = filtered.predict(PERIOD_S * RATE_RADPS, 0.0007, RATE_RADPS, 0.007)
        true, seen = 0.8 * PERIOD_S * n, 0.8 * (PERIOD_S * n + 0.005 * random.standard_normal())
        measured: FloatArray = np.diag([1e-6, 1e-6, 1e-6])  # of the images themselves
        whole = np.linalg.inv(np.linalg.inv(predicted.shown_covariance) + np.linalg.inv(measured))
        off = (_yaw(seen) @ predicted.odom_from_body.inverse()).rotation_vector()
        found = Pose.from_rotation_vector(whole @ np.linalg.solve(measured, off), np.zeros(3)) @ predicted.odom_from_body
        filtered.update(predicted, found, whole)
        shown.append(abs(seen - true))
        kept.append(abs(float((filtered.odom_from_body @ _yaw(true).inverse()).rotation_vector()[2])))
    assert np.sqrt(np.mean(np.square(shown))) > 0.0035
    assert np.sqrt(np.mean(np.square(kept))) < 0.0015
