"""State machine of the mission: a pure function from phase and events to the next phase."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum

from uav_recon.mission.events import EFFECTS, Effect, Event


class Phase(Enum):
    """Phase of the mission. Explore-or-merge is the planner's mode, not a phase."""

    IDLE = "idle"
    READY = "ready"
    TAKEOFF = "take-off"
    SURVEY = "survey"
    HOLD = "hold"
    RETREAT = "retreat"
    RETURN = "return"
    LANDING = "landing"
    DONE = "done"
    YIELDED = "yielded"

    @property
    def finished(self) -> bool:
        """True if nothing more will be done: no phase follows."""
        return self in (Phase.DONE, Phase.YIELDED)


# Events that count in a phase; all others are ignored.
_HEARD: dict[Phase, frozenset[Event]] = {
    Phase.IDLE: frozenset({Event.VEHICLE_READY, Event.ABORTED}),
    Phase.READY: frozenset({Event.START, Event.ABORTED}),
    Phase.TAKEOFF: frozenset({Event.AIRBORNE, Event.ABORTED, Event.PILOT_LANDS, Event.REFUSED, Event.TOUCHED_DOWN}),
    Phase.SURVEY: frozenset(Event) - {Event.VEHICLE_READY, Event.START, Event.AIRBORNE, Event.AT_HOME, Event.NO_WAY_HOME},
    Phase.HOLD: frozenset(
        {
            Event.FRAMES_BACK,
            Event.ABORTED,
            Event.PILOT_LANDS,
            Event.BATTERY_LOW,
            Event.BATTERY_LOST,
            Event.TIME_SPENT,
            Event.TOUCHED_DOWN,
            Event.CALLED_HOME,
        }
    ),
    Phase.RETURN: frozenset(
        {Event.AT_HOME, Event.NO_WAY_HOME, Event.ABORTED, Event.PILOT_LANDS, Event.TOUCHED_DOWN, Event.HELD}
    ),
    Phase.RETREAT: frozenset({Event.AT_HOME, Event.ABORTED, Event.PILOT_LANDS, Event.TOUCHED_DOWN, Event.HELD}),
    Phase.LANDING: frozenset({Event.TOUCHED_DOWN}),
    Phase.DONE: frozenset(),
    Phase.YIELDED: frozenset(),
}

_ADVANCE = {Phase.IDLE: Phase.READY, Phase.READY: Phase.TAKEOFF, Phase.TAKEOFF: Phase.SURVEY}

_TARGET = {
    Effect.YIELD: Phase.YIELDED,
    Effect.FINISH: Phase.DONE,
    Effect.LAND: Phase.LANDING,
    Effect.RETREAT: Phase.RETREAT,
    Effect.RETURN: Phase.RETURN,
    Effect.HOLD: Phase.HOLD,
    Effect.RESUME: Phase.SURVEY,
}

_ON_THE_GROUND = frozenset({Phase.IDLE, Phase.READY})


def advance(phase: Phase, events: Iterable[Event]) -> Phase:
    """Return the phase after these events: the strongest effect that counts in the phase wins.

    A human wins from every phase in which the vehicle may fly, and nothing leaves YIELDED.
    """
    heard = _HEARD[phase]
    if not phase.finished:
        heard = heard | {Event.HUMAN}
    effects = {EFFECTS[event] for event in events if event in heard}
    if not effects:
        return phase
    strongest = next(effect for effect in Effect if effect in effects)
    if strongest is Effect.ADVANCE:
        return _ADVANCE[phase]
    if strongest is Effect.LAND and phase in _ON_THE_GROUND:
        return Phase.DONE
    return _TARGET[strongest]
