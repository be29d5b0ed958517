"""Flights of the pilot against the simulated ArduCopter in lockstep; each test is a promise."""

from __future__ import annotations

import numpy as np
import pytest
from flight_copy import flight_copy
from flight_rig import ARM, MODE, TAKEOFF_LAG_S, TICK_S, Rig, Tap

from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.byte_links import ByteEnd
from uav_recon.autopilot.firmware.ardupilot import ARDUPILOT
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase

SETPOINT, CLIMB = "SET_POSITION_TARGET_LOCAL_NED", "COMMAND_LONG 22"
ORDERS = (SETPOINT, f"COMMAND_LONG {MODE}", f"COMMAND_LONG {ARM}", CLIMB)


class CopterRig(Rig):
    """The same flight on the other firmware."""

    firmware = ARDUPILOT

    def _make_autopilot(self, end: ByteEnd, seed: int) -> ArduCopter:
        return ArduCopter(self.vehicle, end, ArduPilotParameters.load(), seed)

    def take_off_and_hover(self) -> None:
        self.until(FlightPhase.READY, 30.0)
        self.intent = (Goal.FLY, None)
        self.until(FlightPhase.FLYING, 15.0)
        self.run(0.3)
        self.run(self.fly((0.0, 0.0, 1.1)).duration_s + TAKEOFF_LAG_S)
        assert abs(self.height_m - 1.1) < 0.06


@pytest.fixture(scope="module")
def flown_up() -> CopterRig:
    rig = CopterRig()
    rig.take_off_and_hover()
    return rig


@pytest.fixture
def hovering(flown_up: CopterRig) -> CopterRig:
    return flight_copy(flown_up)


def mode_of(rig: Rig) -> str:
    return rig.autopilot.truth().mode


def test_the_handshake_keeps_its_order_and_never_forces(hovering: CopterRig) -> None:
    first: dict[str, float] = {}
    for at, message in hovering.tap.sent:
        first.setdefault(Tap.name(message), at)
        if Tap.name(message) == f"COMMAND_LONG {ARM}":
            assert (message.param1, message.param2) == (1.0, 0.0)
    order = ["TIMESYNC", "ODOMETRY", "SET_GPS_GLOBAL_ORIGIN", f"COMMAND_LONG {MODE}", f"COMMAND_LONG {ARM}", CLIMB, SETPOINT]
    assert [first[name] for name in order] == sorted(first[name] for name in order)
    assert hovering.tap.since(0)["SET_GPS_GLOBAL_ORIGIN"] == 1
    assert hovering.tap.since(0)[CLIMB] == 1
    assert {m.type_mask for _, m in hovering.tap.sent if Tap.name(m) == SETPOINT} == {2048}


def test_no_setpoint_is_sent_before_it_is_in_the_air(hovering: CopterRig) -> None:
    first_s = next(at for at, m in hovering.tap.sent if Tap.name(m) == SETPOINT)
    height = next(place[2] for at, place in hovering.track if at >= first_s)
    assert height > 0.3


def test_a_trajectory_is_followed_and_the_flight_ends_disarmed(hovering: CopterRig) -> None:
    hovering.run(hovering.fly((2.0, 0.0, 1.1), identifier=2).duration_s + 2.0)
    assert hovering.state.refusals == 0
    assert np.linalg.norm(hovering.autopilot.truth().position - np.array([2.0, 0.0, 1.1])) < 0.1
    hovering.intent = (Goal.LAND, None)
    hovering.until(FlightPhase.LANDED, 20.0)
    assert not hovering.autopilot.truth().armed
    assert hovering.autopilot.failsafes == []


def test_a_silent_mission_is_landed_for_since_the_firmware_would_hover_for_ever(hovering: CopterRig) -> None:
    hovering.intent = None
    hovering.until(FlightPhase.LANDED, 25.0)
    assert ReasonCode.MISSION_SILENT in hovering.note_codes
    assert hovering.autopilot.failsafes == []


def test_lost_poses_land_seconds_before_the_firmware_notices(hovering: CopterRig) -> None:
    hovering.poses = False
    hovering.until(FlightPhase.LANDING, 1.3)
    hovering.run(0.3)
    assert mode_of(hovering) == "LAND"
    hovering.until(FlightPhase.LANDED, 25.0)
    assert hovering.autopilot.failsafes == []


def test_a_dead_companion_is_landed_for(hovering: CopterRig) -> None:
    begin = now_s = hovering.clock.now_s()
    while mode_of(hovering) == "GUIDED" and now_s < begin + 4.0:
        now_s += TICK_S
        hovering.autopilot.step(now_s)
    assert hovering.autopilot.failsafes == ["Companion silent: LAND"]
    assert now_s - begin < 1.7


def test_a_pilot_who_takes_over_is_left_alone(hovering: CopterRig) -> None:
    hovering.autopilot.pilot_takes_over()
    hovering.until(FlightPhase.YIELDED, 1.2)
    yielded_s = hovering.clock.now_s()
    hovering.fly((1.0, 0.0, 1.1), identifier=9)
    hovering.pilot.operator.request_land()
    hovering.run(6.0)
    assert mode_of(hovering) == "LOITER"
    assert not any(hovering.tap.since(yielded_s + TICK_S)[order] for order in ORDERS)
    assert hovering.tap.since(yielded_s + 1.0)["HEARTBEAT"] > 0
    assert hovering.tap.since(yielded_s + 1.0)["ODOMETRY"] > 0, "a human in LOITER needs the poses"


