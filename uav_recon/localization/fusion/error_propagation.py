"""Error propagation between two poses: transition and process noise, as one kernel.

Over an interval dt with the rotated force integrals dv, dp (first order: Sola, Quaternion kinematics for the error-state
Kalman filter, 2017, section 7, with the global angular error):

    p' = p + v dt - [dp] a + [dp] R b dt / 3 + c dt^2 / 2        a' = a - R b dt
    v' = v - [dv] a + [dv] R b dt / 2 + c dt                      b' = b,  c' = S c

S is the turn of the body over the interval with an accelerometer, whose errors turn with the body, and 1 without.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.localization.fusion.imu_integration import Quaternion, Vector
from uav_recon.types.frames import FloatArray

# index of the first element of each in the error
_POSITION = 0
_VELOCITY = 3
_ATTITUDE = 6
_BIAS = 9
_OFFSET = 12


@kernel
def _matrix(q: Quaternion) -> FloatArray:
    """Return the rotation matrix (3, 3) of a unit quaternion."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@kernel
def dynamics(
    dt: float, accelerometer: bool, before: Quaternion, after: Quaternion, dp: Vector, dv: Vector, densities: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return the transition (15, 15) of the error and its process noise (15, 15).

    The noise is white acceleration and rate, and random walks of offset, bias and the source's drift.

    before, after: odom_from_body at both ends. densities: variances of acceleration, offset, rate, bias, position, attitude.
    """
    a, c, g, b, place, attitude = densities
    first, last = _matrix(before), _matrix(after)
    turned = 0.5 * (first + last)  # mean over the interval
    transition, walk = np.eye(15), np.zeros((15, 15))
    way = np.array([[0.0, -dp[2], dp[1]], [dp[2], 0.0, -dp[0]], [-dp[1], dp[0], 0.0]])
    push = np.array([[0.0, -dv[2], dv[1]], [dv[2], 0.0, -dv[0]], [-dv[1], dv[0], 0.0]])
    for i in range(3):
        p, v, r, w, o = _POSITION + i, _VELOCITY + i, _ATTITUDE + i, _BIAS + i, _OFFSET + i
        transition[p, v] = transition[v, o] = dt
        transition[p, o] = 0.5 * dt * dt
        walk[p, p] = a * dt**3 / 3 + c * dt**5 / 20 + place * dt
        walk[p, v] = walk[v, p] = a * dt**2 / 2 + c * dt**4 / 8
        walk[p, o] = walk[o, p] = c * dt**3 / 6
        walk[v, v] = a * dt + c * dt**3 / 3
        walk[v, o] = walk[o, v] = c * dt**2 / 2
        walk[o, o] = c * dt
        walk[r, r] = g * dt + b * dt**3 / 3 + attitude * dt
        walk[w, w] = b * dt
        for j in range(3):
            if accelerometer:
                transition[o, _OFFSET + j] = last[i, 0] * first[j, 0] + last[i, 1] * first[j, 1] + last[i, 2] * first[j, 2]
            transition[r, _BIAS + j] = -dt * turned[i, j]
            walk[r, _BIAS + j] = walk[_BIAS + j, r] = -b * dt**2 / 2 * turned[i, j]
            if accelerometer:  # without one the hover force is known in odom, for any attitude
                transition[p, _ATTITUDE + j], transition[v, _ATTITUDE + j] = -way[i, j], -push[i, j]
                for k in range(3):
                    transition[p, _BIAS + j] += dt / 3.0 * way[i, k] * turned[k, j]
                    transition[v, _BIAS + j] += dt / 2.0 * push[i, k] * turned[k, j]
    return transition, walk


def warm_up() -> None:
    """Compile every kernel."""
    identity, zero = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    dynamics(0.01, True, identity, identity, zero, zero, (0.0,) * 6)
