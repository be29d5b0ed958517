from __future__ import annotations

import numpy as np
import pytest
from box_room import BASELINE_M, DEPTH_LENS, HIGH, LOW, NOISE_PX, distance_to_walls, look

from uav_recon.mapping.neural.keyframes.ray_buffer import RAYS_PER_VIEW, RayBuffer, ViewRays
from uav_recon.mapping.neural.keyframes.ray_records import ray_records
from uav_recon.types.camera import PosedFrame

SIGMA = NOISE_PX / (DEPTH_LENS.fx * BASELINE_M)


def _rays(view: PosedFrame, sigma: float) -> ViewRays:
    records, _ = ray_records(view.frame, sigma, RAYS_PER_VIEW, np.random.default_rng(0))
    pose = view.world_from_depth
    return RayBuffer().rays(records, pose.rotation(), pose.translation_m, sigma, np.ones(2))


def test_rays_end_on_the_walls_with_their_normals() -> None:
    rays = _rays(look((1.5, 1.2, 1.0), 20.0), SIGMA / 10)
    points = rays.points[0].astype(np.float64)
    assert len(points) == DEPTH_LENS.width * DEPTH_LENS.height
    assert np.quantile(distance_to_walls(points), 0.98) < 0.003
    gaps = np.minimum(points - LOW, HIGH - points)
    far_from_edges = np.sort(gaps, axis=1)[:, 1] > 0.25
    wall = gaps.argmin(axis=1)
    inward = np.where(points[np.arange(len(points)), wall] < 1.0, 1.0, -1.0)
    along = rays.normal[np.arange(len(points)), wall] * inward
    known = far_from_edges & (rays.cosine > 0)
    assert known.sum() > 0.5 * far_from_edges.sum()
    assert np.quantile(along[known], 0.02) > 0.995


def test_the_plane_fit_reduces_noise() -> None:
    view = look((1.5, 1.2, 1.0), 20.0, sequence=3, sigma_px=0.1)
    rays = _rays(view, 0.1 / (DEPTH_LENS.fx * BASELINE_M))
    v, u = np.nonzero(np.isfinite(view.frame.depth_m))
    raw = view.frame.depth_intrinsics.bearings()[v, u] * view.frame.depth_m[v, u].astype(np.float64)[:, None]
    raw_error = distance_to_walls(view.world_from_depth.apply(raw)).mean()
    assert distance_to_walls(rays.points[0].astype(np.float64)).mean() < 0.5 * raw_error


def test_replay_thins_its_views_to_stay_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uav_recon.mapping.neural.keyframes.ray_buffer.MAX_RAYS", 5000)
    replay = RayBuffer()
    records = np.zeros((1000, 10), dtype=np.int16)
    for n in range(12):
        records[:, 0] = n
        replay.add(records[: 1000 * replay.rays_per_view() // RAYS_PER_VIEW], np.eye(3), np.zeros(3), SIGMA, np.ones(2))
    first = replay.views.first[: replay.count + 1]
    assert replay.count == 12
    assert first[-1] <= 5000
    assert (np.diff(first) > 0).all()
    for n in range(12):
        assert (replay.views.records[first[n] : first[n + 1], 0] == n).all()
