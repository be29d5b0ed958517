"""Learned field as a torch module, with the queries of sdf_numba.sdf_field."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from uav_recon.mapping.neural.sdf_numba.sdf_field import INITIAL_FEATURE
from uav_recon.mapping.neural.sdf_torch.feature_grid import IN_BLOCK, GridLayout, encode, locate
from uav_recon.mapping.neural.sdf_torch.losses import colour_loss, distance_loss, shape_loss, stencil_points, tetrahedron
from uav_recon.mapping.neural.sdf_torch.network import Heads, initial_weights
from uav_recon.mapping.neural.sdf_torch.ray_sampling import TorchBatch
from uav_recon.types.frames import Float32Array

TOGETHER = {"cpu": 1 << 12, "cuda": 1 << 18}  # points per query batch: cache-sized, or GPU-sized


class TorchSdfField(nn.Module):
    """Parameters, the loss of a batch, and queries in world metres.

    layout, slot (N,) int32: see sdf_torch.feature_grid.
    """

    def __init__(self, layout: GridLayout, slot: Tensor, slots: int, seed: int, device: torch.device) -> None:
        super().__init__()
        random = np.random.default_rng(seed)
        self._layout = layout.to(device)
        self._slot = slot.to(device)
        self._stencil = tetrahedron(device)
        self.weights = nn.Parameter(torch.tensor(initial_weights(layout.levels, random), device=device))
        features = random.uniform(-INITIAL_FEATURE, INITIAL_FEATURE, (slots, IN_BLOCK)).astype(np.float32)
        features[0] = 0.0
        self.features = nn.Parameter(torch.tensor(features, device=device))

    def forward(self, batch: TorchBatch) -> Tensor:
        """Return the loss () of a batch."""
        every = torch.cat([batch.points, stencil_points(batch.surface, self._stencil), batch.coloured])
        sizes = [len(batch.points), 4 * len(batch.surface), len(batch.coloured)]
        heads = Heads(self.weights, self._layout.levels)
        free, corners, coloured = torch.split(self._encode(every), sizes)
        distance_m = heads.distance_m(torch.cat([free, corners]))
        loss = distance_loss(distance_m[: sizes[0]], batch.target_m, batch.weight, batch.at_least)
        loss = loss + shape_loss(distance_m[sizes[0] :], self._stencil, batch.normal, batch.eikonal_weight, batch.normal_weight)
        return loss + colour_loss(*heads.colour(coloured), batch.rgb, batch.at_least_rgb, batch.colour_weight)

    def distance_m(self, points: Float32Array) -> Float32Array:
        """Return the signed distances (N,) at points (N, 3) float32."""
        return self._ask(points, Heads.distance_m)

    def rgb(self, points: Float32Array) -> Float32Array:
        """Return the colours (N, 3) in 0..1 at points (N, 3) float32."""
        if len(points) == 0:
            return np.zeros((0, 3), dtype=np.float32)
        return self._ask(points, lambda heads, encoded: heads.colour(encoded)[0])

    def _encode(self, points: Tensor) -> Tensor:
        return encode(self.features, *locate(self._layout, self._slot, points))

    @torch.no_grad()
    def _ask(self, points: Float32Array, what: Callable[[Heads, Tensor], Tensor]) -> Float32Array:
        heads, device = Heads(self.weights, self._layout.levels), self.weights.device
        whole = torch.from_numpy(np.ascontiguousarray(points, dtype=np.float32))
        pieces = [
            what(heads, self._encode(piece.to(device))).cpu().numpy() for piece in torch.split(whole, TOGETHER[device.type])
        ]
        found: Float32Array = np.concatenate(pieces)
        return found
