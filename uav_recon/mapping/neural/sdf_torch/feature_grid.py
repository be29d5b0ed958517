"""Feature grid as tensors: blocks as in sdf_numba.feature_grid, with finer levels.

The number of levels follows from the finest cell. All views are known before training starts, so blocks are allocated once
and all shapes are constant.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from uav_recon.mapping.neural.sdf_numba.feature_grid import COARSEST_CELL_M, DENSE_BLOCKS, FEATURES, FINEST_CELL_M, LEVELS
from uav_recon.types.frames import FloatArray

GROWTH = (FINEST_CELL_M / COARSEST_CELL_M) ** (1.0 / (LEVELS - 1))  # ratio of the cell sizes of successive levels
MAX_BLOCKS = 400_000_000  # entries of the index, 4 bytes each
IN_BLOCK = 8 * FEATURES  # numbers per block
# a level has blocks up to this distance from a measured point
BAND_CELLS = 4
MIN_BAND_M = 0.03


class GridError(Exception):
    """Raised for a box too large for its finest cell; the text gives the finest that fits."""


class GridLayout(NamedTuple):
    """Position of the blocks of each level.

    origin_world_m (3,) f32; per level inverse_cell_per_m (L,) f32, cells (L, 3), blocks (L, 3) and first (L,) int64 (see
    sdf_numba.feature_grid.FeatureGrid); within (3, 1) int64: bit of each axis in the node number within a block.
    """

    origin_world_m: Tensor
    inverse_cell_per_m: Tensor
    cells: Tensor
    blocks: Tensor
    first: Tensor
    within: Tensor

    @property
    def levels(self) -> int:
        """Number of levels."""
        return len(self.inverse_cell_per_m)

    def to(self, device: torch.device) -> GridLayout:
        """Return a copy on a device."""
        return GridLayout(*(tensor.to(device) for tensor in self))


def lay_out(box_min_m: FloatArray, box_max_m: FloatArray, finest_cell_m: float) -> GridLayout:
    """Return levels from COARSEST_CELL_M down to finest_cell_m.

    Raises GridError if the index would be too large.
    """
    levels = max(2, 1 + round(float(np.log(finest_cell_m / COARSEST_CELL_M) / np.log(GROWTH))))
    growth = (finest_cell_m / COARSEST_CELL_M) ** (1.0 / (levels - 1))
    cell_m = COARSEST_CELL_M * growth ** np.arange(levels)
    extent_m = np.asarray(box_max_m, dtype=np.float64) - np.asarray(box_min_m, dtype=np.float64)
    cells = np.maximum(np.ceil(extent_m[None, :] / cell_m[:, None]), 1).astype(np.int64)
    blocks = (cells + 2) // 2
    count = blocks.prod(axis=1)
    if count.sum() > MAX_BLOCKS:
        min_m = finest_cell_m * (count.sum() / MAX_BLOCKS) ** (1 / 3)
        raise GridError(f"a box of {'x'.join(f'{e:.1f}' for e in extent_m)} m holds cells of {min_m:.3f} m at the finest")
    return GridLayout(
        torch.tensor(np.asarray(box_min_m, dtype=np.float32)),
        torch.tensor((1.0 / cell_m).astype(np.float32)),
        torch.tensor(cells),
        torch.tensor(blocks),
        torch.tensor(np.concatenate(([0], np.cumsum(count)[:-1]))),
        torch.tensor([[2], [1], [0]]),
    )


class FeatureBlocks:
    """Collects the blocks that the measurements need, then numbers them."""

    def __init__(self, layout: GridLayout) -> None:
        self._layout = layout
        count = layout.blocks.prod(dim=1)
        self._wanted = torch.zeros(int(count.sum()), dtype=torch.bool)
        for level in range(layout.levels):
            if count[level] <= DENSE_BLOCKS:  # free space needs coarse features too
                self._wanted[int(layout.first[level]) :][: int(count[level])] = True

    def cover(self, points: Tensor, direction: Tensor) -> None:
        """Request the blocks near measured points (N, 3), along their unit rays (N, 3).

        Fine blocks are requested only near the surface.
        """
        for level in range(self._layout.levels):
            cell_m = 1.0 / float(self._layout.inverse_cell_per_m[level])
            steps = int(max(BAND_CELLS, np.ceil(MIN_BAND_M / cell_m)))
            for n in range(-steps, steps + 1):
                self._mark(points + n * cell_m * direction, level)

    def slots(self) -> tuple[Tensor, int]:
        """Return slot (sum of blocks,) int32, 0 = not allocated, and the number of slots.

        The number includes slot 0.
        """
        number = torch.cumsum(self._wanted, 0, dtype=torch.int32)
        return torch.where(self._wanted, number, 0), int(number[-1]) + 1

    def _mark(self, points: Tensor, level: int) -> None:
        grid, cells = self._layout, self._layout.cells[level]
        at = torch.floor((points - grid.origin_world_m) * grid.inverse_cell_per_m[level]).long()
        at = at[((at >= 0) & (at < cells)).all(dim=1)]
        _, ny, nz = (int(n) for n in grid.blocks[level])
        for corner in range(8):
            block = (at + torch.tensor([corner >> 2, (corner >> 1) & 1, corner & 1])) >> 1
            self._wanted[int(grid.first[level]) + (block[:, 0] * ny + block[:, 1]) * nz + block[:, 2]] = True


def locate(layout: GridLayout, slot: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Return corner nodes (8, L, N) int64 and trilinear weights (8, L, N) of points (N, 3).

    A point outside is moved to the border. The points are the last axis, so that vectorised operations access contiguous
    memory.
    """
    x = (points.T[:, None] - layout.origin_world_m[:, None, None]) * layout.inverse_cell_per_m[:, None]  # (3, L, N)
    cells = layout.cells.T[:, :, None]
    x = torch.minimum(x.clamp(min=0.0), cells.to(x.dtype))
    cell = torch.minimum(x.long(), cells - 1)
    share = x - cell
    ends = torch.stack([cell, cell + 1])  # (2, 3, L, N): the two ends of the cell
    stride = torch.stack([layout.blocks[:, 1] * layout.blocks[:, 2], layout.blocks[:, 2], torch.ones_like(layout.first)])
    x0, y0, z0 = _by_axis((ends >> 1) * stride[:, :, None])
    x1, y1, z1 = _by_axis((ends & 1) << layout.within[:, :, None])
    u, v, w = _by_axis(torch.stack([1.0 - share, share]))
    entry = layout.first[:, None] + x0 + y0 + z0
    nodes = (slot[entry].long() << 3) + (x1 + y1 + z1)
    return nodes.flatten(0, 2), (u * v * w).flatten(0, 2)


