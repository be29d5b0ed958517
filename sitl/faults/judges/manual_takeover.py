"""Check that a vehicle taken over by a human pilot stays under manual control.

The pilot's mode switch and a command of the product may cross on the link.
"""

from __future__ import annotations

import math

import numpy as np

from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.injectors.base import TAKEN_OVER

_LAND = (176, 21)  # DO_SET_MODE and NAV_LAND
_HEARD_S = 0.02  # from a heartbeat's arrival to the reaction
_FLIES_S = 0.1  # transit time of a command


def mode_taken_back(e: FlightEvidence) -> float:
    """Return the number of turns after the switch in another mode than the pilot's.

    A landing does not count if it was requested before the product could receive the new mode. It returns inf if the
    pilot's mode was never active and no such landing is the reason.
    """
    switched_s = e.notes.get(TAKEN_OVER, math.inf)
    blind_until_s = next((stamp_s for stamp_s, _, _ in e.heard if stamp_s >= switched_s), math.inf) + _HEARD_S
    blind = [o.stamp_s for o in e.wire.orders if o.command in _LAND and switched_s - _FLIES_S < o.stamp_s <= blind_until_s]
    after = e.armed & (e.stamp_s > switched_s)
    theirs = np.flatnonzero(after & ~e.ours & ~e.landing)
    asked = [e.since(after & e.landing, o) <= _FLIES_S for o in blind]
    if not len(theirs):
        return 0.0 if any(asked) and not (e.ours & (e.stamp_s > max(blind) + _FLIES_S)).any() else math.inf
    other = np.flatnonzero(
        after & np.array([mode != e.mode[theirs[0]] for mode in e.mode]) & (e.stamp_s > e.stamp_s[theirs[0]])
    )
    begun_s = float(e.stamp_s[other[0]]) if len(other) else math.inf
    excused = any(0.0 <= begun_s - o <= _FLIES_S for o in blind) and bool(e.landing[other].all())
    return 0.0 if excused else float(len(other))
