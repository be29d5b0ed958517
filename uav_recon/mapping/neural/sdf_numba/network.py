"""Distance network (12-32-1+15) and colour network (15+12-32-32-3+1) on encoded points.

Forward and backward passes are written by hand. The last output of the colour network is the log variance of its error. All
functions work on POINTS columns at a time, so that the innermost loop is a vector operation on a row in cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import fast_kernel
from uav_recon.mapping.neural.sdf_numba.feature_grid import CORNERS, ENCODED, POINTS
from uav_recon.types.frames import AnyArray, Float32Array

HIDDEN = 32
SHAPE_FEATURES = 15  # features passed from the distance network to the colour network
COLOUR_IN = SHAPE_FEATURES + ENCODED
COLOUR_OUT = 3 + 1  # red, green, blue; log variance of their error
TRUNCATION_M = np.float32(0.10)  # unit of the learned distances
# of a colour
MIN_LOG_VARIANCE = np.float32(-10.0)
MAX_LOG_VARIANCE = np.float32(2.0)
OUTSIDE_BIAS_M = np.float32(0.05)  # an untrained field is air


class Network(NamedTuple):
    """Weights (out, in) and biases (out,), float32."""

    w1: Float32Array
    b1: Float32Array
    w2: Float32Array
    b2: Float32Array
    c1: Float32Array
    d1: Float32Array
    c2: Float32Array
    d2: Float32Array
    c3: Float32Array
    d3: Float32Array


SHAPES: tuple[tuple[int, ...], ...] = (
    (HIDDEN, ENCODED), (HIDDEN,), (1 + SHAPE_FEATURES, HIDDEN), (1 + SHAPE_FEATURES,),
    (HIDDEN, COLOUR_IN), (HIDDEN,), (HIDDEN, HIDDEN), (HIDDEN,), (COLOUR_OUT, HIDDEN), (COLOUR_OUT,),
)  # fmt: skip
PARAMETERS = sum(int(np.prod(shape)) for shape in SHAPES)


def views(flat: Float32Array) -> Network:
    """Return a network whose arrays are views into one vector (PARAMETERS,)."""
    arrays, start = [], 0
    for shape in SHAPES:
        size = int(np.prod(shape))
        arrays.append(flat[start : start + size].reshape(shape))
        start += size
    return Network(*arrays)


def initial_parameters(random: np.random.Generator) -> Float32Array:
    """Return parameters uniform in ±1/sqrt(in), as in torch.nn.Linear.

    The bias of the distance output is zero.
    """
    flat = np.zeros(PARAMETERS, dtype=np.float32)
    net = views(flat)
    for weight, bias in ((net.w1, net.b1), (net.w2, net.b2), (net.c1, net.d1), (net.c2, net.d2), (net.c3, net.d3)):
        bound = 1.0 / np.sqrt(weight.shape[1])
        weight[...] = random.uniform(-bound, bound, weight.shape)
        bias[...] = random.uniform(-bound, bound, bias.shape)
    net.b2[0] = 0.0
    return flat


class Scratch(NamedTuple):
    """Intermediate results of a batch between its forward and backward pass, in rows of POINTS."""

    node: AnyArray
    weight: Float32Array
    encoded: Float32Array
    hidden: Float32Array
    out: Float32Array
    colour_in: Float32Array
    colour_1: Float32Array
    colour_2: Float32Array
    rgb: Float32Array
    d_encoded: Float32Array
    d_hidden: Float32Array
    d_out: Float32Array
    d_colour_in: Float32Array
    d_colour_1: Float32Array
    d_colour_2: Float32Array
    d_rgb: Float32Array


def make_scratch() -> Scratch:
    """Allocate the scratch arrays, which all batches reuse."""
    rows = (ENCODED, HIDDEN, 1 + SHAPE_FEATURES, COLOUR_IN, HIDDEN, HIDDEN, COLOUR_OUT)
    forward = [np.zeros((n, POINTS), dtype=np.float32) for n in rows]
    backward = [np.zeros((n, POINTS), dtype=np.float32) for n in rows]
    weight = np.zeros((CORNERS, POINTS), dtype=np.float32)
    return Scratch(np.zeros((CORNERS, POINTS), dtype=np.int32), weight, *forward, *backward)


@fast_kernel
def affine(weight: Float32Array, bias: Float32Array, x: Float32Array, y: Float32Array, rows: int) -> None:
    """Compute y[:rows] = W x + b, four inputs at a time."""
    columns = weight.shape[1]
    quads = columns // 4 * 4
    for j in range(rows):
        for p in range(POINTS):
            y[j, p] = bias[j]
        for i in range(0, quads, 4):
            a, b, c, d = weight[j, i], weight[j, i + 1], weight[j, i + 2], weight[j, i + 3]
            for p in range(POINTS):
                y[j, p] += a * x[i, p] + b * x[i + 1, p] + c * x[i + 2, p] + d * x[i + 3, p]
        for i in range(quads, columns):
            a = weight[j, i]
            for p in range(POINTS):
                y[j, p] += a * x[i, p]


@fast_kernel
def affine_backward(
    weight: Float32Array, x: Float32Array, d_y: Float32Array, rows: int,
    d_weight: Float32Array, d_bias: Float32Array, d_x: Float32Array,
) -> None:  # fmt: skip
    """Add to the gradients of W and b, and set d_x = W^T d_y, for the first ``rows`` outputs."""
    columns = weight.shape[1]
    for i in range(columns):
        for p in range(POINTS):
            d_x[i, p] = 0.0
        for j in range(rows):
            w, total = weight[j, i], np.float32(0.0)
            for p in range(POINTS):
                d_x[i, p] += w * d_y[j, p]
                total += x[i, p] * d_y[j, p]
            d_weight[j, i] += total
    for j in range(rows):
        total = np.float32(0.0)
        for p in range(POINTS):
            total += d_y[j, p]
        d_bias[j] += total


@fast_kernel
def rectify(x: Float32Array) -> None:
    """Apply max(x, 0) in place."""
    for j in range(x.shape[0]):
        for p in range(POINTS):
            x[j, p] = max(x[j, p], np.float32(0.0))


@fast_kernel
def rectify_backward(x: Float32Array, d_x: Float32Array) -> None:
    """Set the gradient to zero where the unit was inactive."""
    for j in range(x.shape[0]):
        for p in range(POINTS):
            d_x[j, p] = d_x[j, p] if x[j, p] > 0.0 else np.float32(0.0)


@fast_kernel
def distance_forward(net: Network, s: Scratch, rows: int) -> None:
    """Compute s.out[:rows] from s.encoded; row 0 is in metres."""
    affine(net.w1, net.b1, s.encoded, s.hidden, HIDDEN)
    rectify(s.hidden)
    affine(net.w2, net.b2, s.hidden, s.out, rows)
    for p in range(POINTS):
        s.out[0, p] = s.out[0, p] * TRUNCATION_M + OUTSIDE_BIAS_M


@fast_kernel
def distance_alone(net: Network, s: Scratch) -> None:
    """Compute s.out[0] in metres from s.encoded, as distance_forward().

    The hidden units are not stored, so that no backward pass is possible.
    """
    x, total = s.encoded, s.out[0]
    for p in range(POINTS):
        total[p] = net.b2[0]
    for j in range(HIDDEN):
        a, b, c, d, e, f = net.w1[j, 0], net.w1[j, 1], net.w1[j, 2], net.w1[j, 3], net.w1[j, 4], net.w1[j, 5]
        g, h, i, k, m, n = net.w1[j, 6], net.w1[j, 7], net.w1[j, 8], net.w1[j, 9], net.w1[j, 10], net.w1[j, 11]
        bias, share = net.b1[j], net.w2[0, j]
        for p in range(POINTS):
            unit = bias + a * x[0, p] + b * x[1, p] + c * x[2, p] + d * x[3, p] + e * x[4, p] + f * x[5, p]
            unit += g * x[6, p] + h * x[7, p] + i * x[8, p] + k * x[9, p] + m * x[10, p] + n * x[11, p]
            total[p] += share * max(unit, np.float32(0.0))
    for p in range(POINTS):
        total[p] = total[p] * TRUNCATION_M + OUTSIDE_BIAS_M


@fast_kernel
def distance_backward(net: Network, s: Scratch, rows: int, d_net: Network) -> None:
    """Compute s.d_encoded and the gradients of the weights from s.d_out[:rows].

    Row 0 of s.d_out is per metre.
    """
    for p in range(POINTS):
        s.d_out[0, p] *= TRUNCATION_M
    affine_backward(net.w2, s.hidden, s.d_out, rows, d_net.w2, d_net.b2, s.d_hidden)
    rectify_backward(s.hidden, s.d_hidden)
    affine_backward(net.w1, s.encoded, s.d_hidden, HIDDEN, d_net.w1, d_net.b1, s.d_encoded)


@fast_kernel
def colour_forward(net: Network, s: Scratch) -> None:
    """Compute s.rgb (0..1 and the log variance) from s.out and s.encoded.

    Needs distance_forward() with all rows before.
    """
    for i in range(SHAPE_FEATURES):
        for p in range(POINTS):
            s.colour_in[i, p] = s.out[1 + i, p]
    for i in range(ENCODED):
        for p in range(POINTS):
            s.colour_in[SHAPE_FEATURES + i, p] = s.encoded[i, p]
    affine(net.c1, net.d1, s.colour_in, s.colour_1, HIDDEN)
    rectify(s.colour_1)
    affine(net.c2, net.d2, s.colour_1, s.colour_2, HIDDEN)
    rectify(s.colour_2)
    affine(net.c3, net.d3, s.colour_2, s.rgb, COLOUR_OUT)
    for j in range(3):
        for p in range(POINTS):
            s.rgb[j, p] = np.float32(1.0) / (np.float32(1.0) + np.exp(-s.rgb[j, p]))


@fast_kernel
def colour_backward(net: Network, s: Scratch, d_net: Network) -> None:  # noqa: C901
    """Compute s.d_encoded through both networks and all gradients of the weights from s.d_rgb.

    The variance output only changes its own weights: a large Gaussian loss would outweigh the colour loss.
    """
    for i in range(HIDDEN):
        total = np.float32(0.0)
        for p in range(POINTS):
            total += s.colour_2[i, p] * s.d_rgb[3, p]
        d_net.c3[3, i] += total
    total = np.float32(0.0)
    for p in range(POINTS):
        total += s.d_rgb[3, p]
    d_net.d3[3] += total
    for j in range(3):
        for p in range(POINTS):
            s.d_rgb[j, p] *= s.rgb[j, p] * (np.float32(1.0) - s.rgb[j, p])
    affine_backward(net.c3, s.colour_2, s.d_rgb, 3, d_net.c3, d_net.d3, s.d_colour_2)
    rectify_backward(s.colour_2, s.d_colour_2)
    affine_backward(net.c2, s.colour_1, s.d_colour_2, HIDDEN, d_net.c2, d_net.d2, s.d_colour_1)
    rectify_backward(s.colour_1, s.d_colour_1)
    affine_backward(net.c1, s.colour_in, s.d_colour_1, HIDDEN, d_net.c1, d_net.d1, s.d_colour_in)
    for p in range(POINTS):
        s.d_out[0, p] = 0.0
    for i in range(SHAPE_FEATURES):
        for p in range(POINTS):
            s.d_out[1 + i, p] = s.d_colour_in[i, p]
    distance_backward(net, s, 1 + SHAPE_FEATURES, d_net)
    for i in range(ENCODED):
        for p in range(POINTS):
            s.d_encoded[i, p] += s.d_colour_in[SHAPE_FEATURES + i, p]
