"""Simple solids as textured meshes, for building rooms: patches, boxes, tubes, bushes.

A fine builder divides every face into cells small enough for its texture. A coarse one makes the same shapes of as few
triangles as possible, for flights without colour.
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
    """Builder of solids; lengths in metres.

    fine: divide faces into cells of at most their step_m, with the paint's colours; otherwise build the shape alone, in
    grey. Flat faces have the same geometry either way; a bush is rougher if not fine.
    """

    fine: bool = True

    def patch(self, origin: Vector, edge_u: Vector, edge_v: Vector, paint: Paint, step_m: float = COARSE_M) -> Mesh:
        """Return a parallelogram with its front side in the direction of edge_u x edge_v."""
        o, p, q = (np.asarray(x, np.float64) for x in (origin, edge_u, edge_v))
        shape = lambda u, v: o + u[:, None] * p + v[:, None] * q  # noqa: E731
        step = step_m if self.fine else math.inf
        return self._surface(shape, paint, float(np.linalg.norm(p)), float(np.linalg.norm(q)), step, step)

    def box(self, low: Vector, high: Vector, paint: Paint, step_m: float = COARSE_M) -> Mesh:
        """Return an upright box with six sides, each of a different shade so that edges are visible."""
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
        """Return an upright cone frustum standing on centre; with a lid it is closed at the top."""
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
        """Return a ball with bumps: the leaves of a plant."""

        def shape(u: F64, v: F64) -> F64:
            angle, slope = 2.0 * math.pi * u, math.pi * v
            bumps = 0.16 * np.sin(5 * angle) * np.sin(4 * slope) + 0.10 * np.cos(9 * angle + 6 * slope) * np.sin(slope)
            r = radius * (1.0 + bumps)
            flat = r * np.sin(slope)
            return np.asarray(centre) + np.stack([flat * np.cos(angle), flat * np.sin(angle), -r * np.cos(slope)], axis=1)

        step = 0.02 if self.fine else 0.06
        return self._surface(shape, paint, 2.0 * math.pi * radius, math.pi * radius, step, step)

    def _surface(self, shape: Shape, paint: Paint, length_u: float, length_v: float, step_u: float, step_v: float) -> Mesh:
        """Return the grid mesh of shape(u, v) -> points (..., 3), u and v in 0..1.

        length_u and length_v are the lengths along u and v; cells are at most step_u and step_v long (m).
        """
        n, m = max(1, math.ceil(length_u / step_u)), max(1, math.ceil(length_v / step_v))
        u, v = np.meshgrid(np.linspace(0.0, 1.0, n + 1), np.linspace(0.0, 1.0, m + 1), indexing="ij")
        points = shape(u.ravel(), v.ravel())
        index = np.arange((n + 1) * (m + 1)).reshape(n + 1, m + 1)
        a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
        faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        rgb = texture.to_rgb(paint(points)) if self.fine else np.full(points.shape, GREY, np.uint8)
        return Mesh(points.astype(np.float32), faces.astype(np.int32), rgb)
