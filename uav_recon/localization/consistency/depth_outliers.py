"""Depth outliers: isolated pixels of one depth image, found without a pose."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray

_WIDEST_PX = 60  # max. width of the sampled image
# min. difference of an isolated pixel, plus a share of the range: no surface has it
_ALONE_M = 0.06
_ALONE_SHARE = 0.03
_FEWEST = 60  # min. pixels that can be judged


@kernel
def isolated_pixel_fraction(depth_m: AnyArray) -> float:
    """Return the share of isolated pixels: those that differ from four neighbours that agree.

    It is 0 if too few pixels have such neighbours. NaN = no return. At an edge the neighbours do not agree, at a hole there are
    none: neither counts. Sensor noise is smaller than the limit, and sensor errors are spatially correlated; salt noise and
    flipped bits are neither.
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
            # the middle two of the four values, in either order
            one, other = max(min(left, right), min(above, below)), min(max(left, right), max(above, below))
            expected = 0.5 * (one + other)
            allowed = _ALONE_M + _ALONE_SHARE * expected
            if abs(one - other) <= allowed:
                count += 1
                alone += int(abs(here - expected) > allowed)
    return alone / count if count >= _FEWEST else 0.0
