"""Refusals that lead nowhere: how long nothing but them has come of what the mission wants."""

from __future__ import annotations

import numpy as np
import pytest
from flight_rig import Rig

from uav_recon.autopilot.pilot.refusal_timer import RefusalTimer
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal, Trajectory
from uav_recon.types.vehicle import FlightPhase

TICK_S = 1 / 30


def beyond_the_fence(rig: Rig, identifier: int) -> tuple[Goal, Trajectory]:
    still, level = np.zeros((3, 3)), np.zeros(3)
    there = np.tile([40.0, 0.0, 1.1], (3, 1))
    way = Trajectory(rig.clock.now_s(), 0.02, there, still, still, level, level, level, np.zeros(0), 0, identifier)
    return Goal.FLY, way


def heard(vain: RefusalTimer, seconds: float, now_s: float, refusals: int = 0, moving: bool = False) -> float:
    """The same for a while; the instant at which it ends."""
    for _ in range(round(seconds / TICK_S)):
        now_s += TICK_S
        vain.update(refusals, moving, now_s)
    return now_s


@pytest.mark.parametrize("period_s", [0.5, 3.0, 19.0])
def test_it_counts_from_the_first_refusal_to_the_last(period_s: float) -> None:
    vain, now_s = RefusalTimer(20.0), 100.0
    assert vain.refused_s == 0.0
    for n in range(5):
        now_s = heard(vain, period_s, now_s, 1 + n)
        assert vain.refused_s == pytest.approx(n * period_s, abs=0.1)


def test_hovering_after_a_refusal_is_not_being_refused() -> None:
    vain = RefusalTimer(20.0)
    now_s = heard(vain, 21.0, 100.0, 1)
    assert vain.refused_s == 0.0
    heard(vain, 3.0, now_s, 2)
    assert vain.refused_s == 0.0, "the one before is too long ago"


def test_a_motion_of_a_second_ends_it_and_a_shorter_one_does_not() -> None:
    vain = RefusalTimer(20.0)
    now_s = heard(vain, 5.0, heard(vain, 5.0, 100.0, 1), 2)
    assert vain.refused_s == pytest.approx(5.0, abs=0.1)
    now_s = heard(vain, 0.5, heard(vain, 0.9, now_s, 2, moving=True), 3)
    assert vain.refused_s == pytest.approx(10.9, abs=0.2)
    now_s = heard(vain, 1.2, now_s, 3, moving=True)
    assert vain.refused_s == 0.0
    now_s = heard(vain, 4.0, now_s, 4)
    assert vain.refused_s == 0.0
    heard(vain, 4.0, now_s, 5)
    assert vain.refused_s == pytest.approx(4.0, abs=0.1)


def test_two_moments_of_motion_are_no_motion() -> None:
    vain = RefusalTimer(20.0)
    now_s = heard(vain, 5.0, heard(vain, 5.0, 100.0, 1), 2)
    for n in range(5):
        now_s = heard(vain, 0.1, heard(vain, 0.8, now_s, 3 + n, moving=True), 3 + n)
    assert vain.refused_s > 8.0


@pytest.mark.parametrize("period_s", [1.0, *(pytest.param(s, marks=pytest.mark.nightly) for s in (0.4, 0.55, 4.0))])
def test_a_mission_that_wants_nothing_but_what_is_refused_is_landed(hovering: Rig, period_s: float) -> None:
    begin_s, n, next_s = hovering.clock.now_s(), 10, -1.0
    while hovering.pilot.phase is FlightPhase.FLYING and hovering.clock.now_s() - begin_s < 30.0:
        if hovering.clock.now_s() >= next_s:
            next_s, n = hovering.clock.now_s() + period_s, n + 1
            hovering.intent = beyond_the_fence(hovering, n)
        hovering.step()
    assert hovering.pilot.phase is FlightPhase.LANDING
    assert 20.0 < hovering.clock.now_s() - begin_s <= 20.0 + 2.0 * period_s + 2.5
    hovering.run(0.1)
    assert ReasonCode.REFUSED_TOO_LONG in hovering.note_codes
    hovering.until(FlightPhase.LANDED, 15.0)


def test_a_mission_that_moves_between_refusals_flies_on(hovering: Rig) -> None:
    begin_s, n = hovering.clock.now_s(), 10
    while hovering.clock.now_s() - begin_s < 40.0:
        n += 2
        hovering.intent = beyond_the_fence(hovering, n)
        hovering.run(4.0)
        hovering.fly((1.0 if n % 4 else 0.0, 0.0, 1.1), identifier=n + 1)
        hovering.run(6.0)
        assert hovering.pilot.phase is FlightPhase.FLYING, hovering.state.note
    assert hovering.state.refusals >= 4
