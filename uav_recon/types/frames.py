"""The table of coordinate frames, and the array aliases used in every signature.

========  ===========================================================================================
world     ENU, metres, origin at the body's position on the take-off pad; maps and plans are in it
odom      like world but without jumps; the autopilot uses it; world_from_odom holds the corrections (REP-105)
body      FLU: x forward, y left, z up; origin at the flight controller
depth     optical RDF: x right, y down, z forward; origin at the depth imager
rgb       optical RDF of the colour imager
NED/FRD   exist only between autopilot/mavlink and the wire
========  ===========================================================================================

Transforms are named ``target_from_source``. Quaternions are Hamilton, wxyz. Angles are radians.
Stamps are the companion's CLOCK_MONOTONIC in seconds.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
ByteArray = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]
AnyArray = NDArray[Any]

_A = TypeVar("_A", bound=AnyArray)


def frozen(array: _A) -> _A:
    """Return ``array`` C-contiguous and read-only.

    It is copied only if the caller's array is still writeable or is not contiguous.
    """
    flags = array.flags
    if flags.writeable or not flags.c_contiguous:
        array = array.copy(order="C")
        array.setflags(write=False)
    return array
