"""Simulated pose stream of a visual tracking system: slow drift, white noise and delay."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.geometry.quaternion import Quat, Vec3, from_small_rotation, multiply

RATE_HZ = 15.0
DRIFT_M = 0.01
DRIFT_RAD = math.radians(0.3)
DRIFT_TIME_S = 20.0
WHITE_M = 0.002
WHITE_RAD = math.radians(0.1)
DELAY_S = 0.060
DELAY_SPREAD_S = 0.020
DELAY_MIN_S = 0.010
F64 = NDArray[np.float64]
_DRIFT = np.repeat([DRIFT_M, DRIFT_RAD], 3)
_WHITE = np.repeat([WHITE_M, WHITE_RAD], 3)
_VARIANCE = np.repeat([DRIFT_M**2 + WHITE_M**2, DRIFT_RAD**2 + WHITE_RAD**2], 3)


@dataclass(frozen=True)
class PoseRecord:
    """One delivered pose odom_from_body.

    stamp_s: capture time. position_m (3,). quat_wxyz (4,). variance (6,): position in m², rotation in rad².
    """

    stamp_s: float
    position_m: F64
    quat_wxyz: F64
    variance: F64
    quality: int
    reset_counter: int


class SimulatedTracker:
    """Source of poses with drift and white noise, delivered 60 ± 20 ms after capture.

    The drift is an Ornstein-Uhlenbeck process with a time constant of 20 s; it is zero at the first pose.
    """

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 0x905E])
        self._drift: F64 = np.zeros(6)
        self._due_s: float | None = None
        self._last_s = 0.0
        self._last_arrival_s = -math.inf
        self._pending: deque[tuple[float, PoseRecord]] = deque()

    def due(self, now_s: float) -> bool:
        """Return True if step() would capture or deliver a pose now."""
        return self._due_s is None or now_s >= self._due_s - 1e-9 or bool(self._pending and self._pending[0][0] <= now_s)

    def step(self, now_s: float, position_m: Vec3, quat_wxyz: Quat) -> list[PoseRecord]:
        """Capture a pose if one is due, and return the poses delivered by now_s, oldest first.

        position_m and quat_wxyz (world_from_body) are the true pose at now_s. Does not block.
        Call it at 30 Hz or more: a pose is captured only inside a call.
        """
        if self._due_s is None or now_s >= self._due_s - 1e-9:
            self._capture(now_s, position_m, quat_wxyz)
            scheduled_s = now_s if self._due_s is None else self._due_s
            self._due_s = max(scheduled_s + 1.0 / RATE_HZ, now_s)
        arrived = []
        while self._pending and self._pending[0][0] <= now_s:
            arrived.append(self._pending.popleft()[1])
        return arrived

    def _capture(self, now_s: float, position_m: Vec3, quat_wxyz: Quat) -> None:
        if self._due_s is not None:
            keep = math.exp(-(now_s - self._last_s) / DRIFT_TIME_S)
            spread = _DRIFT * math.sqrt(1.0 - keep * keep)
            self._drift = keep * self._drift + spread * self._rng.standard_normal(6)
        self._last_s = now_s
        error = self._drift + _WHITE * self._rng.standard_normal(6)
        attitude = np.array(multiply(from_small_rotation(*error[3:].tolist()), quat_wxyz))
        record = PoseRecord(now_s, position_m + error[:3], attitude, _VARIANCE, 100, 0)
        delay_s = max(DELAY_S + DELAY_SPREAD_S * float(self._rng.standard_normal()), DELAY_MIN_S)
        self._last_arrival_s = max(self._last_arrival_s, now_s + delay_s)
        self._pending.append((self._last_arrival_s, record))
