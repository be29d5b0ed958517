"""Speed limit where the camera does not look, by the age of the last free sight.

Guard and motion planning use this one function.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray

#: refuse: a climb into space not seen within blind_memory_s, if its direction has less than this vertical part
_CLIMB_SHARE = 0.5
#: refuse: a steeper climb into space not seen within this multiple of it: what comes into a room comes from the side or below
_CLIMB_MEMORY_FACTOR = 3.0
_STEEP_SHARE = 0.1  #: internal: a direction with a smaller level part has no side of its own
#: refuse: a motion outside the view that is too fast for the age of the space this far off its path, of the hull's radius
_OFF_SHARE = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class SightSpeedLimit:
    """Speed limit by age (SI).

    Space seen free within blind_fresh_s is entered at full_speed_mps. Then the limit falls evenly, to blind_speed_mps from
    blind_stale_s on. Space not seen free within blind_memory_s is not entered.
    """

    full_speed_mps: float
    blind_speed_mps: float
    blind_fresh_s: float
    blind_stale_s: float
    blind_memory_s: float

    def at(self, age_s: FloatArray) -> FloatArray:
        """Return the speed limits (N,) at ages (N,); an infinite age is space that was never seen."""
        fall_s = max(self.blind_stale_s - self.blind_fresh_s, 1e-9)
        share = np.clip((age_s - self.blind_fresh_s) / fall_s, 0.0, 1.0)
        limit_mps = self.full_speed_mps + share * (self.blind_speed_mps - self.full_speed_mps)
        return np.where(age_s <= self.blind_memory_s, limit_mps, 0.0)


def memory_s(blind_memory_s: float, direction: FloatArray) -> FloatArray:
    """Return the age (s) up to which space that was seen is entered at blind_speed_mps.

    direction: (..., 3) unit vectors in world. A steep climb may rely on older views.
    """
    return blind_memory_s * np.where(direction[..., 2] >= _CLIMB_SHARE, _CLIMB_MEMORY_FACTOR, 1.0)


def longest_memory_s(blind_memory_s: float) -> float:
    """Return the greatest value of memory_s()."""
    return _CLIMB_MEMORY_FACTOR * blind_memory_s


def entered_points(
    place_m: FloatArray, direction: FloatArray, stopping_m: FloatArray, hull_radius_m: float, reach_m: float
) -> FloatArray:
    """Return points (M, 11, 3) of the space that a hull enters on its way and while it stops.

    place_m: (M, 3) centre of the hull. direction: (M, 3) unit vectors of motion. stopping_m: (M,) path until it stands.
    reach_m: from the centre to what the hull reaches next. Three points lie in front of it: now, on half of the path, and at
    its end. Four lie around its front now, and four at the end.
    """
    level = np.hypot(direction[:, 0], direction[:, 1])
    steep = level < _STEEP_SHARE
    aside = np.stack([-direction[:, 1], direction[:, 0], np.zeros(len(level))], axis=1) / np.where(steep, 1.0, level)[:, None]
    aside[steep] = (1.0, 0.0, 0.0)
    above = np.cross(direction, aside)
    off_m = _OFF_SHARE * hull_radius_m
    set_back_m = hull_radius_m - math.sqrt(hull_radius_m**2 - off_m**2)
    points = [place_m + (share * stopping_m + reach_m)[:, None] * direction for share in (0.0, 0.5, 1.0)]
    for share in (0.0, 1.0):
        front = place_m + (share * stopping_m + reach_m - set_back_m)[:, None] * direction
        points += [front + off_m * aside, front - off_m * aside, front + off_m * above, front - off_m * above]
    return np.stack(points, axis=1)
