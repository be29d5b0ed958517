"""Checks of the battery return: charge at the turn-back point against charge used to return."""

from __future__ import annotations

import math

import numpy as np

from sitl.faults.flight_evidence import FlightEvidence

LAND_AT = 0.20  # state of charge at which both firmwares land
_ASTRAY_M = 0.3  # increase of the distance that a detour round a pillar may cause


def reserve(e: FlightEvidence) -> float:
    """Return the ratio of the usable charge at the turn-back point to the charge used to return.

    The usable charge is the charge above LAND_AT. The return lasts until the motors stop. It returns inf for a flight that
    used no charge.
    """
    armed = np.flatnonzero(e.armed)
    if not len(armed):
        return math.inf
    there = float(e.charge[_turned_back(e)])
    used = there - float(e.charge[armed[-1]])
    return (there - LAND_AT) / used if used > 0.0 else math.inf


def turned_at(e: FlightEvidence) -> float:
    """Return the horizontal distance from the pad to the turn-back point (m)."""
    return float(np.hypot(*e.position_m[_turned_back(e), :2]))


def _turned_back(e: FlightEvidence) -> int:
    """Return the index of the turn from which on the vehicle only approaches the pad.

    A wait at that point before the return counts as part of the return.
    """
    away_m = np.hypot(e.position_m[:, 0], e.position_m[:, 1])
    turned = k = len(away_m) - 1
    while k >= 0 and away_m[k] >= away_m[turned] - _ASTRAY_M:
        turned = k if away_m[k] >= away_m[turned] else turned
        k -= 1
    return turned
