"""The parts of flyable space that hang together with the vehicle.

They are kept as a tree of parents. When blocks change, only what hung on them looks for another parent (the adoption of
Boykov and Kolmogorov, 2004), so the cost follows the change, not the map, and the answer is exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.planning.blocks import EDGE, MOST_PARTS, ONE, SIDES, WordArray, part_around, part_with, split, touches, word_of
from uav_recon.types.frames import ByteArray, IntArray
from uav_recon.types.maps import TILE

PartArray = NDArray[np.int32]

DETACHED, ORPHAN = 0, -1  # values of parent; otherwise the parent's number + 1, the root is its own parent


@kernel
def _orphan_children(
    words: WordArray, counts: ByteArray, parent: PartArray, steps: IntArray, part: int, queue: PartArray, size: int
) -> int:
    blocks = len(counts)
    for side in range(26):
        beside = part % blocks + steps[side]
        for c in range(counts[beside]):
            if parent[c * blocks + beside] == part + 1 and c * blocks + beside != part:
                parent[c * blocks + beside] = ORPHAN
                queue[size] = c * blocks + beside
                size += 1
    return size


@kernel
def _hangs_on_root(parent: PartArray, checked: PartArray, part: int, now: int) -> bool:
    """Follow the parents; the way is marked where it leads to the root."""
    at = part
    while checked[at] != now:
        above = parent[at]
        if above <= 0:
            return False
        if above == at + 1:
            break
        at = above - 1
    while checked[part] != now:
        checked[part] = now
        part = parent[part] - 1
    return True


@kernel
def _adopt(
    words: WordArray,
    counts: ByteArray,
    parent: PartArray,
    checked: PartArray,
    steps: IntArray,
    orphans: PartArray,
    size: int,
    queue: PartArray,
    queued: int,
    now: int,
) -> int:
    """Find each orphan another parent; who finds none is detached, queued, and makes orphans of its children."""
    blocks = len(counts)
    first = 0
    while first < size:
        part = orphans[first]
        first += 1
        if parent[part] != ORPHAN:
            continue
        block = part % blocks
        for side in range(26):
            beside = block + steps[side]
            for c in range(counts[beside]):
                other = c * blocks + beside
                if parent[part] != ORPHAN or parent[other] <= 0:
                    continue
                if touches(words[part], words[other], side) and _hangs_on_root(parent, checked, other, now):
                    parent[part] = other + 1
        if parent[part] == ORPHAN:
            parent[part] = DETACHED
            queue[queued] = part
            queued += 1
            size = _orphan_children(words, counts, parent, steps, part, orphans, size)
    return queued


@kernel
def _grow(words: WordArray, counts: ByteArray, parent: PartArray, steps: IntArray, queue: PartArray, queued: int) -> int:
    """Attach the queued parts that touch the tree, then whatever touches them, and so on; how many are queued in the end."""
    blocks = len(counts)
    first = 0
    while first < queued:
        part = queue[first]
        first += 1
        block = part % blocks
        if parent[part] == DETACHED and words[part] != 0:
            for side in range(26):
                beside = block + steps[side]
                for c in range(counts[beside]):
                    other = c * blocks + beside
                    if parent[part] == DETACHED and parent[other] > 0 and touches(words[part], words[other], side):
                        parent[part] = other + 1
        if parent[part] == DETACHED:
            continue
        for side in range(26):
            beside = block + steps[side]
            for c in range(counts[beside]):
                other = c * blocks + beside
                if parent[other] == DETACHED and touches(words[part], words[other], side):
                    parent[other] = part + 1
                    queue[queued] = other
                    queued += 1
    return queued


@kernel
def _detach(words: WordArray, counts: ByteArray, parent: PartArray, steps: IntArray, queue: PartArray, root: int) -> int:
    """Detach the whole tree; how many parts it had, all in the queue."""
    blocks = len(counts)
    queue[0] = root
    parent[root] = DETACHED
    first, queued = 0, 1
    while first < queued:
        part = queue[first]
        first += 1
        for side in range(26):
            beside = part % blocks + steps[side]
            for c in range(counts[beside]):
                other = c * blocks + beside
                if parent[other] != DETACHED and touches(words[part], words[other], side):
                    parent[other] = DETACHED
                    queue[queued] = other
                    queued += 1
    return queued


@kernel
def _reshape(
    mask: ByteArray,
    shape: IntArray,
    changed: IntArray,
    words: WordArray,
    counts: ByteArray,
    parent: PartArray,
    steps: IntArray,
    root: int,
    orphans: PartArray,
    queue: PartArray,
) -> tuple[int, int, int]:
    """Read the changed blocks anew; the root (-1: lost), how many orphans there are and how many parts are queued."""
    blocks = len(counts)
    size, queued = 0, 0
    for block in changed:
        word, before = word_of(mask, block, shape), words[block]
        if counts[block] == 1 and before & ~word == 0 and part_around(before, word) == word:
            words[block] = word  # it only grew: whatever it hung on, it still does
            queue[queued] = block
            queued += 1
            continue
        rooted = np.uint64(0)
        for c in range(counts[block]):
            part = c * blocks + block
            if parent[part] != DETACHED:
                size = _orphan_children(words, counts, parent, steps, part, orphans, size)
            if part == root:
                rooted = words[part]
                root = -1
            parent[part] = DETACHED
        split(words, counts, block, word)
        for c in range(counts[block]):
            part = c * blocks + block
            if words[part] & rooted != 0 and root < 0:
                root = part
                parent[part] = part + 1
            queue[queued] = part
            queued += 1
    if root < 0:
        for n in range(size):
            if root < 0 and parent[orphans[n]] == ORPHAN:
                root = orphans[n]
                parent[root] = root + 1
    return root, size, queued


@kernel
def _show(
    blocks_shown: IntArray,
    shape: IntArray,
    words: WordArray,
    counts: ByteArray,
    parent: PartArray,
    shown: WordArray,
    reachable: ByteArray,
    tile_revision: IntArray,
    revision: int,
) -> None:
    """Write the voxels of blocks that came to hang on the root, or no longer do, into the padded mask ``reachable``."""
    blocks = len(counts)
    for block in blocks_shown:
        word = np.uint64(0)
        for c in range(counts[block]):
            if parent[c * blocks + block] != DETACHED:
                word |= words[c * blocks + block]
        differs = word ^ shown[block]
        if differs == 0:
            continue
        shown[block] = word
        bz, by = block % shape[2], block // shape[2] % shape[1]
        bx = block // (shape[1] * shape[2])
        tile_revision[(bx - 1) // 2, (by - 1) // 2] = revision
        for bit in range(64):
            if (differs >> np.uint64(bit)) & ONE:
                i, j, k = bx * EDGE - 3 + bit // 16, by * EDGE - 3 + bit // 4 % 4, bz * EDGE - 3 + bit % 4
                reachable[i, j, k] ^= 1


class Regions:
    """Blocks, their parts, and which parts hang together with the root.

    shape: (3,) blocks along each axis, the border included. words: (8 * blocks,) uint64, voxels of each part, 0 = no such
    part. counts: (blocks,) uint8 parts of a block. parent: (8 * blocks,) int32, DETACHED, or a part's number + 1.
    reachable: padded uint8 like the mask, 1 = hangs together with the root. tile_revision: (tiles along x, along y) int64,
    the revision at which ``reachable`` last changed in a tile.
    """

    def __init__(self, grid_shape: tuple[int, int, int]) -> None:
        """Nothing is flyable yet. Memory is committed by the system only where something is."""
        nx, ny, nz = grid_shape
        self.shape = np.array([-(-n // EDGE) + 2 for n in grid_shape], dtype=np.int64)
        blocks = int(np.prod(self.shape))
        strides = np.array([self.shape[1] * self.shape[2], self.shape[2], 1], dtype=np.int64)
        self.steps: IntArray = SIDES @ strides
        self.words = np.zeros(MOST_PARTS * blocks, dtype=np.uint64)
        self.counts = np.zeros(blocks, dtype=np.uint8)
        self.parent = np.zeros(MOST_PARTS * blocks, dtype=np.int32)
        self.reachable = np.zeros((nx + 2, ny + 2, nz + 2), dtype=np.uint8)
        self.tile_revision = np.zeros((-(-nx // TILE), -(-ny // TILE)), dtype=np.int64)
        self._shown = np.zeros(blocks, dtype=np.uint64)
        self._checked = np.zeros(MOST_PARTS * blocks, dtype=np.int32)
        self._orphans = np.empty(MOST_PARTS * blocks, dtype=np.int32)
        self._queue = np.empty(2 * MOST_PARTS * blocks, dtype=np.int32)
        self._now = 0
        self._root = -1

    def update(self, mask: ByteArray, changed: IntArray, revision: int) -> None:
        """Read changed blocks (N,) of a padded mask anew; each once. The time follows their number."""
        self._root, orphans, queued = _reshape(
            mask, self.shape, changed, self.words, self.counts, self.parent, self.steps, self._root, self._orphans, self._queue
        )
        self._now += 1
        queued = _adopt(
            self.words,
            self.counts,
            self.parent,
            self._checked,
            self.steps,
            self._orphans,
            orphans,
            self._queue,
            queued,
            self._now,
        )
        queued = _grow(self.words, self.counts, self.parent, self.steps, self._queue, queued)
        self._show(changed, revision)
        self._show_queued(queued, revision)

    def part_at(self, i: int, j: int, k: int) -> int:
        """Number of the part that holds a PADDED voxel; -1 for none."""
        block = int(((i + 3) // EDGE * self.shape[1] + (j + 3) // EDGE) * self.shape[2] + (k + 3) // EDGE)
        return int(part_with(self.words, self.counts, block, (i + 3) % EDGE * 16 + (j + 3) % EDGE * 4 + (k + 3) % EDGE))

    def hang_on(self, part: int, revision: int) -> None:
        """Make ``reachable`` what hangs together with this part. Costs nothing if it does already, else the size of both."""
        if self.parent[part] != DETACHED:
            return
        if self._root >= 0:
            lost = _detach(self.words, self.counts, self.parent, self.steps, self._queue, self._root)
            self._show_queued(lost, revision)
        self._root, self.parent[part], self._queue[0] = part, part + 1, part
        queued = _grow(self.words, self.counts, self.parent, self.steps, self._queue, 1)
        self._show_queued(queued, revision)

    def _show_queued(self, count: int, revision: int) -> None:
        self._show(self._queue[:count].astype(np.int64) % len(self.counts), revision)

    def _show(self, blocks: IntArray, revision: int) -> None:
        _show(
            blocks, self.shape, self.words, self.counts, self.parent, self._shown, self.reachable, self.tile_revision, revision
        )
