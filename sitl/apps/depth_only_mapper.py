"""A mapper that learns nothing: the surface straight from the keyframes' depth, for flights that are judged without a model."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sitl.camera import depth_surfels
from sitl.camera.depth_surfels import DepthSurfels
from uav_recon.config import Config
from uav_recon.mapping.neural.keyframes.keyframe_validation import RejectCounts, in_words, padded, reject_reason
from uav_recon.types.camera import PosedFrame
from uav_recon.types.maps import SurfaceElements
from uav_recon.types.pose import MapCorrection


class DepthOnlyMapper:
    """A Mapper for lockstep: it takes and refuses the same views as the neural one and gives as dense a surface, no mesh."""

    def __init__(self, config: Config) -> None:
        """Compiles its kernel."""
        depth_surfels.warm_up()
        self._low, self._high = padded(np.array(config.safety.fence_min_m), np.array(config.safety.fence_max_m))
        self._voxel_m = config.mapper.surface_voxel_m
        self._memory = DepthSurfels(self._low, self._high, self._voxel_m)
        self._noise_px, self._baseline_m = config.camera.depth_noise_px, config.camera.baseline_m
        self._refusals = RejectCounts()
        self._surface: SurfaceElements | None = None
        self._revision, self._map_epoch, self._stale = 0, 0, False

    def add(self, keyframe: PosedFrame) -> bool:
        """Take a view; a few milliseconds. False where the neural mapper would refuse it too."""
        reason = reject_reason(keyframe, self._low, self._high)
        if reason is not None:
            self._refusals.note(reason)
            return False
        frame, pose = keyframe.frame, keyframe.world_from_depth
        lens = frame.depth_intrinsics
        noise = self._noise_px / (lens.fx * self._baseline_m)
        intrinsics = np.array([lens.fx, lens.fy, lens.cx, lens.cy])
        self._memory.look(frame.depth_m, intrinsics, pose.rotation(), pose.translation_m, noise)
        self._revision, self._stale = self._revision + 1, True
        return True

    def refused(self) -> dict[str, int]:
        """Views that were not taken, by reason."""
        return in_words(self._refusals.counts)

    def repose(self, correction: MapCorrection) -> None:
        """Forget the old map: unlike the neural mapper it keeps no views to learn a new one from."""
        self._memory = DepthSurfels(self._low, self._high, self._voxel_m)
        self._surface, self._map_epoch, self._stale = None, correction.map_epoch, False

    def surface(self) -> SurfaceElements | None:
        """The surface after the last view; None before the first."""
        if self._stale and len(self._memory):
            self._surface, self._stale = SurfaceElements(*self._memory.elements(), self._revision, self._map_epoch), False
        return self._surface

    def alive(self) -> bool:
        """Always: there is no process to lose."""
        return True

    def finish(self, folder: Path) -> None:
        """Leave no mesh."""
