"""Turn track: the body's turn by a gyro, at any instants of the last half minute."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from uav_recon.localization.flow.sample_buffer import SampleBuffer
from uav_recon.types.frames import FloatArray

Turned = Callable[[float, float], FloatArray | None]  # from_s, to_s: rotation vector (3,) in body axes, None if it is not known

_STEP_S = 0.02  # of the track; between its instants the rate is constant
_KEPT = 1600  # instants: half a minute
_WAIT_S = 0.25  #: internal: the first gyro is waited for until it is late by this, then the second one is used


class TurnTrack:
    """Sums turns, as angles about the body's axes and as an attitude.

    first: the gyro that is preferred. second: in its place where it does not report.
    """

    def __init__(self, first: Turned, second: Turned) -> None:
        self._first = first
        self._second = second
        self._rows = SampleBuffer(_KEPT, 1 + 3 + 9)
        self._attitude = np.eye(3)
        self._angle_rad = np.zeros(3)
        self._first_works = True

    @property
    def newest_s(self) -> float:
        """The newest instant, -inf without one."""
        return self._rows.newest_s

    def extend(self, from_s: float, to_s: float) -> None:
        """Continue the track up to an instant, as far as the gyros report.

        from_s: where a new track begins. A time without any gyro ends the old one.
        """
        if math.isinf(self.newest_s) or to_s - self.newest_s > _KEPT * _STEP_S:
            self._begin(from_s)
        self._first_works = self._first_works or self._first(self.newest_s - _STEP_S, self.newest_s) is not None
        while (end_s := self.newest_s + _STEP_S) <= to_s:
            turn_rad = self._first(self.newest_s, end_s)
            if turn_rad is None and self._first_works and to_s - end_s < _WAIT_S:
                return
            if turn_rad is None:
                self._first_works = False
                turn_rad = self._second(self.newest_s, end_s)
            if turn_rad is None:
                self._begin(end_s)
                continue
            self._angle_rad = self._angle_rad + turn_rad
            self._attitude = self._attitude @ _rotation(*map(float, turn_rad))
            self._rows.append(end_s, *self._angle_rad, *self._attitude.ravel())

    @property
    def covered_s(self) -> tuple[float, float]:
        """First and last instant of the track; (inf, -inf) without one."""
        rows = self._rows.rows()
        return (float(rows[0, 0]), float(rows[-1, 0])) if len(rows) else (math.inf, -math.inf)

    def at(self, instants_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return sums of turns (N, 3) about the body's axes, and start_from_body (N, 3, 3).

        instants_s: (N,), covered by the track.
        """
        rows = self._rows.rows()
        before = np.clip(np.searchsorted(rows[:, 0], instants_s, side="right") - 1, 0, max(len(rows) - 2, 0))
        start, end = rows[before], rows[np.minimum(before + 1, len(rows) - 1)]
        share = np.clip((instants_s - start[:, 0]) / np.maximum(end[:, 0] - start[:, 0], 1e-9), 0.0, 1.0)[:, None]
        turned = share * (end[:, 1:4] - start[:, 1:4])
        small = np.zeros((len(before), 3, 3))
        small[:, (0, 1, 2), (0, 1, 2)] = 1.0
        small[:, (2, 0, 1), (1, 2, 0)] = turned
        small[:, (1, 2, 0), (2, 0, 1)] = -turned
        return start[:, 1:4] + turned, start[:, 4:].reshape(-1, 3, 3) @ small

    def _begin(self, from_s: float) -> None:
        self._rows.clear()
        self._rows.append(from_s, *self._angle_rad, *self._attitude.ravel())


def _rotation(x: float, y: float, z: float) -> FloatArray:
    """Return the rotation matrix (3, 3) of a rotation vector (Rodrigues).

    Pose costs three times as much.
    """
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    s, c = (math.sin(angle) / angle, (1.0 - math.cos(angle)) / square) if angle > 1e-6 else (1.0, 0.5)
    return np.array(
        [
            [1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
            [c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x],
            [c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)],
        ]
    )
