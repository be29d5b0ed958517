"""What a depth picture says of itself, without a pose: pixels that stand alone."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray

_WIDEST_PX = 60  # across, of what is looked at
_ALONE_M, _ALONE_SHARE = 0.06, 0.03  # off its neighbours by more than this and this share of the range: no surface does that
_FEWEST = 60  # pixels that can be judged, for a verdict


@kernel
def isolated_pixel_fraction(depth_m: AnyArray) -> float:
    """Share of the pixels that stand off what their four neighbours agree on, 0 where too few have neighbours. NaN = no return.

    An edge has neighbours that do not agree, a hole has none: neither counts. A sensor's noise is smaller, and its errors
    hang together; salt and flipped bits do neither.
    """
    height, width = depth_m.shape
    stride = max(width // _WIDEST_PX, 1)
    count = alone = 0
    for v in range(1, height - 1, stride):
        for u in range(1, width - 1, stride):
            here, left, right = depth_m[v, u], depth_m[v, u - 1], depth_m[v, u + 1]
            above, below = depth_m[v - 1, u], depth_m[v + 1, u]
            if not np.isfinite(here + left + right + above + below):
                continue
            # the two in the middle of four, in either order
            one, other = max(min(left, right), min(above, below)), min(max(left, right), max(above, below))
            expected = 0.5 * (one + other)
            allowed = _ALONE_M + _ALONE_SHARE * expected
            if abs(one - other) <= allowed:
                count += 1
                alone += int(abs(here - expected) > allowed)
    return alone / count if count >= _FEWEST else 0.0
