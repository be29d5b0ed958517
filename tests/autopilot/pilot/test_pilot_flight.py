"""Flights of the pilot against the simulated PX4 in lockstep; each test is a promise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from flight_rig import ARM, ENVELOPE, MODE, SETPOINT, TAKEOFF_LAG_S, TICK_S, Rig, Tap, setpoints
from guard_rooms import may_stand
from pymavlink.dialects.v20 import common as mavlink

from uav_recon.autopilot.mavlink.address import COMPANION_ADDRESS
from uav_recon.autopilot.mavlink.tlog import Tlog
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase

ORDERS = (SETPOINT, f"COMMAND_LONG {MODE}", f"COMMAND_LONG {ARM}")


def test_a_whole_flight_from_boot_to_disarmed() -> None:
    rig = Rig()
    rig.until(FlightPhase.READY, 20.0)
    assert not rig.state.armed
    assert rig.tap.since(0)[SETPOINT] == 0, "nothing is streamed before the mission wants to fly"
    rig.intent = (Goal.FLY, None)
    rig.until(FlightPhase.FLYING, 8.0)
    rig.run(rig.fly((0.0, 0.0, 1.1)).duration_s + TAKEOFF_LAG_S)
    begin = rig.clock.now_s()
    rig.run(rig.fly((2.0, 0.0, 1.1), identifier=2).duration_s + 1.5)
    assert rig.state.trajectory_id == 2
    assert rig.state.refusals == 0

    times, wanted = setpoints(rig, begin)
    flown = np.array([np.interp(times, [t for t, _ in rig.track], [p[i] for _, p in rig.track]) for i in range(3)]).T
    error = np.linalg.norm(wanted - flown, axis=1)
    assert np.percentile(error, 95) < 0.12
    assert np.linalg.norm(rig.px4.truth().position - np.array([2.0, 0.0, 1.1])) < 0.1

    rig.intent = (Goal.LAND, None)
    rig.until(FlightPhase.LANDED, 15.0)
    assert not rig.px4.truth().armed
    assert rig.px4.failsafes == []
    assert rig.tap.since(0)[f"COMMAND_LONG {ARM}"] == 1


def test_the_handshake_keeps_its_order_and_never_forces() -> None:
    rig = Rig()
    rig.take_off_and_hover()
    first: dict[str, float] = {}
    for at, message in rig.tap.sent:
        first.setdefault(Tap.name(message), at)
    assert first["TIMESYNC"] < first["ODOMETRY"] < first["SET_GPS_GLOBAL_ORIGIN"] < first[SETPOINT]
    assert first[f"COMMAND_LONG {MODE}"] - first[SETPOINT] >= 0.9, "a stream runs before OFFBOARD is asked for"
    assert first[f"COMMAND_LONG {ARM}"] > first[f"COMMAND_LONG {MODE}"]
    for _, message in rig.tap.sent:
        if Tap.name(message) == f"COMMAND_LONG {ARM}":
            assert (message.param1, message.param2) == (1.0, 0.0)
        assert message.get_srcSystem() == COMPANION_ADDRESS.system == 233
        assert message.get_srcSystem() != 1


def test_setpoints_come_at_their_rate(hovering: Rig) -> None:
    begin = hovering.clock.now_s()
    hovering.run(5.0)
    times, _ = setpoints(hovering, begin)
    assert 148 <= len(times) <= 152
    assert np.diff(times).max() <= 0.05


@pytest.mark.slow
def test_a_converged_autopilot_still_reads_our_stamps_right() -> None:
    rig = Rig()
    rig.run(70.0)
    assert rig.px4.timesync_converged
    assert abs(rig.px4._state.timesync.offset_us) < 10_000, "our answers are on its own clock: nothing is left to correct"
    rig.take_off_and_hover()
    assert rig.px4.failsafes == []


def test_a_pilot_who_takes_over_is_left_alone(hovering: Rig) -> None:
    hovering.px4.pilot_takes_over("POSCTL")
    taken_s = hovering.clock.now_s()
    assert hovering.until(FlightPhase.YIELDED, 1.2) <= 1.2
    yielded_s = hovering.clock.now_s()
    hovering.fly((1.0, 0.0, 1.1), identifier=9)
    hovering.run(8.0)
    assert hovering.state.human_in_control
    assert not any(hovering.tap.since(yielded_s + TICK_S)[order] for order in ORDERS)
    assert hovering.tap.since(taken_s)[f"COMMAND_LONG {MODE}"] == 0
    hovering.intent = (Goal.LAND, None)
    hovering.pilot.operator.request_land()
    hovering.run(5.0)
    assert hovering.px4.truth().mode == "POSCTL"
    assert not any(hovering.tap.since(yielded_s + TICK_S)[order] for order in ORDERS)
    assert hovering.tap.since(yielded_s + 1.0)["ODOMETRY"] > 0, "a human in POSCTL needs the poses"


@pytest.mark.parametrize("delay_ticks", [0, 1, 2, 5, 10, 15, 19, 21, 50, 99, 150, 163])
def test_a_pilot_who_takes_over_while_we_ask_to_land_keeps_the_vehicle(hovering: Rig, delay_ticks: int) -> None:
    """The race between our mode request and theirs: after their mode shows in HEARTBEAT nothing more is asked."""
    rig = hovering
    rig.pilot.operator.request_land()
    rig.run(delay_ticks * TICK_S)
    rig.px4.pilot_takes_over("POSCTL")
    rig.run(1.1)
    assert rig.pilot.phase is FlightPhase.YIELDED
    quiet_s = rig.clock.now_s()
    rig.run(4.0)
    assert rig.px4.truth().mode == "POSCTL"
    assert not any(rig.tap.since(quiet_s)[order] for order in ORDERS)


def test_a_failsafe_landing_of_the_autopilot_is_accepted(hovering: Rig) -> None:
    hovering.px4.pilot_takes_over("LAND")
    hovering.until(FlightPhase.LANDING, 1.2)
    landing_s = hovering.clock.now_s()
    hovering.until(FlightPhase.LANDED, 15.0)
    assert hovering.tap.since(landing_s)[f"COMMAND_LONG {MODE}"] == 0
    assert ReasonCode.AUTOPILOT_LANDS in hovering.note_codes


def test_a_take_off_wants_its_column_known_free() -> None:
    rig = Rig()
    rig.free[40, 40, 15] = False  # a lamp over the pad
    rig.publish_free()
    rig.until(FlightPhase.READY, 20.0)
    rig.intent = (Goal.FLY, None)
    rig.run(3.0)
    assert rig.pilot.phase is FlightPhase.READY
    assert rig.note_codes == (ReasonCode.TAKEOFF_REFUSED, ReasonCode.TAKEOFF_COLUMN_NOT_FREE)
    assert not any(rig.tap.since(0)[order] for order in ORDERS)


def test_a_mission_that_never_stops_proposing_nonsense_is_not_heard(hovering: Rig) -> None:
    place = np.array(hovering.px4.truth().position)
    for identifier in range(2, 30):
        object.__setattr__(hovering.fly((2.0, 0.0, 1.1), identifier=identifier), "map_epoch", 7)
        hovering.run(0.1)
    assert ReasonCode.MANY_REFUSALS in hovering.note_codes
    assert np.linalg.norm(np.array(hovering.px4.truth().position) - place) < 0.3


def test_a_push_over_the_fence_that_lasts_lands(hovering: Rig) -> None:
    for _ in range(1200):
        (x_m, _, _), (speed_mps, _, _) = hovering.vehicle.position, hovering.vehicle.velocity
        wanted_mps = min(max(2.0 * (-3.2 - x_m), -0.8), 0.8)
        push_mps2 = min(max(25.0 * (wanted_mps - speed_mps), -15.0), 15.0)
        hovering.vehicle.external_acceleration_mps2 = (push_mps2, 0.0, 0.0)
        hovering.step()
        if hovering.pilot.phase is FlightPhase.LANDING:
            break
    assert ReasonCode.OUTSIDE_FENCE_TOO_LONG in hovering.note_codes


def test_a_landing_that_does_not_end_is_told_and_never_disarmed(hovering: Rig) -> None:
    hovering.px4.parameters.set("COM_DISARM_LAND", 0.0)
    begin_s = hovering.clock.now_s()
    hovering.intent = (Goal.LAND, None)
    hovering.run(18.0)
    assert hovering.pilot.phase is FlightPhase.LANDING
    texts = [(at - begin_s, codes) for at, codes in hovering.reported(begin_s)]
    assert [codes for _, codes in texts] == [(ReasonCode.MISSION_LAND,), (ReasonCode.LANDING_NOT_ENDING,)]
    assert texts[0][0] < 1.0
    assert 10.0 < texts[1][0] < 18.0
    assert hovering.tap.since(begin_s)[f"COMMAND_LONG {ARM}"] == 0


def test_a_mission_that_comes_back_does_not_stop_a_landing(hovering: Rig) -> None:
    hovering.intent = None
    hovering.until(FlightPhase.LANDING, 20.2)
    hovering.fly((1.0, 0.0, 1.1), identifier=5)
    hovering.until(FlightPhase.LANDED, 15.0)
    hovering.run(3.0)
    assert hovering.pilot.phase is FlightPhase.LANDED
    assert not hovering.px4.truth().armed


def test_sigterm_lands_at_once(hovering: Rig) -> None:
    hovering.pilot.operator.request_land()
    begin = hovering.clock.now_s()
    hovering.run(0.1)
    assert hovering.tap.since(begin)[f"COMMAND_LONG {MODE}"] == 1
    assert hovering.pilot.in_flight
    hovering.until(FlightPhase.LANDED, 15.0)
    assert not hovering.pilot.in_flight


def test_sigterm_on_the_ground_begins_no_flight() -> None:
    rig = Rig()
    rig.until(FlightPhase.READY, 20.0)
    rig.pilot.operator.request_land()
    rig.intent = (Goal.FLY, None)
    rig.run(5.0)
    assert rig.pilot.phase is FlightPhase.READY
    assert not any(rig.tap.since(0)[order] for order in ORDERS)


def test_a_vehicle_that_cannot_lift_itself_is_switched_off_where_it_stands() -> None:
    rig = Rig()
    rig.until(FlightPhase.READY, 20.0)
    rig.vehicle.set_thrust_ratio(1.0 / 3.0)
    rig.intent = (Goal.FLY, None)
    rig.until(FlightPhase.FLYING, 8.0)
    begin_s = rig.clock.now_s()
    rig.fly((0.0, 0.0, 1.1))
    rig.until(FlightPhase.LANDED, 8.0)
    assert rig.clock.now_s() - begin_s < 4.7
    slow = Reason(ReasonCode.CLIMB_TOO_SLOW, (0.0, 4.0))
    assert rig.state.note == Reason(ReasonCode.TAKEOFF_GIVEN_UP, details=(slow,))
    assert not rig.px4.truth().armed
    disarms = [m for _, m in rig.tap.sent if Tap.name(m) == f"COMMAND_LONG {ARM}" and m.param1 == 0.0]
    assert [m.param2 for m in disarms] == [0.0], "asked once, and never forced"
    rig.run(5.0)
    assert rig.pilot.phase is FlightPhase.LANDED


def test_a_landing_from_the_air_never_asks_for_the_motors(hovering: Rig) -> None:
    mark = len(hovering.tap.sent)
    hovering.intent = (Goal.LAND, None)
    hovering.until(FlightPhase.LANDED, 15.0)
    assert hovering.tap.since(mark)[f"COMMAND_LONG {ARM}"] == 0


def test_a_trajectory_through_the_fence_ends_in_a_hover_inside(hovering: Rig) -> None:
    trajectory = hovering.fly((4.95, 0.0, 1.1), identifier=2)
    hovering.run(trajectory.duration_s + 2.0)
    _, places = setpoints(hovering)
    assert all(may_stand(ENVELOPE, (x, y, z)) for x, y, z in np.round(places, 5).tolist())
    assert hovering.state.refusals == 1
    assert ReasonCode.OUTSIDE_FENCE in hovering.note_codes
    assert hovering.pilot.phase is FlightPhase.FLYING
    assert hovering.px4.truth().position[0] < 4.7 + 0.05


def test_the_moment_it_refuses_it_says_where_it_comes_to_rest(hovering: Rig) -> None:
    hovering.fly((4.95, 0.0, 1.1), identifier=2)
    while hovering.state.refusals == 0:
        hovering.step()
    said, (_, places) = hovering.state.world_from_rest, setpoints(hovering)
    hovering.run(3.0)
    _, later = setpoints(hovering)
    assert said is not None
    assert np.linalg.norm(said.translation_m - later[-1]) < 1e-3
    assert np.linalg.norm(places[-1] - later[-1]) > 0.01, "it braked"
    assert np.linalg.norm(said.translation_m - hovering.px4.truth().position) < 0.05, "and there it is"


def test_a_malformed_trajectory_holds_and_is_counted_once(hovering: Rig) -> None:
    place = np.array(hovering.px4.truth().position)
    broken = hovering.fly((2.0, 0.0, 1.1), identifier=2)
    object.__setattr__(broken, "position_m", broken.position_m[:-1])
    hovering.run(3.0)
    assert hovering.state.refusals == 1
    assert ReasonCode.TRAJECTORY_MALFORMED in hovering.note_codes
    assert np.linalg.norm(np.array(hovering.px4.truth().position) - place) < 0.15


def test_a_trajectory_of_another_epoch_is_not_flown(hovering: Rig) -> None:
    trajectory = hovering.fly((2.0, 0.0, 1.1), identifier=2)
    object.__setattr__(trajectory, "map_epoch", 3)
    hovering.run(3.0)
    assert ReasonCode.TRAJECTORY_MAP_EPOCH in hovering.note_codes
    assert hovering.px4.truth().position[0] < 0.2


def test_a_pilot_started_in_the_air_only_watches(hovering: Rig) -> None:
    hovering.pilot = hovering.new_pilot()
    begin = hovering.clock.now_s()
    hovering.until(FlightPhase.YIELDED, 1.5)
    hovering.run(8.0)
    assert not any(hovering.tap.since(begin + TICK_S)[order] for order in ORDERS)
    assert ReasonCode.ARMED_BY_OTHER in hovering.note_codes


def test_a_silent_autopilot_gets_no_stream(hovering: Rig) -> None:
    hovering.fly((2.0, 0.0, 1.1), identifier=2)
    hovering.run(2.0)
    hovering.tap.deaf = True
    begin = hovering.clock.now_s()
    hovering.run(1.7)
    _, places = setpoints(hovering, begin + 1.5)
    assert np.ptp(places, axis=0).max() < 1e-6, "held after a second of silence"
    hovering.run(1.5)
    assert hovering.pilot.phase is FlightPhase.YIELDED
    assert hovering.tap.since(begin + 3.1)[SETPOINT] == 0
    hovering.run(2.0)
    assert hovering.px4.truth().mode == "LAND", "the autopilot's own answer to a stream that ends"


def test_the_same_seed_sends_the_same_bytes_and_the_log_holds_them(tmp_path: Path) -> None:
    logs = []
    for name in ("a", "b"):
        log = Tlog(tmp_path / name, epoch_s=0.0)
        rig = Rig(seed=3, log=log)
        rig.until(FlightPhase.READY, 20.0)
        rig.intent = (Goal.FLY, None)
        rig.run(4.0)
        log.close()
        assert log.dropped == 0
        logs.append((tmp_path / name).read_bytes())
    assert logs[0] == logs[1]
    parser, stamps, offset, kinds = mavlink.MAVLink(None), [], 0, set()
    while offset < len(logs[0]):
        stamps.append(int.from_bytes(logs[0][offset : offset + 8], "big") * 1e-6)
        length = 12 + logs[0][offset + 9]
        kinds.add(parser.decode(bytearray(logs[0][offset + 8 : offset + 8 + length])).get_type())
        offset += 8 + length
    assert all(np.diff(stamps) >= 0)
    assert stamps[0] == pytest.approx(100.0, abs=0.1)
    assert {"HEARTBEAT", "ODOMETRY", SETPOINT, "SYS_STATUS", "COMMAND_ACK"} <= kinds


def test_why_the_mission_lands_is_told_at_once(hovering: Rig) -> None:
    hovering.said, hovering.intent = Reason(ReasonCode.RETURN_STOPPED, (4,)), (Goal.LAND, None)
    landing_s = hovering.clock.now_s()
    hovering.run(0.2)
    said = [codes for _, codes in hovering.reported(landing_s)]
    assert said == [(ReasonCode.MISSION_LAND,), (ReasonCode.RETURN_STOPPED,)]
