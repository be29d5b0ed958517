"""Ray rendering of a field: composite colour and distance along each ray.

The position of a learned surface is known to about EDGE_M. So a ray that just misses an edge may hit it, and one that just
hits it may pass. Opacity is the share of a normal distribution of that width which the distance has fallen through, and
colours are composited with it (NeuS: Wang et al. 2021, equation 13, with a cumulative normal for the sigmoid).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from uav_recon.mapping.neural.sdf_interface import SdfField
from uav_recon.types.frames import BoolArray, Float32Array

NEAREST_M = 0.10
FARTHEST_M = 12.0
EDGE_M = 0.008
EDGE_SIGMAS = 2.5  # deviations beyond which the opacity is zero
SHORTEST_STEP_M = 0.01
LONGEST_STEP_M = 0.25
STEP_FRACTION = 0.8  # step as a share of the distance: a learned field is not an exact distance
MIN_SHARE = 0.01  # minimum share of a ray for a colour sample
MIN_TRANSMITTANCE = 0.02  # remaining share at which a ray ends
MIN_HIT_OPACITY = 0.02  # minimum opacity for a hit

Solid = Callable[[Float32Array], BoolArray]


def render_rays(
    field: SdfField, solid: Solid, origin: Float32Array, direction: Float32Array
) -> tuple[Float32Array, Float32Array, BoolArray]:
    """Render rays: colour (N, 3) in 0..1, mean distance in metres (N,) and hit mask (N,).

    origin (N, 3), direction (N, 3): unit vectors. solid(points) returns where surface was measured (MeasuredCells.holding):
    elsewhere the field is unsupported and treated as transparent. A ray without a hit within FARTHEST_M is black.
    """
    count = len(origin)
    rgb, reach = np.zeros((count, 3), dtype=np.float32), np.zeros(count, dtype=np.float32)
    left, open_before = np.ones(count, dtype=np.float32), np.ones(count, dtype=np.float32)
    walking, at = np.arange(count), np.full(count, NEAREST_M, dtype=np.float32)
    before = at.copy()
    while len(walking):
        points = origin[walking] + at[walking, None] * direction[walking]
        distance = field.distance_m(points)
        opening = np.ones(len(walking), dtype=np.float32)
        near = np.flatnonzero(distance < EDGE_SIGMAS * EDGE_M)
        near = near[solid(points[near])]
        opening[near] = _open(distance[near])
        met = np.clip(1.0 - opening / np.maximum(open_before[walking], 1e-5), 0.0, 1.0).astype(np.float32)
        some = np.flatnonzero(met > MIN_SHARE)
        ray, share = walking[some], (left[walking] * met)[some]
        middle = np.maximum(0.5 * (before[ray] + at[ray]), at[ray] - np.float32(0.5 * SHORTEST_STEP_M))
        rgb[ray] += share[:, None] * field.rgb(origin[ray] + at[ray, None] * direction[ray])
        reach[ray] += share * middle
        left[ray] -= share
        open_before[walking], before[walking] = opening, at[walking]
        clear = np.abs(distance) - np.float32(EDGE_SIGMAS * EDGE_M)
        at[walking] += np.clip(STEP_FRACTION * clear, SHORTEST_STEP_M, LONGEST_STEP_M)
        walking = walking[(left[walking] > MIN_TRANSMITTANCE) & (at[walking] < FARTHEST_M)]
    found = left < 1.0 - MIN_HIT_OPACITY
    whole = np.where(found, 1.0 - left, 1.0).astype(np.float32)
    return (
        np.where(found[:, None], rgb / whole[:, None], np.float32(0.0)),
        np.where(found, reach / whole, np.float32(FARTHEST_M)),
        found,
    )


def _open(distance_m: Float32Array) -> Float32Array:
    """Return the probability (N,) that a point at a learned distance (N,) is in the air."""
    from scipy.special import ndtr

    share: Float32Array = ndtr(distance_m / np.float32(EDGE_M))
    return share
