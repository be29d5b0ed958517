"""The last rung: a landing that is asked for, never over a human's head, and handed to the firmware if it is not taken up."""

from __future__ import annotations

from typing import Any

import pytest
from flight_rig import ARM, MODE, SETPOINT, TICK_S, Rig
from test_pilot_flight_ardupilot import CopterRig

from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase

ORDERS = (SETPOINT, f"COMMAND_LONG {MODE}", f"COMMAND_LONG {ARM}")
ASKED = f"COMMAND_LONG {MODE}"


def refuse_every_mode(commander: Any) -> None:
    """MAV_RESULT_TEMPORARILY_REJECTED, to every request."""
    vars(commander)["request_mode"] = lambda *request: 1


def test_a_refused_landing_is_handed_to_px4(hovering: Rig) -> None:
    refuse_every_mode(hovering.px4._state.commander)
    hovering.intent = (Goal.LAND, None)
    hovering.until(FlightPhase.LANDING, 0.5)
    hovering.until(FlightPhase.YIELDED, 5.2)
    yielded_s = hovering.clock.now_s()
    assert 7 <= hovering.tap.since(yielded_s - 5.2)[ASKED] <= 8
    hovering.run(1.5)
    assert hovering.px4.truth().mode == "LAND", "its answer to a stream that ends"
    assert ReasonCode.LAND_NOT_ACCEPTED in hovering.note_codes
    hovering.run(12.0)
    assert not hovering.px4.truth().armed
    assert not any(hovering.tap.since(yielded_s + TICK_S)[order] for order in ORDERS)


def test_a_refused_landing_is_handed_to_ardupilot() -> None:
    rig = CopterRig()
    rig.take_off_and_hover()
    refuse_every_mode(rig.autopilot._state.commander)  # type: ignore[attr-defined]
    rig.intent = (Goal.LAND, None)
    rig.until(FlightPhase.LANDING, 0.5)
    rig.until(FlightPhase.YIELDED, 5.2)
    rig.run(2.5)
    assert rig.autopilot.failsafes == ["Companion silent: LAND"], "its answer to a heartbeat that ends"
    rig.run(12.0)
    assert not rig.autopilot.truth().armed


@pytest.mark.parametrize("wish", ["the operator's", "the mission's", "the ladder's"])
@pytest.mark.parametrize("deaf_s", [1.2, 2.0, 2.9])
def test_no_landing_is_sent_over_a_human_unseen(hovering: Rig, wish: str, deaf_s: float) -> None:
    hovering.tap.deaf = True
    deaf_since_s = hovering.clock.now_s()
    hovering.run(0.3)
    hovering.px4.pilot_takes_over("POSCTL")
    hovering.poses = wish != "the ladder's"
    hovering.run(0.3)
    if wish == "the operator's":
        hovering.pilot.operator.request_land()
    elif wish == "the mission's":
        hovering.intent = (Goal.LAND, None)
    hovering.run(deaf_s - 0.6)
    hovering.tap.deaf = False
    hovering.until(FlightPhase.YIELDED, 0.3)
    assert hovering.tap.since(deaf_since_s)[ASKED] == 0


def test_a_landing_wished_for_while_deaf_is_asked_for_when_it_hears_again(hovering: Rig) -> None:
    hovering.tap.deaf = True
    hovering.run(0.7)
    hovering.pilot.operator.request_land()
    hovering.run(0.8)
    hovering.tap.deaf = False
    hovering.run(0.4)
    assert hovering.px4.truth().mode == "LAND"
    hovering.until(FlightPhase.LANDED, 15.0)


def test_a_landing_wished_for_while_deaf_for_good_is_the_firmwares(hovering: Rig) -> None:
    hovering.tap.deaf = True
    hovering.run(0.7)
    hovering.pilot.operator.request_land()
    hovering.until(FlightPhase.YIELDED, 2.5)
    hovering.run(1.5)
    assert hovering.px4.truth().mode == "LAND"
