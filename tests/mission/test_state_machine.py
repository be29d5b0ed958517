"""The mission's mind: every promise of the phase table."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_recon.mission.events import EFFECTS, Event
from uav_recon.mission.state_machine import Phase, advance

PHASES = st.sampled_from(Phase)
EVENTS = st.sets(st.sampled_from(Event))


def test_every_event_has_an_effect() -> None:
    assert set(EFFECTS) == set(Event)


def test_a_whole_flight_reads_like_a_flight_card() -> None:
    flight = [
        (Event.VEHICLE_READY, Phase.READY),
        (Event.START, Phase.TAKEOFF),
        (Event.AIRBORNE, Phase.SURVEY),
        (Event.FRAMES_LOST, Phase.HOLD),
        (Event.FRAMES_BACK, Phase.SURVEY),
        (Event.NOTHING_LEFT, Phase.RETURN),
        (Event.AT_HOME, Phase.LANDING),
        (Event.TOUCHED_DOWN, Phase.DONE),
    ]
    phase = Phase.IDLE
    for event, expected in flight:
        phase = advance(phase, {event})
        assert phase is expected


@given(PHASES, EVENTS)
def test_a_human_wins_from_every_phase(phase: Phase, events: set[Event]) -> None:
    after = advance(phase, events | {Event.HUMAN})
    assert after is (Phase.DONE if phase is Phase.DONE else Phase.YIELDED)


@given(st.lists(EVENTS, max_size=30))
def test_nothing_leaves_yielded(stream: list[set[Event]]) -> None:
    phase = Phase.YIELDED
    for events in stream:
        phase = advance(phase, events)
    assert phase is Phase.YIELDED


@given(st.lists(EVENTS, max_size=30))
def test_landing_is_never_taken_back(stream: list[set[Event]]) -> None:
    phase = Phase.LANDING
    for events in stream:
        phase = advance(phase, events)
        assert phase in (Phase.LANDING, Phase.DONE, Phase.YIELDED)


@pytest.mark.parametrize("phase", [Phase.TAKEOFF, Phase.SURVEY, Phase.HOLD, Phase.RETURN, Phase.RETREAT])
def test_an_abort_lands_from_every_flying_phase(phase: Phase) -> None:
    assert advance(phase, {Event.ABORTED}) is Phase.LANDING


@pytest.mark.parametrize("phase", [Phase.IDLE, Phase.READY])
def test_an_abort_on_the_ground_ends_the_mission_without_a_flight(phase: Phase) -> None:
    assert advance(phase, {Event.ABORTED, Event.START, Event.VEHICLE_READY}) is Phase.DONE


@given(PHASES, EVENTS)
def test_going_home_is_never_turned_back_into_a_survey(phase: Phase, events: set[Event]) -> None:
    if phase in (Phase.RETURN, Phase.RETREAT, Phase.LANDING, Phase.DONE):
        assert advance(phase, events) not in (Phase.SURVEY, Phase.TAKEOFF, Phase.READY, Phase.IDLE)


def test_landing_beats_returning_and_returning_beats_holding() -> None:
    assert advance(Phase.SURVEY, {Event.NOTHING_LEFT, Event.PILOT_LANDS, Event.FRAMES_LOST}) is Phase.LANDING
    assert advance(Phase.SURVEY, {Event.BATTERY_LOW, Event.FRAMES_LOST}) is Phase.RETURN


def test_the_machine_is_total() -> None:
    for phase, a, b in itertools.product(Phase, Event, Event):
        assert isinstance(advance(phase, {a, b}), Phase)
