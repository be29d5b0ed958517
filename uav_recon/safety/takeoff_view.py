"""View before the take-off: nothing stands close before the camera, and it sees the room.

The vehicle stands on its pad. The floor near by is too close, or seen at too flat an angle, for most of the lower image. So
only what is about as high as the vehicle's centre, or higher, counts.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.types.min_range_grid import MinRangeGrid, ray_directions
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_NEAR_M = 0.55  #: refuse: a take-off with something this close before the camera, such as a hand
_ABOVE_M = -0.04  #: refuse: it is higher than this, from the vehicle's centre: lower returns are of the floor
_NEAR_CELLS = 3  #: refuse: it shows in this many cells; fewer are noise
_BLANK_SHARE = 0.4  #: refuse: this share of the cells above the horizon has no return; in a hall of 12 m it is 26 %
_HORIZON_RAD = 0.05  #: internal: elevation from which on a cell is above the horizon
_FEWEST_CELLS = 12  #: internal: fewer cells above the horizon tell nothing: the camera looks down


def takeoff_view_fault(nearby: MinRangeGrid) -> Reason | None:
    """Return why the vehicle may not take off with this view, None if it may.

    nearby: of a vehicle that stands level on its pad.
    """
    places = nearby.body_from_depth.apply(nearby.points())
    away_m = np.linalg.norm(places - nearby.body_from_depth.translation_m, axis=1)
    near_m = np.sort(away_m[(places[:, 2] > _ABOVE_M) & (away_m <= _NEAR_M)])
    if near_m.size >= _NEAR_CELLS:
        return Reason(ReasonCode.TAKEOFF_VIEW_BLOCKED, (float(near_m[0]), _NEAR_M))
    upwards = (ray_directions(nearby) @ nearby.body_from_depth.rotation().T)[..., 2] > math.sin(_HORIZON_RAD)
    blank = ~np.isfinite(nearby.range_m[upwards])
    if blank.size >= _FEWEST_CELLS and float(blank.mean()) >= _BLANK_SHARE:
        return Reason(ReasonCode.TAKEOFF_VIEW_BLANK, (float(blank.mean()), _BLANK_SHARE))
    return None
