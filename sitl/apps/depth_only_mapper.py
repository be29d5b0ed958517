"""Depth-only mapper: surface elements from keyframe depth, without learning or a model."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sitl.camera import depth_surfels
from sitl.camera.depth_surfels import DepthSurfels
from uav_recon.config import Config
from uav_recon.mapping.neural.keyframes.keyframe_validation import RejectCounts, counts_as_text, padded_box, reject_reason
from uav_recon.types.camera import PosedFrame
from uav_recon.types.maps import SurfaceElements
from uav_recon.types.pose import MapCorrection


class DepthOnlyMapper:
    """Mapper for lockstep flights that are evaluated without a reconstructed model; no mesh.

    It accepts and rejects the same keyframes as the neural mapper, and its surface elements are equally dense.
    """

    def __init__(self, config: Config) -> None:
        """Compile the kernels and create an empty surface inside the fence."""
        depth_surfels.warm_up()
        self._low, self._high = padded_box(np.array(config.safety.fence_min_m), np.array(config.safety.fence_max_m))
        self._voxel_m = config.mapper.surface_voxel_m
        self._memory = DepthSurfels(self._low, self._high, self._voxel_m)
        self._noise_px = config.camera.depth_noise_px
        self._baseline_m = config.camera.baseline_m
        self._refusals = RejectCounts()
        self._surface: SurfaceElements | None = None
        self._revision = 0
        self._map_epoch = 0
        self._stale = False

    def add(self, keyframe: PosedFrame) -> bool:
        """Add a keyframe; takes a few ms. Return False if the neural mapper would reject it, too."""
        reason = reject_reason(keyframe, self._low, self._high)
        if reason is not None:
            self._refusals.note(reason)
            return False
        frame, pose = keyframe.frame, keyframe.world_from_depth
        lens = frame.depth_intrinsics
        noise = self._noise_px / (lens.fx * self._baseline_m)
        intrinsics = np.array([lens.fx, lens.fy, lens.cx, lens.cy])
        self._memory.look(frame.depth_m, intrinsics, pose.rotation(), pose.translation_m, noise)
        self._revision = self._revision + 1
        self._stale = True
        return True

    def refused(self) -> dict[str, int]:
        """Return the number of rejected keyframes by reason."""
        return counts_as_text(self._refusals.counts)

    def repose(self, correction: MapCorrection) -> None:
        """Discard the surface at a new map epoch; unlike the neural mapper it keeps no keyframes."""
        self._memory = DepthSurfels(self._low, self._high, self._voxel_m)
        self._surface = None
        self._map_epoch = correction.map_epoch
        self._stale = False

    def surface(self) -> SurfaceElements | None:
        """Return the surface after the last keyframe; None before the first."""
        if self._stale and len(self._memory):
            self._surface = SurfaceElements(*self._memory.elements(), self._revision, self._map_epoch)
            self._stale = False
        return self._surface

    def alive(self) -> bool:
        """Return True: there is no process that could fail."""
        return True

    def finish(self, folder: Path) -> None:
        """Do nothing: there is no mesh to write."""
