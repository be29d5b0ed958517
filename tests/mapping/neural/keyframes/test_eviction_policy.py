from __future__ import annotations

import numpy as np
import pytest

from uav_recon.mapping.neural.keyframes.eviction_policy import CELL_M, EvictionPolicy
from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.keyframes.ray_sampling import RECENT_VIEWS
from uav_recon.types.frames import Float32Array


def _patch(cell: int, size: int = 10) -> Float32Array:
    """End points in ``size`` cells of a row, from a number on; four of each, because every fourth is looked at."""
    x = (np.repeat(cell + np.arange(size), 4) + 0.5) * CELL_M
    return np.stack([x, np.full_like(x, 2.0), np.full_like(x, 1.0)], axis=1).astype(np.float32)


def _of(cells: list[int]) -> EvictionPolicy:
    remembered = EvictionPolicy()
    for cell in cells:
        remembered.add(remembered.taken, np.array([-100.0, 0.0, 0.0]), _patch(cell))
    return remembered


def test_a_hover_leaves_little_and_a_place_seen_once_stays() -> None:
    cells = [0] * 40 + [1000] + [0] * 40 + [2000, 2000, 2000]
    which = _of(cells).most_useful(20)
    assert which.sum() == 20
    assert which[40]
    assert which[-RECENT_VIEWS:].all()
    hover = np.flatnonzero(which[:81])
    assert np.diff(hover).max() <= 16  # what stays of it is spread over its time


def test_the_same_place_from_the_other_side_counts_for_itself() -> None:
    remembered = _of([0] * 10)
    remembered.add(remembered.taken, np.array([100.0, 0.0, 0.0]), _patch(0))
    for _ in range(10):
        remembered.add(remembered.taken, np.array([-100.0, 0.0, 0.0]), _patch(0))
    assert remembered.most_useful(8)[10]


def test_forgetting_again_and_again_keeps_all_parts_of_a_flight() -> None:
    remembered, random = EvictionPolicy(), np.random.default_rng(0)
    for _ in range(2000):
        remembered.add(remembered.taken, np.array([-100.0, 0.0, 0.0]), _patch(int(random.integers(0, 40))))
        if len(remembered.numbers) == 64:
            remembered.keep(remembered.most_useful(48))
    numbers = np.array(remembered.numbers)
    assert remembered.taken == 2000
    assert (np.diff(numbers) > 0).all()
    assert np.diff(numbers).max() < 250  # even spacing would be 40
    assert np.histogram(numbers, bins=4, range=(0, 2000))[0].min() >= 6


def test_replay_keeps_the_rays_of_those_that_stay() -> None:
    replay, random = RayBuffer(), np.random.default_rng(1)
    views = [random.integers(-30000, 30000, (50 + n, 10)).astype(np.int16) for n in range(9)]
    for n, records in enumerate(views):
        replay.add(records, n * np.eye(3), np.full(3, float(n)), 0.1 * n)
    which = np.array([0, 1, 1, 0, 0, 1, 0, 1, 1], dtype=np.bool_)
    replay.keep(which)
    assert replay.count == 5
    for index, n in enumerate(np.flatnonzero(which).tolist()):
        assert np.array_equal(replay.records(index), views[n])
        assert replay.views.rotation[index, 0, 0] == n
        assert replay.views.position[index, 2] == n
        assert replay.views.inverse_depth_sigma[index] == pytest.approx(0.1 * n)
    replay.add(views[0], np.eye(3), np.zeros(3), 0.0)
    assert np.array_equal(replay.records(5), views[0])
