"""Simple solids as textured meshes: patches, boxes, tubes, bushes. What rooms are furnished with.

A fine workshop cuts every face into cells small enough for the paint; a coarse one makes the same shapes of as few triangles
as they need, for flights in which nobody looks at colour.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.scene import texture
from sitl.scene.mesh import GREY, Mesh, joined
from sitl.scene.texture import Paint

COARSE_M = 0.03
F64 = NDArray[np.float64]
Vector = tuple[float, float, float]
Shape = Callable[[F64, F64], F64]


@dataclass(frozen=True)
class MeshBuilder:
    """Makes solids in metres. fine: cells of at most a face's own step, for its paint; else the shape alone.

    Flat faces are the same either way; a bush is rougher where it is not fine.
    """

    fine: bool = True

    def patch(self, origin: Vector, edge_u: Vector, edge_v: Vector, paint: Paint, step_m: float = COARSE_M) -> Mesh:
        """Parallelogram; seen from where edge_u x edge_v points to."""
        o, p, q = (np.asarray(x, np.float64) for x in (origin, edge_u, edge_v))
        shape = lambda u, v: o + u[:, None] * p + v[:, None] * q  # noqa: E731
        step = step_m if self.fine else math.inf
        return self._surface(shape, paint, float(np.linalg.norm(p)), float(np.linalg.norm(q)), step, step)

    def box(self, low: Vector, high: Vector, paint: Paint, step_m: float = COARSE_M) -> Mesh:
        """Upright box with all six sides, shaded a little by side so that its edges show."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        a, b, c = (x1 - x0, 0.0, 0.0), (0.0, y1 - y0, 0.0), (0.0, 0.0, z1 - z0)
        dim = texture.dimmed
        return joined(
            [
                self.patch((x0, y0, z1), a, b, paint, step_m),
                self.patch((x0, y0, z0), b, a, dim(paint, 0.55), step_m),
                self.patch((x0, y0, z0), a, c, dim(paint, 0.88), step_m),
                self.patch((x0, y1, z0), c, a, dim(paint, 0.82), step_m),
                self.patch((x0, y0, z0), c, b, dim(paint, 0.75), step_m),
                self.patch((x1, y0, z0), b, c, dim(paint, 0.92), step_m),
            ]
        )

    def tube(
        self, centre: Vector, low_radius: float, high_radius: float, height: float, paint: Paint, lid: bool = False
    ) -> Mesh:
        """Upright cone frustum standing on centre; with a lid it is closed at the top."""
        x, y, z = centre

        def side(u: F64, v: F64) -> F64:
            angle, radius = 2.0 * math.pi * u, low_radius + v * (high_radius - low_radius)
            return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), z + v * height], axis=1)

        def top(u: F64, v: F64) -> F64:
            angle = 2.0 * math.pi * u
            return np.stack(
                [x + v * high_radius * np.cos(angle), y + v * high_radius * np.sin(angle), np.full_like(u, z + height)], axis=1
            )

        around = 2.0 * math.pi * max(low_radius, high_radius, 0.04)
        along = COARSE_M if self.fine else math.inf
        parts = [self._surface(side, paint, around, height, COARSE_M, along)]
        return joined([*parts, self._surface(top, paint, around, high_radius, COARSE_M, along)] if lid else parts)

    def bush(self, centre: Vector, radius: float, paint: Paint) -> Mesh:
        """A ball with bumps: a plant's leaves."""

        def shape(u: F64, v: F64) -> F64:
            angle, slope = 2.0 * math.pi * u, math.pi * v
            bumps = 0.16 * np.sin(5 * angle) * np.sin(4 * slope) + 0.10 * np.cos(9 * angle + 6 * slope) * np.sin(slope)
            r = radius * (1.0 + bumps)
            flat = r * np.sin(slope)
            return np.asarray(centre) + np.stack([flat * np.cos(angle), flat * np.sin(angle), -r * np.cos(slope)], axis=1)

        step = 0.02 if self.fine else 0.06
        return self._surface(shape, paint, 2.0 * math.pi * radius, math.pi * radius, step, step)

    def _surface(self, shape: Shape, paint: Paint, length_u: float, length_v: float, step_u: float, step_v: float) -> Mesh:
        """Grid over shape(u, v) -> points (..., 3), u and v in 0..1, with cells of at most the steps."""
        n, m = max(1, math.ceil(length_u / step_u)), max(1, math.ceil(length_v / step_v))
        u, v = np.meshgrid(np.linspace(0.0, 1.0, n + 1), np.linspace(0.0, 1.0, m + 1), indexing="ij")
        points = shape(u.ravel(), v.ravel())
        index = np.arange((n + 1) * (m + 1)).reshape(n + 1, m + 1)
        a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
        faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        rgb = texture.to_rgb(paint(points)) if self.fine else np.full(points.shape, GREY, np.uint8)
        return Mesh(points.astype(np.float32), faces.astype(np.int32), rgb)
