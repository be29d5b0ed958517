"""Losses of sdf_numba.losses on tensors.

The weights contain the loss factors and the means, so each loss is a plain sum.
"""

from __future__ import annotations

import torch
from torch import Tensor

from uav_recon.mapping.neural.sdf_numba.losses import STENCIL_M, TETRAHEDRON, VARIANCE_SHARE
from uav_recon.mapping.neural.sdf_numba.network import MAX_LOG_VARIANCE, MIN_LOG_VARIANCE

MIN_SLOPE = 1e-6  # added to the norm of a gradient


def tetrahedron(device: torch.device) -> Tensor:
    """Return the difference stencil (4, 3) on a device.

    It is created once, because a CUDA graph cannot copy data from the host.
    """
    return torch.tensor(TETRAHEDRON, device=device)


def stencil_points(points: Tensor, stencil: Tensor) -> Tensor:
    """Return the tetrahedron corners (4 N, 3) about points (N, 3)."""
    return (points[:, None] + float(STENCIL_M) * stencil).view(-1, 3)


def distance_loss(distance_m: Tensor, target_m: Tensor, weight: Tensor, at_least: Tensor) -> Tensor:
    """Return the sum of weight * (f - target)², all (N,).

    Where at_least is set, only values below the target count.
    """
    error = distance_m - target_m
    error = torch.where(at_least, error.clamp(max=0.0), error)
    return (weight * error.square()).sum()


def shape_loss(corner_m: Tensor, stencil: Tensor, normal: Tensor, eikonal_weight: Tensor, normal_weight: Tensor) -> Tensor:
    """Return the sum of eikonal_weight * (|g| - 1)² + normal_weight * |g/|g| - n|².

    g is computed from corner_m (4 N,), the distances at the points of stencil_points().
    """
    gradient = corner_m.view(-1, 4) @ stencil / (4.0 * float(STENCIL_M))
    # outside the box the gradient is zero, where the square root has no derivative
    length = gradient.square().sum(dim=1).clamp(min=MIN_SLOPE**2).sqrt() + MIN_SLOPE
    along = (gradient * normal).sum(dim=1) / length
    return (eikonal_weight * (length - 1.0).square() + 2.0 * normal_weight * (1.0 - along)).sum()


def colour_loss(rgb: Tensor, log_variance: Tensor, seen: Tensor, at_least: Tensor, weight: Tensor) -> Tensor:
    """Return the sum of weight * (e² + VARIANCE_SHARE / 2 * (e² / v + log v)).

    rgb, seen (N, 3); log_variance, weight (N,). Where at_least (N, 3) is set, only values below ``seen`` count, and values
    above are excluded from the second term (see sdf_numba.losses.fit_colour).
    """
    error = rgb - seen
    known = ~at_least | (error <= 0.0)
    total, count = torch.where(known, error, 0.0).square().sum(dim=1), known.sum(dim=1)
    # straight-through clamp: the value stays within its limits, but the gradient passes, so that a large error can raise it
    held = log_variance + (log_variance.clamp(float(MIN_LOG_VARIANCE), float(MAX_LOG_VARIANCE)) - log_variance).detach()
    gaussian = (total / count.clamp(min=1)).detach() * torch.exp(-held) + held
    return (weight * (total / 3.0 + 0.5 * float(VARIANCE_SHARE) * torch.where(count > 0, gaussian, 0.0))).sum()
