from __future__ import annotations

import numpy as np
import pytest

from uav_recon.mapping.neural.keyframes.eviction_policy import CELL_M, EvictionPolicy
from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.keyframes.ray_sampling import RECENT_VIEWS
from uav_recon.types.frames import Float32Array


def _patch(cell: int, size: int = 10) -> Float32Array:
    """Return end points in ``size`` neighbouring cells from a cell number on.

    There are four points in each cell, because the policy uses every fourth point.
    """
    x = (np.repeat(cell + np.arange(size), 4) + 0.5) * CELL_M
    return np.stack([x, np.full_like(x, 2.0), np.full_like(x, 1.0)], axis=1).astype(np.float32)


def _of(cells: list[int]) -> EvictionPolicy:
    remembered = EvictionPolicy()
    for cell in cells:
        remembered.add(remembered.taken, np.array([-100.0, 0.0, 0.0]), _patch(cell))
    return remembered


def test_few_views_of_a_hover_are_kept_and_a_surface_seen_once_stays() -> None:
    cells = [0] * 40 + [1000] + [0] * 40 + [2000, 2000, 2000]
    which = _of(cells).most_useful(20)
    assert which.sum() == 20
    assert which[40]
    assert which[-RECENT_VIEWS:].all()
    hover = np.flatnonzero(which[:81])
    assert np.diff(hover).max() <= 16  # the kept views are spread over the hover


def test_a_surface_seen_from_its_other_side_counts_separately() -> None:
    remembered = _of([0] * 10)
    remembered.add(remembered.taken, np.array([100.0, 0.0, 0.0]), _patch(0))
    for _ in range(10):
        remembered.add(remembered.taken, np.array([-100.0, 0.0, 0.0]), _patch(0))
    assert remembered.most_useful(8)[10]


def test_repeated_eviction_keeps_views_of_all_parts_of_a_flight() -> None:
    remembered, random = EvictionPolicy(), np.random.default_rng(0)
    for _ in range(2000):
        remembered.add(remembered.taken, np.array([-100.0, 0.0, 0.0]), _patch(int(random.integers(0, 40))))
        if len(remembered.numbers) == 64:
            remembered.keep(remembered.most_useful(48))
    numbers = np.array(remembered.numbers)
    assert remembered.taken == 2000
    assert (np.diff(numbers) > 0).all()
    assert np.diff(numbers).max() < 250  # even spacing would give 40
    assert np.histogram(numbers, bins=4, range=(0, 2000))[0].min() >= 6


def test_replay_keeps_the_rays_of_the_kept_views() -> None:
    replay, random = RayBuffer(), np.random.default_rng(1)
    views = [random.integers(-30000, 30000, (50 + n, 10)).astype(np.int16) for n in range(9)]
    for n, records in enumerate(views):
        replay.add(records, n * np.eye(3), np.full(3, float(n)), 0.1 * n, np.full(2, 1.0 + 0.01 * n))
    which = np.array([0, 1, 1, 0, 0, 1, 0, 1, 1], dtype=np.bool_)
    replay.keep(which)
    assert replay.count == 5
    for index, n in enumerate(np.flatnonzero(which).tolist()):
        assert np.array_equal(replay.records(index), views[n])
        assert replay.views.rotation[index, 0, 0] == n
        assert replay.views.position[index, 2] == n
        assert replay.views.inverse_depth_sigma[index] == pytest.approx(0.1 * n)
        assert replay.views.stretch[index] == pytest.approx(np.full(2, 1.0 + 0.01 * n))
    replay.add(views[0], np.eye(3), np.zeros(3), 0.0, np.ones(2))
    assert np.array_equal(replay.records(5), views[0])
