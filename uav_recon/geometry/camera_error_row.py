"""Derivatives of measured points by the errors of a depth camera.

An apparent surface point p of a frame is off by

    e = tau (v + w x (p - c)) + R (phi x q) + s (p - c) + f R (qx, qy, 0) + R d        q = R^T (p - c)

with the camera's position c, rotation R, velocity v and turn rate w in the world at the stamp: the frame shows where the camera
was tau before its stamp, the mount is rotated by phi and moved by d, depth is too large by the share s, and the image too wide
by the share f.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray


@kernel
def error_row(
    normal: AnyArray, point: AnyArray, rotation: AnyArray, place: AnyArray, velocity: AnyArray, rate: AnyArray
) -> AnyArray:
    """Return the derivatives (9,) of a point's error along a normal.

    By delay, rotation (3), scale, width, offset (3).
    normal (3,), point (3,) in odom; rotation (3, 3), place (3,), velocity (3,), rate (3,) of the camera.
    """
    out = np.empty(9)
    x, y, z = point[0] - place[0], point[1] - place[1], point[2] - place[2]
    swept = (
        normal[0] * (velocity[0] + rate[1] * z - rate[2] * y)
        + normal[1] * (velocity[1] + rate[2] * x - rate[0] * z)
        + normal[2] * (velocity[2] + rate[0] * y - rate[1] * x)
    )
    q0 = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
    q1 = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
    q2 = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
    m0 = rotation[0, 0] * normal[0] + rotation[1, 0] * normal[1] + rotation[2, 0] * normal[2]
    m1 = rotation[0, 1] * normal[0] + rotation[1, 1] * normal[1] + rotation[2, 1] * normal[2]
    m2 = rotation[0, 2] * normal[0] + rotation[1, 2] * normal[1] + rotation[2, 2] * normal[2]
    out[0] = swept
    out[1], out[2], out[3] = q1 * m2 - q2 * m1, q2 * m0 - q0 * m2, q0 * m1 - q1 * m0
    out[4] = m0 * q0 + m1 * q1 + m2 * q2
    out[5] = m0 * q0 + m1 * q1
    out[6], out[7], out[8] = m0, m1, m2
    return out
