"""Comparison of two tracks of one body over windows: ways that only one of them has."""

from __future__ import annotations

import itertools
import math
from collections import deque
from typing import NamedTuple

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

#: reject: windows (s), and the difference (m) of the ways over them that no two honest tracks have
_LIMITS = ((0.3, 0.03), (1.0, 0.06))
#: reject: the same for a slow drift; honest tracks differ by up to 0.21 m, one that drifts by 0.05 m/s by 0.4 m
_DRIFT_WINDOW_S = 8.0
_DRIFT_LIMIT_M = 0.30
_SHOWN_ALWAYS_SHARE = 0.6  #: internal: share of every position of such a window that was measured
_SIGMAS = 4.0  #: reject: the same, but never within this many standard deviations of the white noise of both
_GAP_S = 0.25  #: internal: a track is interpolated between poses that are not farther apart
_SHOWN_SHARE = 0.75  #: internal: share of a position that a pose has measured itself, from which on a direction is compared
_MOST_POSES = 256  #: internal: poses of each track that wait for the other one
_LEAST_NOISE_M = 0.003
_NOISE_MEMORY = 0.05  # share of the newest pair in the mean of the squared noise


class _Pair(NamedTuple):
    """Both tracks at one instant.

    shown (3, 3): see MotionComparison.add_second. least_shown: in its worst direction.
    """

    stamp_s: float
    first: Pose
    second: Pose
    shown: FloatArray
    least_shown: float


class MotionComparison:
    """Compares two tracks at the instants of the second. Not thread-safe.

    ``excess``: difference of the ways as a multiple of its limit, the largest of the short windows. ``drift_excess``: the same
    of the long window; NaN unless the second track has measured itself in every direction all the time.
    """

    def __init__(self) -> None:
        self.excess, self.drift_excess = 0.0, math.nan
        self.compared_s = -np.inf
        self._first: deque[tuple[float, Pose]] = deque(maxlen=_MOST_POSES)
        self._second: deque[tuple[float, Pose, FloatArray]] = deque(maxlen=_MOST_POSES)
        self._pairs: deque[_Pair] = deque()
        self._noise_m2 = _LEAST_NOISE_M**2
        self._paired_s = -np.inf  # newest instant of the second track that was taken out

    def forget(self) -> None:
        """Forget both tracks."""
        self._first.clear()
        self._second.clear()
        self._pairs.clear()
        self.excess, self.drift_excess = 0.0, math.nan

    def add_first(self, stamp_s: float, pose: Pose) -> bool:
        """Add a pose of the first track. Return True if something new was compared."""
        if self._first and stamp_s <= self._first[-1][0]:
            return False
        self._first.append((stamp_s, pose))
        return self._pair()

    def add_second(self, stamp_s: float, pose: Pose, shown: FloatArray) -> bool:
        """Add a pose of the second track. Return True if something new was compared.

        shown (3, 3): share of its position, in its axes, that the pose has measured itself.
        """
        newest_s = self._second[-1][0] if self._second else self._paired_s
        if stamp_s <= newest_s:
            return False
        self._second.append((stamp_s, pose, shown))
        return self._pair()

    def _pair(self) -> bool:
        """Pair what both tracks have reached; returns whether there is something new."""
        found = False
        while self._second and self._first and self._second[0][0] <= self._first[-1][0]:
            stamp_s, second, shown = self._second.popleft()
            self._paired_s = stamp_s
            first = self._first_at(stamp_s)
            if first is not None:
                self._pairs.append(_Pair(stamp_s, first, second, shown, float(np.linalg.eigvalsh(shown + shown.T)[0]) / 2.0))
                found = True
        while len(self._first) > 2 and self._pairs and self._first[1][0] < self._pairs[-1].stamp_s:
            self._first.popleft()
        while self._pairs and self._pairs[-1].stamp_s - self._pairs[0].stamp_s > _DRIFT_WINDOW_S + 1e-6:
            self._pairs.popleft()
        if found:
            self._compare()
        return found

    def _first_at(self, stamp_s: float) -> Pose | None:
        """Return the first track at an instant; None in a gap."""
        for (before_s, before), (after_s, after) in itertools.pairwise(self._first):
            if before_s <= stamp_s <= after_s:
                if after_s - before_s > _GAP_S:
                    return None
                share = (stamp_s - before_s) / (after_s - before_s)
                between = (before.inverse() @ after).rotation_vector()
                turned = before @ Pose.from_rotation_vector(share * between, np.zeros(3))
                place_m = before.translation_m + share * (after.translation_m - before.translation_m)
                return Pose(turned.quat_wxyz, place_m)
        return None

    def _compare(self) -> None:
        newest = self._pairs[-1]
        self.compared_s = newest.stamp_s
        if len(self._pairs) >= 3:
            self._learn_noise(self._pairs[-3], self._pairs[-2], newest)
        self.excess = max(self._excess(window_s, limit_m, _SHOWN_SHARE) for window_s, limit_m in _LIMITS)
        always = all(pair.least_shown >= _SHOWN_ALWAYS_SHARE for pair in self._pairs)
        whole = newest.stamp_s - self._pairs[0].stamp_s >= 0.5 * _DRIFT_WINDOW_S
        known = always and whole
        self.drift_excess = self._excess(_DRIFT_WINDOW_S, _DRIFT_LIMIT_M, _SHOWN_ALWAYS_SHARE**2) if known else math.nan

    def _learn_noise(self, before: _Pair, here: _Pair, after: _Pair) -> None:
        """Learn the white noise from three pairs: what is left after the velocity."""
        a_m, b_m, c_m = (_apart_m(pair, here) for pair in (before, here, after))
        second_m2 = float(np.sum((a_m - 2.0 * b_m + c_m) ** 2)) / 18.0  # six variances, three axes
        share = _NOISE_MEMORY if second_m2 < 25.0 * self._noise_m2 else 0.1 * _NOISE_MEMORY
        self._noise_m2 = max(
            self._noise_m2 + share * (min(second_m2, 25.0 * self._noise_m2) - self._noise_m2), _LEAST_NOISE_M**2
        )

    def _excess(self, window_s: float, limit_m: float, shown_share: float) -> float:
        newest = self._pairs[-1]
        seen = [pair for pair in self._pairs if newest.stamp_s - pair.stamp_s <= window_s + 1e-6]
        first = seen[0]
        if newest.stamp_s - first.stamp_s < 0.5 * window_s:
            return 0.0
        off_m = _apart_m(newest, first) - _apart_m(first, first)
        shown = first.shown @ newest.shown
        values, directions = np.linalg.eigh(0.5 * (shown + shown.T))
        kept = directions[:, values > shown_share]
        along_m = float(np.linalg.norm(kept.T @ (_second_from_first(first) @ off_m)))
        return along_m / max(limit_m, _SIGMAS * float(np.sqrt(2.0 * self._noise_m2)))


def _second_from_first(pair: _Pair) -> FloatArray:
    """Return the rotation (3, 3) from the first track's axes to those of the second."""
    return pair.second.rotation() @ pair.first.rotation().T


def _apart_m(pair: _Pair, at: _Pair) -> FloatArray:
    """Return the first track's place (3,) less that of the second.

    at: pair that gives the first track's axes.
    """
    return pair.first.translation_m - _second_from_first(at).T @ pair.second.translation_m