def encode(features: Tensor, node: Tensor, weight: Tensor) -> Tensor:
    """Interpolate features (S, IN_BLOCK) at nodes and weights of locate(): (N, L * FEATURES)."""
    encoded: Tensor = _Gather.apply(features, node, weight)  # type: ignore[no-untyped-call]
    return encoded


def _by_axis(ends: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Split (2, 3, L, N) into x, y and z for broadcasting over the corners (2, 2, 2, L, N)."""
    return ends[:, None, None, 0], ends[None, :, None, 1], ends[None, None, :, 2]


class _Gather(torch.autograd.Function):
    """Weighted sum over corners, with a backward pass in one call.

    Its shapes are constant, so that a CUDA graph can capture it.
    """

    @staticmethod
    def forward(ctx: Any, features: Tensor, node: Tensor, weight: Tensor) -> Tensor:
        ctx.save_for_backward(node, weight)
        ctx.shape = features.shape
        found = features.view(-1, FEATURES)[node] * weight[..., None]
        return found.sum(dim=0).transpose(0, 1).flatten(1)

    @staticmethod
    def backward(ctx: Any, d_encoded: Tensor) -> tuple[Tensor, None, None]:
        node, weight = ctx.saved_tensors
        d_found = weight[..., None] * d_encoded.view(len(d_encoded), -1, FEATURES).transpose(0, 1)
        gradient = torch.zeros(ctx.shape, dtype=d_encoded.dtype, device=d_encoded.device)
        gradient.view(-1, FEATURES).index_add_(0, node.flatten(), d_found.flatten(0, 2))
        gradient[0] = 0.0  # slot 0 represents all positions without measurement
        return gradient, None, None
