"""Views and poses of a tracking engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from uav_recon.types.camera import Intrinsics
from uav_recon.types.frames import Float32Array, frozen
from uav_recon.types.pose import Pose


class TrackerError(Exception):
    """An engine that cannot be used.

    It is not installed, or without its files. The message is one line.
    """


@dataclass(frozen=True, slots=True, eq=False)
class RgbdView:
    """A colour image with the depth of each of its pixels.

    rgb (h, w, 3) uint8. depth_m (h, w) along the optical axis, 0 = unknown. camera: of both.
    """

    stamp_s: float
    rgb: np.ndarray[Any, np.dtype[np.uint8]]
    depth_m: Float32Array
    camera: Intrinsics

    def __post_init__(self) -> None:
        object.__setattr__(self, "rgb", frozen(self.rgb))
        object.__setattr__(self, "depth_m", frozen(self.depth_m))


@dataclass(frozen=True, slots=True, eq=False)
class TrackedPose:
    """Pose of the colour camera (optical axes) in the world of an engine.

    The world is that of the first view unless the engine says otherwise. quality: 1 to 100. world: number of the world; another
    one has no relation to those before.
    """

    stamp_s: float
    world_from_rgb: Pose
    quality: int
    world: int = 0


class TrackingEngine(Protocol):
    """A tracker of RGB-D views."""

    def track(self, view: RgbdView) -> list[TrackedPose]:
        """Track a view and return the poses that this gives, oldest first. Blocks while it computes.

        Empty while the engine is lost or still computes. Poses may be of earlier views.
        """
        ...

    def close(self) -> None:
        """Release the engine."""
        ...
