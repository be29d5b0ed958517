"""Event detection: observations become events, and a table gives each event its effect.

No state, no clock, no I/O.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from uav_recon.types.vehicle import FlightPhase, VehicleState


class Event(Enum):
    """Events of a step."""

    VEHICLE_READY = "the autopilot is ready to arm"
    START = "start was given"
    AIRBORNE = "the take-off is over"
    FRAMES_LOST = "no depth frame for too long"
    FRAMES_BACK = "depth frames are back"
    NOTHING_LEFT = "no task is worth a flight"
    VIEWS_SPENT = "the view budget is spent"
    TIME_SPENT = "the flight time is spent"
    BATTERY_LOW = "the battery is low for the way home"
    BATTERY_LOST = "nothing credible was heard of the battery for too long"
    AT_HOME = "over the pad"
    NO_WAY_HOME = "no way home is known"
    ABORTED = "the operator asked to land"
    HELD = "the operator asked to hold"
    CALLED_HOME = "the operator asked to return"
    PILOT_LANDS = "the pilot process or the autopilot is landing"
    TOUCHED_DOWN = "disarmed after the flight"
    REFUSED = "the autopilot refuses to arm"
    HUMAN = "a human has the sticks"


class Effect(Enum):
    """Effect of an event on the state machine, strongest first."""

    YIELD = "yield"
    FINISH = "finish"
    LAND = "land"
    RETREAT = "retreat"
    RETURN = "return"
    HOLD = "hold"
    RESUME = "resume"
    ADVANCE = "advance"


EFFECTS: dict[Event, Effect] = {
    Event.HUMAN: Effect.YIELD,
    Event.TOUCHED_DOWN: Effect.FINISH,
    Event.REFUSED: Effect.FINISH,
    Event.ABORTED: Effect.LAND,
    Event.PILOT_LANDS: Effect.LAND,
    Event.AT_HOME: Effect.LAND,
    Event.NO_WAY_HOME: Effect.RETREAT,
    Event.NOTHING_LEFT: Effect.RETURN,
    Event.VIEWS_SPENT: Effect.RETURN,
    Event.TIME_SPENT: Effect.RETURN,
    Event.BATTERY_LOW: Effect.RETURN,
    Event.BATTERY_LOST: Effect.RETURN,
    Event.CALLED_HOME: Effect.RETURN,
    Event.HELD: Effect.HOLD,
    Event.FRAMES_LOST: Effect.HOLD,
    Event.FRAMES_BACK: Effect.RESUME,
    Event.VEHICLE_READY: Effect.ADVANCE,
    Event.START: Effect.ADVANCE,
    Event.AIRBORNE: Effect.ADVANCE,
}


@dataclass(frozen=True, slots=True)
class Facts:
    """Input of one step of the conductor; observe() turns it into events."""

    vehicle: VehicleState | None
    start: bool  # given by the operator or by autostart, with every stage warm
    abort: bool
    at_rest: bool  # the trajectory is flown and its views are taken
    took_off: bool  # it is off the floor, and the climb was commanded
    frame_age_s: float
    frame_timeout_s: float
    nothing_left: bool
    views_left: int
    flight_s: float
    max_flight_s: float
    arrived: bool  # at the end of a path home
    no_way_home: bool
    battery_low: bool  # the charge is needed for the way home
    battery_lost: bool
    hold: bool = False  # the operator's hold is active
    go_home: bool = False


# Events of the mission itself. They wait while the operator holds the vehicle; humans, landings and faults do not.
OWN_WISHES = frozenset(
    {
        Event.AIRBORNE, Event.FRAMES_BACK, Event.NOTHING_LEFT, Event.VIEWS_SPENT, Event.TIME_SPENT, Event.BATTERY_LOW,
        Event.BATTERY_LOST, Event.AT_HOME, Event.NO_WAY_HOME, Event.CALLED_HOME,
    }
)  # fmt: skip


def observe(facts: Facts) -> frozenset[Event]:
    """Return every event that these facts show."""
    vehicle = facts.vehicle
    if vehicle is None:
        return frozenset()
    phase = vehicle.phase
    shown = {
        Event.VEHICLE_READY: phase is FlightPhase.READY,
        Event.START: facts.start and phase is FlightPhase.READY,
        Event.AIRBORNE: facts.took_off and facts.at_rest and phase is FlightPhase.FLYING,
        Event.FRAMES_LOST: facts.frame_age_s > facts.frame_timeout_s,
        Event.FRAMES_BACK: facts.frame_age_s <= facts.frame_timeout_s,
        Event.NOTHING_LEFT: facts.nothing_left,
        Event.VIEWS_SPENT: facts.views_left <= 0 and facts.at_rest,
        Event.TIME_SPENT: facts.flight_s > facts.max_flight_s,
        Event.BATTERY_LOW: facts.battery_low,
        Event.BATTERY_LOST: facts.battery_lost,
        Event.AT_HOME: facts.arrived,
        Event.NO_WAY_HOME: facts.no_way_home,
        Event.ABORTED: facts.abort,
        Event.HELD: facts.hold,
        Event.CALLED_HOME: facts.go_home,
        Event.PILOT_LANDS: phase is FlightPhase.LANDING,
        Event.TOUCHED_DOWN: phase is FlightPhase.LANDED,
        Event.REFUSED: phase is FlightPhase.READY and vehicle.note is not None,  # back on the ground with a reason
        Event.HUMAN: vehicle.human_in_control or phase is FlightPhase.YIELDED,
    }
    events = frozenset(event for event, holds in shown.items() if holds)
    return events - OWN_WISHES if facts.hold else events
