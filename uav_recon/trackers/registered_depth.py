"""Depth of each pixel of the colour image, from a depth camera beside it."""

from __future__ import annotations

import numpy as np

from uav_recon.types.camera import Intrinsics
from uav_recon.types.frames import Float32Array
from uav_recon.types.pose import Pose

_FIRST_M = 2.5  # first guess of a depth
_ROUNDS = 3


class DepthRegistration:
    """Registers depth images of one camera to the colour images of another.

    The depth on the ray of a colour pixel is found by iteration: the present depth gives the pixel of the depth image, and this
    pixel the next depth. There are no holes between the pixels of a coarser depth image.
    """

    def __init__(self, depth: Intrinsics, rgb: Intrinsics, rgb_from_depth: Pose) -> None:
        self._depth = depth
        self._same = depth == rgb and np.allclose(rgb_from_depth.matrix(), np.eye(4))
        columns, rows = np.meshgrid(np.arange(rgb.width), np.arange(rgb.height))
        rays = np.stack([(columns - rgb.cx) / rgb.fx, (rows - rgb.cy) / rgb.fy, np.ones(columns.shape)], axis=-1)
        depth_from_rgb = rgb_from_depth.inverse()
        self._rays = (rays @ depth_from_rgb.rotation().T).astype(np.float32)
        self._offset_m = depth_from_rgb.translation_m.astype(np.float32)
        self._along = rgb_from_depth.rotation()[2].astype(np.float32)  # optical axis of the colour camera in the depth camera
        self._shift_m = np.float32(rgb_from_depth.translation_m[2])

    def registered(self, depth_m: Float32Array) -> Float32Array:
        """Return depth (h, w) along the optical axis of the colour camera.

        depth_m (H, W). 0 = unknown, in both.
        """
        if self._same:
            return depth_m
        far_m = np.full(self._rays.shape[:2], _FIRST_M, dtype=np.float32)
        known = np.zeros(far_m.shape, dtype=np.bool_)
        for _ in range(_ROUNDS):
            x, y, z = np.moveaxis(self._rays * far_m[..., None] + self._offset_m, -1, 0)
            z = np.maximum(z, 1e-3)
            u = np.rint(x / z * self._depth.fx + self._depth.cx).astype(np.int32)
            v = np.rint(y / z * self._depth.fy + self._depth.cy).astype(np.int32)
            inside = (u >= 0) & (u < self._depth.width) & (v >= 0) & (v < self._depth.height)
            u, v = np.clip(u, 0, self._depth.width - 1), np.clip(v, 0, self._depth.height - 1)
            found = depth_m[v, u]
            known = inside & (found > 0.0)
            p, q = (u - self._depth.cx) / self._depth.fx, (v - self._depth.cy) / self._depth.fy
            there = (found * (self._along[0] * p + self._along[1] * q + self._along[2]) + self._shift_m).astype(np.float32)
            far_m = np.where(known, there, far_m)
        return np.where(known, far_m, np.float32(0.0))
