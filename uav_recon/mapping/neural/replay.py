"""All rays of all keyframes, in one growing array, for random replay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.mapping.neural.rays import BEARING_UNIT, COLUMNS, DEPTH_UNIT_M
from uav_recon.mapping.neural.samples import Views, ray_points
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray

RAYS_PER_VIEW = 26_000
MOST_RAYS = 8_000_000  # 160 MB; beyond it every view keeps half of its rays (they are in random order)
OFFSETS_M = np.array([0.0, -0.10, -0.07, -0.04, 0.03, 0.06], dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class ViewRays:
    """One view's end points in world: points (len(OFFSETS_M), N, 3) shifted along the rays (the first by nothing),
    viewing cosine (N,), depth sigma_m (N,), normal (N, 3); all float32.
    """

    points: Float32Array
    cosine: Float32Array
    sigma_m: Float32Array
    normal: Float32Array


class Replay:
    """The arrays behind Views, and how they grow."""

    def __init__(self) -> None:
        self.count, self._share = 0, 1
        self.views = _empty(views=16, rays=16 * RAYS_PER_VIEW)

    def rays_per_view(self) -> int:
        """How many rays the next view should bring."""
        return RAYS_PER_VIEW // self._share

    def rays(self, records: AnyArray, rotation: FloatArray, position: FloatArray, inverse_depth_sigma: float) -> ViewRays:
        """Where the rays of a view end; world_from_depth as rotation (3, 3) and position (3,)."""
        one = Views(
            records,
            np.array([0, len(records)]),
            rotation[None].astype(np.float32),
            position[None].astype(np.float32),
            np.array([inverse_depth_sigma], dtype=np.float32),
        )
        count = len(records)
        points = np.empty((len(OFFSETS_M), count, 3), dtype=np.float32)
        cosine, sigma = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
        normal = np.empty((count, 3), dtype=np.float32)
        ray_points(one, 0, OFFSETS_M, points, cosine, sigma, normal)
        return ViewRays(points, cosine, sigma, normal)

    def add(self, records: AnyArray, rotation: FloatArray, position: FloatArray, inverse_depth_sigma: float) -> None:
        """Append a view."""
        start = int(self.views.first[self.count])
        if start + len(records) > MOST_RAYS:
            self._thin()
            start = int(self.views.first[self.count])
        self._grow(self.count + 1, start + len(records))
        v, n = self.views, self.count
        v.records[start : start + len(records)] = records
        v.rotation[n], v.position[n], v.inverse_depth_sigma[n] = rotation, position, inverse_depth_sigma
        v.first[n + 1] = start + len(records)
        self.count += 1

    def camera_points(self, view: int, most: int) -> tuple[FloatArray, FloatArray]:
        """Up to ``most`` measured points of a view in its camera (N, 3) and their depth sigma (N,)."""
        v = self.views
        records = v.records[v.first[view] : min(v.first[view + 1], v.first[view] + most)].astype(np.float64)
        z = records[:, 2] * DEPTH_UNIT_M
        points = np.stack([records[:, 0] * BEARING_UNIT * z, records[:, 1] * BEARING_UNIT * z, z], axis=1)
        return points, z * z * float(v.inverse_depth_sigma[view])

    def _grow(self, views: int, rays: int) -> None:
        old = self.views
        if views <= len(old.rotation) and rays <= len(old.records):
            return
        fresh = _empty(max(2 * len(old.rotation), views), max(2 * len(old.records), rays))
        for name in Views._fields:
            source = getattr(old, name)
            getattr(fresh, name)[: len(source)] = source
        self.views = fresh

    def _thin(self) -> None:
        v, end = self.views, 0
        for n in range(self.count):
            start, keep = int(v.first[n]), max(1, int(v.first[n + 1] - v.first[n]) // 2)
            v.records[end : end + keep] = v.records[start : start + keep].copy()
            v.first[n] = end
            end += keep
        v.first[self.count] = end
        self._share *= 2


def _empty(views: int, rays: int) -> Views:
    return Views(
        np.zeros((rays, COLUMNS), dtype=np.int16),
        np.zeros(views + 1, dtype=np.int64),
        np.zeros((views, 3, 3), dtype=np.float32),
        np.zeros((views, 3), dtype=np.float32),
        np.zeros(views, dtype=np.float32),
    )
