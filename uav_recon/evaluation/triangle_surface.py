"""Triangle surface on which quality is measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray, IntArray, frozen


@dataclass(frozen=True, slots=True, eq=False)
class TriangleSurface:
    """Triangles in world: vertices_world (V, 3) metres, faces (F, 3).

    Raises ValueError if a face has an invalid vertex index.
    """

    vertices_world: FloatArray
    faces: IntArray

    def __post_init__(self) -> None:
        vertices = np.asarray(self.vertices_world, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(self.faces, dtype=np.int64).reshape(-1, 3)
        if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise ValueError(f"faces name vertices {faces.min()} to {faces.max()} of {len(vertices)}")
        object.__setattr__(self, "vertices_world", frozen(vertices))
        object.__setattr__(self, "faces", frozen(faces))

    def areas_m2(self) -> FloatArray:
        """Return the area of each triangle, (F,)."""
        a, b, c = (self.vertices_world[self.faces[:, i]] for i in range(3))
        areas: FloatArray = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return areas

    def sample(self, count: int, seed: int) -> FloatArray:
        """Return points (count, 3), uniform over the area; (0, 3) if there is no area.

        The same seed gives the same points. Stratified over the cumulative area, so that equal areas get equal shares (Turk
        1990 within the triangle).
        """
        areas = self.areas_m2()
        if not areas.sum() > 0.0:
            return np.zeros((0, 3))
        rng = np.random.default_rng(seed)
        cumulated = np.cumsum(areas)
        place = (np.arange(count) + rng.random(count)) / count * cumulated[-1]
        face = np.minimum(np.searchsorted(cumulated, place, side="right"), len(areas) - 1)
        root, along = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
        a, b, c = (self.vertices_world[self.faces[face, i]] for i in range(3))
        points: FloatArray = (1 - root) * a + root * (1 - along) * b + root * along * c
        return points

    def distance_m(self, points_world: FloatArray) -> FloatArray:
        """Return the distance (N,) from points (N, 3) to the nearest triangle; infinite without one."""
        if len(self.faces) == 0:
            return np.full(len(points_world), np.inf)
        import open3d

        tensor = open3d.core.Tensor.from_numpy
        scene = open3d.t.geometry.RaycastingScene()
        scene.add_triangles(tensor(self.vertices_world.astype(np.float32)), tensor(self.faces.astype(np.uint32)))
        found: FloatArray = scene.compute_distance(tensor(points_world.astype(np.float32))).numpy().astype(np.float64)
        return found
