"""The outside world's own conversion between its ENU / FLU frames and the autopilot's NED / FRD frames.

Deliberately not shared with the product: a mistake there must show here.
"""

from __future__ import annotations

import math

from sitl.geometry.quaternion import Quat, Vec3, multiply

_H = math.sqrt(0.5)
# ned_from_enu exchanges the first two axes and negates the third: half a turn about (1, 1, 0) / sqrt(2).
_NED_FROM_ENU: Quat = (0.0, _H, _H, 0.0)
# flu_from_frd is half a turn about the first axis.
_FLU_FROM_FRD: Quat = (0.0, 1.0, 0.0, 0.0)


def ned_from_enu(v: Vec3) -> Vec3:
    """World vector, ENU to NED; the same exchange takes NED to ENU."""
    return (v[1], v[0], -v[2])


def frd_from_flu(v: Vec3) -> Vec3:
    """Body vector, FLU to FRD; the same exchange takes FRD to FLU."""
    return (v[0], -v[1], -v[2])


def ned_frd_from_enu_flu(enu_from_flu: Quat) -> Quat:
    """Attitude ned_from_frd of the body whose attitude is enu_from_flu, with a positive first element."""
    q = multiply(multiply(_NED_FROM_ENU, enu_from_flu), _FLU_FROM_FRD)
    return q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
