"""Motion of the body: Kalman filter of place, velocity and offset of the accelerometer.

The accelerometer carries the place through views that do not determine it: along a bare wall, or with nothing in view. Its
offset has two parts. One turns with the body: its bias, and a mount that is off. The other one does not: gravity along the tilt
of the map. At rest on the pad only their sum is known; a vehicle that turns shows each. An accelerometer that the images
contradict is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from uav_recon.localization.flow.measured_motion import MeasuredMotion
from uav_recon.localization.fusion.imu_integration import GRAVITY_MPS2, InertialState, conjugate
from uav_recon.localization.slam.place_errors import PLACE, PlaceErrors, Update
from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.pose import Pose

VELOCITY = slice(3, 6)
BIAS = slice(6, 9)  # of the accelerometer, body axes
TILT = slice(9, 12)  # specific force by the tilt of the map, odom axes
OFFSETS = slice(6, 12)
_SIZE = 12
_VELOCITY_MPS = 0.05  # standard deviations at the start
_BIAS_MPS2 = 0.15
_TILT_MPS2 = 0.15  # of a map that is level by the accelerometer alone; its vertical part is nothing
_TILT_VARIANCE = np.array([_TILT_MPS2**2, _TILT_MPS2**2, 1e-6])
_REST_MPS2 = 0.03  # of their sum, which the rest on the pad has shown
_PLACE_M = 1e-3
_FORCE_DENSITY = 0.10  # m/s² per root Hz: twice that of a real hexacopter (EuRoC MH_05): stamps are off by milliseconds
_BIAS_WALK = 0.015  # m/s² per root second
_TILT_WALK = 0.01
_BLIND_MPS2 = 2.0  # white acceleration of a body without an accelerometer, over one frame
_STEP_M = 0.004  # what the images themselves are off by, from frame to frame
_SURPRISE = 25.0  # squared innovation of a place, in standard deviations; a larger one counts as this
_STEP_SURPRISE = 25.0  # squared innovation of a measured step, in standard deviations, beyond which it is not used
_MEAN_SURPRISE = 5.0  # mean over _MEAN_FRAMES that contradicts the accelerometer: after four large ones, or more small ones
_MEAN_FRAMES = 15
_LEAST_FORCE_MPS2 = 6.4  #: reject: the accelerometer, if its mean between two frames is less: no commanded motion reaches it
_MOST_FORCE_MPS2 = 14.7  #: reject: the accelerometer, if its mean between two frames is more
_GRAVITY = np.array([0.0, 0.0, -GRAVITY_MPS2])


@dataclass(frozen=True, slots=True, eq=False)
class PredictedMotion:
    """Place and velocity in odom at a later frame.

    state (12,): of MotionFilter; covariance (12, 12). transition (12, 12): of its errors since the newest frame.
    """

    state: FloatArray
    covariance: FloatArray
    transition: FloatArray

    @property
    def place_m(self) -> FloatArray:
        """The place (3,)."""
        return self.state[PLACE]

    @property
    def velocity_mps(self) -> FloatArray:
        """The velocity (3,)."""
        return self.state[VELOCITY]

    def shifted(self, shift_m: FloatArray) -> PredictedMotion:
        """Return the motion of a place farther by this shift (3,)."""
        state = self.state.copy()
        state[PLACE] += shift_m
        return replace(self, state=state)

    @property
    def place_covariance(self) -> FloatArray:
        """The covariance (3, 3) of the place."""
        return self.covariance[PLACE, PLACE]


class MotionFilter:
    """Kalman filter. Not thread-safe.

    State (12,): place (m), velocity (m/s), bias (m/s², body axes), tilt (m/s², odom axes).

    odom_from_body: pose at rest. offset_mps2 (3,): what the accelerometer measures there beside gravity, body axes.
    ``errors``: joint covariance with the places of the keyframes. ``accelerometer_used``: False once the images have
    contradicted the accelerometer; a comparison over a longer time sets it again.
    """

    def __init__(self, odom_from_body: Pose, offset_mps2: FloatArray) -> None:
        offsets, covariance = _offsets_at_rest(odom_from_body.rotation(), offset_mps2)
        self._state, resting = _resting(odom_from_body.translation_m, offsets, covariance)
        self.errors = PlaceErrors.start(resting)
        self._mean_surprise = 0.0
        self.accelerometer_used = True

    @property
    def now(self) -> PredictedMotion:
        """The motion at the newest frame."""
        return PredictedMotion(self._state, self.errors.state, np.eye(_SIZE))

    @property
    def now_against_lag(self) -> PredictedMotion:
        """The motion at the newest frame, with its uncertainty against the place lately.

        That is the place one or two seconds before.
        """
        return replace(self.now, covariance=self.errors.against_lag())

    @property
    def velocity_mps(self) -> FloatArray:
        """Velocity (3,) in odom."""
        return self._state[VELOCITY]

    def begin(self, place_m: FloatArray, velocity_mps: FloatArray) -> None:
        """Begin again at a place (3,) with a velocity (3,), in another map.

        The bias of the accelerometer stays known.
        """
        offsets, covariance = np.concatenate((self._state[BIAS], np.zeros(3))), np.zeros((6, 6))
        covariance[:3, :3], covariance[3:, 3:] = self.errors.state[BIAS, BIAS], np.diag(_TILT_VARIANCE)
        self._state, began = _resting(place_m, offsets, covariance)
        self._state[VELOCITY] = velocity_mps
        self.errors = PlaceErrors.start(began)

    def rest(self) -> None:
        """Set the velocity to zero: the body rests."""
        self._state, resting = _resting(self._state[PLACE], self._state[OFFSETS], self.errors.state[OFFSETS, OFFSETS])
        self.errors = self.errors.at_rest(resting)

    def predict(
        self,
        step_s: float,
        odom_from_body: Pose,
        track: tuple[InertialState, InertialState] | None,
        measured: MeasuredMotion | None = None,
    ) -> PredictedMotion:
        """Return the motion step_s later.

        odom_from_body: attitude now. track: the inertial track now and then, None without an accelerometer. measured: the same
        step by another source; it is left out where the prediction contradicts it.
        """
        if track is not None and not _flyable(track, step_s):
            self.accelerometer_used = False
        now = self.now
        state, transition, noise = _propagated(now, step_s, odom_from_body, track if self.accelerometer_used else None)
        noise[PLACE, PLACE] += _STEP_M**2 * np.eye(3)
        noise[BIAS, BIAS] += _BIAS_WALK**2 * step_s * np.eye(3)
        noise[TILT, TILT] += _TILT_WALK**2 * step_s * np.eye(3)
        covariance = transition @ now.covariance @ transition.T + noise
        if measured is not None:
            stepped = transition[PLACE] - np.eye(_SIZE)[PLACE]
            of_step = stepped @ now.covariance @ stepped.T + noise[PLACE, PLACE]
            cross = transition @ now.covariance @ stepped.T + noise[:, PLACE]
            off_m = measured.displacement_odom_m - (state[PLACE] - now.place_m)
            gain = _take_step(state, covariance, off_m, of_step, cross, measured.covariance_m2)
            transition = transition - gain @ stepped
        return PredictedMotion(state, covariance, transition)

    def predicted_errors(self, predicted: PredictedMotion) -> PlaceErrors:
        """Return the joint covariance at a predicted motion."""
        return self.errors.predicted(predicted.covariance, predicted.transition)

    def add_keyframe(self, placed_m: float) -> None:
        """Add a keyframe at the place of now. placed_m: as in PlaceErrors.with_keyframe()."""
        self.errors = self.errors.with_keyframe(placed_m)

    def mark_lag(self) -> None:
        """Take the place of now as the next one against which the track is measured."""
        self.errors = self.errors.with_lag()

    def coast(self, predicted: PredictedMotion) -> None:
        """Take the predicted motion: the frame was not accepted."""
        self.errors, self._state = self.predicted_errors(predicted), predicted.state

    def update(
        self, predicted: PredictedMotion, numbers: IntArray, moved_m: FloatArray, joint: FloatArray
    ) -> tuple[FloatArray, Update]:
        """Take an accepted frame; return the correction of the keyframes, and what undoes it.

        The correction (N, 3) is that of their places.
        numbers, moved_m, joint: as in PlaceErrors.updated().
        """
        errors = self.predicted_errors(predicted)
        before = errors.against_lag()[PLACE, PLACE]
        self.errors, correction, places_m, update = errors.updated(numbers, moved_m, joint)
        self._state = predicted.state + correction
        stepped_m = moved_m[:3] - moved_m[3:6]
        self._judge(float(stepped_m @ np.linalg.solve(before, stepped_m)))
        return places_m, update

    def _judge(self, surprise: float) -> None:
        """Leave the accelerometer out after surprises."""
        self._mean_surprise += (min(surprise, _SURPRISE) - self._mean_surprise) / _MEAN_FRAMES
        if self._mean_surprise > _MEAN_SURPRISE:
            self.accelerometer_used, self._mean_surprise = False, 0.0


def propagate(
    motion: PredictedMotion, step_s: float, odom_from_body: Pose, track: tuple[InertialState, InertialState] | None
) -> PredictedMotion:
    """Return a motion step_s later by dead reckoning.

    odom_from_body: attitude before. track: the inertial track now and then, None without an accelerometer.
    """
    state, transition, noise = _propagated(motion, step_s, odom_from_body, track)
    return PredictedMotion(state, transition @ motion.covariance @ transition.T + noise, transition)


def _propagated(
    motion: PredictedMotion, step_s: float, odom_from_body: Pose, track: tuple[InertialState, InertialState] | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the state (12,) step_s later, the transition (12, 12), and the noise (12, 12)."""
    state, transition, noise = motion.state.copy(), np.eye(_SIZE), np.zeros((_SIZE, _SIZE))
    transition[PLACE, VELOCITY] = step_s * np.eye(3)
    if track is None:
        state[PLACE] += step_s * state[VELOCITY]
        _add_white_acceleration(noise, _BLIND_MPS2**2 * step_s, step_s)
        return state, transition, noise
    a, b = track
    odom_from_gyro = odom_from_body @ Pose(np.array(conjugate(a.gyro_from_body)), np.zeros(3))
    turn, body = odom_from_gyro.rotation(), odom_from_body.rotation()
    gained = turn @ (np.array(b.velocity_integral) - np.array(a.velocity_integral))
    swept = turn @ (np.array(b.position_integral) - np.array(a.position_integral) - np.array(a.velocity_integral) * step_s)
    off = body @ state[BIAS] + state[TILT]
    state[PLACE] += step_s * state[VELOCITY] + swept + 0.5 * step_s**2 * (_GRAVITY - off)
    state[VELOCITY] += gained + step_s * (_GRAVITY - off)
    by_offsets = np.hstack((body, np.eye(3)))
    transition[PLACE, OFFSETS] = -0.5 * step_s**2 * by_offsets
    transition[VELOCITY, OFFSETS] = -step_s * by_offsets
    _add_white_acceleration(noise, _FORCE_DENSITY**2, step_s)
    return state, transition, noise


