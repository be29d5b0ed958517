"""Optical flow of the autopilot and the ranges of its range finder, both looking down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray, frozen


@dataclass(frozen=True, slots=True, eq=False)
class FlowReadings:
    """The newest readings of an optical flow sensor and of a range finder, each oldest first.

    stamps_s: (N,), ends of the intervals on the companion's clock. intervals_s: (N,). flow_rad: (N, 2), angle about the body's
    x and y axes (FLU) by which the sensor seems to turn against the surface below: its turn, and its motion over the distance.
    gyro_rad: (N, 3), turn by the sensor's own gyro, NaN if unknown. quality: (N,), 0 (none) to 1.
    range_stamps_s, ranges_m: (M,), along the body's z axis, downwards.
    """

    stamps_s: FloatArray
    intervals_s: FloatArray
    flow_rad: FloatArray
    gyro_rad: FloatArray
    quality: FloatArray
    range_stamps_s: FloatArray
    ranges_m: FloatArray

    def __post_init__(self) -> None:
        for name in ("stamps_s", "intervals_s", "flow_rad", "gyro_rad", "quality", "range_stamps_s", "ranges_m"):
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name), dtype=np.float64)))
