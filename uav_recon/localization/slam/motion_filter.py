"""Motion of the body: Kalman filter of place, velocity and offset of the accelerometer.

The accelerometer carries the place through views that do not determine it: along a bare wall, or with nothing in view. Its
offset contains its bias, a mount that is off, and the tilt error of the map: it turns with the body. An accelerometer that the
images contradict is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.localization.imu_integration import GRAVITY_MPS2, InertialState, conjugate
from uav_recon.localization.slam.gyro_alignment import JITTER_S
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

PLACE = slice(0, 3)
VELOCITY = slice(3, 6)
OFFSET = slice(6, 9)
TILT = slice(9, 12)
_SIZE = 12
_VELOCITY_MPS = 0.05  # standard deviations at the start
_OFFSET_MPS2 = np.array([0.15, 0.15, 0.1])  # a bias, and a mount that is off by 0.6 degrees
_REST_MPS2 = 0.03  # what the rest on the pad leaves unknown of offset and tilt together
_PLACE_M = 1e-3
_RELOCATED_M = 0.01
_FORCE_DENSITY = 0.12  # m/s² per root Hz: more than that of a flying camera (0.07 to 0.09)
_OFFSET_WALK = 0.015  # m/s² per root second
_TILT_WALK = 0.005
_BLIND_MPS2 = 2.0  # white acceleration of a body without an accelerometer, over one frame
_STEP_M = 0.001  # drift of the map from frame to frame
_SHOWN_M = 0.002  # what the images are off by, each on its own
_SURPRISE = 25.0  # squared innovation of a place, in standard deviations; a larger one counts as this
_REACHED = 9.0  # squared standard deviations that the motion may be off
_MEAN_SURPRISE = 5.0  # mean over _MEAN_FRAMES that contradicts the accelerometer: after four large ones, or more small ones
_MEAN_FRAMES = 15
_TRUSTED_AGAIN = 45  # frames without a surprise until it is used again
_GRAVITY = np.array([0.0, 0.0, -GRAVITY_MPS2])


@dataclass(frozen=True, slots=True, eq=False)
class PredictedMotion:
    """Place and velocity in odom at a later frame.

    state (12,): of MotionFilter; covariance (12, 12). shown_covariance (3, 3): of the place that the frame shows, with the
    error of its stamp.
    """

    state: FloatArray
    covariance: FloatArray
    shown_covariance: FloatArray

    @property
    def place_m(self) -> FloatArray:
        """The place (3,)."""
        return self.state[PLACE]

    @property
    def velocity_mps(self) -> FloatArray:
        """The velocity (3,)."""
        return self.state[VELOCITY]


class MotionFilter:
    """State (12,): place (m), velocity (m/s), offset (m/s², body axes), tilt (m/s², odom axes). Not thread-safe."""

    def __init__(self, place_m: FloatArray) -> None:
        self._now = PredictedMotion(
            np.concatenate((place_m, np.zeros(_SIZE - 3))), _covariance_at_rest(), _PLACE_M**2 * np.eye(3)
        )
        self._mean_surprise = 0.0
        self._calm = _TRUSTED_AGAIN

    @property
    def velocity_mps(self) -> FloatArray:
        """Velocity (3,) in odom."""
        return self._now.velocity_mps

    @property
    def accelerometer_used(self) -> bool:
        """True unless the images have contradicted the accelerometer."""
        return self._calm >= _TRUSTED_AGAIN

    def rest(self) -> None:
        """Set the velocity to zero: the body rests."""
        self._now = PredictedMotion(
            np.concatenate((self._now.place_m, np.zeros(3), self._now.state[6:])),
            _covariance_at_rest(),
            _PLACE_M**2 * np.eye(3),
        )

    def predict(
        self, step_s: float, odom_from_body: Pose, track: tuple[InertialState, InertialState] | None
    ) -> PredictedMotion:
        """Return the motion step_s later.

        odom_from_body: attitude now. track: the inertial track now and then, None without an accelerometer.
        """
        state, transition = self._now.state.copy(), np.eye(_SIZE)
        transition[PLACE, VELOCITY] = step_s * np.eye(3)
        noise = np.zeros((_SIZE, _SIZE))
        if track is None or not self.accelerometer_used:
            state[PLACE] += step_s * state[VELOCITY]
            _add_white_acceleration(noise, _BLIND_MPS2**2 * step_s, step_s)
        else:
            a, b = track
            odom_from_gyro = odom_from_body @ Pose(np.array(conjugate(a.gyro_from_body)), np.zeros(3))
            turn, body = odom_from_gyro.rotation(), odom_from_body.rotation()
            gained = turn @ (np.array(b.velocity_integral) - np.array(a.velocity_integral))
            swept = turn @ (
                np.array(b.position_integral) - np.array(a.position_integral) - np.array(a.velocity_integral) * step_s
            )
            off = body @ state[OFFSET] + state[TILT]
            state[PLACE] += step_s * state[VELOCITY] + swept + 0.5 * step_s**2 * (_GRAVITY - off)
            state[VELOCITY] += gained + step_s * (_GRAVITY - off)
            transition[PLACE, OFFSET] = -0.5 * step_s**2 * body
            transition[VELOCITY, OFFSET] = -step_s * body
            transition[PLACE, TILT] = -0.5 * step_s**2 * np.eye(3)
            transition[VELOCITY, TILT] = -step_s * np.eye(3)
            _add_white_acceleration(noise, _FORCE_DENSITY**2, step_s)
        noise[PLACE, PLACE] += _STEP_M**2 * np.eye(3)
        noise[OFFSET, OFFSET] += _OFFSET_WALK**2 * step_s * np.eye(3)
        noise[TILT, TILT] += _TILT_WALK**2 * step_s * np.eye(3)
        covariance, velocity = transition @ self._now.covariance @ transition.T + noise, state[VELOCITY]
        shown = covariance[PLACE, PLACE] + _SHOWN_M**2 * np.eye(3) + JITTER_S**2 * np.outer(velocity, velocity)
        return PredictedMotion(state, covariance, shown)

    def coast(self, predicted: PredictedMotion) -> None:
        """Take the predicted motion: the frame was not believed."""
        self._now = predicted

    def relocate(self, predicted: PredictedMotion, place_m: FloatArray) -> None:
        """Take a place (3,) that a search has found.

        If it lies where the motion may have come to, it corrects the motion, too; else the map was off, and not the motion.
        """
        covariance, shift = _RELOCATED_M**2 * np.eye(3), place_m - predicted.place_m
        if float(shift @ np.linalg.solve(predicted.shown_covariance, shift)) < _REACHED:
            self.update(predicted, place_m, covariance)
            return
        whole = predicted.covariance.copy()
        whole[PLACE, :], whole[:, PLACE] = 0.0, 0.0
        whole[PLACE, PLACE] = covariance
        self._now = PredictedMotion(np.concatenate((place_m, predicted.state[3:])), whole, covariance)

    def update(self, predicted: PredictedMotion, place_m: FloatArray, place_covariance: FloatArray) -> None:
        """Take the place (3,) of a believed frame, with its covariance (3, 3).

        Both contain the prediction already.
        """
        before = predicted.shown_covariance
        gain = np.linalg.solve(before, predicted.covariance[PLACE, :]).T
        shift = place_m - predicted.place_m
        covariance = predicted.covariance - gain @ (before - place_covariance) @ gain.T
        covariance = 0.5 * (covariance + covariance.T)
        self._now = PredictedMotion(predicted.state + gain @ shift, covariance, covariance[PLACE, PLACE])
        self._judge(float(shift @ np.linalg.solve(before, shift)))

    def _judge(self, surprise: float) -> None:
        """Leave the accelerometer out after surprises; use it again after a while without."""
        self._mean_surprise += (min(surprise, _SURPRISE) - self._mean_surprise) / _MEAN_FRAMES
        if self._mean_surprise > _MEAN_SURPRISE:
            self._calm, self._mean_surprise = 0, 0.0
        else:
            self._calm += 1


def _covariance_at_rest() -> FloatArray:
    """Return the covariance of a body at rest: it shows offset and tilt together, and not each alone."""
    out = np.diag([_PLACE_M**2] * 3 + [_VELOCITY_MPS**2] * 3 + [0.0] * 6)
    apart = np.diag(_OFFSET_MPS2**2)
    out[OFFSET, OFFSET], out[TILT, TILT], out[OFFSET, TILT], out[TILT, OFFSET] = apart, apart, -apart, -apart
    out[OFFSET, OFFSET] += _REST_MPS2**2 * np.eye(3)
    return out


def _add_white_acceleration(noise: FloatArray, density2: float, step_s: float) -> None:
    """Add the growth by white acceleration of a squared density (m²/s³) over a step."""
    eye = np.eye(3)
    noise[PLACE, PLACE] += density2 * step_s**3 / 3.0 * eye
    noise[PLACE, VELOCITY] += density2 * step_s**2 / 2.0 * eye
    noise[VELOCITY, PLACE] += density2 * step_s**2 / 2.0 * eye
    noise[VELOCITY, VELOCITY] += density2 * step_s * eye
