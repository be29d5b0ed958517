"""Heading on a path without views: nose first, so that depth sees obstacles in the path."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.tasks import ViewPath, Viewpoint

AHEAD_M = 0.5  #: plan: distance of the position ahead on the way home that the nose points at
#: plan: turns on the way home where the nose is farther off: half of the camera's view, less the hull's own width
OFF_RAD = math.radians(25.0)


def yaw_along_path(path: ViewPath, yaw_rad: float) -> ViewPath:
    """Return the path of one leg with turns on the spot where the heading is too far off.

    yaw_rad: heading at its start. Parts that are steeper than wide, and the last AHEAD_M, keep the heading with which they are
    reached. The views of the result are turns, which are passed and not captured.
    """
    (way,), (goal,) = path.waypoints_world, path.viewpoints
    legs, views, begin = list[FloatArray](), list[Viewpoint](), 0
    for k in range(len(way) - 1):
        bearing_rad = _bearing(way[k:])
        if bearing_rad is None or abs(math.remainder(bearing_rad - yaw_rad, math.tau)) <= OFF_RAD:
            continue
        if k > 0:
            legs.append(way[begin : k + 1])
            views.append(Viewpoint(way[k], yaw_rad, goal.pitch_down_rad))
        legs.append(way[k : k + 1])
        views.append(Viewpoint(way[k], bearing_rad, goal.pitch_down_rad))
        yaw_rad, begin = bearing_rad, k
    last = Viewpoint(goal.position_world, yaw_rad, goal.pitch_down_rad)
    return dataclasses.replace(path, viewpoints=(*views, last), waypoints_world=(*legs, way[begin:]))


def _bearing(way: FloatArray) -> float | None:
    """Return the bearing of the first position of a path (N, 3) that is AHEAD_M away.

    None if there is none, or if it is rather above or below.
    """
    ahead = way[1:] - way[0]
    far = np.flatnonzero(np.linalg.norm(ahead, axis=1) >= AHEAD_M)
    if not len(far):
        return None
    east_m, north_m, up_m = ahead[far[0]].tolist()
    return math.atan2(north_m, east_m) if math.hypot(east_m, north_m) > abs(up_m) else None
