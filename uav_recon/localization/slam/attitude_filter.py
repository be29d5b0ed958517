"""Attitude of the body: what the gyro carries, apart from what a frame shows at an instant that is not exactly known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.localization.slam.gyro_alignment import JITTER_S
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

_SHOWN_RAD = math.radians(0.05)  # standard deviation of what a frame shows, each on its own


@dataclass(frozen=True, slots=True, eq=False)
class PredictedAttitude:
    """Attitude in odom at a later frame.

    covariance (3, 3): of a rotation in odom axes. shown_covariance (3, 3): of the attitude that the frame shows, with the error
    of its stamp.
    """

    odom_from_body: Pose
    covariance: FloatArray
    shown_covariance: FloatArray


class AttitudeFilter:
    """Attitude against the map. Not thread-safe. odom_from_body: its translation has no meaning."""

    def __init__(self, odom_from_body: Pose, covariance: FloatArray) -> None:
        self.odom_from_body = odom_from_body
        self._covariance = covariance

    def predict(self, turn_rad: FloatArray, sigma_rad: float, rate_radps: FloatArray) -> PredictedAttitude:
        """Return the attitude after a turn (3,) in body axes.

        sigma_rad: standard deviation of the turn, per axis. rate_radps (3,): turn rate at its end, in body axes.
        """
        turned = self.odom_from_body @ Pose.from_rotation_vector(turn_rad, np.zeros(3))
        rate, eye = turned.rotation() @ rate_radps, np.eye(3)
        covariance = self._covariance + sigma_rad**2 * eye
        return PredictedAttitude(turned, covariance, covariance + _SHOWN_RAD**2 * eye + JITTER_S**2 * np.outer(rate, rate))

    def coast(self, predicted: PredictedAttitude) -> None:
        """Take the predicted attitude: the frame was not believed."""
        self.odom_from_body, self._covariance = predicted.odom_from_body, predicted.covariance

    def update(self, predicted: PredictedAttitude, odom_from_body: Pose, covariance: FloatArray) -> None:
        """Take the attitude of a believed frame, with its covariance (3, 3). Both contain the prediction already."""
        gain = np.linalg.solve(predicted.shown_covariance, predicted.covariance).T
        off = (odom_from_body @ predicted.odom_from_body.inverse()).rotation_vector()
        kept = predicted.covariance - gain @ (predicted.shown_covariance - covariance) @ gain.T
        self.odom_from_body = Pose.from_rotation_vector(gain @ off, np.zeros(3)) @ predicted.odom_from_body
        self._covariance = 0.5 * (kept + kept.T)
