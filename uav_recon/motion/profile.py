"""The way as nodes, the fastest pass over them, and turns of an angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, FloatArray, IntArray

NODE_M = 0.02  # spacing of the nodes that carry speed limits
CREEP_MPS = 0.01  # stands for a stop, so that every node is passed in finite time


@kernel
def pass_times(limit: AnyArray, along_m: AnyArray, acceleration: float, speed: AnyArray, times: AnyArray) -> None:
    """Fastest speed and time at each node under speed limits and one bound on acceleration; starts and ends creeping."""
    last = len(limit) - 1
    for i in range(last + 1):
        speed[i] = limit[i] if 0 < i < last else min(limit[i], CREEP_MPS)
    for i in range(1, last + 1):
        gain = 2.0 * acceleration * (along_m[i] - along_m[i - 1])
        speed[i] = min(speed[i], np.sqrt(speed[i - 1] ** 2 + gain))
    for i in range(last - 1, -1, -1):
        gain = 2.0 * acceleration * (along_m[i + 1] - along_m[i])
        speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + gain))
    times[0] = 0.0
    for i in range(1, last + 1):
        times[i] = times[i - 1] + 2.0 * (along_m[i] - along_m[i - 1]) / (speed[i] + speed[i - 1])


@kernel
def along_at(step_s: float, along_m: AnyArray, speed: AnyArray, arrive_s: AnyArray, leave_s: AnyArray, out: AnyArray) -> None:
    """Arc length at each sample: constant acceleration between nodes, standing between arrival and leaving."""
    cell = 0
    last = len(along_m) - 1
    for n in range(len(out)):
        now_s = n * step_s
        while cell < last and now_s >= arrive_s[cell + 1]:
            cell += 1
        into_s = now_s - leave_s[cell]
        out[n] = along_m[cell]
        if cell < last and into_s > 0.0:
            rise = (speed[cell + 1] - speed[cell]) / (arrive_s[cell + 1] - leave_s[cell])
            out[n] = min(along_m[cell] + into_s * (speed[cell] + 0.5 * rise * into_s), along_m[cell + 1])


@dataclass(frozen=True, slots=True)
class Turn:
    """A rest-to-rest change of an angle under bounds on rate and acceleration."""

    angle_rad: float
    rate: float
    acceleration: float

    @property
    def peak(self) -> float:
        """Highest rate reached."""
        return min(self.rate, float(np.sqrt(abs(self.angle_rad) * self.acceleration)))

    @property
    def duration_s(self) -> float:
        """Seconds from rest to rest (trapezoid of rate, or triangle for a small angle)."""
        return abs(self.angle_rad) / self.peak + self.peak / self.acceleration if self.angle_rad else 0.0

    def at(self, since_s: FloatArray) -> FloatArray:
        """Angle turned after so many seconds (N,)."""
        rise_s = self.peak / self.acceleration
        rising = np.clip(since_s, 0.0, rise_s)
        cruising = np.clip(since_s - rise_s, 0.0, max(self.duration_s - 2 * rise_s, 0.0))
        falling = np.clip(since_s - (self.duration_s - rise_s), 0.0, rise_s)
        turned = 0.5 * self.acceleration * (rising**2 - falling**2) + self.peak * (cruising + falling)
        return np.asarray(np.sign(self.angle_rad) * turned, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A polyline as nodes: position (M, 3), arc length (M,), which nodes are its inner corners, and which end each leg."""

    position_m: FloatArray
    along_m: FloatArray
    corners: IntArray
    ends: IntArray

    @staticmethod
    def through(start_m: FloatArray, legs: Sequence[FloatArray]) -> Line:
        """Nodes every NODE_M at most, each corner a node; doubled points are dropped."""
        pieces, corners, ends, here, count = [start_m[None]], [], [], start_m, 1
        for leg in legs:
            for point in leg:
                length_m = float(np.linalg.norm(point - here))
                if length_m < 1e-6:
                    continue
                share = np.linspace(0.0, 1.0, int(np.ceil(length_m / NODE_M)) + 1)[1:, None]
                pieces.append(here + share * (point - here))
                count += len(share)
                here = point
                corners.append(count - 1)
            ends.append(count - 1)
        position_m = np.concatenate(pieces)
        steps_m = np.linalg.norm(np.diff(position_m, axis=0), axis=1)
        along_m = np.concatenate(([0.0], np.cumsum(steps_m)))
        return Line(position_m, along_m, np.array(corners[:-1], dtype=np.int64), np.array(ends, dtype=np.int64))
