"""Blocks of 4 x 4 x 4 voxels, one 64-bit word each, and the connected parts of each block.

Bit (i * 4 + j) * 4 + k of a word is voxel (i, j, k) of the block. The voxels of a block form at most eight parts
(26-connected within the block). An array of blocks has a border of empty blocks on all sides. Part c of block b has the
number c * blocks + b. Numbers with c > 0 are rare, so that memory is hardly ever touched.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import ByteArray, FloatArray, IntArray

WordArray = NDArray[np.uint64]
LinkArray = NDArray[np.uint32]

EDGE = 4  # voxels along the edge of a block
MAX_PARTS = 8

ONE = np.uint64(1)
_FOUR = np.uint64(4)
_SIXTEEN = np.uint64(16)
_K0 = np.uint64(0x1111111111111111)  # voxels with k = 0, with k = 3, ...
_K3 = np.uint64(0x8888888888888888)
_J0 = np.uint64(0x000F000F000F000F)
_J3 = np.uint64(0xF000F000F000F000)
ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
_NOT_K0 = ALL ^ _K0
_NOT_K3 = ALL ^ _K3
_NOT_J0 = ALL ^ _J0
_NOT_J3 = ALL ^ _J3

SIDES = np.array(
    [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) != (0, 0, 0)], dtype=np.int64
)
_FROM_MIDDLE_2 = [(bit // 16 - 1.5) ** 2 + (bit // 4 % 4 - 1.5) ** 2 + (bit % 4 - 1.5) ** 2 for bit in range(64)]
FROM_MIDDLE = np.argsort(_FROM_MIDDLE_2, kind="stable")  # bit numbers of a block's voxels, those nearest to its middle first
_SLICES = {
    1: (0xFFFF000000000000, 0xF000F000F000F000, 0x8888888888888888),
    -1: (0xFFFF, 0x000F000F000F000F, 0x1111111111111111),
}


def _side_words() -> tuple[WordArray, WordArray, WordArray]:
    """Return, for each side, the mask of its voxels and two shifts.

    Shifting right by the second array and left by the third one moves a side's voxels to their positions in the word of the
    neighbouring block.
    """
    keep, right, left = [], [], []
    for side in SIDES:
        word, moves = int(ALL), 0
        for axis, shift in enumerate((48, 12, 3)):
            if side[axis]:
                word &= _SLICES[int(side[axis])][axis]
                moves += shift * int(side[axis])
        keep.append(word)
        right.append(max(moves, 0))
        left.append(max(-moves, 0))
    return np.array(keep, dtype=np.uint64), np.array(right, dtype=np.uint64), np.array(left, dtype=np.uint64)


_KEEP, _RIGHT, _LEFT = _side_words()


@kernel
def touches(a: np.uint64, b: np.uint64, side: int) -> bool:
    """Return True if voxels ``a`` of a block touch voxels ``b`` of its neighbour on ``side``.

    Voxels touch if they are 26-connected.
    """
    word = a
    if SIDES[side, 0] == 0:
        word |= (word << _SIXTEEN) | (word >> _SIXTEEN)
    if SIDES[side, 1] == 0:
        word |= ((word & _NOT_J3) << _FOUR) | ((word & _NOT_J0) >> _FOUR)
    if SIDES[side, 2] == 0:
        word |= ((word & _NOT_K3) << ONE) | ((word & _NOT_K0) >> ONE)
    word = ((word & _KEEP[side]) >> _RIGHT[side]) << _LEFT[side]
    return bool((word & b) != 0)


@kernel
def part_around(seed: np.uint64, word: np.uint64) -> np.uint64:
    """Return the voxels of ``word`` that are 26-connected to those of ``seed``."""
    grown = seed
    while True:
        wide = grown | ((grown & _NOT_K3) << ONE) | ((grown & _NOT_K0) >> ONE)
        wide |= ((wide & _NOT_J3) << _FOUR) | ((wide & _NOT_J0) >> _FOUR)
        wide |= (wide << _SIXTEEN) | (wide >> _SIXTEEN)
        wide &= word
        if wide == grown:
            return grown
        grown = wide


class VoxelBlocks(NamedTuple):
    """The blocks of a grid as arrays for kernels; updated in place.

    shape: (3,) blocks along each axis, the border included.
    steps: (26,) difference of the block numbers to the neighbour on SIDES.
    counts: (blocks,) uint8 number of parts of each block.
    words: (8 * blocks,) uint64 voxels of each part.
    links: (8 * blocks,) uint32, bit n = touches a part of the block on SIDES[n].
    centre: (8 * blocks, 3) in padded voxel units, centre of the voxel that represents a part: the one nearest to the middle
        of its block.
    """

    shape: IntArray
    steps: IntArray
    counts: ByteArray
    words: WordArray
    links: LinkArray
    centre: FloatArray


def blocks_of(grid_shape: tuple[int, int, int]) -> VoxelBlocks:
    """Return empty blocks for a grid of voxels.

    The system commits memory only where it is written.
    """
    shape = np.array([-(-n // EDGE) + 2 for n in grid_shape], dtype=np.int64)
    number = int(np.prod(shape))
    return VoxelBlocks(
        shape=shape,
        steps=SIDES @ np.array([shape[1] * shape[2], shape[2], 1], dtype=np.int64),
        counts=np.zeros(number, dtype=np.uint8),
        words=np.zeros(MAX_PARTS * number, dtype=np.uint64),
        links=np.zeros(MAX_PARTS * number, dtype=np.uint32),
        centre=np.zeros((MAX_PARTS * number, 3), dtype=np.float64),
    )


@kernel
def corner_of(blocks: VoxelBlocks, block: int) -> tuple[int, int, int]:
    """Return the PADDED indices of a block's first voxel."""
    plane = blocks.shape[1] * blocks.shape[2]
    rest = block % plane
    i, j, k = block // plane, rest // blocks.shape[2], rest % blocks.shape[2]
    return EDGE * i - EDGE + 1, EDGE * j - EDGE + 1, EDGE * k - EDGE + 1


