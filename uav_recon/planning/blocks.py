"""Voxels in blocks of 4 x 4 x 4, each block one 64-bit word, and the parts into which walls divide them.

Bit (i * 4 + j) * 4 + k of a word is the block's voxel (i, j, k). A block's voxels fall into at most eight parts (26-connected
inside the block). An array of blocks has a border of empty ones all round. Part c of block b has the number c * blocks + b:
numbers with c > 0 are rare, so their memory is hardly ever touched.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import ByteArray, IntArray

WordArray = NDArray[np.uint64]

EDGE = 4  # voxels along a block's edge
MOST_PARTS = 8

ONE, _FOUR, _SIXTEEN = np.uint64(1), np.uint64(4), np.uint64(16)
_K0 = np.uint64(0x1111111111111111)  # voxels with k = 0, with k = 3, ...
_K3 = np.uint64(0x8888888888888888)
_J0 = np.uint64(0x000F000F000F000F)
_J3 = np.uint64(0xF000F000F000F000)
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
_NOT_K0, _NOT_K3, _NOT_J0, _NOT_J3 = _ALL ^ _K0, _ALL ^ _K3, _ALL ^ _J0, _ALL ^ _J3

SIDES = np.array(
    [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) != (0, 0, 0)], dtype=np.int64
)
_SLICES = {
    1: (0xFFFF000000000000, 0xF000F000F000F000, 0x8888888888888888),
    -1: (0xFFFF, 0x000F000F000F000F, 0x1111111111111111),
}


def _side_words() -> tuple[WordArray, WordArray, WordArray]:
    """For each side: which voxels of a block lie on it, and by how much right, then left, to move them onto the neighbour's."""
    keep, right, left = [], [], []
    for side in SIDES:
        word, moves = int(_ALL), 0
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
    """Tell whether voxels ``a`` of a block and voxels ``b`` of its neighbour on ``side`` are 26-connected somewhere."""
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
    """Voxels of ``word`` that are 26-connected to those of ``seed``."""
    grown = seed
    while True:
        wide = grown | ((grown & _NOT_K3) << ONE) | ((grown & _NOT_K0) >> ONE)
        wide |= ((wide & _NOT_J3) << _FOUR) | ((wide & _NOT_J0) >> _FOUR)
        wide |= (wide << _SIXTEEN) | (wide >> _SIXTEEN)
        wide &= word
        if wide == grown:
            return grown
        grown = wide


@kernel
def word_of(mask: ByteArray, block: int, shape: IntArray) -> np.uint64:
    """Read a block's voxels from a padded mask."""
    bz, by = block % shape[2], block // shape[2] % shape[1]
    bx = block // (shape[1] * shape[2])
    word, bit = np.uint64(0), np.uint64(0)
    for i in range(bx * EDGE - 3, bx * EDGE + 1):  # voxel indices of a padded mask: block 1 begins at voxel 1
        for j in range(by * EDGE - 3, by * EDGE + 1):
            for k in range(bz * EDGE - 3, bz * EDGE + 1):
                if i < mask.shape[0] and j < mask.shape[1] and k < mask.shape[2]:
                    word |= np.uint64(mask[i, j, k]) << bit
                bit += ONE
    return word


@kernel
def split(words: WordArray, counts: ByteArray, block: int, word: np.uint64) -> None:
    """Write a block's parts, in the order of their lowest voxels."""
    blocks = len(counts)
    count = 0
    while word != 0:
        part = part_around(word & (~word + ONE), word)
        words[count * blocks + block] = part
        word ^= part
        count += 1
    for c in range(count, counts[block]):
        words[c * blocks + block] = 0
    counts[block] = count


@kernel
def part_with(words: WordArray, counts: ByteArray, block: int, bit: int) -> int:
    """Return the number of the part that holds a block's voxel; -1 for none."""
    for c in range(counts[block]):
        if (words[c * len(counts) + block] >> np.uint64(bit)) & ONE:
            return c * len(counts) + block
    return -1
