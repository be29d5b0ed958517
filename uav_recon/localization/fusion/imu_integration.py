"""IMU integration: gyro and accelerometer, once per sample, in a separate frame.

The GYRO frame is any inertial frame: it starts aligned with the first sample's body axes and drifts with the gyro. In it

    q(t): gyro_from_body,    V(t) = integral of R(q) f dt,    X(t) = integral of V dt        (f: specific force)

so the motion between ANY two instants a < b follows from differences, even if more is learned later about the pose of the gyro
frame in odom (odom_from_gyro, R below) and about gravity g (strapdown mechanisation, e.g. Titterton and Weston,
Strapdown Inertial Navigation Technology, ch. 3):

    v(b) = v(a) + R (V(b) - V(a)) + g (b - a)
    p(b) = p(a) + v(a) (b - a) + R (X(b) - X(a) - V(a) (b - a)) + g (b - a)^2 / 2

A late pose therefore needs no second pass over the samples. The gyro's bias is subtracted as it is known when a sample
arrives; B(t), the integral of the subtracted bias, allows a later correction of the difference.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uav_recon.types.frames import FloatArray

Quaternion = tuple[float, float, float, float]  # wxyz
Vector = tuple[float, float, float]

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)
_ZERO: Vector = (0.0, 0.0, 0.0)
GRAVITY_MPS2 = 9.80665
_KNOCK_MPS2 = 30.0  # no propeller pushes harder: a blow, or a sensor error
_WHIRL_RADPS = 10.0  # firmware turns at 4 at most; a sample of 5 ms with a smaller error is within the gate of 3 degrees
_RANGE_RADPS = 17.5  # 1000 degrees/s: the range of a D435i's gyro; a larger value is limited to it
_CAPACITY = 4096  # samples: 20 s at 200 Hz; a full buffer keeps its newer half


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the Hamilton product, wxyz.

    Plain floats are ten times faster than numpy for four numbers.
    """
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def normalised(q: Quaternion) -> Quaternion:
    """Return the unit quaternion of the same direction."""
    n = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (q[0] / n, q[1] / n, q[2] / n, q[3] / n)


def rotate(q: Quaternion, v: Vector) -> Vector:
    """Transform a vector from the source frame of ``q`` into its target frame."""
    w, x, y, z = q
    tx, ty, tz = 2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )


def exponential(rotation_rad: Vector) -> Quaternion:
    """Return the unit quaternion of a rotation vector."""
    x, y, z = rotation_rad
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-9:
        return (1.0, 0.5 * x, 0.5 * y, 0.5 * z)
    s = math.sin(0.5 * angle) / angle
    return (math.cos(0.5 * angle), s * x, s * y, s * z)


def logarithm(q: Quaternion) -> Vector:
    """Return the rotation vector of a unit quaternion, for the smaller angle."""
    w, x, y, z = q if q[0] >= 0 else (-q[0], -q[1], -q[2], -q[3])
    s = math.sqrt(x * x + y * y + z * z)
    k = 2.0 if s < 1e-9 else 2.0 * math.atan2(s, w) / s
    return (k * x, k * y, k * z)


class InertialState(NamedTuple):
    """The track at one instant.

    gyro_from_body, V (m/s) and X (m) in the gyro frame, B (rad, body axes). shock_velocity_mps and overrate_angle_rad:
    integrals of the forces harder than any propeller's and of the turn rates faster than any vehicle's, without direction.
    """

    stamp_s: float
    gyro_from_body: Quaternion
    velocity_integral: Vector
    position_integral: Vector
    bias_integral: Vector
    shock_velocity_mps: float = 0.0
    overrate_angle_rad: float = 0.0


