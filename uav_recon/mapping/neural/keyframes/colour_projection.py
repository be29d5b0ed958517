"""Projection of depth points to the colour image of a moving rolling shutter.

A row is exposed dt after depth, with the share r of the rows between it and the middle one:

    dt = delay + readout * r        q' = q - dt (v + w x q)        s = turn(phi)^T (R q' + t - d)

with the point q, velocity v and turn rate w of the depth imager in its own axes, and the nominal pose R, t of that imager in
the colour imager. The true colour imager is rotated by phi and moved by d against the nominal one, and its focal lengths are
1 + width times the nominal ones. Errors (9,): delay, readout, phi (3), width, d (3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.neural.keyframes.ray_records import BEARING_UNIT, DEPTH_UNIT_M
from uav_recon.types.frames import AnyArray, ByteArray, FloatArray

NEAREST_M = 0.05  # along the axis of the colour imager


class ColourImager(NamedTuple):
    """Nominal colour imager, and how it moves.

    lens (4,): fx, fy, cx, cy; rotation (3, 3) and offset (3,): pose of the depth imager in it; speed (3,) and rate (3,): of the
    depth imager, in its own axes.
    """

    lens: FloatArray
    rotation: FloatArray
    offset: FloatArray
    speed: FloatArray
    rate: FloatArray


@kernel
def turned(errors: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) of nominal axes to those of the true imager."""
    a, b, c = errors[2], errors[3], errors[4]
    angle = np.sqrt(a * a + b * b + c * c)
    s = np.sin(angle) / angle if angle > 1e-9 else 1.0
    k = (1.0 - np.cos(angle)) / (angle * angle) if angle > 1e-9 else 0.5
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - k * (b * b + c * c), k * a * b + s * c, k * a * c - s * b
    out[1, 0], out[1, 1], out[1, 2] = k * a * b - s * c, 1.0 - k * (a * a + c * c), k * b * c + s * a
    out[2, 0], out[2, 1], out[2, 2] = k * a * c + s * b, k * b * c - s * a, 1.0 - k * (a * a + b * b)
    return out


@kernel
def project(q: FloatArray, imager: ColourImager, turn: FloatArray, errors: FloatArray, height: int, out: FloatArray) -> None:
    """Compute where an image of a height sees a point q (3,) of the depth imager.

    turn (3, 3): turned(errors). out (9,): column, row, share of the rows from the middle one, the point in the axes of the
    imager (3,), and its velocity there (3,).
    """
    rotation, offset, speed, rate = imager.rotation, imager.offset, imager.speed, imager.rate
    a = -(speed[0] + rate[1] * q[2] - rate[2] * q[1])
    b = -(speed[1] + rate[2] * q[0] - rate[0] * q[2])
    c = -(speed[2] + rate[0] * q[1] - rate[1] * q[0])
    row = 0.0
    for _ in range(2):  # the row gives the instant, and the instant the row
        dt = errors[0] + errors[1] * row
        x, y, z = q[0] + dt * a, q[1] + dt * b, q[2] + dt * c
        s0 = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + offset[0] - errors[6]
        s1 = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + offset[1] - errors[7]
        s2 = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + offset[2] - errors[8]
        for i in range(3):
            out[3 + i] = turn[i, 0] * s0 + turn[i, 1] * s1 + turn[i, 2] * s2
        depth_m = max(out[5], 1e-3)
        out[0] = (1.0 + errors[5]) * imager.lens[0] * out[3] / depth_m + imager.lens[2]
        out[1] = (1.0 + errors[5]) * imager.lens[1] * out[4] / depth_m + imager.lens[3]
        row = min(max((out[1] + 0.5) / height - 0.5, -0.5), 0.5)
    out[2] = row
    for i in range(3):
        out[6 + i] = rotation[i, 0] * a + rotation[i, 1] * b + rotation[i, 2] * c


@kernel
def paint(records: AnyArray, stretch: AnyArray, rgb: ByteArray, imager: ColourImager, errors: FloatArray) -> None:
    """Give rays (N, COLUMNS) the colours of an image (h, w, 3) where it sees their ends.

    stretch (2,): see ray_sampling.Views.
    """
    height, width = rgb.shape[:2]
    q, at, turn = np.empty(3), np.empty(9), turned(errors)
    wider, deeper = stretch[0] * BEARING_UNIT, stretch[1] * DEPTH_UNIT_M
    for n in range(records.shape[0]):
        record = records[n]
        record[6:10] = 0
        q[2] = record[2] * deeper
        q[0], q[1] = record[0] * wider * q[2], record[1] * wider * q[2]
        project(q, imager, turn, errors, height, at)
        u, v = at[0], at[1]
        if at[5] < NEAREST_M or not (u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1):
            continue
        i, j = int(v), int(u)
        s, t = v - i, u - j
        for channel in range(3):
            top = (1 - t) * rgb[i, j, channel] + t * rgb[i, j + 1, channel]
            low = (1 - t) * rgb[i + 1, j, channel] + t * rgb[i + 1, j + 1, channel]
            record[6 + channel] = round((1 - s) * top + s * low)
        record[9] = 1
