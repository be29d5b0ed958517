"""Speed limit at each node of a curve.

It depends on clearance, climb and turn rate, and motion blur at views.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, FloatArray, IntArray

CALM_SPANS = 1  # spans on either side of a view with the blur limit: the frame comes late, and smoothing mixes neighbours in
ENTRY_SPANS = 2  # spans in which a motion entered above a limit, by the error of smoothing, returns to it


class CurveNodes(NamedTuple):
    """A curve at its M nodes.

    slope: (M, 5) derivatives by span. along_m: (M,) length from the start. node_clearance_m: (M,) clearance.
    max_speed_mps: (M,) a further speed limit. view_node: (K,) span at whose start each view is passed. per_span: nodes in each
    span.
    """

    slope: FloatArray
    along_m: FloatArray
    node_clearance_m: FloatArray
    max_speed_mps: FloatArray
    view_node: IntArray
    per_span: int


class NodeLimits(NamedTuple):
    """Limits of a flight, in metres, seconds and radians.

    clearance_m, open_m, spread_m: the tight speed holds up to this clearance, the full speed from ``open_m`` more on; the least
    clearance within ``spread_m`` along the path counts. blur_radps, blur_distance_m: how far the image may move at the views,
    see MotionConfig. braking: acceleration of a motion that is entered too fast. max_pace: spans per second.
    """

    clearance_m: float
    open_m: float
    spread_m: float
    speed: float
    tight_speed: float
    climb: float
    descent: float
    rate: float
    blur_radps: float
    blur_distance_m: float
    braking: float
    max_pace: float


@kernel
def _clearance_speeds(nodes: CurveNodes, limits: NodeLimits, out: AnyArray) -> None:
    """Fill ``out`` (M,) with the speed limit at each node from the clearance around it.

    Clearance beyond ``clearance_m`` raises the limit from the tight to the full speed.
    """
    along_m, node_clearance_m = nodes.along_m, nodes.node_clearance_m
    speed, tight_speed, spread_m = limits.speed, limits.tight_speed, limits.spread_m
    first = 0
    for n in range(len(out)):
        while along_m[n] - along_m[first] > spread_m:
            first += 1
        min_m = node_clearance_m[n]
        j = first
        while j < len(out) and along_m[j] - along_m[n] <= spread_m:
            min_m = min(min_m, node_clearance_m[j])
            j += 1
        share = min(max((min_m - limits.clearance_m) / limits.open_m, 0.0), 1.0)
        out[n] = min(tight_speed, speed) + share * max(speed - tight_speed, 0.0)


@kernel
def node_speed_limits(nodes: CurveNodes, limits: NodeLimits, entry: FloatArray, out: AnyArray) -> None:
    """Fill out (M,): the greatest (spans per second)² at each node of a curve.

    At the views the image may move by at most ``blur_radps``: turn rate plus speed over distance. A motion entered at velocity
    ``entry`` (5,), faster than tight places or views after it allow, may brake down to those limits.
    """
    slope, per_span = nodes.slope, nodes.per_span
    _clearance_speeds(nodes, limits, out)
    for n in range(len(out)):
        flat = math.sqrt(slope[n, 0] ** 2 + slope[n, 1] ** 2 + slope[n, 2] ** 2)
        out[n] = min(out[n], nodes.max_speed_mps[n]) / max(flat, 1e-9)
    for node in nodes.view_node:
        for n in range(max((node - CALM_SPANS) * per_span, 0), min((node + CALM_SPANS) * per_span, len(out) - 1) + 1):
            flat = math.sqrt(slope[n, 0] ** 2 + slope[n, 1] ** 2 + slope[n, 2] ** 2)
            turning = math.sqrt(slope[n, 3] ** 2 + slope[n, 4] ** 2)
            out[n] = min(out[n], limits.blur_radps / max(turning + flat / limits.blur_distance_m, 1e-9))
    entry2 = entry[0] ** 2 + entry[1] ** 2 + entry[2] ** 2
    for n in range(len(out)):
        left = entry2 - 2.0 * limits.braking * nodes.along_m[n]
        flat = math.sqrt(slope[n, 0] ** 2 + slope[n, 1] ** 2 + slope[n, 2] ** 2)
        if left > 0.0:
            out[n] = max(out[n], math.sqrt(left) / max(flat, 1e-9))
        entering = n <= ENTRY_SPANS * per_span
        up = max(limits.climb, entry[2]) if entering else limits.climb
        down = max(limits.descent, -entry[2]) if entering else limits.descent
        pace = min(limits.max_pace, out[n], (up if slope[n, 2] > 0.0 else down) / max(abs(slope[n, 2]), 1e-9))
        for d in range(3, 5):
            turning = max(limits.rate, abs(entry[d])) if entering else limits.rate
            pace = min(pace, turning / max(abs(slope[n, d]), 1e-9))
        out[n] = pace * pace
