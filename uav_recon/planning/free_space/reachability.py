"""The parts of flyable space that are connected to the vehicle.

They are kept as a tree of parent links. When blocks change, only the descendants of the changed parts look for another
parent (adoption, Boykov and Kolmogorov, 2004). The cost thus depends on the size of the change, not of the map, and the
result is exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.planning.free_space.voxel_blocks import (
    EDGE,
    MAX_PARTS,
    ONE,
    VoxelBlocks,
    WordArray,
    blocks_of,
    corner_of,
    link,
    meets,
    part_around,
    part_at,
    split,
    word_of,
)
from uav_recon.types.frames import ByteArray, IntArray
from uav_recon.types.maps import TILE

PartArray = NDArray[np.int32]

# values of parent; otherwise the parent's number + 1; the root is its own parent
DETACHED = 0
ORPHAN = -1


class ReachableSpace:
    """The blocks of a padded mask, and which of their parts are connected to the root.

    parent: (8 * blocks,) int32, DETACHED, ORPHAN, or a part's number + 1.
    reachable: padded uint8 like the mask, 1 = connected to the root.
    tile_revision: (tiles along x, along y) int64, the revision at which ``reachable`` last changed in a tile.
    """

    def __init__(self, grid_shape: tuple[int, int, int]) -> None:
        """Create a space without flyable voxels."""
        nx, ny, nz = grid_shape
        self.blocks = blocks_of(grid_shape)
        number = len(self.blocks.counts)
        self.parent = np.zeros(MAX_PARTS * number, dtype=np.int32)
        self.reachable = np.zeros((nx + 2, ny + 2, nz + 2), dtype=np.uint8)
        self.tile_revision = np.zeros((-(-nx // TILE), -(-ny // TILE)), dtype=np.int64)
        self._shown = np.zeros(number, dtype=np.uint64)
        self._checked = np.zeros(MAX_PARTS * number, dtype=np.int32)
        self._orphans = np.empty(MAX_PARTS * number, dtype=np.int32)
        self._queue = np.empty(2 * MAX_PARTS * number, dtype=np.int32)
        self._now = 0
        self._root = -1

    def update(self, mask: ByteArray, changed: IntArray, revision: int) -> None:
        """Read the changed blocks (N,) from a padded mask and update ``reachable``.

        Each block is listed once. The time is proportional to the number of changed blocks.
        """
        self._now += 1
        self._root, orphans, queued = _reshape(self.blocks, mask, changed, self.parent, self._root, self._orphans, self._queue)
        queued = _adopt(self.blocks, self.parent, self._checked, self._now, self._orphans, orphans, self._queue, queued)
        self._grow(queued, revision)
        _show(changed, self.blocks, self.parent, self._shown, self.reachable, self.tile_revision, revision)

    def set_root(self, i: int, j: int, k: int, revision: int) -> None:
        """Set the root to a PADDED flyable voxel, so that ``reachable`` is what is connected to it.

        Returns at once if the voxel is reachable already. Otherwise the cost is proportional to the parts detached and
        attached. Raises ValueError if the voxel is not flyable.
        """
        part = int(part_at(self.blocks, i, j, k))
        if part < 0:
            raise ValueError(f"voxel ({i}, {j}, {k}) is not flyable")
        if self.parent[part] != DETACHED:
            return
        if self._root >= 0:
            self._show_queued(int(_detach(self.blocks, self.parent, self._queue, self._root)), revision)
        self._root = part
        self.parent[part] = part + 1
        self._queue[0] = part
        self._grow(1, revision)

    def _grow(self, queued: int, revision: int) -> None:
        self._show_queued(int(_grow(self.blocks, self.parent, self._queue, queued)), revision)

    def _show_queued(self, count: int, revision: int) -> None:
        changed = self._queue[:count].astype(np.int64) % len(self.blocks.counts)
        _show(changed, self.blocks, self.parent, self._shown, self.reachable, self.tile_revision, revision)


@kernel
def _reshape(  # noqa: C901
    blocks: VoxelBlocks, mask: ByteArray, changed: IntArray, parent: PartArray, root: int, orphans: PartArray, queue: PartArray
) -> tuple[int, int, int]:
    """Read the changed blocks and split them into parts.

    Returns the root (-1: lost) and the numbers of orphans and of queued parts.
    """
    number = len(blocks.counts)
    size, queued = 0, 0
    for block in changed:
        word, before = word_of(blocks, block, mask), blocks.words[block]
        if blocks.counts[block] == 1 and before & ~word == 0 and part_around(before, word) == word:
            blocks.words[block] = word  # the part only grew, so its connection remains valid
            queue[queued] = block
            queued += 1
            continue
        rooted = np.uint64(0)
        for c in range(blocks.counts[block]):
            part = c * number + block
            if parent[part] != DETACHED:
                size = _orphan_children(blocks, parent, part, orphans, size)
            if part == root:
                rooted = blocks.words[part]
                root = -1
            parent[part] = DETACHED
        split(blocks, block, word)
        for c in range(blocks.counts[block]):
            part = c * number + block
            if blocks.words[part] & rooted != 0 and root < 0:
                root = part
                parent[part] = part + 1
            queue[queued] = part
            queued += 1
    for block in changed:
        link(blocks, block)
    if root < 0:
        for n in range(size):
            if root < 0 and parent[orphans[n]] == ORPHAN:
                root = orphans[n]
                parent[root] = root + 1
    return root, size, queued


@kernel
def _orphan_children(blocks: VoxelBlocks, parent: PartArray, part: int, orphans: PartArray, size: int) -> int:
    number = len(blocks.counts)
    for side in range(26):
        beside = part % number + blocks.steps[side]
        for c in range(blocks.counts[beside]):
            if parent[c * number + beside] == part + 1:
                parent[c * number + beside] = ORPHAN
                orphans[size] = c * number + beside
                size += 1
    return size


@kernel
def _hangs_on_root(parent: PartArray, checked: PartArray, now: int, part: int) -> bool:
    """Return True if the parent links of a part lead to the root; mark the path if they do."""
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
    blocks: VoxelBlocks,
    parent: PartArray,
    checked: PartArray,
    now: int,
    orphans: PartArray,
    size: int,
    queue: PartArray,
    queued: int,
) -> int:
    """Find another parent for each orphan.

    An orphan without a parent is detached and queued, and its children become orphans. Returns the number of queued parts.
    """
    number = len(blocks.counts)
    first = 0
    while first < size:
        part = orphans[first]
        first += 1
        if parent[part] != ORPHAN:
            continue
        for side in range(26):
            beside = part % number + blocks.steps[side]
            for c in range(blocks.counts[beside] if (blocks.links[part] >> side) & 1 else 0):
                other = c * number + beside
                if parent[part] != ORPHAN or parent[other] <= 0:
                    continue
                if meets(blocks, part, side, other) and _hangs_on_root(parent, checked, now, other):
                    parent[part] = other + 1
        if parent[part] == ORPHAN:
            parent[part] = DETACHED
            queue[queued] = part
            queued += 1
            size = _orphan_children(blocks, parent, part, orphans, size)
    return queued


@kernel
def _grow(blocks: VoxelBlocks, parent: PartArray, queue: PartArray, queued: int) -> int:
    """Attach the queued parts that touch the tree, then the parts that touch those, and so on.

    Returns the number of queued parts at the end.
    """
    number = len(blocks.counts)
    first = 0
    while first < queued:
        part = queue[first]
        first += 1
        block = part % number
        for side in range(26):
            if parent[part] != DETACHED:
                break
            beside = block + blocks.steps[side]
            for c in range(blocks.counts[beside] if (blocks.links[part] >> side) & 1 else 0):
                other = c * number + beside
                if parent[other] > 0 and meets(blocks, part, side, other):
                    parent[part] = other + 1
        if parent[part] == DETACHED:
            continue
        for side in range(26):
            beside = block + blocks.steps[side]
            for c in range(blocks.counts[beside] if (blocks.links[part] >> side) & 1 else 0):
                other = c * number + beside
                if parent[other] == DETACHED and meets(blocks, part, side, other):
                    parent[other] = part + 1
                    queue[queued] = other
                    queued += 1
    return queued


@kernel
def _detach(blocks: VoxelBlocks, parent: PartArray, queue: PartArray, root: int) -> int:
    """Detach the whole tree and return the number of its parts, which are all in the queue."""
    number = len(blocks.counts)
    queue[0] = root
    parent[root] = DETACHED
    first, queued = 0, 1
    while first < queued:
        part = queue[first]
        first += 1
        for side in range(26):
            beside = part % number + blocks.steps[side]
            for c in range(blocks.counts[beside] if (blocks.links[part] >> side) & 1 else 0):
                other = c * number + beside
                if parent[other] != DETACHED and meets(blocks, part, side, other):
                    parent[other] = DETACHED
                    queue[queued] = other
                    queued += 1
    return queued


@kernel
def _show(
    changed: IntArray,
    blocks: VoxelBlocks,
    parent: PartArray,
    shown: WordArray,
    reachable: ByteArray,
    tile_revision: IntArray,
    revision: int,
) -> None:
    """Update the padded mask ``reachable`` in blocks whose connection to the root changed."""
    for block in changed:
        word = np.uint64(0)
        for c in range(blocks.counts[block]):
            part = c * len(blocks.counts) + block
            if parent[part] != DETACHED:
                word |= blocks.words[part]
        differs = word ^ shown[block]
        if differs == 0:
            continue
        shown[block] = word
        i, j, k = corner_of(blocks, block)
        tile_revision[(i - 1) // TILE, (j - 1) // TILE] = revision
        for bit in range(EDGE**3):
            if (differs >> np.uint64(bit)) & ONE:
                reachable[i + bit // 16, j + bit // 4 % 4, k + bit % 4] ^= 1
