"""Losses of the numba field: forward pass, loss and backward pass of one batch.

Each kernel works in cache-sized pieces. It takes points and their targets, adds to the gradients and returns its loss. The
weights contain the loss factors and the means, so a loss is a plain weighted sum. Kinds of loss: iSDF (Ortiz et al. 2022)
and MonoSDF (Yu et al. 2022), with metric depth.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import fast_kernel
from uav_recon.mapping.neural.sdf_numba.feature_grid import POINTS, FeatureGrid, Gradient, gather, locate, scatter
from uav_recon.mapping.neural.sdf_numba.network import (
    COLOUR_OUT,
    MAX_LOG_VARIANCE,
    MIN_LOG_VARIANCE,
    SHAPE_FEATURES,
    Network,
    Scratch,
    colour_backward,
    colour_forward,
    distance_backward,
    distance_forward,
)
from uav_recon.types.frames import BoolArray, Float32Array

TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=np.float32)
STENCIL_M = np.float32(0.02)  # half edge of the cube that holds the tetrahedron of difference points

VARIANCE_SHARE = np.float32(0.02)  # share of the Gaussian loss in the colour loss
UNKNOWN = np.float32(-1.0)  # an error that no channel determines

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)


@fast_kernel
def fit_distance(
    grid: FeatureGrid, net: Network, d_net: Network, gradient: Gradient, s: Scratch,
    points: Float32Array, target_m: Float32Array, weight: Float32Array, at_least: BoolArray,
) -> float:  # fmt: skip
    """Return the sum of weight * (f(x) - target)² for points (N, 3), and add its gradient.

    Where at_least is set, only values below the target count.
    """
    loss = _ZERO
    for start in range(0, points.shape[0], POINTS):
        count = min(POINTS, points.shape[0] - start)
        locate(grid, points, start, count, s.node, s.weight)
        gather(grid.features, s.node, s.weight, s.encoded)
        distance_forward(net, s, 1)
        for p in range(POINTS):
            s.d_out[0, p] = _ZERO
        for p in range(count):
            error = s.out[0, p] - target_m[start + p]
            if at_least[start + p] and error > _ZERO:
                error = _ZERO
            loss += weight[start + p] * error * error
            s.d_out[0, p] = _TWO * weight[start + p] * error
        distance_backward(net, s, 1, d_net)
        scatter(s.d_encoded, count, s.node, s.weight, gradient)
    return float(loss)


@fast_kernel
def fit_shape(
    grid: FeatureGrid, net: Network, d_net: Network, gradient: Gradient, s: Scratch, stencil: Float32Array,
    corners: Float32Array, points: Float32Array, normal: Float32Array, eikonal_weight: Float32Array,
    normal_weight: Float32Array,
) -> float:  # fmt: skip
    """Return the sum of eikonal_weight * (|g| - 1)² + normal_weight * |g/|g| - n|².

    Adds its gradient. g: gradient of f at the points (N, 3), from differences over a tetrahedron; n: normal (N, 3). corners
    (POINTS, 3) is scratch, stencil is TETRAHEDRON.
    """
    loss = _ZERO
    together = POINTS // 4
    scale = _ONE / (np.float32(4.0) * STENCIL_M)
    for start in range(0, points.shape[0], together):
        count = min(together, points.shape[0] - start)
        for n in range(count):
            for t in range(4):
                for axis in range(3):
                    corners[n * 4 + t, axis] = points[start + n, axis] + STENCIL_M * stencil[t, axis]
        locate(grid, corners, 0, count * 4, s.node, s.weight)
        gather(grid.features, s.node, s.weight, s.encoded)
        distance_forward(net, s, 1)
        for p in range(POINTS):
            s.d_out[0, p] = _ZERO
        for n in range(count):
            gx, gy, gz = _ZERO, _ZERO, _ZERO
            for t in range(4):
                f = s.out[0, n * 4 + t] * scale
                gx += f * stencil[t, 0]
                gy += f * stencil[t, 1]
                gz += f * stencil[t, 2]
            length = np.sqrt(gx * gx + gy * gy + gz * gz) + np.float32(1e-6)
            ux, uy, uz = gx / length, gy / length, gz / length
            nx, ny, nz = normal[start + n, 0], normal[start + n, 1], normal[start + n, 2]
            a, b = eikonal_weight[start + n], normal_weight[start + n]
            along = ux * nx + uy * ny + uz * nz
            loss += a * (length - _ONE) * (length - _ONE) + _TWO * b * (_ONE - along)
            radial = _TWO * a * (length - _ONE) + _TWO * b * along / length
            across = _TWO * b / length
            dx, dy, dz = radial * ux - across * nx, radial * uy - across * ny, radial * uz - across * nz
            for t in range(4):
                s.d_out[0, n * 4 + t] = scale * (dx * stencil[t, 0] + dy * stencil[t, 1] + dz * stencil[t, 2])
        distance_backward(net, s, 1, d_net)
        scatter(s.d_encoded, count * 4, s.node, s.weight, gradient)
    return float(loss)


@fast_kernel
def fit_colour(
    grid: FeatureGrid, net: Network, d_net: Network, gradient: Gradient, s: Scratch,
    points: Float32Array, rgb: Float32Array, at_least: BoolArray, weight: Float32Array, error_squared: Float32Array,
) -> float:  # fmt: skip
    """Return the sum of weight * (e² + VARIANCE_SHARE / 2 * (e² / v + log v)).

    Adds its gradient. e² is the mean over channels of (colour(x) - rgb)², v the variance predicted by the network. The
    second term is the Gaussian colour loss of the paper; its e² is constant in the gradient. rgb (N, 3) in 0..1. Where
    at_least (N, 3) is set, only values below rgb count, and values above rgb are excluded from the second term: its e² is
    the mean over the other channels, and it is zero without any. Writes that e² to error_squared (N,), or UNKNOWN.
    """
    loss, third = _ZERO, np.float32(1.0 / 3.0)
    for start in range(0, points.shape[0], POINTS):
        count = min(POINTS, points.shape[0] - start)
        locate(grid, points, start, count, s.node, s.weight)
        gather(grid.features, s.node, s.weight, s.encoded)
        distance_forward(net, s, 1 + SHAPE_FEATURES)
        colour_forward(net, s)
        for j in range(COLOUR_OUT):
            for p in range(POINTS):
                s.d_rgb[j, p] = _ZERO
        for p in range(count):
            total, known = _ZERO, _ZERO
            for j in range(3):
                error = s.rgb[j, p] - rgb[start + p, j]
                if at_least[start + p, j] and error > _ZERO:
                    error = _ZERO
                else:
                    known += _ONE
                total += error * error
                s.d_rgb[j, p] = _TWO * third * weight[start + p] * error
            square = total / max(known, _ONE)
            log_variance = min(max(s.rgb[3, p], MIN_LOG_VARIANCE), MAX_LOG_VARIANCE)
            surprise = square * np.exp(-log_variance)
            share = np.float32(0.5) * VARIANCE_SHARE * weight[start + p] if known > _ZERO else _ZERO
            error_squared[start + p] = square if known > _ZERO else UNKNOWN
            loss += weight[start + p] * total * third + share * (surprise + log_variance)
            s.d_rgb[3, p] = share * (_ONE - surprise)
        colour_backward(net, s, d_net)
        scatter(s.d_encoded, count, s.node, s.weight, gradient)
    return float(loss)
