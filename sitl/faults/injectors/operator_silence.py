"""Faults of a silent or rarely querying operator, and measures of the reaction (D8)."""

from __future__ import annotations

import math

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.injectors.base import ATTENDED, Capabilities, InjectionContext, Injector
from sitl.faults.injectors.mavlink_link import proxy_of
from sitl.faults.judges.reaction_metrics import Measure
from sitl.faults.reason_codes import NO_OPERATOR, OPERATOR_LOST_RETURNING

TIMEOUT_S = 30.0  # operator timeout of the campaign's flights, which all have an operator
_TURNED_S = 1.0  # from the message to the flight home


class OperatorSilent(Injector):
    """The operator stops querying the status."""

    needs = Capabilities.STAGES

    def begin(self, at: InjectionContext) -> None:
        """Stop for the rest of the flight."""
        at.attends = False


class OperatorIntermittent(Injector):
    """The operator queries the status once every every_s, beginning now."""

    needs = Capabilities.STAGES

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Attend during the first second of each period, in which one query falls."""
        at.attends = since_s % self._every_s < 1.0


class GroundStation(Injector):
    """Heartbeats of a ground station that reach the product once a second.

    Anybody on the link can send them.
    """

    def __init__(self, system: int = 255) -> None:
        self._voice = mavlink.MAVLink(None, system, 190)
        self._next_s = 0.0

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Send one heartbeat a second, by default from the usual system id of ground stations."""
        if since_s >= self._next_s:
            self._next_s += 1.0
            beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
            proxy_of(at).inject_to_product(bytes(beat.pack(self._voice)))


def return_delay(e: FlightEvidence) -> float:
    """Return the seconds from the operator's last query to the return message or to a landing."""
    last_s = e.notes.get(ATTENDED, math.inf)
    said = [stamp_s for stamp_s in e.reported_s((OPERATOR_LOST_RETURNING,)) if stamp_s >= last_s]
    return min([stamp_s - last_s for stamp_s in said] + [e.since(e.landing & e.armed, last_s)])


def warns_after(e: FlightEvidence) -> float:
    """Return the seconds from the operator's last query to the first warning; inf for none."""
    last_s = e.notes.get(ATTENDED, math.inf)
    return min((stamp_s - last_s for stamp_s in e.reported_s(NO_OPERATOR) if stamp_s >= last_s), default=math.inf)


def warnings(e: FlightEvidence) -> float:
    """Return the number of warnings that no operator is present."""
    return float(len(e.reported_s(NO_OPERATOR)))


def detour_on_return(after_s: float) -> Measure:
    """Return a measure of the detour on the way home.

    It is the horizontal distance flown (m) beyond the straight line to the pad, from after_s after the operator's last query
    on; _TURNED_S is added for the turn.
    """

    def measure(e: FlightEvidence) -> float:
        from_s = e.notes.get(ATTENDED, math.inf) + after_s + _TURNED_S
        way = e.position_m[(e.stamp_s >= from_s) & e.armed, :2]
        if not len(way):
            return 0.0 if from_s < math.inf else math.inf
        return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum() - np.linalg.norm(way[0]))

    return measure
