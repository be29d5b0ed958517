"""Two glass walls of a scene, as a depth camera sees them.

A stereo camera measures nothing on the one. In the other it measures the room's mirror image, which lies behind the wall; half
of its colour is that of the mirror image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.camera.camera_view import CameraView
from sitl.scene.mesh_sampling import area_weighted_samples
from sitl.scene.rasterizer import Renderer, Rendering
from sitl.scene.scene import Scene
from uav_recon.sensors.stream_format import CameraSpec

WIDTH_M = 5.0
HEIGHT_M = (0.1, 2.2)  # of the lower and the upper edge in the world
THICKNESS_M = 0.12  # surfaces this close to the plane belong to the glass
_SAMPLES = 20_000
_CANDIDATES = 200
_SEED = 0x61A5
_VERTICAL = 0.2
_SAME_WALL_COS = 0.95
_OTHER_WALL_COS = 0.7
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Pane:
    """Upright rectangle, WIDTH_M wide: middle (3,), m, and horizontal unit normal (3,)."""

    middle_m: F64
    normal: F64

    @property
    def along(self) -> F64:
        """Horizontal unit vector (3,) in the plane."""
        return np.array([-self.normal[1], self.normal[0], 0.0])

    def contains(self, points: F64) -> Bools:
        """Return which points (..., 3) lie on the pane."""
        offset = points - self.middle_m
        low, high = HEIGHT_M
        return np.asarray(
            (np.abs(offset @ self.normal) <= THICKNESS_M)
            & (np.abs(offset @ self.along) <= 0.5 * WIDTH_M)
            & (points[..., 2] >= low) & (points[..., 2] <= high)
        )  # fmt: skip


def widest_panes(scene: Scene) -> tuple[Pane, Pane]:
    """Return a pane in each of the two largest walls that are not parallel.

    Raises ValueError without two walls.
    """
    samples, facing = area_weighted_samples(scene.vertices, scene.faces, _SAMPLES, _SEED)
    low, high = HEIGHT_M
    upright = (np.abs(facing[:, 2]) < _VERTICAL) & (samples[:, 2] >= low) & (samples[:, 2] <= high)
    points: F64 = samples[upright].astype(np.float64)
    normals: F64 = facing[upright].astype(np.float64)
    if len(points) < 2:
        raise ValueError(f"{scene.name}: no walls to be of glass")
    first = _widest(points, normals)
    across = np.abs(normals @ first.normal) < _OTHER_WALL_COS
    if not across.any():
        raise ValueError(f"{scene.name}: no second wall to be of glass")
    return first, _widest(points[across], normals[across])


def _widest(points: F64, normals: F64) -> Pane:
    """Return the pane that most of the samples lie on."""
    chosen = np.random.default_rng(_SEED).permutation(len(points))[:_CANDIDATES]
    flat = normals * np.array([1.0, 1.0, 0.0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    best, best_count = Pane(points[0], flat[0]), -1
    for k in chosen:
        pane = Pane(points[k], flat[k])
        count = int((pane.contains(points) & (np.abs(flat @ flat[k]) > _SAME_WALL_COS)).sum())
        if count > best_count:
            best, best_count = pane, count
    return best


class GlassView:
    """View of a scene with a glass wall of each kind; the camera flies on the side of the pad."""

    def __init__(self, scene: Scene, view: CameraView) -> None:
        self._view = view
        self._clear, mirror = (_facing_pad(pane) for pane in widest_panes(scene))
        self._mirror = mirror
        painted = scene.paint or scene
        offset = (painted.vertices - mirror.middle_m) @ mirror.normal
        before = (offset > THICKNESS_M)[painted.faces].any(axis=1)
        mirrored = painted.vertices - 2.0 * offset[:, None] * mirror.normal
        faces = np.ascontiguousarray(painted.faces[before][:, ::-1])
        self._reflection = Renderer(np.ascontiguousarray(mirrored, np.float32), faces, painted.rgb)

    def render(
        self, world_from_camera: F64, spec: CameraSpec, near_m: float = 0.05, far_m: float = math.inf, colour: bool = True
    ) -> Rendering:
        """Render the scene with its glass; arguments as for Renderer.render()."""
        room = self._view.render(world_from_camera, spec, near_m, far_m, colour)
        points = _points(room.depth_m, world_from_camera, spec)
        seen = room.depth_m > 0
        through, reflecting = seen & self._clear.contains(points), seen & self._mirror.contains(points)
        if not reflecting.any():
            return Rendering(np.where(through, np.float32(0.0), room.depth_m), room.rgb, room.incidence_cos)
        image = self._reflection.render(world_from_camera, spec, near_m, far_m, colour)
        half = (room.rgb // 2 + image.rgb // 2).astype(np.uint8)
        depth = np.where(reflecting, image.depth_m, np.where(through, np.float32(0.0), room.depth_m))
        return Rendering(
            depth.astype(np.float32),
            np.where(reflecting[..., None], half, room.rgb),
            np.where(reflecting, image.incidence_cos, room.incidence_cos),
        )


def _facing_pad(pane: Pane) -> Pane:
    """Return the pane with its normal towards the pad, which is the world's origin."""
    sign = 1.0 if -pane.middle_m @ pane.normal >= 0.0 else -1.0
    return Pane(pane.middle_m, sign * pane.normal)


def _points(depth_m: F32, world_from_camera: F64, spec: CameraSpec) -> F64:
    """Return the world point (H, W, 3) of each pixel."""
    u, v = np.arange(spec.width), np.arange(spec.height)[:, None]
    x, y = (u - spec.cx) / spec.fx * depth_m, (v - spec.cy) / spec.fy * depth_m
    return np.asarray(np.stack([x, y, depth_m], axis=-1) @ world_from_camera[:3, :3].T + world_from_camera[:3, 3])
