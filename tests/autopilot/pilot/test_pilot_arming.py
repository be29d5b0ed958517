"""From the mission's word to fly to the first motion: whose vehicle it is, and what may not end a flight yet."""

from __future__ import annotations

import math
from typing import Any

import pytest
from flight_rig import ARM, MODE, SETPOINT, TAKEOFF_LAG_S, TICK_S, Rig

from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase

ORDERS = (SETPOINT, f"COMMAND_LONG {MODE}", f"COMMAND_LONG {ARM}")


@pytest.fixture
def arming() -> Rig:
    rig = Rig()
    rig.until(FlightPhase.READY, 20.0)
    rig.intent = (Goal.FLY, None)
    rig.until(FlightPhase.ARMING, 2.0)
    return rig


def arm_as_a_human(rig: Rig, mode: str) -> None:
    """He chooses a mode and starts the motors."""
    rig.px4.pilot_takes_over(mode)
    commander = rig.px4._state.commander
    assert commander.request_arming(arm=True, force=False, condition=rig.px4._state.condition()) == 0


def reject_modes(rig: Rig, until_s: float) -> None:
    """No mode that is asked for is taken before an instant."""
    commander = rig.px4._state.commander
    request = commander.request_mode

    def answer(wanted: int, condition: Any) -> int:
        return 1 if rig.clock.now_s() < until_s else request(wanted, condition)

    vars(commander)["request_mode"] = answer


@pytest.mark.parametrize("mode", ["POSCTL", "TAKEOFF", "LOITER"])
@pytest.mark.parametrize("after_s", [0.2, 0.6, 1.05, 1.3])
def test_a_vehicle_that_a_human_armed_stays_his(arming: Rig, mode: str, after_s: float) -> None:
    reject_modes(arming, arming.clock.now_s() + after_s + 1.0)  # OFFBOARD does not come at once: it would be asked for again
    arming.run(after_s)
    arm_as_a_human(arming, mode)
    arming.until(FlightPhase.YIELDED, 0.3)
    yielded_s = arming.clock.now_s()
    arming.run(6.0)
    assert arming.px4.truth().mode in {mode, "LOITER"}, "where its own take-off ends"
    assert arming.note_codes == (ReasonCode.CONTROL_RELEASED, ReasonCode.ARMED_BY_OTHER)
    assert not any(arming.tap.since(yielded_s + TICK_S)[order] for order in ORDERS)


@pytest.mark.parametrize("after_s", [0.2, 1.02])
def test_a_mode_that_a_human_chooses_before_ours_shows_is_not_asked_away(arming: Rig, after_s: float) -> None:
    reject_modes(arming, math.inf)
    arming.run(after_s)
    arming.px4.pilot_takes_over("POSCTL")
    arming.until(FlightPhase.READY, 0.3)
    ready_s = arming.clock.now_s()
    arming.run(6.0)
    assert Reason(ReasonCode.MODE_CHANGED, ("POSCTL",)) in (arming.state.note or Reason(ReasonCode.REFUSED)).details
    assert not any(arming.tap.since(ready_s + TICK_S)[order] for order in ORDERS)


@pytest.mark.parametrize("heard", [True, False])
def test_a_pilot_told_to_end_waits_for_motors_that_may_still_start(arming: Rig, heard: bool) -> None:
    """SIGTERM just after the request: a process that ended there would leave an armed vehicle to nobody."""
    while not arming.tap.since(0)[f"COMMAND_LONG {ARM}"]:
        arming.step()
    arming.tap.deaf = True
    arming.pilot.operator.request_land()
    arming.run(1.0)
    assert arming.px4.truth().armed
    arming.tap.deaf = not heard
    begin_s = arming.clock.now_s()
    while arming.pilot.in_flight and arming.clock.now_s() - begin_s < 15.0:
        arming.step()
    if heard:
        assert not arming.px4.truth().armed
        assert arming.pilot.phase is FlightPhase.LANDED
    else:
        assert arming.px4.truth().mode == "LAND", "by itself, since nothing was streamed"


def test_a_pilot_whose_request_for_motors_came_to_nothing_ends(arming: Rig) -> None:
    vars(arming.px4._state.commander)["request_arming"] = lambda *request: 1
    while not arming.tap.since(0)[f"COMMAND_LONG {ARM}"]:
        arming.step()
    arming.pilot.operator.request_land()
    arming.run(4.8)
    assert arming.pilot.in_flight
    arming.run(0.4)
    assert not arming.pilot.in_flight


def test_somebody_who_passes_while_it_arms_does_not_end_the_flight(arming: Rig) -> None:
    arming.run(0.2)
    for n in range(60):
        arming.wall_m = 2.4 - 0.008 * n
        arming.step()
    arming.wall_m = 9.0
    arming.until(FlightPhase.FLYING, 8.0)
    arming.run(arming.fly((0.0, 0.0, 1.1)).duration_s + TAKEOFF_LAG_S)
    assert arming.pilot.phase is FlightPhase.FLYING
    assert arming.height_m == pytest.approx(1.1, abs=0.05)