def _flyable(track: tuple[InertialState, InertialState], step_s: float) -> bool:
    """Return True if the mean specific force of a step is one of flight."""
    before, after = track
    mean_mps2 = math.dist(after.velocity_integral, before.velocity_integral) / max(step_s, 1e-6)
    return _LEAST_FORCE_MPS2 < mean_mps2 < _MOST_FORCE_MPS2


def _resting(place_m: FloatArray, offsets: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the state (12,) of a body at rest, and its covariance (12, 12).

    offsets (6,): of its accelerometer, with their covariance (6, 6).
    """
    spread = np.diag([_PLACE_M**2] * 3 + [_VELOCITY_MPS**2] * 3 + [0.0] * 6)
    spread[OFFSETS, OFFSETS] = covariance
    return np.concatenate((place_m, np.zeros(3), offsets)), spread


def _offsets_at_rest(body: FloatArray, offset_mps2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return bias and tilt (6,) whose sum the rest has shown (3,), and their covariance (6, 6).

    body (3, 3): odom_from_body.
    """
    prior = np.diag(np.concatenate(([_BIAS_MPS2**2] * 3, _TILT_VARIANCE)))
    rows = np.hstack((np.eye(3), body.T))
    gain = np.linalg.solve(rows @ prior @ rows.T + _REST_MPS2**2 * np.eye(3), rows @ prior).T
    return gain @ offset_mps2, prior - gain @ rows @ prior


def _take_step(
    state: FloatArray, covariance: FloatArray, off_m: FloatArray, of_step: FloatArray, cross: FloatArray, noise: FloatArray
) -> FloatArray:
    """Correct state (12,) and covariance (12, 12) by a measured step; return the gain (12, 3).

    off_m (3,): measured less predicted. of_step (3, 3): covariance of the predicted step. cross (12, 3): of state and step.
    noise (3, 3): covariance of the measured step.
    """
    spread = of_step + noise
    if off_m @ np.linalg.solve(spread, off_m) > _STEP_SURPRISE:
        return np.zeros_like(cross)
    gain = np.linalg.solve(spread, cross.T).T
    state += gain @ off_m
    covariance -= gain @ cross.T
    return np.asarray(gain)


def _add_white_acceleration(noise: FloatArray, density2: float, step_s: float) -> None:
    """Add the growth by white acceleration of a squared density (m²/s³) over a step."""
    eye = np.eye(3)
    noise[PLACE, PLACE] += density2 * step_s**3 / 3.0 * eye
    noise[PLACE, VELOCITY] += density2 * step_s**2 / 2.0 * eye
    noise[VELOCITY, PLACE] += density2 * step_s**2 / 2.0 * eye
    noise[VELOCITY, VELOCITY] += density2 * step_s * eye
