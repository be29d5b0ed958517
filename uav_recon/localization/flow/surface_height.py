"""Surface height: height of the body above what is below it, from a range finder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import BoolArray, FloatArray

_STEP_M = 0.08  #: reject: a change of height between two ranges larger than this, and than the climb in between: an edge below
_CLIMB_MPS = 1.0  #: reject: the same, faster than this: the vehicle climbs and descends at 0.7 m/s at most
_APART_S = 0.3  #: reject: optical flow between two ranges that are farther apart in time
_AROUND_S = 0.25  #: reject: a climb by ranges with a step within this time around it
_BESIDE_S = 0.15  #: reject: optical flow farther in time from the first or the last range


@dataclass(frozen=True, slots=True)
class SurfaceHeight:
    """Heights of the body's origin over the surfaces below, at the instants of ranges.

    stamps_s, heights_m: (M,). steps: (M,), True where the surface below is another one than at the range before.
    """

    stamps_s: FloatArray
    heights_m: FloatArray
    steps: BoolArray

    @staticmethod
    def of(
        stamps_s: FloatArray, ranges_m: FloatArray, odom_from_body: FloatArray, position_body_m: FloatArray
    ) -> SurfaceHeight:
        """Return the heights of ranges (M,) along the body's z axis, over surfaces that are level.

        odom_from_body: rotations (M, 3, 3). position_body_m: (3,), of the range finder.
        """
        up_body = odom_from_body[:, 2, :]
        heights_m = ranges_m * up_body[:, 2] - up_body @ position_body_m
        change_m, apart_s = np.diff(heights_m, prepend=heights_m[:1]), np.diff(stamps_s, prepend=stamps_s[:1])
        steps = np.abs(change_m) > _STEP_M + _CLIMB_MPS * apart_s
        return SurfaceHeight(stamps_s, heights_m, steps)

    def at(self, instants_s: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return heights (N,) at instants (N,), and where they are known (N,)."""
        if not len(self.stamps_s):
            return np.ones(len(instants_s)), np.zeros(len(instants_s), dtype=bool)
        after = np.searchsorted(self.stamps_s, instants_s)
        last = len(self.stamps_s) - 1
        earlier_s, later_s = self.stamps_s[np.clip(after - 1, 0, last)], self.stamps_s[np.clip(after, 0, last)]
        inside = (after > 0) & (after <= last)
        beside = np.minimum(np.abs(instants_s - earlier_s), np.abs(instants_s - later_s)) <= _BESIDE_S
        known = np.where(inside, later_s - earlier_s <= _APART_S, beside)
        return np.interp(instants_s, self.stamps_s, self.heights_m), known

    def step_times_s(self) -> FloatArray:
        """Return the instants (K,) in the middle of each step."""
        (at,) = np.nonzero(self.steps)
        return np.asarray((self.stamps_s[at] + self.stamps_s[at - 1]) / 2.0)

    def step_sizes(self) -> FloatArray:
        """Return the size (K,) of each step as a share of the larger height."""
        (at,) = np.nonzero(self.steps)
        before, after = self.heights_m[at - 1], self.heights_m[at]
        return np.asarray(np.abs(after - before) / np.maximum(np.maximum(before, after), 1e-3))

    def climb_m(self, from_s: float, to_s: float) -> float | None:
        """Return the change of height between two instants.

        None if it is not known, or if there is a step near them.
        """
        both, steps_s = np.array([from_s, to_s]), self.step_times_s()
        if np.any((steps_s > from_s - _AROUND_S) & (steps_s < to_s + _AROUND_S)) or not self.at(both)[1].all():
            return None
        start_m, end_m = np.interp(both, self.stamps_s, self.heights_m)
        return float(end_m - start_m)
