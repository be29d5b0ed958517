"""Visibility of surface points in depth images: seen, or measured through.

An image measured through a point if its depth there is larger than that of the point.
"""

from __future__ import annotations

from itertools import compress
from typing import Any

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, BoolArray, Float32Array, FloatArray

# a depth image sees a point within SEEN_SIGMAS * sigma_z + SEEN_MARGIN_M ...
SEEN_SIGMAS = 2.0
SEEN_MARGIN_M = 0.02
SEEN_MIN_COSINE = 0.15  # ... of a surface that faces it
SHOWN_MIN_COSINE = 0.35


DepthImage = tuple[Float32Array, FloatArray, FloatArray, FloatArray, float, FloatArray]  # arguments of DepthVisibility.add()


class DepthVisibility:
    """Depth images of the kept keyframes at half resolution, for visibility queries."""

    def __init__(self) -> None:
        self._depth_mm: list[AnyArray] = []
        self._lens: list[FloatArray] = []
        self._depth_from_world: list[tuple[FloatArray, FloatArray]] = []
        self._sigma: list[float] = []
        self._stretch: list[FloatArray] = []

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a checkpoint, without the images, which it stores by view.

        See image() and put_back().
        """
        return self.__dict__ | {"_depth_mm": [np.zeros(0, dtype=np.uint16)] * len(self._depth_mm)}

    def image(self, view: int) -> AnyArray:
        """Return the depth image (h, w) uint16 of a view, in millimetres, read-only."""
        return self._depth_mm[view]

    def put_back(self, view: int, depth_mm: AnyArray) -> None:
        """Restore the depth image of a view after unpickling."""
        self._depth_mm[view] = depth_mm

    def keep(self, which: BoolArray) -> None:
        """Drop all views except those selected by a mask (V,)."""
        self._depth_mm = list(compress(self._depth_mm, which))
        self._lens = list(compress(self._lens, which))
        self._depth_from_world = list(compress(self._depth_from_world, which))
        self._sigma = list(compress(self._sigma, which))
        self._stretch = list(compress(self._stretch, which))

    def add(
        self,
        depth_m: Float32Array,
        lens: FloatArray,
        rotation: FloatArray,
        position: FloatArray,
        inverse_depth_sigma: float,
        stretch: FloatArray,
    ) -> None:
        """Add a depth image (H, W).

        lens: fx, fy, cx, cy; pose world_from_depth as rotation (3, 3) and position (3,); stretch: see place().
        """
        with np.errstate(over="ignore"):  # an overflow becomes infinite, which means no return
            half = np.nan_to_num(depth_m[::2, ::2] * 1000.0, nan=0.0, posinf=0.0, neginf=0.0)
        self._depth_mm.append(np.clip(half, 0, 65535).astype(np.uint16))
        self._lens.append(lens)
        self._depth_from_world.append((rotation.T.copy(), -rotation.T @ position))
        self._sigma.append(inverse_depth_sigma)
        self._stretch.append(np.asarray(stretch, dtype=np.float64))

    def place(self, view: int, rotation: FloatArray, position: FloatArray, stretch: AnyArray) -> None:
        """Change the pose and the lens of an image.

        world_from_depth as in add(); stretch (2,): factors on bearings and depth.
        """
        self._depth_from_world[view] = (rotation.T.copy(), -rotation.T @ position)
        self._stretch[view] = np.asarray(stretch, dtype=np.float64)

    def _pinhole_mm(self, view: int) -> FloatArray:
        """Return fx, fy, cx, cy of a stretched image, and the unit of its depth in metres (5,)."""
        fx, fy, cx, cy = self._lens[view]
        wider, deeper = self._stretch[view]
        return np.array([fx / wider, fy / wider, cx, cy, 0.001 * deeper])

    def votes(self, points: Float32Array, normals: Float32Array, most: int = 1 << 30) -> Float32Array:
        """Return the votes (N,) of the images on surface points (N, 3) with normals (N, 3).

        Each image that sees a surface at the point adds 1, each that measured through it subtracts 1/2. most: maximum number
        of images used, spread evenly over all.
        """
        score = np.zeros(len(points), dtype=np.float32)
        count = len(self._depth_mm)
        for view in np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)) if count else ():
            rotation, translation = self._depth_from_world[view]
            _vote(
                self._depth_mm[view], self._pinhole_mm(view), rotation, translation, self._sigma[view], points, normals, score
            )
        return score

    def shown(self, view: int, points: Float32Array, normals: Float32Array) -> BoolArray:
        """Return True (N,) if an image shows the surface at points (N, 3) with normals (N, 3).

        The surface must face the camera by SHOWN_MIN_COSINE and not lie beside the edge of a nearer one.
        """
        shown = np.zeros(len(points), dtype=np.bool_)
        rotation, translation = self._depth_from_world[view]
        _show(self._depth_mm[view], self._pinhole_mm(view), rotation, translation, self._sigma[view], points, normals, shown)
        return shown

    def looked_through(self, points: Float32Array, margin_m: float) -> BoolArray:
        """Return True (N,) if an image measured a depth behind points (N, 3) by more than a margin.

        Such a point is in the air.
        """
        through = np.zeros(len(points), dtype=np.bool_)
        for view, (rotation, translation) in enumerate(self._depth_from_world):
            lens, sigma = self._pinhole_mm(view), self._sigma[view]
            _look_through(self._depth_mm[view], lens, rotation, translation, sigma, margin_m, points, through)
        return through


@kernel
def _in_camera(rotation: FloatArray, translation: FloatArray, point: Float32Array) -> tuple[float, float, float]:
    """Return a point (3,) of the world in the axes of a camera."""
    px, py, pz = point[0], point[1], point[2]
    return (
        rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz + translation[0],
        rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz + translation[1],
        rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz + translation[2],
    )


@kernel
def _pixel(lens: FloatArray, x: float, y: float, z: float) -> tuple[int, int]:
    """Return column and row of the nearest pixel of an image at half resolution."""
    u, v = x / z * lens[0] + lens[2], y / z * lens[1] + lens[3]
    return int(np.floor(u * 0.5 + 0.5)), int(np.floor(v * 0.5 + 0.5))


@kernel
def _facing(rotation: FloatArray, normal: Float32Array, x: float, y: float, z: float) -> float:
    """Return the cosine between a normal (3,) in world and the ray back to the camera.

    x, y, z: the point, in the axes of the camera.
    """
    along = (
        (rotation[0, 0] * normal[0] + rotation[0, 1] * normal[1] + rotation[0, 2] * normal[2]) * x
        + (rotation[1, 0] * normal[0] + rotation[1, 1] * normal[1] + rotation[1, 2] * normal[2]) * y
        + (rotation[2, 0] * normal[0] + rotation[2, 1] * normal[1] + rotation[2, 2] * normal[2]) * z
    )
    cosine: float = -along / np.sqrt(x * x + y * y + z * z)
    return cosine


@kernel
def _show(
    image: AnyArray, lens: FloatArray, rotation: FloatArray, translation: FloatArray, inverse_sigma: float,
    points: Float32Array, normals: Float32Array, shown: BoolArray,
) -> None:  # fmt: skip
    height, width = image.shape
    for n in range(points.shape[0]):
        x, y, z = _in_camera(rotation, translation, points[n])
        if z < 0.2:
            continue
        u, v = _pixel(lens, x, y, z)
        if u < 1 or v < 1 or u >= width - 1 or v >= height - 1:
            continue
        facing = _facing(rotation, normals[n], x, y, z)
        if facing < SHOWN_MIN_COSINE:
            continue
        gate = (SEEN_SIGMAS * inverse_sigma * z * z + SEEN_MARGIN_M) / facing
        near = True
        for side in range(5):  # no edge of a nearer surface
            depth = lens[4] * image[v + (side == 1) - (side == 2), u + (side == 3) - (side == 4)]
            near = near and abs(depth - z) < gate
        shown[n] = near


@kernel
def _look_through(
    image: AnyArray, lens: FloatArray, rotation: FloatArray, translation: FloatArray, inverse_sigma: float, margin_m: float,
    points: Float32Array, through: BoolArray,
) -> None:  # fmt: skip
    height, width = image.shape
    for n in range(points.shape[0]):
        if through[n]:
            continue
        x, y, z = _in_camera(rotation, translation, points[n])
        if z < 0.05:
            continue
        u, v = _pixel(lens, x, y, z)
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        through[n] = lens[4] * image[v, u] > z + margin_m + SEEN_SIGMAS * inverse_sigma * z * z


@kernel
def _vote(
    image: AnyArray, lens: FloatArray, rotation: FloatArray, translation: FloatArray, inverse_sigma: float,
    points: Float32Array, normals: Float32Array, score: Float32Array,
) -> None:  # fmt: skip
    height, width = image.shape
    for n in range(points.shape[0]):
        x, y, z = _in_camera(rotation, translation, points[n])
        if z < 0.2:
            continue
        u, v = _pixel(lens, x, y, z)
        if u < 1 or v < 1 or u >= width - 1 or v >= height - 1:
            continue
        gate = SEEN_SIGMAS * inverse_sigma * z * z + SEEN_MARGIN_M
        facing = _facing(rotation, normals[n], x, y, z)
        slope = gate / max(facing, SEEN_MIN_COSINE) if facing > 0.0 else gate
        measured, through = 0, 0
        for near in range(5):  # the pixel and its four neighbours: poses can be off by a pixel, and depth edges are ragged
            depth = lens[4] * image[v + (near == 1) - (near == 2), u + (near == 3) - (near == 4)]
            if depth == 0.0:
                continue
            measured += 1
            if facing > 0.0 and abs(depth - z) < slope:
                score[n] += 1.0
                through = 0
                break
            through += depth > z + 2.0 * slope + 0.03
        if measured > 0 and through == measured:
            score[n] -= 0.5
