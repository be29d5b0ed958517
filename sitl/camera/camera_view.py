"""Interface of what a camera looks at."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sitl.scene.rasterizer import Rendering
from uav_recon.sensors.stream_format import CameraSpec

F64 = NDArray[np.float64]


class CameraView(Protocol):
    """Source of rendered images: a scene's renderer, or one with additional objects."""

    def render(
        self, world_from_camera: F64, spec: CameraSpec, near_m: float = 0.05, far_m: float = math.inf, colour: bool = True
    ) -> Rendering:
        """Render an image; see Renderer.render()."""
        ...
