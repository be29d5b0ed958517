"""Checks of values that a user of the library passes.

Each raises ValueError with name, value and expectation in one line.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

T = TypeVar("T")


def require_number(name: str, value: float, low: float = -math.inf, high: float = math.inf) -> float:
    """Return a finite number of the closed range [low, high]."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and low <= number <= high):
        limits = [f" of {low:g} or more"] if math.isfinite(low) else []
        limits = [f" of {low:g} to {high:g}"] if math.isfinite(high) else limits
        raise ValueError(f"{name}: {value!r}, expected a finite number{''.join(limits)}")
    return number


def require_vector(name: str, value: ArrayLike) -> FloatArray:
    """Return three finite numbers, (3,) float64."""
    try:
        vector = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: {value!r}, expected 3 finite numbers") from None
    if vector.shape != (3,):
        raise ValueError(f"{name}: shape {vector.shape}, expected (3,)")
    if not np.isfinite(vector).all():
        raise ValueError(f"{name}: {vector.tolist()}, expected 3 finite numbers")
    return vector


def require_box(box_min_m: ArrayLike, box_max_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the lower and the upper corner (3,) of a box of positive size."""
    low, high = require_vector("box_min_m", box_min_m), require_vector("box_max_m", box_max_m)
    if not (high > low).all():
        raise ValueError(f"box_max_m: {high.tolist()}, expected more than box_min_m {low.tolist()} on each axis")
    return low, high


def require_kind(name: str, value: object, kind: type[T], hint: str = "") -> T:
    """Return the value if it is of a class. hint: how to get such a value."""
    if not isinstance(value, kind):
        raise ValueError(f"{name}: {type(value).__name__}, expected {kind.__name__}{hint and f' ({hint})'}")
    return value


def require_pose(name: str, value: object) -> Pose:
    """Return the value if it is a Pose, which is finite by construction."""
    return require_kind(name, value, Pose, "Pose.from_matrix takes a 4x4 matrix")
