"""An operator's hold and land at the pilot, while the mission lives, is silent, or is none."""

from __future__ import annotations

import numpy as np
import pytest
from flight_rig import ARM, MODE, Rig, Tap

from uav_recon.types.vehicle import FlightPhase


def braked_after_s(rig: Rig, since_s: float) -> float:
    """How long after an instant a setpoint was on the wire that is slower by a tenth than the last one before it."""
    speeds = [(at, float(np.hypot(m.vx, m.vy))) for at, m in rig.tap.sent if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    before = [speed for at, speed in speeds if at < since_s][-1]
    assert before > 0.2
    return next(at for at, speed in speeds if at >= since_s and speed < 0.9 * before) - since_s


@pytest.mark.parametrize("mission", ["lives", "is dead"])
def test_a_hold_is_on_the_wire_at_once_and_lasts(hovering: Rig, mission: str) -> None:
    hovering.fly((2.5, 0.0, 1.1))
    hovering.run(3.0)
    if mission == "is dead":
        hovering.intent = None
    begin_s = hovering.clock.now_s()
    hovering.pilot.request_hold(True)
    hovering.run(1.5)
    assert braked_after_s(hovering, begin_s) <= 0.15
    here = hovering.track[-1][1]
    hovering.run(2.0)
    assert np.linalg.norm(hovering.track[-1][1] - here) < 0.10
    assert hovering.pilot.phase is FlightPhase.FLYING


def test_a_hold_is_ended_by_going_on(hovering: Rig) -> None:
    hovering.pilot.request_hold(True)
    hovering.fly((0.8, 0.0, 1.1))
    hovering.run(3.0)
    assert hovering.track[-1][1][0] < 0.1
    hovering.pilot.request_hold(False)
    way = hovering.fly((0.8, 0.0, 1.1), identifier=2)
    hovering.run(way.duration_s + 2.0)
    assert hovering.track[-1][1][0] == pytest.approx(0.8, abs=0.06)


def test_a_land_with_a_dead_mission_is_asked_for_at_once(hovering: Rig) -> None:
    hovering.intent = None
    hovering.run(1.0)
    begin_s = hovering.clock.now_s()
    hovering.pilot.request_land("the operator asked to land")
    hovering.until(FlightPhase.LANDED, 20.0)
    commands = [at for at, m in hovering.tap.sent if Tap.name(m) == f"COMMAND_LONG {MODE}" and at >= begin_s]
    assert commands[0] - begin_s <= 0.30  # it waits for a heartbeat, lest a human took over unseen
    assert hovering.state.note == "the operator asked to land"


def test_a_human_wins_over_a_hold(hovering: Rig) -> None:
    hovering.pilot.request_hold(True)
    hovering.run(0.5)
    hovering.px4.pilot_takes_over("POSCTL")
    hovering.until(FlightPhase.YIELDED, 1.5)
    begin_s = hovering.clock.now_s()
    hovering.pilot.request_hold(False)
    hovering.pilot.request_hold(True)
    hovering.run(3.0)
    sent = hovering.tap.since(begin_s)
    assert sent["SET_POSITION_TARGET_LOCAL_NED"] == sent[f"COMMAND_LONG {MODE}"] == sent[f"COMMAND_LONG {ARM}"] == 0
