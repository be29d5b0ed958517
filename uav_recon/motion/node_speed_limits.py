"""Speed limit at each node of a curve.

It depends on clearance, climb and turn rate, and motion blur at views.
"""

from __future__ import annotations

import math

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray

CALM_SPANS = 1  # spans on either side of a view with the blur limit: the frame comes late, and smoothing mixes neighbours in
ENTRY_SPANS = 2  # spans in which a motion entered above a limit, by the error of smoothing, returns to it


@kernel
def _room_speeds(
    along_m: AnyArray, room_m: AnyArray, clearance_m: float, open_m: float, speed: float, tight_speed: float, spread_m: float,
    out: AnyArray,
) -> None:  # fmt: skip
    """Fill ``out`` (M,) with the speed limit at each node from the clearance around it.

    Clearance beyond ``clearance_m`` raises the limit from the tight to the full speed. The least clearance within ``spread_m``
    along the path counts.
    """
    first = 0
    for n in range(len(out)):
        while along_m[n] - along_m[first] > spread_m:
            first += 1
        min_m = room_m[n]
        j = first
        while j < len(out) and along_m[j] - along_m[n] <= spread_m:
            min_m = min(min_m, room_m[j])
            j += 1
        share = min(max((min_m - clearance_m) / open_m, 0.0), 1.0)
        out[n] = min(tight_speed, speed) + share * max(speed - tight_speed, 0.0)


@kernel
def node_speed_limits(
    slope: AnyArray, along_m: AnyArray, room_m: AnyArray, max_speed_mps: AnyArray, view_node: AnyArray, per_span: int,
    clearance_m: float, open_m: float, speed: float, tight_speed: float, climb: float, descent: float, rate: float,
    blur_radps: float, blur_distance_m: float, spread_m: float, entry: AnyArray, braking: float, fastest: float, out: AnyArray,
) -> None:  # fmt: skip
    """Fill out (M,): the greatest (spans per second)² at each node of a curve.

    slope: (M, 5) derivatives of the curve by span. At the views the image may move by at most ``blur_radps`` (see
    MotionConfig): turn rate plus speed over distance. A motion entered at velocity ``entry`` (5,), faster than tight places or
    views after it allow, may brake down to those limits. max_speed_mps (M,): a further speed limit.
    """
    _room_speeds(along_m, room_m, clearance_m, open_m, speed, tight_speed, spread_m, out)
    for n in range(len(out)):
        flat = math.sqrt(slope[n, 0] ** 2 + slope[n, 1] ** 2 + slope[n, 2] ** 2)
        out[n] = min(out[n], max_speed_mps[n]) / max(flat, 1e-9)
    for node in view_node:
        for n in range(max((node - CALM_SPANS) * per_span, 0), min((node + CALM_SPANS) * per_span, len(out) - 1) + 1):
            flat = math.sqrt(slope[n, 0] ** 2 + slope[n, 1] ** 2 + slope[n, 2] ** 2)
            turning = math.sqrt(slope[n, 3] ** 2 + slope[n, 4] ** 2)
            out[n] = min(out[n], blur_radps / max(turning + flat / blur_distance_m, 1e-9))
    entry2 = entry[0] ** 2 + entry[1] ** 2 + entry[2] ** 2
    for n in range(len(out)):
        left = entry2 - 2.0 * braking * along_m[n]
        flat = math.sqrt(slope[n, 0] ** 2 + slope[n, 1] ** 2 + slope[n, 2] ** 2)
        if left > 0.0:
            out[n] = max(out[n], math.sqrt(left) / max(flat, 1e-9))
        entering = n <= ENTRY_SPANS * per_span
        up = max(climb, entry[2]) if entering else climb
        down = max(descent, -entry[2]) if entering else descent
        pace = min(fastest, out[n], (up if slope[n, 2] > 0.0 else down) / max(abs(slope[n, 2]), 1e-9))
        for d in range(3, 5):
            turning = max(rate, abs(entry[d])) if entering else rate
            pace = min(pace, turning / max(abs(slope[n, d]), 1e-9))
        out[n] = pace * pace
