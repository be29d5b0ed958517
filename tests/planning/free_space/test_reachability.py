"""Reachability by blocks of voxels, against a labelling of all voxels."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from uav_recon.planning.free_space.reachability import ReachableSpace
from uav_recon.planning.free_space.voxel_blocks import EDGE, SIDES, part_around, touches
from uav_recon.types.frames import AnyArray, BoolArray, ByteArray, IntArray

EVERY_NEIGHBOUR = np.ones((3, 3, 3))


def word(voxels: AnyArray) -> np.uint64:
    return np.uint64(sum(1 << int(bit) for bit in np.flatnonzero(voxels)))


def test_two_blocks_touch_if_any_of_their_voxels_are_neighbours() -> None:
    rng = np.random.default_rng(0)
    seen = set()
    for side, step in enumerate(SIDES):
        for _ in range(60):
            a, b = (rng.random((4, 4, 4)) < rng.choice([0.03, 0.3, 0.6]) for _ in range(2))
            near = np.abs((np.argwhere(b) + 4 * step)[None] - np.argwhere(a)[:, None]).max(axis=2) <= 1
            assert touches(word(a), word(b), side) == bool(near.any())
            seen.add((side, bool(near.any())))
    assert len(seen) == 2 * 26


def test_a_part_of_a_block_is_the_connected_component_of_its_voxels() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        voxels = rng.random((4, 4, 4)) < rng.uniform(0.05, 0.5)
        labels, count = ndimage.label(voxels, structure=EVERY_NEIGHBOUR)
        for n in range(1, count + 1):
            first = word(np.arange(64).reshape(4, 4, 4) == np.flatnonzero(labels.ravel() == n)[0])
            assert part_around(first, word(voxels)) == word(labels == n)


def changed_blocks(reachable_space: ReachableSpace, differs: BoolArray) -> IntArray:
    at = np.argwhere(differs[1:-1, 1:-1, 1:-1]) // EDGE + 1
    return np.unique((at[:, 0] * reachable_space.blocks.shape[1] + at[:, 1]) * reachable_space.blocks.shape[2] + at[:, 2])


def connected(mask: ByteArray, cell: IntArray) -> ByteArray:
    labels, _ = ndimage.label(mask, structure=EVERY_NEIGHBOUR)
    return np.asarray((labels == labels[tuple(cell)]) & (mask > 0)).astype(np.uint8)


@pytest.mark.parametrize("seed", range(20))
def test_random_changes_give_the_components_of_a_labelling_from_scratch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(int(n) for n in rng.integers(3, 26, 3))
    share = rng.uniform(0.08, 0.3)  # around the share at which random voxels become connected
    mask = np.pad((rng.random(shape) < share).astype(np.uint8), 1)
    reachable_space = ReachableSpace((shape[0], shape[1], shape[2]))
    reachable_space.update(mask, changed_blocks(reachable_space, mask > 0), 1)
    cell = None
    for revision in range(2, 60):
        if mask.any() and (cell is None or not mask[tuple(cell)] or rng.random() < 0.2):
            cell = rng.choice(np.argwhere(mask))
        if cell is not None and mask[tuple(cell)]:
            i, j, k = (int(n) for n in cell)
            reachable_space.set_root(i, j, k, revision)
            np.testing.assert_array_equal(reachable_space.reachable, connected(mask, cell))
        flips = rng.random(shape) < rng.choice([0.001, 0.01, 0.1])
        if rng.random() < 0.2:  # add or remove a wall
            flips = np.zeros(shape, dtype=bool)
            axis = int(rng.integers(3))
            np.moveaxis(flips, axis, 0)[int(rng.integers(shape[axis]))] = rng.random() < 0.9
        after = mask.copy()
        after[1:-1, 1:-1, 1:-1] ^= flips.astype(np.uint8)
        changed = changed_blocks(reachable_space, after != mask)
        mask = after
        reachable_space.update(mask, changed, revision)


def test_a_block_that_only_grows_keeps_all_parents() -> None:
    mask = np.zeros((14, 6, 6), dtype=np.uint8)
    mask[1:13, 2, 2] = 1
    reachable_space = ReachableSpace((12, 4, 4))
    reachable_space.update(mask, changed_blocks(reachable_space, mask > 0), 1)
    reachable_space.set_root(1, 2, 2, 1)
    parents = reachable_space.parent.copy()
    grown = mask.copy()
    grown[5:9, 2:4, 2] = 1
    reachable_space.update(grown, changed_blocks(reachable_space, grown != mask), 2)
    np.testing.assert_array_equal(reachable_space.parent, parents)
    np.testing.assert_array_equal(reachable_space.reachable, grown)
