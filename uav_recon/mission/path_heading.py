"""Where the nose points on a way that is not flown to look at anything: ahead, so that depth sees what has come into it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.tasks import ViewPath, Viewpoint

AHEAD_M = 0.5  # so far ahead lies the place that the nose points at
OFF_RAD = math.radians(25.0)  # that far off it may be: half of what the camera sees, less the hull's own width


def yaw_along_path(path: ViewPath, yaw_rad: float) -> ViewPath:
    """The same way of one leg, begun with a heading of yaw_rad: wherever that is too far off, the vehicle turns on the spot.

    What is steeper than it is wide, and the last AHEAD_M, keep the heading that they are reached with. The views of the answer
    are turns, to be passed and not to be captured.
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
    """Of the first place of a way (N, 3) that is AHEAD_M away; None for none, or for one that is rather above or below."""
    ahead = way[1:] - way[0]
    far = np.flatnonzero(np.linalg.norm(ahead, axis=1) >= AHEAD_M)
    if not len(far):
        return None
    east_m, north_m, up_m = ahead[far[0]].tolist()
    return math.atan2(north_m, east_m) if math.hypot(east_m, north_m) > abs(up_m) else None
