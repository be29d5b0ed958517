"""What is near, straight from one raw depth frame: no pose, no map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import Float32Array, frozen
from uav_recon.types.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class Nearby:
    """The depth image in cells of equal angle tangents, rows from its top, columns from its left.

    range_m: (rows, columns) float32, distance along the ray to the nearest return in each cell, NaN where it holds too few.
    half_tan: tangents of half the horizontal and half the vertical angle of view. share: of the pixels that had a return.
    believed: whether the picture fits itself and what was seen before. What is near in one that does not is still not flown at.
    """

    stamp_s: float
    body_from_depth: Pose
    range_m: Float32Array
    half_tan: tuple[float, float]
    share: float
    believed: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "range_m", frozen(np.asarray(self.range_m, dtype=np.float32)))
