"""Attitude of the body, apart from what a frame with a wrong stamp shows of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

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

    def with_heading(self, off_rad: float, variance: float) -> PredictedAttitude:
        """Return the attitude corrected by a measured heading.

        off_rad: measured less predicted. variance: of this difference.
        """
        gain = self.covariance[:, 2] / variance
        less = np.outer(gain, self.covariance[2])
        turn = Pose.from_rotation_vector(gain * off_rad, np.zeros(3))
        return PredictedAttitude(turn @ self.odom_from_body, self.covariance - less, self.shown_covariance - less)


class AttitudeFilter:
    """Attitude against the map. Not thread-safe. odom_from_body: its translation has no meaning."""

    def __init__(self, odom_from_body: Pose, covariance: FloatArray) -> None:
        self.odom_from_body = odom_from_body
        self._covariance = covariance

    def predict(
        self, turn_rad: FloatArray, sigma_rad: float, rate_radps: FloatArray, stamp_sigma_s: float
    ) -> PredictedAttitude:
        """Return the attitude after a turn (3,) in body axes.

        sigma_rad: standard deviation of the turn, per axis. rate_radps (3,): turn rate at its end, in body axes. stamp_sigma_s:
        standard deviation of the instant that the frame shows.
        """
        turned = self.odom_from_body @ Pose.from_rotation_vector(turn_rad, np.zeros(3))
        rate, eye = turned.rotation() @ rate_radps, np.eye(3)
        covariance = self._covariance + sigma_rad**2 * eye
        return PredictedAttitude(turned, covariance, covariance + _SHOWN_RAD**2 * eye + stamp_sigma_s**2 * np.outer(rate, rate))

    def coast(self, predicted: PredictedAttitude) -> None:
        """Take the predicted attitude: the frame was not accepted."""
        self.odom_from_body, self._covariance = predicted.odom_from_body, predicted.covariance

    def update(self, predicted: PredictedAttitude, odom_from_body: Pose, covariance: FloatArray) -> None:
        """Take the attitude of an accepted frame, with its covariance (3, 3).

        Both contain the prediction already.
        """
        gain = np.linalg.solve(predicted.shown_covariance, predicted.covariance).T
        off = (odom_from_body @ predicted.odom_from_body.inverse()).rotation_vector()
        kept = predicted.covariance - gain @ (predicted.shown_covariance - covariance) @ gain.T
        self.odom_from_body = Pose.from_rotation_vector(gain @ off, np.zeros(3)) @ predicted.odom_from_body
        self._covariance = 0.5 * (kept + kept.T)
