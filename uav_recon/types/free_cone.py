"""Free cone: the space that one measurement of a range finder found empty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray, frozen


@dataclass(frozen=True, slots=True, eq=False)
class FreeCone:
    """A round cone from the sensor, closed by a sphere around it: no surface is inside.

    stamp_s: of the measurement, companion's clock. map_epoch: of the maps that go with the pose. apex_odom_m: (3,), position
    of the sensor. axis_odom: (3,), unit vector. half_angle_rad: from the axis to the side, below a right angle. reach_m: radius
    of the sphere. With such an angle it is convex. `safety/free_cone_rule` says which points are inside.
    """

    stamp_s: float
    map_epoch: int
    apex_odom_m: FloatArray
    axis_odom: FloatArray
    half_angle_rad: float
    reach_m: float

    def __post_init__(self) -> None:
        for name in ("apex_odom_m", "axis_odom"):
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name), dtype=np.float64)))
