from __future__ import annotations

import itertools

import numpy as np
from skimage.graph import MCP_Geometric

from uav_recon.planning.search import chain, distances_from, length_of, line_is_open, pull
from uav_recon.types.frames import ByteArray

NO_TARGETS = np.zeros(0, dtype=np.int64)


def random_mask(rng: np.random.Generator, share_open: float) -> ByteArray:
    inner = (rng.random(tuple(rng.integers(3, 14, 3))) < share_open).astype(np.uint8)
    return np.pad(inner, 1)


def test_distances_are_those_of_an_independent_search() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        mask = random_mask(rng, rng.uniform(0.3, 1.0))
        cells = np.flatnonzero(mask)
        if not len(cells):
            continue
        source = int(rng.choice(cells))
        distance, _ = distances_from(mask, source, NO_TARGETS, np.inf)
        oracle = MCP_Geometric(np.where(mask > 0, 1.0, -1.0), fully_connected=True)
        expected, _ = oracle.find_costs([np.unravel_index(source, mask.shape)])
        np.testing.assert_allclose(distance, expected.ravel(), atol=1e-9)


def test_targets_are_exact_although_the_search_stops_early() -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        mask = random_mask(rng, 0.7)
        cells = np.flatnonzero(mask)
        source, targets = int(cells[0]), rng.choice(cells, 3)
        whole, _ = distances_from(mask, source, NO_TARGETS, np.inf)
        some, _ = distances_from(mask, source, targets, np.inf)
        np.testing.assert_array_equal(some[targets], whole[targets])


def test_a_limit_leaves_out_what_is_farther_and_nothing_else() -> None:
    mask = np.pad(np.ones((9, 9, 9), dtype=np.uint8), 1)
    source = int(np.ravel_multi_index((5, 5, 5), mask.shape))
    whole, _ = distances_from(mask, source, NO_TARGETS, np.inf)
    near, _ = distances_from(mask, source, NO_TARGETS, 3.3)
    np.testing.assert_array_equal(np.isfinite(near), whole <= 3.3)


def test_pulled_paths_stay_open_keep_their_ends_and_are_never_longer() -> None:
    rng = np.random.default_rng(2)
    pulled_something = 0
    for _ in range(30):
        mask = random_mask(rng, 0.8)
        cells = np.flatnonzero(mask)
        distance, previous = distances_from(mask, int(cells[0]), NO_TARGETS, np.inf)
        reached = cells[np.isfinite(distance[cells])]
        target = int(reached[np.argmax(distance[reached])])
        points = np.asarray(np.argwhere(np.ones_like(mask))[chain(previous, target)] + 0.5)
        pulled = pull(mask, points)
        np.testing.assert_array_equal(pulled[[0, -1]], points[[0, -1]])
        assert all(line_is_open(mask, a, b) for a, b in itertools.pairwise(pulled))
        assert length_of(pulled) <= length_of(points) + 1e-9
        assert np.isclose(length_of(points), distance[target])
        pulled_something += len(pulled) < len(points)
    assert pulled_something > 5


def test_a_line_is_closed_by_a_single_voxel_in_its_way() -> None:
    mask = np.ones((5, 5, 5), dtype=np.uint8)
    a, b = np.array([0.5, 2.5, 2.5]), np.array([4.5, 2.5, 2.5])
    assert line_is_open(mask, a, b)
    mask[2, 2, 2] = 0
    assert not line_is_open(mask, a, b)
    assert not line_is_open(np.ones((5, 5, 5), dtype=np.uint8), a, np.array([6.5, 2.5, 2.5]))
