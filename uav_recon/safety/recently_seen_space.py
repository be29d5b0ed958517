"""Memory of the space that was seen free a short time ago.

Outside the camera's view the vehicle may only fly through such space.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.safety.envelope import Vec3
from uav_recon.safety.free_cone_memory import FreeConeMemory
from uav_recon.safety.sight_speed_limit import longest_memory_s, memory_s
from uav_recon.types.frames import FloatArray
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.min_range_grid import MinRangeGrid, in_view
from uav_recon.types.pose import Pose

_VIEWS = 160  #: internal: stored views in each blind_memory_s, evenly spread: ten seconds of them at 15 Hz
_BEFORE_M = 0.05  #: refuse: a motion outside the view into space nearer to a seen return than this, which is range noise


class RecentlySeenSpace:
    """The last views with their cells' nearest returns, past positions of the hull, free cones.

    They are kept for as long as any motion may rely on them, see sight_speed_limit.memory_s().
    """

    def __init__(self, *, blind_memory_s: float, vehicle_radius_m: float) -> None:
        self.memory_s = blind_memory_s
        self.radius_m = vehicle_radius_m
        self.reach_m = vehicle_radius_m + _BEFORE_M  # from the body's centre to what the hull reaches next
        self._count = 0
        views = round(_VIEWS * longest_memory_s(blind_memory_s) / blind_memory_s)
        self._stamp_s = np.full(views, -math.inf)
        self._depth_from_odom = np.zeros((views, 3, 3))
        self._place_m = np.zeros((views, 3))
        self._body_m = np.full((views, 3), math.inf)
        self._range_m: FloatArray = np.zeros((views, 1, 1))
        self._half_tan = np.ones(2)
        self._cones = FreeConeMemory(blind_memory_s, before_m=_BEFORE_M)

    def add(self, nearby: MinRangeGrid, odom_from_body: Pose) -> None:
        """Store a frame taken from this pose."""
        if self._range_m.shape[1:] != nearby.range_m.shape:
            self._range_m = np.zeros((len(self._stamp_s), *nearby.range_m.shape))
            self._stamp_s[:] = -math.inf
        n = self._count % len(self._stamp_s)
        if nearby.stamp_s - self._stamp_s[n - 1] < self.memory_s / _VIEWS:
            return
        self._count = self._count + 1
        odom_from_depth = odom_from_body @ nearby.body_from_depth
        self._stamp_s[n] = nearby.stamp_s
        self._half_tan = np.array(nearby.half_tan)
        self._depth_from_odom[n], self._place_m[n] = odom_from_depth.rotation().T, odom_from_depth.translation_m
        self._body_m[n], self._range_m[n] = odom_from_body.translation_m, nearby.range_m

    def add_cone(self, cone: FreeCone) -> None:
        """Store what the upward range finder found empty."""
        self._cones.add(cone)

    def forget(self) -> None:
        """Forget all views after a jump of odom: none of them was seen in the new odom."""
        self._stamp_s[:] = -math.inf
        self._cones.forget()

    def saw_free(self, place_m: Vec3, now_s: float, direction: FloatArray | None = None) -> bool:
        """Return True if a view within the memory saw past this position, or the hull was there.

        direction: (3,) unit vector in odom of the motion that enters it, None = level.
        """
        within_s = self.memory_s if direction is None else float(memory_s(self.memory_s, direction))
        return bool(self.ages_s(np.array([place_m]), now_s, within_s)[0] <= within_s)

    def ages_s(self, places_m: FloatArray, now_s: float, within_s: float | None = None) -> FloatArray:
        """Return the ages (N,) of the newest views that saw past positions (N, 3) or were there.

        A free cone around a position counts as such a view. Infinity where none within the memory did, or within within_s.
        """
        fresh = np.flatnonzero(now_s - self._stamp_s <= (self.memory_s if within_s is None else within_s))
        off_m = places_m[None] - self._body_m[fresh, None]
        there = np.einsum("vni,vni->vn", off_m, off_m) <= self.radius_m**2
        seen = np.einsum("vij,vnj->vni", self._depth_from_odom[fresh], places_m[None] - self._place_m[fresh, None])
        inside, row, column = in_view(seen, self._half_tan, self._range_m.shape)
        view, n = np.nonzero(inside)
        nearest = self._range_m[fresh[view], row[view, n].astype(int), column[view, n].astype(int)]
        there[view, n] |= np.linalg.norm(seen[view, n], axis=1) <= nearest - _BEFORE_M
        age_s = np.where(there, (now_s - self._stamp_s[fresh])[:, None], math.inf)
        newest_s = np.minimum(age_s.min(axis=0, initial=math.inf), self._cones.ages_s(places_m, now_s))
        return np.asarray(np.maximum(newest_s, 0.0))
