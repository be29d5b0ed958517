"""Quaternion algebra on tuples of floats.

Quaternions are Hamilton, wxyz; `a_from_b` rotates the coordinates of a vector from b into a. Tuples are used because
the physics step runs at 250 Hz, where the overhead of tiny arrays exceeds the arithmetic.
"""

from __future__ import annotations

import math

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]

IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)


def multiply(a: Quat, b: Quat) -> Quat:
    """Return the Hamilton product a b: the rotation b followed by a."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q: Quat) -> Quat:
    """Return the conjugate, which is the inverse of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def normalised(q: Quat) -> Quat:
    """Scale to unit length. Raises ZeroDivisionError for the zero quaternion."""
    w, x, y, z = q
    s = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return (w * s, x * s, y * s, z * s)


def rotate(q: Quat, v: Vec3) -> Vec3:
    """Return the coordinates of v in frame a, for q = a_from_b and v given in frame b."""
    w, x, y, z = q
    vx, vy, vz = v
    tx = 2.0 * (y * vz - z * vy)
    ty = 2.0 * (z * vx - x * vz)
    tz = 2.0 * (x * vy - y * vx)
    return (vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx)


def from_small_rotation(x: float, y: float, z: float) -> Quat:
    """Return the quaternion of a rotation vector, rad.

    Exact to third order; meant for one time step (below 0.2 rad).
    """
    half = 0.5 - (x * x + y * y + z * z) / 48.0
    w = 1.0 - (x * x + y * y + z * z) / 8.0
    return normalised((w, x * half, y * half, z * half))


def small_rotation(q: Quat) -> Vec3:
    """Return the rotation vector, rad, of a quaternion near identity; exact to second order."""
    s = 2.0 if q[0] >= 0.0 else -2.0
    return (s * q[1], s * q[2], s * q[3])


def from_yaw(yaw_rad: float) -> Quat:
    """Return the rotation by yaw_rad about the third axis."""
    return (math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad))


def yaw_of(q: Quat) -> float:
    """Return the heading of the first body axis in the horizontal plane, rad in (-pi, pi]."""
    w, x, y, z = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quat:
    """Return the attitude of yaw, then pitch, then roll, rad; the inverse of euler_of()."""
    pitch = (math.cos(0.5 * pitch_rad), 0.0, math.sin(0.5 * pitch_rad), 0.0)
    roll = (math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad), 0.0, 0.0)
    return multiply(multiply(from_yaw(yaw_rad), pitch), roll)


def euler_of(q: Quat) -> Vec3:
    """Return roll, pitch and yaw (intrinsic z-y-x), rad."""
    w, x, y, z = q
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    return (roll, pitch, yaw_of(q))


def wrapped(angle_rad: float) -> float:
    """Return the equivalent angle in [-pi, pi), rad."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
