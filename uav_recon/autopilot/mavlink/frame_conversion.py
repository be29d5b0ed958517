"""Conversions between ENU/FLU inside and NED/FRD on the wire, used by the codec only.

Each is its own inverse. ned = (y, x, -z) of enu; frd = (x, -y, -z) of flu; both are proper rotations, so vectors, rotation
vectors and quaternions all follow from them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from uav_recon.types.frames import FloatArray

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]

NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_HALF = math.sqrt(0.5)
_SIX = np.kron(np.eye(2), NED_FROM_ENU)


def swap_world(vector: Iterable[float]) -> Vec3:
    """Convert ENU (3,) to NED, or NED to ENU."""
    x, y, z = vector
    return (float(y), float(x), -float(z))


def swap_body(vector: Iterable[float]) -> Vec3:
    """Convert FLU (3,) to FRD, or FRD to FLU."""
    x, y, z = vector
    return (float(x), -float(y), -float(z))


def swap_attitude(quat_wxyz: Iterable[float]) -> Quat:
    """Convert ENU-from-FLU to NED-from-FRD, or back.

    (0,s,s,0) q (0,1,0,0) with s = sqrt(1/2), up to the sign of the whole.
    """
    w, x, y, z = map(float, quat_wxyz)
    return (_HALF * (w + z), _HALF * (x + y), _HALF * (x - y), _HALF * (w - z))


def swap_yaw(yaw_rad: float) -> float:
    """Convert heading counter-clockwise from east to heading clockwise from north, or back.

    The result is in [-pi, pi].
    """
    return math.remainder(math.pi / 2 - yaw_rad, math.tau)


def swap_covariance(covariance: FloatArray) -> FloatArray:
    """Convert a covariance (6, 6) from ENU to NED, or back.

    Position and rotation vector, both in world axes.
    """
    swapped: FloatArray = _SIX @ covariance @ _SIX.T
    return swapped
