"""The losses of mapping.neural.losses on tensors. Weights carry the factors and the means: each loss is a plain sum."""

from __future__ import annotations

import torch
from torch import Tensor

from uav_recon.mapping.neural.sdf_numba.losses import STENCIL_M, TETRAHEDRON, VARIANCE_SHARE
from uav_recon.mapping.neural.sdf_numba.network import MAX_LOG_VARIANCE, MIN_LOG_VARIANCE

MIN_SLOPE = 1e-6  # added to a gradient's length


def tetrahedron(device: torch.device) -> Tensor:
    """The difference stencil (4, 3), made once: a CUDA graph may fetch nothing from outside."""
    return torch.tensor(TETRAHEDRON, device=device)


def around(points: Tensor, stencil: Tensor) -> Tensor:
    """The tetrahedron's corners (4 N, 3) about points (N, 3)."""
    return (points[:, None] + float(STENCIL_M) * stencil).view(-1, 3)


def distance_loss(distance_m: Tensor, target_m: Tensor, weight: Tensor, at_least: Tensor) -> Tensor:
    """Sum of weight * (f - target)², all (N,); where at_least, only a value below the target counts."""
    error = distance_m - target_m
    error = torch.where(at_least, error.clamp(max=0.0), error)
    return (weight * error.square()).sum()


def shape_loss(corner_m: Tensor, stencil: Tensor, normal: Tensor, eikonal_weight: Tensor, normal_weight: Tensor) -> Tensor:
    """Sum of eikonal_weight * (|g| - 1)² + normal_weight * |g/|g| - n|², with g from corner_m (4 N,) of around()."""
    gradient = corner_m.view(-1, 4) @ stencil / (4.0 * float(STENCIL_M))
    # a place outside the box has no slope at all, and a root no derivative there
    length = gradient.square().sum(dim=1).clamp(min=MIN_SLOPE**2).sqrt() + MIN_SLOPE
    along = (gradient * normal).sum(dim=1) / length
    return (eikonal_weight * (length - 1.0).square() + 2.0 * normal_weight * (1.0 - along)).sum()


def colour_loss(rgb: Tensor, log_variance: Tensor, seen: Tensor, at_least: Tensor, weight: Tensor) -> Tensor:
    """Sum of weight * (e² + VARIANCE_SHARE / 2 * (e² / v + log v)): rgb, seen (N, 3); log_variance, weight (N,).

    Where at_least (N, 3), only a value below what was seen counts, and one above says nothing of v (see losses.fit_colour).
    """
    error = rgb - seen
    known = ~at_least | (error <= 0.0)
    total, count = torch.where(known, error, 0.0).square().sum(dim=1), known.sum(dim=1)
    # held inside its limits, yet always free to move: what surprises must be able to widen it
    held = log_variance + (log_variance.clamp(float(MIN_LOG_VARIANCE), float(MAX_LOG_VARIANCE)) - log_variance).detach()
    gaussian = (total / count.clamp(min=1)).detach() * torch.exp(-held) + held
    return (weight * (total / 3.0 + 0.5 * float(VARIANCE_SHARE) * torch.where(count > 0, gaussian, 0.0))).sum()
