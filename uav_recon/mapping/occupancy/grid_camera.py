"""The depth camera of one frame in the voxel grid."""

from __future__ import annotations

from typing import NamedTuple

from uav_recon.types.frames import FloatArray


class GridCamera(NamedTuple):
    """The depth camera of one frame in the grid, with its range and noise.

    pinhole_px: (4,) fx, fy, cx, cy. rotation: (3, 3), grid from camera. origin: (3,) position of the camera, voxels. near_m,
    far_m: range of depths. noise_per_m: one sigma of the depth is noise_per_m * depth². resolution_m: edge of a voxel.
    """

    pinhole_px: FloatArray
    rotation: FloatArray
    origin: FloatArray
    near_m: float
    far_m: float
    noise_per_m: float
    resolution_m: float
