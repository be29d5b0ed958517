"""Occupancy mapping for a user of the library: a camera and a box in, a voxel map out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from uav_recon.config import VoxelConfig
from uav_recon.mapping.occupancy.occupancy_map import DepthSensor, OccupancyMap
from uav_recon.types.argument_checks import require_box, require_kind, require_number, require_vector
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import AnyArray
from uav_recon.types.maps import GridSpec, VoxelMap
from uav_recon.types.pose import Pose
from uav_recon.types.rgbd_camera import Camera

_DEFAULTS = VoxelConfig()
MAX_VOXELS = 1 << 26


class OccupancyMapper:
    """OccupancyMap over a box, in world (ENU, metres), as in flight; not thread-safe.

    box_min_m, box_max_m (3,): the space to map; the map extends 0.3 m beyond it, and no voxel there becomes free.
    max_range_m: a depth beyond it frees voxels up to it and marks nothing. Raises ValueError for an invalid argument.
    """

    def __init__(
        self,
        camera: Camera,
        box_min_m: ArrayLike,
        box_max_m: ArrayLike,
        resolution_m: float = _DEFAULTS.resolution_m,
        *,
        max_range_m: float = _DEFAULTS.max_range_m,
    ) -> None:
        low, high = require_box(box_min_m, box_max_m)
        self.camera = require_kind("camera", camera, Camera)
        require_number("resolution_m", resolution_m, 0.01, 1.0)
        require_number("max_range_m", max_range_m, resolution_m, 100.0)
        grid = GridSpec.covering(low - _DEFAULTS.margin_m, high + _DEFAULTS.margin_m, resolution_m)
        if math.prod(grid.shape) > MAX_VOXELS:
            raise ValueError(
                f"resolution_m: {resolution_m:g} makes {math.prod(grid.shape)} voxels, expected {MAX_VOXELS} at most"
            )
        sensor = DepthSensor(camera.depth_min_m, camera.depth_noise_px, camera.baseline_m)
        self._occupancy = OccupancyMap(grid, sensor, max_range_m, low.tolist(), high.tolist(), _DEFAULTS.distance_cap_m)

    def add(self, keyframe: PosedFrame) -> int:
        """Integrate a frame with its pose; returns the number of voxels that changed.

        Camera.keyframe() makes such a frame. It takes about 0.4 ms for 320x240. Raises ValueError if the depth does not
        have the size that its intrinsics give.
        """
        require_kind("keyframe", keyframe, PosedFrame, "Camera.keyframe makes one")
        lens, shape = keyframe.frame.depth_intrinsics, keyframe.frame.depth_m.shape
        if shape != (lens.height, lens.width):
            raise ValueError(f"depth_m: shape {shape}, expected {(lens.height, lens.width)}")
        return self._occupancy.integrate(keyframe)

    def add_depth(self, depth_m: AnyArray, world_from_camera: Pose) -> int:
        """Integrate a depth image of the camera; returns the number of voxels that changed.

        For depth_m and errors see Camera.frame(); world_from_camera: pose of the depth imager.
        """
        return self.add(self.camera.keyframe(depth_m, None, world_from_camera))

    def declare_free(self, position_m: ArrayLike, radius_m: float = _DEFAULTS.takeoff_radius_m) -> None:
        """Set the voxels in an upright cylinder free, where it is known that nothing is.

        position_m (3,): its centre, in world; radius_m: its radius and half its height. A planner starts in free space, and
        the camera does not see the space that the body is in.
        """
        centre = require_vector("position_m", position_m)
        require_number("radius_m", radius_m, 0.0, 100.0)
        self._occupancy.declare_free(centre, radius_m, centre[2] - radius_m, centre[2] + radius_m)

    @property
    def map(self) -> VoxelMap:
        """Immutable snapshot of the map.

        It holds voxel states UNKNOWN, FREE or OCCUPIED, and distances to the nearest voxel that is not free.
        """
        return self._occupancy.snapshot()

    @property
    def explored_m3(self) -> float:
        """Volume inside the box that is known (free or occupied), in cubic metres."""
        return self._occupancy.explored_m3()

    def points(self, state: int) -> AnyArray:
        """Return the centres (N, 3) in world of the voxels in a state.

        state: maps.UNKNOWN, FREE or OCCUPIED.
        """
        voxels = self.map
        return voxels.grid.centre(np.argwhere(voxels.state == state))

    def warm_up(self) -> None:
        """Compile every kernel."""
        self._occupancy.warm_up()
