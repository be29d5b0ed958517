"""Checks of the STATUSTEXT reports (hazard G7).

The product must report a reaction and its reason within a second. A STATUSTEXT counts by the codes of its reason and of
that reason's details.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.judges.reaction_metrics import Measure, tries_s
from sitl.faults.reason_codes import CONTROL_LOST, LANDING, MISSION_LAND, REDUCED_SPEED

_LAND = (176, 21)  # DO_SET_MODE and NAV_LAND; in flight the product requests no other mode
_REPORTED_S = 1.0 + 0.05  # a second, and one or two iterations of the pilot's loop
_AIRBORNE_M = 0.3
_BEFORE_S = 0.5  # it may report first, and send the command once it knows the current mode
_FLYING_S = 0.5  # a product that sent a setpoint this recently was running and in control
_OURS_S = 3.0  # a landing this soon after the command is the one requested
_FLOOR_M = 0.05  # above the final height


def statustext_delay(*codes: str) -> Measure:
    """Return a measure of the seconds from the fault to the first STATUSTEXT with such a code."""
    return lambda e: _since(e, codes, e.onset_s)


def statustext_on_floor(*codes: str) -> Measure:
    """Return a measure of the seconds from touchdown to the first STATUSTEXT with such a code."""

    def measure(e: FlightEvidence) -> float:
        height = e.position_m[:, 2]
        low = height <= height[e.stamp_s >= e.onset_s].min(initial=math.inf) + _FLOOR_M
        return _since(e, codes, e.onset_s + e.since(low, e.onset_s))

    return measure


def statustext_after_arming(*codes: str) -> Measure:
    """Return a measure of the seconds from the first arm command to such a STATUSTEXT."""
    return lambda e: _since(e, codes, tries_s(e)[0]) if tries_s(e) else math.inf


def statustext_after_arm_command(*codes: str) -> Measure:
    """Return a measure of the seconds from the first arm command to such a STATUSTEXT.

    It is 0 if one was sent before.
    """

    def measure(e: FlightEvidence) -> float:
        reported, tried = e.reported_s(codes), tries_s(e)
        return max(0.0, min(reported) - tried[0]) if reported and tried else math.inf

    return measure


def _since(e: FlightEvidence, codes: Collection[str], from_s: float) -> float:
    reported = [stamp_s for stamp_s in e.reported_s(codes) if stamp_s >= from_s]
    return reported[0] - from_s if reported else math.inf


def landed_by_alarm(e: FlightEvidence) -> float:
    """Return 1 if no STATUSTEXT says that the mission asks to land, else 0.

    An alarm may end a flight at the pad, too.
    """
    return float(not e.reported_s((MISSION_LAND,)))


def statustext_missing(e: FlightEvidence) -> str:
    """Return the first reaction that was not reported in time, as text; '' for none."""
    asked = [o.stamp_s for o in e.wire.orders if o.command in _LAND and _airborne(e, o.stamp_s)]
    due: list[tuple[str, Collection[str], float, float]] = []
    due += [("landing requested", LANDING, asked[0], asked[0])] if asked else []
    due += [
        ("foreign mode", LANDING if lands else CONTROL_LOST, lost_s, received_s)
        for lost_s, received_s, lands in _lost(e, asked)
    ]
    for what, why, from_s, known_s in due:
        reasons = [stamp_s for stamp_s, codes in e.reported if REDUCED_SPEED not in codes and not set(codes).isdisjoint(why)]
        reported = any(from_s - _BEFORE_S <= stamp_s <= known_s + _REPORTED_S for stamp_s in reasons)
        if not reported and known_s + _REPORTED_S < e.end_s:
            return f"{what} {known_s - e.onset_s:.1f} s after the fault and not reported within {_REPORTED_S:.2f} s"
    return ""


def _airborne(e: FlightEvidence, stamp_s: float) -> bool:
    """Return whether the vehicle was off the ground.

    There a mode command can only request a landing; on the ground it requests the flight's own mode.
    """
    return bool(np.interp(stamp_s, e.stamp_s, e.position_m[:, 2]) > _AIRBORNE_M)


def _lost(e: FlightEvidence, asked: list[float]) -> list[tuple[float, float, bool]]:
    """Return each loss of our mode under our setpoints that the product had not requested.

    Each entry is (time of the loss, time at which the product received it, whether the autopilot is landing). A product
    that was about to land anyway, and has reported why, needs no further report and no further command.
    """
    left = np.flatnonzero(e.ours[:-1] & ~e.ours[1:] & e.armed[1:]) + 1
    found = []
    for at in left.tolist():
        lost_s = float(e.stamp_s[at])
        flown = ((e.wire.setpoint_s > lost_s - _FLYING_S) & (e.wire.setpoint_s <= lost_s)).any()
        ours = any(0.0 <= lost_s - stamp_s < _OURS_S for stamp_s in asked)
        before = next((mode for stamp_s, mode, _ in reversed(e.heard) if stamp_s < lost_s), None)
        received_s = next((stamp_s for stamp_s, mode, _ in e.heard if stamp_s >= lost_s and mode != before), math.inf)
        if flown and not ours:
            found.append((lost_s, received_s, bool(e.landing[at])))
    return found
