"""Whether a flight turned back in time: the battery where it did, held against what the way home then took of it."""

from __future__ import annotations

import math

import numpy as np

from sitl.faults.flight_evidence import FlightEvidence

LAND_AT = 0.20  # of the battery: both firmwares land there
_ASTRAY_M = 0.3  # round a pillar


def reserve(e: FlightEvidence) -> float:
    """How many times what was left above LAND_AT covers the last way home, from where it turned back until the motors stood.

    inf for a flight that used none.
    """
    armed = np.flatnonzero(e.armed)
    if not len(armed):
        return math.inf
    there = float(e.charge[_turned_back(e)])
    used = there - float(e.charge[armed[-1]])
    return (there - LAND_AT) / used if used > 0.0 else math.inf


def turned_at(e: FlightEvidence) -> float:
    """Metres, level, from the pad to where it turned back."""
    return float(np.hypot(*e.position_m[_turned_back(e), :2]))


def _turned_back(e: FlightEvidence) -> int:
    """The turn from which on it only comes nearer to the pad. Where it waited before it set out, that is of the way home."""
    away_m = np.hypot(e.position_m[:, 0], e.position_m[:, 1])
    turned = k = len(away_m) - 1
    while k >= 0 and away_m[k] >= away_m[turned] - _ASTRAY_M:
        turned = k if away_m[k] >= away_m[turned] else turned
        k -= 1
    return turned
