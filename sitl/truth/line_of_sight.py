"""Surface points that give a depth return at a camera pose, by ray casting (Open3D)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.camera import d435i
from sitl.scene.scene import Scene

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
OCCLUSION_MARGIN_M = 0.004  # the ray ends this far before the point: only a surface farther in front occludes it


class LineOfSight:
    """Visibility test of points (N, 3) with the unit normals (N, 3) of their triangles.

    Both sides of a triangle are visible.
    """

    def __init__(self, scene: Scene, points: F32, normals: F32) -> None:
        import open3d

        self._tensor: Any = open3d.core.Tensor.from_numpy
        self._rays: Any = open3d.t.geometry.RaycastingScene()
        self._rays.add_triangles(self._tensor(scene.vertices.astype(np.float32)), self._tensor(scene.faces.astype(np.uint32)))
        self._points = points.astype(np.float64)
        self._normals = normals.astype(np.float64)

    def returns(self, candidates: NDArray[np.int64], camera_from_world: F64) -> NDArray[np.int64]:
        """Return the candidate point indices that give a depth return.

        Such a point is inside the image, in range, not at grazing incidence and not occluded. camera_from_world: (4, 4).
        """
        lens, points = d435i.DEPTH_SPEC, self._points[candidates]
        x, y, z = (points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]).T
        safe = np.maximum(z, 1e-6)
        u, v = lens.fx * x / safe + lens.cx, lens.fy * y / safe + lens.cy
        inside = (z >= d435i.RANGE_M[0]) & (z <= d435i.RANGE_M[1])
        inside &= (u >= -0.5) & (u < lens.width - 0.5) & (v >= -0.5) & (v < lens.height - 0.5)
        found, points = candidates[inside], points[inside]
        eye = -camera_from_world[:3, :3].T @ camera_from_world[:3, 3]
        away = points - eye
        distance_m = np.linalg.norm(away, axis=1)
        squarely = np.abs(np.einsum("ij,ij->i", away, self._normals[found])) >= d435i.GRAZING_COS * distance_m
        found, away, distance_m = found[squarely], away[squarely], distance_m[squarely]
        reach = away * (1.0 - OCCLUSION_MARGIN_M / distance_m)[:, None]
        rays = np.concatenate([np.broadcast_to(eye, reach.shape), reach], axis=1).astype(np.float32)
        hidden: NDArray[np.bool_] = self._rays.test_occlusions(self._tensor(np.ascontiguousarray(rays)), 0.0, 1.0).numpy()
        return np.asarray(found[~hidden], dtype=np.int64)
