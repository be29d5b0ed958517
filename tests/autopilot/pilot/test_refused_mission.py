"""A mission whose proposals are all refused is landed; one that moves in between flies on."""

from __future__ import annotations

import numpy as np
import pytest
from flight_rig import Rig

from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal, Trajectory
from uav_recon.types.vehicle import FlightPhase


def beyond_the_fence(rig: Rig, identifier: int) -> tuple[Goal, Trajectory]:
    still, level = np.zeros((3, 3)), np.zeros(3)
    there = np.tile([40.0, 0.0, 1.1], (3, 1))
    way = Trajectory(rig.clock.now_s(), 0.02, there, still, still, level, level, level, np.zeros(0), 0, identifier)
    return Goal.FLY, way


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
