"""Smooth flight along waypoints: rest on the pad, climb, waypoints, rest in the air.

Position and heading are uniform quintic B-splines. Their control points lie STEP_S apart on the straight legs and move at no
more than the given speed and turn rate. A B-spline's derivative is a mean of the differences of its control points, so the
flight never exceeds these rates either. Corners are rounded; the body tilts with the acceleration as a quadrotor does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from sitl.geometry.quaternion import wrapped
from sitl.world.quadrotor import GRAVITY_MPS2

STEP_S = 0.4  # between control points: corners are rounded over about 1 s
REST_S = 2.0  # on the pad with the motors off
SPIN_UP_S = 0.5  # on the pad with the motors on
CLIMB_MPS = 0.4
END_S = 1.0  # at rest after the last waypoint
_DEGREE = 5
_HALF_SUPPORT = 3  # control points on each side that a value depends on
_DIFFERENCE_S = 5e-4
F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Rates:
    """Limits of a flight: speed, m/s, and turn rates of body and gimbal, rad/s."""

    speed_mps: float = 0.6
    yaw_radps: float = math.radians(45.0)
    gimbal_radps: float = math.radians(30.0)


@dataclass(frozen=True)
class Waypoint:
    """Position (3,) in the world, m; heading and tilt of the camera on the leg to it, rad."""

    position_m: tuple[float, float, float]
    yaw_rad: float
    pitch_down_rad: float = 0.0


@dataclass(frozen=True)
class TrajectoryStates:
    """States at T instants: ENU world, FLU body.

    stamp_s (T,). position_m (T, 3). quat_wxyz (T, 4): world_from_body. velocity_mps (T, 3): world. gyro_radps (T, 3) and
    specific_force_mps2 (T, 3): body. pitch_down_rad (T,): of the gimbal. motors_on (T,).
    """

    stamp_s: F64
    position_m: F64
    velocity_mps: F64
    quat_wxyz: F64
    gyro_radps: F64
    specific_force_mps2: F64
    pitch_down_rad: F64
    motors_on: NDArray[np.bool_]


class SplineTrajectory:
    """Flight from the pad, at the world's origin, through waypoints.

    The first waypoint is straight above the pad.
    """

    def __init__(self, start_yaw_rad: float, waypoints: list[Waypoint], rates: Rates | None = None) -> None:
        controls = _controls(start_yaw_rad, waypoints, rates or Rates())
        knots = STEP_S * (np.arange(len(controls) + _DEGREE + 1) - _HALF_SUPPORT)
        self._curve = BSpline(knots, controls, _DEGREE)
        self._velocity = self._curve.derivative()
        self._acceleration = self._velocity.derivative()
        self.duration_s = float(STEP_S * (len(controls) - 1 - _HALF_SUPPORT))

    def states(self, stamp_s: F64) -> TrajectoryStates:
        """Return the states at times (T,) from the start, s; outside the flight it rests."""
        t = self._within(stamp_s)
        at, velocity, thrust = self._curve(t), self._velocity(t), self._thrust(t)
        quat = self._attitude(t)
        turned = _multiply(_conjugate(self._attitude(t - _DIFFERENCE_S)), self._attitude(t + _DIFFERENCE_S))
        gyro = turned[:, 1:] / _DIFFERENCE_S  # a small rotation is twice the vector part
        force = _rotate(_conjugate(quat), thrust)
        motors_on = np.asarray(stamp_s) >= REST_S
        return TrajectoryStates(np.asarray(stamp_s), at[:, :3], velocity[:, :3], quat, gyro, force, at[:, 4], motors_on)

    def _within(self, stamp_s: F64) -> F64:
        margin = 2.0 * _DIFFERENCE_S
        return np.clip(np.asarray(stamp_s, np.float64), margin, self.duration_s - margin)

    def _thrust(self, t: F64) -> F64:
        """Return the specific force (T, 3) in the world."""
        return np.asarray(self._acceleration(t)[:, :3] + np.array([0.0, 0.0, GRAVITY_MPS2]))

    def _attitude(self, t: F64) -> F64:
        """Return world_from_body (T, 4).

        First the heading, then the shortest rotation of the vertical onto the thrust.
        """
        thrust, yaw = self._thrust(t), self._curve(t)[:, 3]
        up = thrust / np.linalg.norm(thrust, axis=1, keepdims=True)
        tilt = np.stack([1.0 + up[:, 2], -up[:, 1], up[:, 0], np.zeros(len(up))], axis=1)
        tilt /= np.linalg.norm(tilt, axis=1, keepdims=True)
        zero = np.zeros(len(yaw))
        return _multiply(tilt, np.stack([np.cos(0.5 * yaw), zero, zero, np.sin(0.5 * yaw)], axis=1))


def _controls(start_yaw_rad: float, waypoints: list[Waypoint], rates: Rates) -> F64:
    """Return the control points (K, 5): position, heading, tilt of the gimbal."""
    at, yaw, pitch = np.zeros(3), start_yaw_rad, waypoints[0].pitch_down_rad
    rest = math.ceil((REST_S + SPIN_UP_S) / STEP_S) + 2 * _HALF_SUPPORT
    rows = [[*at, yaw, pitch]] * rest
    for number, leg in enumerate(waypoints):
        goal = np.array(leg.position_m)
        step_m = STEP_S * (CLIMB_MPS if number == 0 else rates.speed_mps)
        while (left_m := float(np.linalg.norm(goal - at))) > 1e-9:
            at = goal if left_m <= step_m else at + (goal - at) * (step_m / left_m)
            yaw = yaw + _limited(wrapped(leg.yaw_rad - yaw), rates.yaw_radps * STEP_S)
            pitch = pitch + _limited(leg.pitch_down_rad - pitch, rates.gimbal_radps * STEP_S)
            rows.append([*at, yaw, pitch])
    rows += [rows[-1]] * (math.ceil(END_S / STEP_S) + 2 * _HALF_SUPPORT)
    return np.array(rows)


def _limited(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


def _multiply(a: F64, b: F64) -> F64:
    """Return the Hamilton products (T, 4) of quaternions (T, 4)."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a.T, b.T
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=1,
    )


def _conjugate(q: F64) -> F64:
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def _rotate(q: F64, v: F64) -> F64:
    w, u = q[:, :1], q[:, 1:]
    t = 2.0 * np.cross(u, v)
    return np.asarray(v + w * t + np.cross(u, t))
