"""An operator's hold and land at the pilot, while the mission lives, is silent, or is none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from flight_rig import ARM, MODE, Rig, Tap
from pymavlink.dialects.v20 import common as mavlink

from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
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
    hovering.pilot.operator.request_hold(True)
    hovering.run(1.5)
    assert braked_after_s(hovering, begin_s) <= 0.15
    here = hovering.track[-1][1]
    hovering.run(2.0)
    assert np.linalg.norm(hovering.track[-1][1] - here) < 0.10
    assert hovering.pilot.phase is FlightPhase.FLYING


def test_a_hold_is_ended_by_going_on(hovering: Rig) -> None:
    hovering.pilot.operator.request_hold(True)
    hovering.fly((0.8, 0.0, 1.1))
    hovering.run(3.0)
    assert hovering.track[-1][1][0] < 0.1
    hovering.pilot.operator.request_hold(False)
    way = hovering.fly((0.8, 0.0, 1.1), identifier=2)
    hovering.run(way.duration_s + 2.0)
    assert hovering.track[-1][1][0] == pytest.approx(0.8, abs=0.06)


def test_a_land_with_a_dead_mission_is_asked_for_at_once(hovering: Rig) -> None:
    hovering.intent = None
    hovering.run(1.0)
    begin_s = hovering.clock.now_s()
    hovering.pilot.operator.request_land(Reason(ReasonCode.OPERATOR_LAND))
    hovering.until(FlightPhase.LANDED, 20.0)
    commands = [at for at, m in hovering.tap.sent if Tap.name(m) == f"COMMAND_LONG {MODE}" and at >= begin_s]
    assert commands[0] - begin_s <= 0.30  # it waits for a heartbeat, lest a human took over unseen
    assert hovering.state.note == Reason(ReasonCode.OPERATOR_LAND)


def test_a_human_wins_over_a_hold(hovering: Rig) -> None:
    hovering.pilot.operator.request_hold(True)
    hovering.run(0.5)
    hovering.px4.pilot_takes_over("POSCTL")
    hovering.until(FlightPhase.YIELDED, 1.5)
    begin_s = hovering.clock.now_s()
    hovering.pilot.operator.request_hold(False)
    hovering.pilot.operator.request_hold(True)
    hovering.run(3.0)
    sent = hovering.tap.since(begin_s)
    assert sent["SET_POSITION_TARGET_LOCAL_NED"] == sent[f"COMMAND_LONG {MODE}"] == sent[f"COMMAND_LONG {ARM}"] == 0


def test_forged_heartbeats_of_a_ground_station_are_no_operator(hovering: Rig) -> None:
    """From systems and components that ground stations have, and from our own; only the desk counts."""
    voices = [mavlink.MAVLink(None, *ids) for ids in ((255, 190), (255, 0), (233, 191), (1, 190), (42, 1))]
    beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    for _ in range(20):
        hovering.tap.forged += b"".join(bytes(beat.pack(voice)) for voice in voices)
        hovering.run(0.1)
    assert hovering.pilot.phase is FlightPhase.FLYING
    assert hovering.state.operator_received_s == -math.inf
    hovering.pilot.operator.hear_operator()
    hovering.run(0.1)
    assert hovering.state.operator_received_s == pytest.approx(hovering.clock.now_s() - 0.1, abs=0.02)


def test_what_the_mission_has_to_tell_is_told_once_and_its_operators_hold_ends_with_him(hovering: Rig) -> None:
    hovering.pilot.operator.request_hold(True)
    way = hovering.fly((0.8, 0.0, 1.1))
    hovering.said = Reason(ReasonCode.OPERATOR_SILENT, (5.0, 30.0))
    hovering.run(3.0)
    assert hovering.track[-1][1][0] < 0.1, "a warning alone takes no hold away"
    hovering.said, hovering.operator_lost = Reason(ReasonCode.OPERATOR_LOST_RETURNING, (30.0,)), True
    hovering.run(way.duration_s + 2.0)
    way = hovering.fly((0.8, 0.0, 1.1), identifier=2)
    hovering.run(way.duration_s + 2.0)
    assert hovering.track[-1][1][0] > 0.5
    told = {(ReasonCode.OPERATOR_SILENT.value,), (ReasonCode.OPERATOR_LOST_RETURNING.value,)}
    assert [codes for _, codes in hovering.reported() if codes in told] == [
        (ReasonCode.OPERATOR_SILENT,), (ReasonCode.OPERATOR_LOST_RETURNING,),
    ]  # fmt: skip
    hovering.operator_lost = False
    hovering.run(0.1)
    hovering.pilot.operator.request_hold(True)
    hovering.fly((0.0, 0.0, 1.1), identifier=3)
    hovering.run(3.0)
    assert hovering.track[-1][1][0] > 0.4, "who is back may hold it again"
