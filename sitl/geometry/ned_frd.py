"""Conversion between the simulator's ENU / FLU frames and the autopilot's NED / FRD frames.

Not shared with the product on purpose: a mistake in the product's conversion then becomes visible in simulation.
"""

from __future__ import annotations

import math

from sitl.geometry.quaternion import Quat, Vec3, multiply

_H = math.sqrt(0.5)
# ned_from_enu exchanges the first two axes and negates the third: a rotation by pi about (1, 1, 0) / sqrt(2).
_NED_FROM_ENU: Quat = (0.0, _H, _H, 0.0)
# flu_from_frd is a rotation by pi about the first axis.
_FLU_FROM_FRD: Quat = (0.0, 1.0, 0.0, 0.0)


def ned_from_enu(v: Vec3) -> Vec3:
    """Convert a world vector from ENU to NED; the same function converts NED to ENU."""
    return (v[1], v[0], -v[2])


def frd_from_flu(v: Vec3) -> Vec3:
    """Convert a body vector from FLU to FRD; the same function converts FRD to FLU."""
    return (v[0], -v[1], -v[2])


def ned_frd_from_enu_flu(enu_from_flu: Quat) -> Quat:
    """Return the attitude ned_from_frd of enu_from_flu, with a non-negative first element."""
    q = multiply(multiply(_NED_FROM_ENU, enu_from_flu), _FLU_FROM_FRD)
    return q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
