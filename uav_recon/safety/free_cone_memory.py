"""Memory of the space above that a range finder found empty a short time ago."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.safety.free_cone_rule import points_in_cones
from uav_recon.types.frames import FloatArray
from uav_recon.types.free_cone import FreeCone

_CONES = 160  #: internal: stored cones, spread over blind_memory_s


class FreeConeMemory:
    """The last free cones; empty without a range finder.

    before_m: what is nearer than this to the end of a cone does not count as free.
    """

    def __init__(self, memory_s: float, *, before_m: float) -> None:
        self._memory_s = memory_s
        self._before_m = before_m
        self._count = 0
        self._stamp_s = np.full(_CONES, -math.inf)
        self._apex_m = np.zeros((_CONES, 3))
        self._axis = np.zeros((_CONES, 3))
        self._cos = np.ones(_CONES)
        self._reach_m = np.zeros(_CONES)

    def add(self, cone: FreeCone) -> None:
        """Store a cone, unless the newest one is almost as new."""
        if cone.stamp_s - self._stamp_s[self._count % _CONES - 1] < self._memory_s / _CONES:
            return
        n = self._count % _CONES
        self._count = self._count + 1
        self._stamp_s[n] = cone.stamp_s
        self._apex_m[n], self._axis[n] = cone.apex_odom_m, cone.axis_odom
        self._cos[n], self._reach_m[n] = math.cos(cone.half_angle_rad), cone.reach_m - self._before_m

    def forget(self) -> None:
        """Forget all cones after a jump of odom."""
        self._stamp_s[:] = -math.inf

    def ages_s(self, places_m: FloatArray, now_s: float) -> FloatArray:
        """Return the ages (N,) of the newest cones around positions (N, 3); infinity for none."""
        fresh = np.flatnonzero(now_s - self._stamp_s <= self._memory_s)
        inside = points_in_cones(places_m, self._apex_m[fresh], self._axis[fresh], self._cos[fresh], self._reach_m[fresh])
        age_s = np.where(inside, (now_s - self._stamp_s[fresh])[:, None], math.inf)
        return np.asarray(age_s.min(axis=0, initial=math.inf))
