"""Level of the map by the floor in view, which an accelerometer with a bias cannot give.

An accelerometer that is off by 0.1 m/s² in two axes tilts the map by 0.8 degrees. Depth shows the floor before the pad to 0.1
degrees: a wrong scale does not turn it, and a focal length that is off by 1 % by 0.14 degrees.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.localization.slam.rest_detection import level_attitude
from uav_recon.types.camera import Frame
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

_STRIDE = 2  # pixels
_FAR_M = 1.0  #: internal: farther depth shows the floor at too flat an angle, and things on it
_BELOW_M = 0.05  #: internal: the floor is farther below the camera
_BAND_M = 0.06  #: internal: height of the bands in which most points are looked for
_NEAR_M = (0.06, 0.03, 0.015, 0.008, 0.008)  # distance from the plane of the points that it is fitted to, round by round
_MIN_POINTS = 200  #: internal: a plane of fewer points is not used
_MIN_SPREAD_M = 0.05  #: internal: a plane with a smaller standard deviation along its narrower side is not used
_MAX_SLOPE_RAD = math.radians(2.0)  #: internal: a plane farther off the accelerometer's level is no floor


def level_by_floor(frame: Frame, odom_from_body: Pose, body_from_depth: Pose) -> Pose:
    """Return odom_from_body with heading zero in which the floor in view is level.

    It is returned as it is if no floor is seen.

    odom_from_body: attitude by the accelerometer. Takes about 1 ms.
    """
    odom_from_depth = odom_from_body @ body_from_depth
    points = odom_from_depth.apply(_points(frame))
    points = points[points[:, 2] < odom_from_depth.translation_m[2] - _BELOW_M]
    slope = _slope(points) if len(points) >= _MIN_POINTS else None
    if slope is None or math.hypot(*slope) > math.tan(_MAX_SLOPE_RAD):
        return odom_from_body
    return level_attitude(odom_from_body.rotation().T @ np.array([-slope[0], -slope[1], 1.0]))


def _points(frame: Frame) -> FloatArray:
    """Return the measured points (N, 3) of every _STRIDE-th pixel, imager axes."""
    lens = frame.depth_intrinsics
    depth_m = frame.depth_m[::_STRIDE, ::_STRIDE].astype(np.float64)
    v, u = np.nonzero((depth_m > 0.0) & (depth_m < _FAR_M))
    z = depth_m[v, u]
    return np.stack([(u * _STRIDE - lens.cx) / lens.fx * z, (v * _STRIDE - lens.cy) / lens.fy * z, z], axis=1)


def _slope(points: FloatArray) -> tuple[float, float] | None:
    """Return the slope along x and y of the plane at the height of most points (N, 3).

    None if the plane is too small.
    """
    band = np.floor(points[:, 2] / _BAND_M).astype(np.int64)
    bands, counts = np.unique(band, return_counts=True)
    plane = np.array([0.0, 0.0, (bands[np.argmax(counts)] + 0.5) * _BAND_M])
    for near_m in _NEAR_M:
        rows = np.column_stack((points[:, :2], np.ones(len(points))))
        kept = np.abs(points[:, 2] - rows @ plane) < near_m
        if np.count_nonzero(kept) < _MIN_POINTS:
            return None
        plane = np.linalg.lstsq(rows[kept], points[kept, 2], rcond=None)[0]
    spread_m2 = np.linalg.eigvalsh(np.cov(points[kept, :2].T))[0]
    return (float(plane[0]), float(plane[1])) if spread_m2 >= _MIN_SPREAD_M**2 else None
