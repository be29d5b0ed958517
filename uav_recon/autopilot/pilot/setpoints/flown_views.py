"""Flown views: the way back with the headings of the flight, while the place is uncertain.

A camera before a bare wall does not know where it moves along it. It knows what it saw before.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from uav_recon.autopilot.pilot.setpoints.breadcrumb_retreat import IDENTIFIER, STEP_S, smoothed
from uav_recon.types.pose import Pose
from uav_recon.types.trajectory import Setpoint, Trajectory

_APART_M = 0.05  #: internal: distance between remembered views
_APART_RAD = math.radians(3.0)  #: internal: or turn between them
_MOST = 400  #: internal: remembered views, the newest: 20 m, or three turns
_NEAR_M = 0.5  #: retreat: a heading shows from here what it showed from within this distance: no need to fly there
_LIFTED_M = 0.3  #: retreat: a view this much below the least height is flown at that height; it shows nearly the same
_SHARE = 0.9  # of the allowed speed: sampling adds the rest
_TURN_SHARE = 0.7  #: retreat: share of the guard's yaw rate on the way back
_TURN_SMOOTH_S = 0.2  #: retreat: as the corners of a path back, of turns: the place is lost after two seconds
_MOST_TURN_RAD = math.radians(135.0)  #: retreat: a longer turn to a view that shows the place takes as long as the way back
_LOOKS_S = 3.0  #: retreat: pause in that view, until the place is known again and odometry is there
_LOW_M = 0.2  #: retreat: height above the pad to which a climb goes back that has lost its place: the floor is in view there
_LONGEST_S = 20.0  #: retreat: longest way back


def way_down(rest: Setpoint, start_s: float, speed_mps: float, map_epoch: int) -> Trajectory:
    """Return a trajectory from rest straight down to _LOW_M; a hold below it.

    The climb has seen the floor there. It stays below a speed.
    """
    x, y, z = rest.position_m.tolist()
    low_m = min(z, _LOW_M)
    samples_s = np.arange(0.0, (z - low_m) / (_SHARE * speed_mps) + 2.0 * STEP_S, STEP_S)
    heights_m = np.maximum(z - _SHARE * speed_mps * samples_s, low_m)
    same = np.ones_like(heights_m)
    rows = np.column_stack([x * same, y * same, heights_m, rest.yaw_rad * same])
    return smoothed(rows, rest, start_s, map_epoch, IDENTIFIER, _TURN_SMOOTH_S, _TURN_SMOOTH_S)


class FlownViews:
    """The newest positions (odom, m) and headings of the flight, and the way back through them."""

    def __init__(self) -> None:
        self._views: deque[tuple[float, float, float, float]] = deque(maxlen=_MOST)

    def add(self, odom_from_body: Pose) -> None:
        """Record the vehicle's position and heading."""
        x, y, z = odom_from_body.translation_m.tolist()
        yaw_rad = odom_from_body.yaw_rad()
        if self._views:
            x0, y0, z0, yaw0_rad = self._views[-1]
            turn_rad = abs(math.remainder(yaw_rad - yaw0_rad, math.tau))
            if math.hypot(x - x0, y - y0, z - z0) <= _APART_M and turn_rad <= _APART_RAD:
                return
        self._views.append((x, y, z, yaw_rad))

    def forget(self) -> None:
        """Forget all views after a jump of odom."""
        self._views.clear()

    def way_back(
        self, rest: Setpoint, height_m: float, start_s: float, speed_mps: float, yaw_rate_radps: float, map_epoch: int,
        seeing_yaw_rad: float | None = None,
    ) -> Trajectory:  # fmt: skip
        """Return a trajectory from rest back through the views, newest first; a hold without any.

        It turns on the spot while the views are near. It does not go below a height, or the present one: it ends at a view
        that is far below. It stays below a speed and a yaw rate. Corners are rounded as on the path along breadcrumbs.
        seeing_yaw_rad: heading in which the map says that the camera shows the place: it turns there first.
        """
        here, turn_radps = tuple(rest.position_m.tolist()), _TURN_SHARE * yaw_rate_radps
        corners, at_s, least_m = [(*here, rest.yaw_rad)], [0.0], min(height_m, here[2])
        turn_rad = 0.0 if seeing_yaw_rad is None else math.remainder(seeing_yaw_rad - rest.yaw_rad, math.tau)
        if _APART_RAD < abs(turn_rad) <= _MOST_TURN_RAD:
            corners += [(*here, rest.yaw_rad + turn_rad)] * 2
            at_s += [abs(turn_rad) / turn_radps, abs(turn_rad) / turn_radps + _LOOKS_S]
        for *place, yaw_rad in reversed(self._views):
            before, there = corners[-1], here if math.dist(place, here) < _NEAR_M else (*place[:2], max(place[2], least_m))
            if place[2] < least_m - _LIFTED_M or at_s[-1] > _LONGEST_S:
                break
            turn_rad = math.remainder(yaw_rad - before[3], math.tau)
            way_m = math.dist(there, before[:3])
            at_s.append(at_s[-1] + max(way_m / (_SHARE * speed_mps), abs(turn_rad) / turn_radps))
            corners.append((*there, before[3] + turn_rad))
        samples_s = np.arange(0.0, at_s[-1] + STEP_S, STEP_S)
        rows = np.column_stack([np.interp(samples_s, at_s, axis) for axis in zip(*corners, strict=True)])
        return smoothed(rows, rest, start_s, map_epoch, IDENTIFIER, _TURN_SMOOTH_S)