def test_a_pilot_who_gives_it_back_is_told_that_it_is_not_taken_up(hovering: CopterRig) -> None:
    hovering.autopilot.pilot_takes_over("LOITER")
    hovering.run(3.0)
    hovering.autopilot.pilot_takes_over("GUIDED")
    given_s = hovering.clock.now_s()
    hovering.run(4.0)
    assert hovering.pilot.phase is FlightPhase.YIELDED
    assert not any(hovering.tap.since(given_s)[order] for order in ORDERS)
    assert [codes for _, codes in hovering.reported(given_s)] == [(ReasonCode.CONTROL_RETURNED,)]
    assert hovering.state.note == Reason(ReasonCode.CONTROL_RETURNED, ("GUIDED",))
    assert mode_of(hovering) == "GUIDED", "a human's own ground station may fly it"


def test_a_failsafe_landing_of_the_autopilot_is_accepted(hovering: CopterRig) -> None:
    hovering.autopilot.pilot_takes_over("LAND")
    hovering.until(FlightPhase.LANDING, 1.2)
    landing_s = hovering.clock.now_s()
    hovering.until(FlightPhase.LANDED, 15.0)
    assert hovering.tap.since(landing_s)[f"COMMAND_LONG {MODE}"] == 0


def test_a_pilot_restarted_in_the_air_keeps_silent_so_that_the_firmware_lands(hovering: CopterRig) -> None:
    """Its heartbeat would say that the companion lives, and the vehicle would hover in GUIDED for ever."""
    hovering.pilot = hovering.new_pilot()
    begin = hovering.clock.now_s()
    hovering.until(FlightPhase.YIELDED, 1.5)
    hovering.run(3.0)
    assert mode_of(hovering) == "LAND"
    hovering.run(10.0)
    assert not hovering.autopilot.truth().armed
    assert not any(hovering.tap.since(begin + TICK_S)[order] for order in ORDERS)


def test_a_silent_autopilot_is_left_to_its_own_failsafe(hovering: CopterRig) -> None:
    hovering.tap.deaf = True
    begin = hovering.clock.now_s()
    hovering.run(4.0)
    assert hovering.pilot.phase is FlightPhase.YIELDED
    assert hovering.tap.since(begin + 3.1)[SETPOINT] == 0
    hovering.run(2.5)
    assert mode_of(hovering) == "LAND", "the answer to a heartbeat that ends"


def test_a_vehicle_that_cannot_lift_itself_is_switched_off_where_it_stands() -> None:
    rig = CopterRig()
    rig.until(FlightPhase.READY, 30.0)
    rig.vehicle.set_thrust_ratio(1.0 / 3.0)
    rig.intent = (Goal.FLY, None)
    while not rig.autopilot.truth().armed:
        rig.step()
    begin_s = rig.clock.now_s()
    while rig.autopilot.truth().armed:
        rig.step()
        assert rig.turn < 4000
    assert 5.0 < rig.clock.now_s() - begin_s < 6.0


def test_a_take_off_that_is_withdrawn_lands() -> None:
    rig = CopterRig()
    rig.until(FlightPhase.READY, 30.0)
    rig.intent = (Goal.FLY, None)
    while rig.height_m < 0.1:
        rig.step()
        assert rig.turn < 4000
    rig.intent = (Goal.STANDBY, None)
    rig.until(FlightPhase.LANDED, 15.0)
    assert not rig.autopilot.truth().armed
    assert rig.tap.since(0)[SETPOINT] < 30, "none but those that hold while LAND is not seen yet"


def test_a_vehicle_that_a_human_armed_while_our_mode_was_lost_stays_his() -> None:
    rig = CopterRig()
    rig.until(FlightPhase.READY, 30.0)
    rig.tap.mute = True
    rig.intent = (Goal.FLY, None)
    rig.until(FlightPhase.ARMING, 2.0)
    rig.run(0.3)
    rig.tap.mute = False
    rig.autopilot.pilot_takes_over("LOITER")
    assert isinstance(rig.autopilot, ArduCopter)
    state = rig.autopilot._state
    assert state.commander.request_arming(True, False, state.condition()) == 0
    rig.until(FlightPhase.YIELDED, 0.3)
    yielded_s = rig.clock.now_s()
    rig.run(6.0)
    assert mode_of(rig) == "LOITER"
    assert not any(rig.tap.since(yielded_s + TICK_S)[order] for order in ORDERS)


@pytest.mark.parametrize("waits_s", [0.05, 0.5, 1.5])
def test_a_pilot_who_takes_over_before_it_lifts_keeps_his_motors(waits_s: float) -> None:
    rig = CopterRig()
    rig.until(FlightPhase.READY, 30.0)
    rig.intent = (Goal.FLY, None)
    while not rig.autopilot.truth().armed:
        rig.step()
    rig.run(waits_s)
    assert rig.height_m < 0.05
    assert isinstance(rig.autopilot, ArduCopter)
    rig.autopilot.pilot_takes_over("LOITER")
    taken_s = rig.clock.now_s()
    rig.run(3.0)
    assert rig.pilot.phase is FlightPhase.YIELDED
    assert rig.tap.since(taken_s)[f"COMMAND_LONG {ARM}"] == 0
    assert mode_of(rig) == "LOITER"
