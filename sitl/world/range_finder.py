"""Range finder that looks up: ray casting over its cone, in the true scene (Open3D)."""

from __future__ import annotations

import math
import random
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.geometry.quaternion import Quat, Vec3, rotate
from sitl.scene.scene import Scene

# of a small time-of-flight sensor
RANGE_M = (0.05, 4.0)
RATE_HZ = 15.0
NOISE_SHARE = 0.02  # rms error as a share of the range
MOUNT_M: Vec3 = (0.0, 0.0, 0.05)  # position on the body, FLU
MOUNT_TILT_RAD = 0.01  # rms error of its axis, about each of two axes
_RAYS_APART_RAD = 0.012  # in the rings around the axis; ring n has 6 n rays
F64 = NDArray[np.float64]


class SimulatedUpwardRangeFinder:
    """A sensor that measures the nearest surface in its cone, at RATE_HZ.

    fov_rad: whole angle of the cone.
    range_m: the newest reading, RANGE_M[1] if nothing is in range. measured_s: when, world clock; -inf before the first.
    """

    def __init__(self, scene: Scene, seed: int, fov_rad: float) -> None:
        """Draw the error of its mount."""
        import open3d

        self._tensor: Any = open3d.core.Tensor.from_numpy
        self._rays: Any = open3d.t.geometry.RaycastingScene()
        self._rays.add_triangles(self._tensor(scene.vertices.astype(np.float32)), self._tensor(scene.faces.astype(np.uint32)))
        self._random = random.Random(seed)
        tilt_rad = (self._random.gauss(0.0, MOUNT_TILT_RAD), self._random.gauss(0.0, MOUNT_TILT_RAD))
        self._directions = cone_directions(fov_rad, tilt_rad)
        self.range_m = RANGE_M[1]
        self.measured_s = self._next_s = -math.inf

    def step(self, now_s: float, position: Vec3, quat_wxyz: Quat) -> None:
        """Measure if it is time. position (ENU, m) and quat_wxyz (enu_from_flu): of the body."""
        if now_s < self._next_s:
            return
        self._next_s = max(self._next_s + 1.0 / RATE_HZ, now_s)
        self.measured_s = now_s
        measured_m = self.nearest_m(position, quat_wxyz) * (1.0 + self._random.gauss(0.0, NOISE_SHARE))
        self.range_m = min(max(measured_m, RANGE_M[0]), RANGE_M[1])

    def nearest_m(self, position: Vec3, quat_wxyz: Quat) -> float:
        """Return the true distance (m) to the nearest surface in the cone, infinity for none."""
        offset = rotate(quat_wxyz, MOUNT_M)
        axes = np.array([rotate(quat_wxyz, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))])
        rays = np.empty((len(self._directions), 6), np.float32)
        rays[:, :3] = np.array(position) + np.array(offset)
        rays[:, 3:] = self._directions @ axes
        return float(self._rays.cast_rays(self._tensor(rays))["t_hit"].numpy().min())


def cone_directions(fov_rad: float, tilt_rad: tuple[float, float] = (0.0, 0.0)) -> F64:
    """Return unit vectors (N, 3), FLU, that fill the cone around the body's z axis.

    tilt_rad: of its axis towards x and y, small.
    """
    rings = math.ceil(0.5 * fov_rad / _RAYS_APART_RAD)
    turned = [
        (0.5 * fov_rad * ring / rings, math.tau * n / (6 * ring)) for ring in range(1, rings + 1) for n in range(6 * ring)
    ]
    off, around = np.array([(0.0, 0.0), *turned]).T
    away = np.column_stack([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), np.cos(off)])
    z = np.array([*tilt_rad, 1.0]) / math.hypot(*tilt_rad, 1.0)
    x = np.array([z[2], 0.0, -z[0]]) / math.hypot(z[0], z[2])
    return np.asarray(away @ np.array([x, np.cross(z, x), z]))