class InertialTrack:
    """The integrals at every sample of the last seconds.

    Between samples rate and force are constant.

    ``hover_force_gyro`` (gyro frame, m/s²) is the specific force that cancels gravity. It fills gaps, so a track without an
    accelerometer moves on at constant velocity.
    """

    def __init__(self, gap_s: float = 0.05) -> None:
        self.hover_force_gyro: Vector = (0.0, 0.0, GRAVITY_MPS2)
        self._gap_s = gap_s
        self._count = 0
        self._stamp = np.empty(_CAPACITY)
        self._state = np.empty((_CAPACITY, 15))  # q, V, X, B, knocks and whirls at the sample
        self._step = np.zeros((_CAPACITY, 11))  # rate (body), force (gyro frame), bias, knock and whirl to the next sample
        self._last: tuple[Vector, Vector | None] = (_ZERO, None)  # newest rate without bias, and newest force
        self._measured = False  # True if the newest sample came from an IMU

    def __len__(self) -> int:
        return self._count

    @property
    def newest_s(self) -> float:
        """Stamp of the newest sample; -inf for an empty track."""
        return float(self._stamp[self._count - 1]) if self._count else -math.inf

    @property
    def oldest_s(self) -> float:
        """Stamp of the oldest stored sample; inf for an empty track."""
        return float(self._stamp[0]) if self._count else math.inf

    def push(self, stamp_s: float, rate_radps: Vector, force_mps2: Vector | None, bias_radps: Vector = _ZERO) -> None:
        """Append a sample: body rate, body specific force, and the gyro's bias as known now.

        Stamps must increase. Without a force the track moves on at constant velocity.
        """
        self._make_room()
        i = self._count - 1
        rx, ry, rz = (rate_radps[0] - bias_radps[0], rate_radps[1] - bias_radps[1], rate_radps[2] - bias_radps[2])
        share = _RANGE_RADPS / max(_length((rx, ry, rz)), _RANGE_RADPS)
        rate_radps = (share * rx, share * ry, share * rz)
        if i >= 0:
            dt = stamp_s - float(self._stamp[i])
            if self._measured and dt > self._gap_s:
                self._step[i] = (*_ZERO, *self.hover_force_gyro, *bias_radps, 0.0, 0.0)
            elif self._measured:
                rate, force = _mean(self._last[0], rate_radps), _mean_force(self._last[1], force_mps2)
                middle = multiply(
                    self._quaternion(i), exponential((0.5 * dt * rate[0], 0.5 * dt * rate[1], 0.5 * dt * rate[2]))
                )
                whirl = _length(rate) if max(_length(self._last[0]), _length(rate_radps)) > _WHIRL_RADPS else 0.0
                self._step[i] = (*rate, *self._in_gyro_frame(middle, force), *bias_radps, _knock_mps2(force), whirl)
            self._append(self._advance(i, stamp_s))
        else:
            self._append(InertialState(stamp_s, IDENTITY, _ZERO, _ZERO, _ZERO))
        self._last = (rate_radps, force_mps2)
        self._measured = True
        newest = self._count - 1
        force_gyro = self._in_gyro_frame(self._quaternion(newest), force_mps2)
        turning = _length(rate_radps)
        whirl = turning if turning > _WHIRL_RADPS else 0.0
        self._step[newest] = (*rate_radps, *force_gyro, *bias_radps, _knock_mps2(force_mps2), whirl)

    def coast(self, stamp_s: float, rate_radps: Vector) -> None:
        """Append a sample without an IMU: turning at ``rate_radps``, not accelerating.

        It counts as a gyro that measures zero and has the opposite bias.
        """
        self._make_room()
        rx, ry, rz = rate_radps
        step = (rx, ry, rz, *self.hover_force_gyro, -rx, -ry, -rz, 0.0, 0.0)
        if self._count:
            i = self._count - 1
            if self._measured and stamp_s - float(self._stamp[i]) > self._gap_s:
                self._step[i] = step
            self._append(self._advance(i, stamp_s))
        else:
            self._append(InertialState(stamp_s, IDENTITY, _ZERO, _ZERO, _ZERO))
        self._step[self._count - 1] = step
        self._measured = False

    def at(self, stamp_s: float) -> InertialState | None:
        """Return the track at an instant, extrapolated after its end; None before its start."""
        if not self._count or stamp_s < self._stamp[0]:
            return None
        i = int(self._stamp[: self._count].searchsorted(stamp_s, side="right")) - 1
        if i == self._count - 1 and self._measured and stamp_s - self._stamp[i] > self._gap_s:
            return self._advance(i, stamp_s, (*_ZERO, *self.hover_force_gyro, *self._step[i, 6:9].tolist(), 0.0, 0.0))
        return self._advance(i, stamp_s)

    def _in_gyro_frame(self, gyro_from_body: Quaternion, force_mps2: Vector | None) -> Vector:
        return self.hover_force_gyro if force_mps2 is None else rotate(gyro_from_body, force_mps2)

    def _quaternion(self, i: int) -> Quaternion:
        w, x, y, z = self._state[i, :4].tolist()
        return (w, x, y, z)

    def _advance(self, i: int, stamp_s: float, step: tuple[float, ...] | None = None) -> InertialState:
        """Return sample i propagated along its own step, or another one, to ``stamp_s``."""
        dt = stamp_s - float(self._stamp[i])
        w, x, y, z, vx, vy, vz, px, py, pz, bx, by, bz, knocks, whirls = self._state[i].tolist()
        rx, ry, rz, ax, ay, az, gx, gy, gz, knock, whirl = self._step[i].tolist() if step is None else step
        half = 0.5 * dt * dt
        return InertialState(
            stamp_s,
            normalised(multiply((w, x, y, z), exponential((rx * dt, ry * dt, rz * dt)))),
            (vx + ax * dt, vy + ay * dt, vz + az * dt),
            (px + vx * dt + ax * half, py + vy * dt + ay * half, pz + vz * dt + az * half),
            (bx + gx * dt, by + gy * dt, bz + gz * dt),
            knocks + knock * dt,
            whirls + whirl * dt,
        )

    def _append(self, state: InertialState) -> None:
        self._stamp[self._count] = state.stamp_s
        self._state[self._count] = (
            *state.gyro_from_body, *state.velocity_integral, *state.position_integral, *state.bias_integral,
            state.shock_velocity_mps, state.overrate_angle_rad,
        )  # fmt: skip
        self._count += 1

    def _make_room(self) -> None:
        """Drop the older half of a full buffer.

        The integrals restart there, so that they stay within the resolution of a float.
        """
        if self._count < _CAPACITY:
            return
        k = _CAPACITY // 2
        self._stamp[:k] = self._stamp[k:]
        self._state[:k] = self._state[k:]
        self._step[:k] = self._step[k:]
        v0, x0 = self._state[0, 4:7].copy(), self._state[0, 7:10].copy()
        since: FloatArray = self._stamp[:k] - self._stamp[0]
        self._state[:k, 7:10] -= x0 + np.outer(since, v0)
        self._state[:k, 4:7] -= v0
        self._state[:k, 10:] -= self._state[0, 10:].copy()
        self._count = k


def _mean(a: Vector, b: Vector) -> Vector:
    return (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]))


def _mean_force(a: Vector | None, b: Vector | None) -> Vector | None:
    return None if a is None or b is None else _mean(a, b)


def _knock_mps2(force_mps2: Vector | None) -> float:
    """Return the size of a force that no vehicle flies by, otherwise 0."""
    force = 0.0 if force_mps2 is None else _length(force_mps2)
    return force if force > _KNOCK_MPS2 else 0.0


def _length(v: Vector) -> float:
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
