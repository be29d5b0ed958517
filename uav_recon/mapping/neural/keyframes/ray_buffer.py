"""Buffer of the rays of the kept keyframes, in one array, for random sampling.

Bounded to MAX_VIEWS views and MAX_RAYS rays. The whole array is reserved at once, and the system assigns memory to the pages
that are written, so the array is never copied to grow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from uav_recon.mapping.neural.keyframes.ray_records import BEARING_UNIT, COLUMNS, DEPTH_UNIT_M, NORMAL_UNIT
from uav_recon.mapping.neural.keyframes.ray_sampling import Views, ray_points
from uav_recon.types.frames import AnyArray, BoolArray, Float32Array, FloatArray, IntArray

RAYS_PER_VIEW = 26_000
MAX_VIEWS = 512
MAX_RAYS = 8_000_000  # 160 MB; beyond it every view keeps half of its rays (they are in random order)
OFFSETS_M = np.array([0.0, -0.10, -0.07, -0.04, 0.03, 0.06], dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class ViewRays:
    """End points of one view in world; all float32.

    points (len(OFFSETS_M), N, 3): shifted along the rays (the first set not at all); cosine (N,): viewing cosine; sigma_m
    (N,): depth sigma; normal (N, 3).
    """

    points: Float32Array
    cosine: Float32Array
    sigma_m: Float32Array
    normal: Float32Array


class RayBuffer:
    """Owner of the arrays of Views."""

    def __init__(self) -> None:
        self.count = 0
        self._share = 1
        self.views = _empty()

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a checkpoint, without the records, which it stores by view.

        See records() and put_back().
        """
        used = {name: getattr(self.views, name)[: self.count] for name in Views._fields if name not in ("records", "first")}
        return {"count": self.count, "share": self._share, "first": self.views.first[: self.count + 1], "used": used}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.count = state["count"]
        self._share = state["share"]
        self.views = _empty()
        self.views.first[: self.count + 1] = state["first"]
        for name, values in state["used"].items():
            getattr(self.views, name)[: self.count] = values

    def rays_per_view(self) -> int:
        """Return the number of rays wanted from the next view."""
        return RAYS_PER_VIEW // self._share

    def rays(
        self,
        records: AnyArray,
        rotation: FloatArray,
        position: FloatArray,
        inverse_depth_sigma: float,
        stretch: AnyArray,
    ) -> ViewRays:
        """Return the end points of rays.

        world_from_depth as rotation (3, 3) and position (3,); stretch (2,): see Views.
        """
        one = Views(
            records,
            np.array([0, len(records)]),
            rotation[None].astype(np.float32),
            position[None].astype(np.float32),
            np.array([inverse_depth_sigma], dtype=np.float32),
            np.ones((1, 3), dtype=np.float32),
            stretch[None].astype(np.float32),
        )
        count = len(records)
        points = np.empty((len(OFFSETS_M), count, 3), dtype=np.float32)
        cosine, sigma = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
        normal = np.empty((count, 3), dtype=np.float32)
        ray_points(one, 0, OFFSETS_M, points, cosine, sigma, normal)
        return ViewRays(points, cosine, sigma, normal)

    def add(
        self,
        records: AnyArray,
        rotation: FloatArray,
        position: FloatArray,
        inverse_depth_sigma: float,
        stretch: AnyArray,
    ) -> None:
        """Append a view, given as to rays(). Raises IndexError beyond MAX_VIEWS: keep() makes room."""
        start = int(self.views.first[self.count])
        if start + len(records) > MAX_RAYS:
            self._thin()
            start = int(self.views.first[self.count])
        v, n = self.views, self.count
        v.records[start : start + len(records)] = records
        v.rotation[n], v.position[n], v.inverse_depth_sigma[n] = rotation, position, inverse_depth_sigma
        v.gain[n], v.stretch[n], v.first[n + 1] = 1.0, stretch, start + len(records)
        self.count += 1

    def pose(self, view: int) -> tuple[FloatArray, FloatArray]:
        """Return the current pose of a view: world_from_depth as rotation (3, 3), position (3,)."""
        return self.views.rotation[view].astype(np.float64), self.views.position[view].astype(np.float64)

    def place(self, view: int, rotation: FloatArray, position: FloatArray, stretch: AnyArray) -> None:
        """Change pose and lens of a view: world_from_depth as in pose(), stretch (2,) as in Views."""
        v = self.views
        v.rotation[view], v.position[view], v.stretch[view] = rotation, position, stretch

    def records(self, view: int) -> AnyArray:
        """Return the rays (N, COLUMNS) of a view, read-only."""
        v = self.views
        return v.records[v.first[view] : v.first[view + 1]]

    def some_points(self, views: int, rays: int) -> tuple[Float32Array, Float32Array]:
        """Return measured points (N, 3) and normals (N, 3) in world.

        Up to ``rays`` points from each of up to ``views`` views, spread evenly; only points with a normal.
        """
        v = self.views
        view = np.unique(np.linspace(0, self.count - 1, min(self.count, views)).astype(int)) if self.count else np.zeros(0, int)
        row = v.first[view][:, None] + np.arange(rays)
        view, row = np.broadcast_to(view[:, None], row.shape), np.minimum(row, v.first[view + 1][:, None] - 1)
        view, records = view.ravel(), v.records[row.ravel()]
        known = records[:, 3:6].any(axis=1)
        view, records = view[known], records[known].astype(np.float32)
        z = records[:, 2] * np.float32(DEPTH_UNIT_M) * v.stretch[view, 1]
        slope = records[:, :2] * np.float32(BEARING_UNIT) * v.stretch[view, :1]
        camera = np.stack([slope[:, 0] * z, slope[:, 1] * z, z], axis=1)
        points = np.einsum("nij,nj->ni", v.rotation[view], camera) + v.position[view]
        return points, np.einsum("nij,nj->ni", v.rotation[view], records[:, 3:6] * np.float32(NORMAL_UNIT))

    def put_back(self, view: int, records: AnyArray) -> None:
        """Restore the rays (N, COLUMNS) of a view after unpickling.

        If the view was thinned in the meantime, the first rays are used. Raises ValueError if they do not belong to it.
        """
        mine = self.records(view)
        if len(records) < len(mine):
            raise ValueError(f"view {view} has {len(mine)} rays, not {len(records)}")
        mine[...] = records[: len(mine)]

    def keep(self, which: BoolArray) -> None:
        """Drop all views except those selected by a mask (V,)."""
        rays = np.diff(self.views.first[: self.count + 1])
        self._close_up(np.flatnonzero(which), rays)

    def _thin(self) -> None:
        rays = np.maximum(np.diff(self.views.first[: self.count + 1]) // 2, 1)
        self._close_up(np.arange(self.count), rays)
        self._share *= 2

    def _close_up(self, kept: IntArray, rays: IntArray) -> None:
        """Move the views kept (K,), ascending, to the front, each with the first of its rays (V,)."""
        v, end = self.views, 0
        for n, view in enumerate(kept):
            start, count = int(v.first[view]), int(rays[view])
            v.records[end : end + count] = v.records[start : start + count].copy()
            v.first[n] = end  # first[view] of a later view is still the old value: n <= view
            end += count
        self.count = len(kept)
        v.first[self.count] = end
        for name in Views._fields:
            if name not in ("records", "first"):
                values = getattr(v, name)
                values[: self.count] = values[kept]


def _empty() -> Views:
    return Views(
        np.zeros((MAX_RAYS, COLUMNS), dtype=np.int16),
        np.zeros(MAX_VIEWS + 1, dtype=np.int64),
        np.zeros((MAX_VIEWS, 3, 3), dtype=np.float32),
        np.zeros((MAX_VIEWS, 3), dtype=np.float32),
        np.zeros(MAX_VIEWS, dtype=np.float32),
        np.ones((MAX_VIEWS, 3), dtype=np.float32),
        np.ones((MAX_VIEWS, 2), dtype=np.float32),
    )
