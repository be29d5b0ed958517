"""Box added to the scene in flight, rendered by the camera and measured by the checks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.camera.camera_view import CameraView
from sitl.geometry.transform import inverse, rigid
from sitl.scene.primitives import MeshBuilder
from sitl.scene.rasterizer import Renderer, Rendering
from sitl.scene.scene import HULL_HEIGHT_M
from sitl.scene.texture import plain
from uav_recon.sensors.stream_format import CameraSpec

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Obstacle:
    """Upright box with half extents half_m, from since_s on.

    place(t) is its centre in the world, in metres.
    """

    since_s: float
    half_m: tuple[float, float, float]
    place: Callable[[float], tuple[float, float, float]]

    def hull_m(self, stamps_s: F64, positions_m: F64, radius_m: float) -> F64:
        """Return the distance (M,) from the hull at each position (M, 3) to the box.

        The hull is an upright cylinder of radius_m. The distance is inf before since_s.
        """
        centre = np.array([self.place(float(t)) for t in stamps_s]).reshape(-1, 3)
        wide, deep, high = self.half_m
        half = np.array([wide, deep, high + 0.5 * HULL_HEIGHT_M])
        gap = np.maximum(np.abs(positions_m - centre) - half, 0.0)
        flat = np.maximum(np.hypot(gap[:, 0], gap[:, 1]) - radius_m, 0.0)
        return np.where(stamps_s >= self.since_s, np.hypot(flat, gap[:, 2]), math.inf)


class RendererWithObstacle:
    """Renderer of a scene with an obstacle added; it replaces the scene's own renderer."""

    def __init__(self, scene: CameraView, obstacle: Obstacle, now_s: Callable[[], float]) -> None:
        low, high = tuple(-h for h in obstacle.half_m), obstacle.half_m
        box = MeshBuilder(fine=False).box((low[0], low[1], low[2]), high, plain((0.7, 0.3, 0.2)))
        self._scene = scene
        self._box = Renderer(box.vertices, box.faces, box.rgb)
        self._obstacle = obstacle
        self._now_s = now_s

    def render(
        self, world_from_camera: F64, spec: CameraSpec, near_m: float = 0.05, far_m: float = math.inf, colour: bool = True
    ) -> Rendering:
        """Render scene and obstacle; the nearer surface is visible.

        Arguments as for Renderer.render.
        """
        room = self._scene.render(world_from_camera, spec, near_m, far_m, colour)
        box_from_world = inverse(rigid(np.eye(3), self._obstacle.place(self._now_s())))
        box = self._box.render(box_from_world @ world_from_camera, spec, near_m, far_m, colour)
        nearer = (box.depth_m > 0) & ((room.depth_m == 0) | (box.depth_m < room.depth_m))
        return Rendering(
            np.where(nearer, box.depth_m, room.depth_m),
            np.where(nearer[..., None], box.rgb, room.rgb),
            np.where(nearer, box.incidence_cos, room.incidence_cos),
        )
