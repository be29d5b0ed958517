"""Camera aiming: the yaw and pitch that show most of the visible directions from a position."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.planning.camera_frustum import PITCH_MAX, PITCH_MIN, TAN_H, TAN_V
from uav_recon.types.frames import Float32Array, FloatArray

YAW_STEPS = 24  # headings tried over the full circle ...
FINE_YAW_STEPS = 4  # ... and on each side of the best one
PITCH_STEPS = 3  # pitches tried on each side ...
PITCH_STEP_RAD = np.radians(10.0)  # ... and their spacing


@kernel
def count_in_frustum(lens: FloatArray, directions: Float32Array, count: int, yaw: float, pitch: float) -> int:
    """Return how many of the first ``count`` directions (3, N) lie inside the frustum."""
    cy, sy, cp, sp = np.float32(np.cos(yaw)), np.float32(np.sin(yaw)), np.float32(np.cos(pitch)), np.float32(np.sin(pitch))
    tan_h, tan_v, zero = np.float32(lens[TAN_H]), np.float32(lens[TAN_V]), np.float32(0.0)
    xs, ys, zs = directions[0], directions[1], directions[2]
    shown = np.int32(0)  # as wide as the other operands, so that the loop is vectorized
    for n in range(count):
        along, left = cy * xs[n] + sy * ys[n], cy * ys[n] - sy * xs[n]
        forward, up = cp * along - sp * zs[n], sp * along + cp * zs[n]
        shown += np.int32((forward > zero) & (abs(left) <= forward * tan_h) & (abs(up) <= forward * tan_v))
    return int(shown)


@kernel
def best_aim(lens: FloatArray, directions: Float32Array, count: int, yaw: float, pitch: float) -> tuple[int, float, float]:  # noqa: C901
    """Return the max. number of directions in one view, and yaw and pitch of that view.

    The directions are the first ``count`` of ``directions`` (3, N). The given angles are used if they show all. Otherwise the
    mean direction is tried, then headings over the full circle and pitches within the range of the mount, first coarse and
    then fine.
    """
    most = count_in_frustum(lens, directions, count, yaw, pitch)
    if most == count:
        return most, yaw, pitch
    x, y, z = 0.0, 0.0, 0.0
    for n in range(count):
        dx, dy, dz = float(directions[0, n]), float(directions[1, n]), float(directions[2, n])
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        x, y, z = x + dx / length, y + dy / length, z + dz / length
    mean_yaw = np.arctan2(y, x)
    mean_pitch = min(max(np.arctan2(-z, np.sqrt(x * x + y * y)), lens[PITCH_MIN]), lens[PITCH_MAX])
    shown = count_in_frustum(lens, directions, count, mean_yaw, mean_pitch)
    if shown > most:
        most, yaw, pitch = shown, mean_yaw, mean_pitch
    if most == count:
        return most, yaw, pitch
    for fine in range(2):
        base = yaw
        for n in range(2 * FINE_YAW_STEPS + 1 if fine else YAW_STEPS):
            step = (n - FINE_YAW_STEPS) * (np.pi / YAW_STEPS / FINE_YAW_STEPS) if fine else n * (2 * np.pi / YAW_STEPS)
            tried = base + step
            shown = count_in_frustum(lens, directions, count, tried, pitch)
            if shown > most:
                most, yaw = shown, tried
        base = pitch
        if lens[PITCH_MAX] > lens[PITCH_MIN]:
            for n in range(-PITCH_STEPS, PITCH_STEPS + 1):
                tried = min(max(base + n * PITCH_STEP_RAD / (1 + 3 * fine), lens[PITCH_MIN]), lens[PITCH_MAX])
                shown = count_in_frustum(lens, directions, count, yaw, tried)
                if shown > most:
                    most, pitch = shown, tried
    return most, np.arctan2(np.sin(yaw), np.cos(yaw)), pitch
