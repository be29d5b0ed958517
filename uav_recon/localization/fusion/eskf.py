"""Error-state Kalman filter: its state, propagation by the track, and correction by a pose.

    position, velocity              odom, m and m/s
    attitude                        odom_from_gyro, with the track's gyro_from_body
    gyro bias                       body, rad/s
    acceleration offset             odom, m/s²: accelerometer bias and tilt error together, which turn with the body

The error (15,) is position, velocity, a small rotation in odom axes (R_true = exp(error) R), gyro bias, offset; its growth
is in error_propagation.dynamics.

Without an accelerometer the offset is the acceleration of the body; without a gyro, which then measures zero, its "bias" is
the negative turn rate (propagation_model).

A pose source has two errors: white noise, and an unobservable slow drift. The state follows the drift, as a random walk of
position and attitude, so the estimate is the body's pose in the source's own frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from filterpy.kalman import predict, update

from uav_recon.localization.fusion.error_propagation import dynamics
from uav_recon.localization.fusion.imu_integration import (
    GRAVITY_MPS2,
    InertialState,
    Quaternion,
    Vector,
    conjugate,
    exponential,
    logarithm,
    multiply,
    normalised,
    rotate,
)
from uav_recon.localization.fusion.propagation_model import PropagationModel
from uav_recon.types.frames import FloatArray

WHITE_SHARE = 0.15  # share of white noise in a claimed variance; the rest is drift
DRIFT_TIME_S = 20.0  # correlation time of a source's drift
_SMALLEST_M2 = 0.002**2
_LARGEST_M2 = 0.08**2
_SMALLEST_RAD2 = 0.0005**2
_LARGEST_RAD2 = 0.1**2
_MEASURED = [0, 1, 2, 6, 7, 8]  # elements of the error that a pose measures
SEEN = np.ix_(_MEASURED, _MEASURED)  # their block of a covariance (15, 15)
_BIAS = slice(9, 12)
_OFFSET = slice(12, 15)
_NOTHING = np.zeros(15)
_H = np.eye(15)[_MEASURED]


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """Variances per axis of a source.

    White noise (m², rad²), and the random walk of its drift (m²/s, rad²/s).
    """

    position_m2: float
    attitude_rad2: float
    position_walk: float
    attitude_walk: float

    def scaled(self, factor: float) -> PoseNoise:
        """Return the noise with this factor on the white variances."""
        return replace(self, position_m2=factor * self.position_m2, attitude_rad2=factor * self.attitude_rad2)

    @staticmethod
    def claimed(covariance: FloatArray) -> PoseNoise:
        """Return the noise for the covariance (6, 6) that a source claims, within plausible limits."""
        xx, yy, zz, aa, bb, cc = np.diagonal(covariance).tolist()
        place = min(max((xx + yy + zz) / 3.0, _SMALLEST_M2 / WHITE_SHARE), _LARGEST_M2)
        turn = min(max((aa + bb + cc) / 3.0, _SMALLEST_RAD2 / WHITE_SHARE), _LARGEST_RAD2)
        drift = 2.0 * (1.0 - WHITE_SHARE) / DRIFT_TIME_S
        return PoseNoise(WHITE_SHARE * place, WHITE_SHARE * turn, drift * place, drift * turn)


class Estimate(NamedTuple):
    """The state at a stamp.

    covariance: (15, 15) of the error. model: what propagated the state to its stamp.
    """

    stamp_s: float
    position_m: Vector
    velocity_mps: Vector
    odom_from_gyro: Quaternion
    gyro_bias_radps: Vector
    offset_mps2: Vector
    covariance: FloatArray
    model: PropagationModel

    @staticmethod
    def at_rest(
        base: InertialState, position_m: Vector, odom_from_body: Quaternion, noise: PoseNoise, model: PropagationModel
    ) -> Estimate:
        """Return the state for a first pose; its motion is unknown."""
        variances = (noise.position_m2, 1.0, noise.attitude_rad2, model.bias_start**2, model.offset_start**2)
        odom_from_gyro = multiply(odom_from_body, conjugate(base.gyro_from_body))
        zero = (0.0, 0.0, 0.0)
        return Estimate(base.stamp_s, position_m, zero, odom_from_gyro, zero, zero, np.diag(np.repeat(variances, 3)), model)

    def propagated_by(self, model: PropagationModel) -> Estimate:
        """Return the state for propagation by a model.

        Bias and offset are forgotten where they have another meaning in that model.
        """
        if model is self.model:
            return self
        covariance, zero, changed = self.covariance.copy(), (0.0, 0.0, 0.0), self._replace(model=model)
        if model.gyro is not self.model.gyro:
            _forget(covariance, _BIAS, model.bias_start)
            changed = changed._replace(gyro_bias_radps=zero)
        if model.accelerometer is not self.model.accelerometer:
            _forget(covariance, _OFFSET, model.offset_start)
            changed = changed._replace(offset_mps2=zero)
        return changed._replace(covariance=covariance)

    def odom_from_body(self, here: InertialState) -> Quaternion:
        """Return the attitude, with the track at this stamp."""
        return multiply(self.odom_from_gyro, here.gyro_from_body)


def propagate_mean(estimate: Estimate, base: InertialState, here: InertialState) -> Estimate:
    """Return the state propagated from ``base`` (the track at its stamp) to ``here``.

    The covariance is not propagated. Takes microseconds.
    """
    return _carry_mean(estimate, base, here)[0]


def propagate(estimate: Estimate, base: InertialState, here: InertialState, noise: PoseNoise) -> Estimate:
    """Return the state and its covariance propagated from ``base`` to ``here``.

    A knock or a whirl in between is integrated, but may be a sensor error: white acceleration, or rate, is added so that its
    whole change of velocity, or its whole turn, is one standard deviation.
    """
    carried, dp, dv = _carry_mean(estimate, base, here)
    model = estimate.model
    before, after = estimate.odom_from_body(base), estimate.odom_from_body(here)
    walks = (noise.position_walk, noise.attitude_walk)
    dt = here.stamp_s - base.stamp_s
    white = model.acceleration**2 + _doubt(here.shock_velocity_mps - base.shock_velocity_mps, dt)
    rate = model.rate**2 + _doubt(here.overrate_angle_rad - base.overrate_angle_rad, dt)
    densities = (white, model.offset_walk**2, rate, model.bias_walk**2, *walks)
    transition, walk = dynamics(dt, model.accelerometer, before, after, dp, dv, densities)
    _, covariance = predict(_NOTHING, estimate.covariance, transition, walk)
    return carried._replace(covariance=covariance)


def innovation(estimate: Estimate, here: InertialState, position_m: Vector, odom_from_body: Quaternion) -> FloatArray:
    """Return the difference (6,) between a pose and the state at its stamp.

    Position, then the rotation vector between the attitudes.
    """
    error = logarithm(multiply(odom_from_body, conjugate(estimate.odom_from_body(here))))
    px, py, pz = estimate.position_m
    return np.array([position_m[0] - px, position_m[1] - py, position_m[2] - pz, *error])


def spread(estimate: Estimate, noise: PoseNoise) -> FloatArray:
    """Return the covariance (6, 6) of the innovation."""
    out: FloatArray = estimate.covariance[SEEN] + _measured(noise)
    return out


def update_estimate(estimate: Estimate, residual: FloatArray, noise: PoseNoise, doubt: float = 1.0) -> Estimate:
    """Return the state corrected by a pose with this innovation (6,).

    doubt: factor on the pose's white noise.
    """
    error, covariance = update(_NOTHING, estimate.covariance, residual, doubt * _measured(noise), _H)
    e = error.tolist()
    (px, py, pz), (vx, vy, vz) = estimate.position_m, estimate.velocity_mps
    (bx, by, bz), (cx, cy, cz) = estimate.gyro_bias_radps, estimate.offset_mps2
    return estimate._replace(
        position_m=(px + e[0], py + e[1], pz + e[2]),
        velocity_mps=(vx + e[3], vy + e[4], vz + e[5]),
        odom_from_gyro=normalised(multiply(exponential((e[6], e[7], e[8])), estimate.odom_from_gyro)),
        gyro_bias_radps=(bx + e[9], by + e[10], bz + e[11]),
        offset_mps2=(cx + e[12], cy + e[13], cz + e[14]),
        covariance=covariance,
    )


def _forget(covariance: FloatArray, part: slice, sigma: float) -> None:
    covariance[part, :] = covariance[:, part] = 0.0
    covariance[part, part] = sigma**2 * np.eye(3)


def _doubt(change: float, dt: float) -> float:
    """Return the density of the white noise that amounts to a change within dt."""
    return change**2 / dt if change > 0.0 else 0.0


def _measured(noise: PoseNoise) -> FloatArray:
    return np.diag((noise.position_m2,) * 3 + (noise.attitude_rad2,) * 3)


def _carry_mean(estimate: Estimate, base: InertialState, here: InertialState) -> tuple[Estimate, Vector, Vector]:
    """Return the mean at ``here``, and the force integrals of position and velocity in odom.

    Gravity is not part of the integrals.
    """
    dt = here.stamp_s - base.stamp_s
    bias, taken0, taken1 = estimate.gyro_bias_radps, base.bias_integral, here.bias_integral
    untaken = (
        bias[0] * dt - (taken1[0] - taken0[0]),
        bias[1] * dt - (taken1[1] - taken0[1]),
        bias[2] * dt - (taken1[2] - taken0[2]),
    )
    (ax, ay, az), (bx, by, bz) = rotate(base.gyro_from_body, untaken), rotate(here.gyro_from_body, untaken)
    turn = (-0.5 * (ax + bx), -0.5 * (ay + by), -0.5 * (az + bz))  # mean over the interval, in the gyro frame
    odom_from_gyro = normalised(multiply(estimate.odom_from_gyro, _part(turn, 1.0)))
    while_faster, while_farther = (
        multiply(estimate.odom_from_gyro, _part(turn, 1 / 2)),
        multiply(estimate.odom_from_gyro, _part(turn, 1 / 3)),
    )
    v0, v1, x0, x1 = base.velocity_integral, here.velocity_integral, base.position_integral, here.position_integral
    dv = rotate(while_faster, (v1[0] - v0[0], v1[1] - v0[1], v1[2] - v0[2]))
    dp = rotate(while_farther, (x1[0] - x0[0] - v0[0] * dt, x1[1] - x0[1] - v0[1] * dt, x1[2] - x0[2] - v0[2] * dt))
    (px, py, pz), (vx, vy, vz), (cx, cy, cz) = estimate.position_m, estimate.velocity_mps, estimate.offset_mps2
    cz, half = cz - GRAVITY_MPS2, 0.5 * dt * dt
    offset_mps2 = estimate.offset_mps2
    if estimate.model.accelerometer:
        in_body = rotate(conjugate(estimate.odom_from_body(base)), offset_mps2)
        offset_mps2 = rotate(multiply(odom_from_gyro, here.gyro_from_body), in_body)
    carried = estimate._replace(
        stamp_s=here.stamp_s,
        offset_mps2=offset_mps2,
        position_m=(px + vx * dt + cx * half + dp[0], py + vy * dt + cy * half + dp[1], pz + vz * dt + cz * half + dp[2]),
        velocity_mps=(vx + cx * dt + dv[0], vy + cy * dt + dv[1], vz + cz * dt + dv[2]),
        odom_from_gyro=odom_from_gyro,
    )
    return carried, dp, dv


def _part(turn: Vector, share: float) -> Quaternion:
    return exponential((share * turn[0], share * turn[1], share * turn[2]))
