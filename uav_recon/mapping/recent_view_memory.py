"""Memory of the last views in the mission, for motion where the camera does not look.

The guard has a memory of its own and does not rely on this one.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry import min_range_binning
from uav_recon.geometry.min_range_binning import nearest_in_cells
from uav_recon.safety.obstacle_speed_limit import ForwardDepth
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import FloatArray
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import Pose
from uav_recon.types.recent_views import RecentViews

_SPACING_S = 0.35  # between stored views: the guard stores as many over a memory of 60 s
_SPACING_SHARE = 0.03  # of their age: between older views: where one saw, the next saw nearly the same


class RecentViewMemory:
    """Stores views of the last ``memory_s`` seconds: all of the last ten, fewer of those before.

    camera_body_m: (3,) position of the camera on the body.
    """

    def __init__(self, memory_s: float, camera_body_m: FloatArray) -> None:
        self._memory_s = memory_s
        self._camera_body_m = camera_body_m
        self._views: list[tuple[MinRangeGrid, Pose]] = []
        self._map_epoch = 0

    def add(self, posed: PosedFrame) -> RecentViews | None:
        """Store a frame; return all stored views, or None if it adds nothing."""
        if posed.map_epoch != self._map_epoch:
            self._views.clear()  # their poses do not fit the new map
            self._map_epoch = posed.map_epoch
        stamp_s = posed.frame.stamp_s
        if self._views and stamp_s - self._views[-1][0].stamp_s < _SPACING_S:
            return None
        nearby = nearest_in_cells(posed.frame, Pose.identity())
        if not ForwardDepth.has_enough_returns(nearby):
            return None
        if self._views and self._views[-1][0].range_m.shape != nearby.range_m.shape:
            self._views.clear()
        self._views.append((nearby, posed.world_from_depth))
        self._views = _thinned(self._views, stamp_s, self._memory_s)
        return self._all()

    def _all(self) -> RecentViews:
        rotation = np.array([pose.rotation() for _, pose in self._views])
        place = np.array([pose.translation_m for _, pose in self._views])
        heading = np.arctan2(rotation[:, 1, 2], rotation[:, 0, 2])  # of the optical axis
        x, y, z = self._camera_body_m
        offset = np.stack([np.cos(heading) * x - np.sin(heading) * y, np.sin(heading) * x + np.cos(heading) * y], axis=1)
        body = place - np.column_stack([offset, np.full(len(offset), z)])
        return RecentViews(
            stamp_s=np.array([nearby.stamp_s for nearby, _ in self._views]),
            depth_from_world=np.ascontiguousarray(rotation.transpose(0, 2, 1)),
            place_world=place,
            body_world=body,
            range_m=np.array([nearby.range_m for nearby, _ in self._views]),
            half_tan=np.array(self._views[-1][0].half_tan),
        )

    @staticmethod
    def warm_up() -> None:
        """Compile every kernel."""
        min_range_binning.warm_up()


def _thinned(views: list[tuple[MinRangeGrid, Pose]], now_s: float, memory_s: float) -> list[tuple[MinRangeGrid, Pose]]:
    """Return the views within the memory, farther apart the older they are."""
    kept: list[tuple[MinRangeGrid, Pose]] = []
    for n, one in enumerate(views):
        age_s = now_s - one[0].stamp_s
        newer_s = views[n + 1][0].stamp_s if n + 1 < len(views) else np.inf
        if age_s > memory_s or (kept and newer_s - kept[-1][0].stamp_s < _SPACING_SHARE * age_s):
            continue
        kept.append(one)
    return kept
