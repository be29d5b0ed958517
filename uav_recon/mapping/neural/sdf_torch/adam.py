"""Adam (Kingma and Ba 2015) on tensors; entries without a gradient stay unchanged.

The same algorithm as sdf_numba.adam. Shapes are constant and nothing is read back to the host, so that a CUDA graph can
capture a step.
"""

from __future__ import annotations

import torch
from torch import Tensor

from uav_recon.mapping.neural.sdf_numba.adam import BETA_1, BETA_2, EPSILON, GRID_RATE, WEIGHT_EPSILON, WEIGHT_RATE

_B1 = float(BETA_1)
_B2 = float(BETA_2)
SETTLED = 2000  # steps after which the bias corrections are 1


class TorchAdam:
    """Moments of the features (S, IN_BLOCK) and of the weights (P,)."""

    def __init__(self, features: Tensor, weights: Tensor) -> None:
        self.feature_moments = torch.zeros((2, *features.shape), device=features.device)
        self.weight_moments = torch.zeros((2, *weights.shape), device=weights.device)

    @torch.no_grad()
    def step(self, features: Tensor, weights: Tensor, count: Tensor, rate: Tensor) -> None:
        """Apply the gradients of the features and the weights.

        count (): number of this step, from 1; rate (): share of the full rate. Raises ValueError if there are no gradients.
        """
        power = count.clamp(max=SETTLED)
        scale = rate * torch.sqrt(1.0 - _B2**power) / (1.0 - _B1**power)
        if weights.grad is None or features.grad is None:
            raise ValueError("a step without gradients")
        _every(weights, weights.grad, self.weight_moments, scale * WEIGHT_RATE)
        if features.is_cuda:
            _touched(features, features.grad, self.feature_moments, scale * GRID_RATE)
            return
        # a CPU is limited by memory access: update only the touched blocks
        rows = torch.nonzero((features.grad != 0.0).any(dim=1))[:, 0]
        value, moments = features[rows], self.feature_moments[:, rows]
        _touched(value, features.grad[rows], moments, scale * GRID_RATE)
        features[rows], self.feature_moments[:, rows] = value, moments


def _every(value: Tensor, gradient: Tensor, moments: Tensor, scale: Tensor) -> None:
    moments[0].mul_(_B1).add_(gradient, alpha=1.0 - _B1)
    moments[1].mul_(_B2).addcmul_(gradient, gradient, value=1.0 - _B2)
    value.sub_(scale * moments[0] / (moments[1].sqrt() + float(WEIGHT_EPSILON)))


def _touched(value: Tensor, gradient: Tensor, moments: Tensor, scale: Tensor) -> None:
    hit = gradient != 0.0
    first = torch.where(hit, _B1 * moments[0] + (1.0 - _B1) * gradient, moments[0])
    second = torch.where(hit, _B2 * moments[1] + (1.0 - _B2) * gradient.square(), moments[1])
    moments[0], moments[1] = first, second
    value.sub_(torch.where(hit, scale * first / (second.sqrt() + float(EPSILON)), 0.0))
