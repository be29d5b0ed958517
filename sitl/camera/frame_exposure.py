"""Instants and poses at which a frame is exposed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class ExposureTimes:
    """World-clock times (s) of a frame: stamp, depth, first and last row of the colour image."""

    stamp_s: float
    depth_s: float
    colour_first_s: float
    colour_last_s: float

    @property
    def complete_s(self) -> float:
        """Time at which the frame can be delivered: never before its stamp, nor before its last row."""
        return max(self.stamp_s, self.depth_s, self.colour_last_s)


@dataclass(frozen=True)
class MountPose:
    """Pose of the body (4, 4) and reported tilt of the camera in it."""

    world_from_body: F64
    pitch_down_rad: float


@dataclass(frozen=True)
class FrameExposure:
    """Stamp and true poses of a frame that is not rendered yet."""

    stamp_s: float
    depth: MountPose
    colour_first: MountPose
    colour_middle: MountPose
    colour_last: MountPose

    @staticmethod
    def at_rest(stamp_s: float, world_from_body: F64, pitch_down_rad: float) -> FrameExposure:
        """Return the exposure of a vehicle that does not move."""
        pose = MountPose(world_from_body, pitch_down_rad)
        return FrameExposure(stamp_s, pose, pose, pose, pose)