@kernel
def part_at(blocks: VoxelBlocks, i: int, j: int, k: int) -> int:
    """Return the number of the part that holds a PADDED voxel; -1 for none."""
    i, j, k = i + EDGE - 1, j + EDGE - 1, k + EDGE - 1
    block = (i // EDGE * blocks.shape[1] + j // EDGE) * blocks.shape[2] + k // EDGE
    bit = np.uint64(i % EDGE * 16 + j % EDGE * 4 + k % EDGE)
    for c in range(blocks.counts[block]):
        if (blocks.words[c * len(blocks.counts) + block] >> bit) & ONE:
            return int(c * len(blocks.counts) + block)
    return -1


@kernel
def word_of(blocks: VoxelBlocks, block: int, mask: ByteArray) -> np.uint64:
    """Read the voxels of a block from a padded mask."""
    i0, j0, k0 = corner_of(blocks, block)
    word, bit = np.uint64(0), np.uint64(0)
    for i in range(i0, i0 + EDGE):
        for j in range(j0, j0 + EDGE):
            for k in range(k0, k0 + EDGE):
                if i < mask.shape[0] and j < mask.shape[1] and k < mask.shape[2]:
                    word |= np.uint64(mask[i, j, k]) << bit
                bit += ONE
    return word


@kernel
def split(blocks: VoxelBlocks, block: int, word: np.uint64) -> None:
    """Write the parts of a block, ordered by their lowest voxels.

    Links and centres must be updated afterwards, see link().
    """
    count = 0
    while word != 0:
        part = part_around(word & (~word + ONE), word)
        blocks.words[count * len(blocks.counts) + block] = part
        word ^= part
        count += 1
    for c in range(count, blocks.counts[block]):
        blocks.words[c * len(blocks.counts) + block] = 0
    blocks.counts[block] = count


@kernel
def link(blocks: VoxelBlocks, block: int) -> None:
    """Update the links of a block's parts to the neighbours, and the centres of the parts.

    The links are updated at both ends.
    """
    number = len(blocks.counts)
    i0, j0, k0 = corner_of(blocks, block)
    for c in range(blocks.counts[block]):
        part = c * number + block
        blocks.links[part] = 0
        for bit in FROM_MIDDLE:
            if (blocks.words[part] >> np.uint64(bit)) & ONE:
                blocks.centre[part, 0] = i0 + bit // 16 + 0.5
                blocks.centre[part, 1] = j0 + bit // 4 % 4 + 0.5
                blocks.centre[part, 2] = k0 + bit % 4 + 0.5
                break
    for side in range(26):
        beside = block + blocks.steps[side]
        here, there = np.uint32(1 << side), np.uint32(1 << (25 - side))  # SIDES[25 - n] is opposite to SIDES[n]
        for d in range(blocks.counts[beside]):
            other = d * number + beside
            met = False
            for c in range(blocks.counts[block]):
                if touches(blocks.words[c * number + block], blocks.words[other], side):
                    blocks.links[c * number + block] |= here
                    met = True
            blocks.links[other] = blocks.links[other] | there if met else blocks.links[other] & ~there


@kernel
def meets(blocks: VoxelBlocks, part: int, side: int, other: int) -> bool:
    """Return True if a part touches a given part of the neighbour on a side.

    The caller has checked that it touches at least one part of that neighbour.
    """
    beside = part % len(blocks.counts) + blocks.steps[side]
    return blocks.counts[beside] == 1 or touches(blocks.words[part], blocks.words[other], side)
