"""Measured motion: the way of the body between two instants, by a sensor beside the camera."""

from __future__ import annotations

from dataclasses import dataclass

from uav_recon.types.frames import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMotion:
    """Motion between two instants, as a measurement.

    displacement_odom_m: (3,), of the body's origin. covariance_m2: (3, 3), odom axes; large along what is not measured.
    """

    displacement_odom_m: FloatArray
    covariance_m2: FloatArray
