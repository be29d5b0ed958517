"""AUTOPILOTS.md, line by line, against the simulated PX4 over a pipe; all clocks injected."""

from __future__ import annotations

import copy
import copyreg
import functools
import math
import struct
from typing import Any

import pytest
from companion import LAND, LOITER, OFFBOARD, POSCTL, Companion
from pymavlink.dialects.v20 import common as mavlink

from sitl.parameters import Parameters
from sitl.px4 import STEP_S, Px4
from sitl.vehicle import Quadrotor

ARM, FORCE = mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 21196.0


def companion(seed: int = 1, **changes: float) -> Companion:
    p = Parameters.load()
    for name, value in changes.items():
        p.set(name, value)
    return Companion(p, seed)


copyreg.pickle(struct.Struct, lambda s: (struct.Struct, (s.format,)))  # pymavlink's codec holds some; copies need this


@functools.lru_cache(maxsize=8)
def taken_off(seed: int) -> Companion:
    """Flown once per seed; tests get copies."""
    c = companion(seed)
    c.take_off()
    return c


def flying(seed: int = 1, **changes: float) -> Companion:
    c = copy.deepcopy(taken_off(seed))
    for name, value in changes.items():
        c.px4.parameters.set(name, value)
    return c


def seconds_until(c: Companion, happened: Any, at_most: float) -> float:
    before = c.now_s
    assert c.run(at_most, happened), f"did not happen within {at_most} s; texts {c.texts}"
    return c.now_s - before


def converged(c: Companion) -> bool:
    return c.px4.timesync_converged


def position_valid(c: Companion) -> bool:
    return c.px4.estimator.horizontal_valid


def truth_mode(c: Companion) -> str:
    return c.px4.truth().mode


# -- the flight that must work --------------------------------------------------------------------------------------


def square(start_s: float, side: float, speed: float) -> tuple[Any, float]:
    """A smooth square at constant height: rest to rest on each side (minimum jerk), with feedforward; its duration."""
    leg_s = 1.875 * side / speed
    corners = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side), (0.0, 0.0)]

    def at(now_s: float) -> tuple[float, ...]:
        t = max(now_s - start_s, 0.0)
        leg = min(int(t / leg_s), 3)
        u = min(t / leg_s - leg, 1.0)
        s = u**3 * (10 - 15 * u + 6 * u * u)
        v = 30 * u * u * (1 - u) ** 2 / leg_s
        a = 60 * u * (1 - u) * (1 - 2 * u) / leg_s**2
        (x0, y0), (x1, y1) = corners[leg], corners[leg + 1]
        dx, dy = x1 - x0, y1 - y0
        return (x0 + s * dx, y0 + s * dy, -1.2, v * dx, v * dy, 0.0, a * dx, a * dy, 0.0, 1.27, 0.0)

    return at, 4 * leg_s


@pytest.mark.parametrize(("wind_mps", "widest"), [(0.0, 0.05), (0.15, 0.07)])
def test_the_whole_handshake_flies_a_square_and_lands(wind_mps: float, widest: float) -> None:
    c = Companion(Parameters.load(), 2, wind_mps)
    c.take_off()
    path, duration = square(c.now_s, 2.0, 0.8)
    c.setpoint = path
    along = across = 0.0
    for _ in range(round(duration / 0.05)):
        c.run(0.05)
        x, y, z = c.ned
        along = max(along, c.away_from(*path(c.now_s)[:3]))
        side = max(abs(x - 1.0), abs(y - 1.0)) - 1.0  # off the outline, outwards or inwards
        across = max(across, abs(side), abs(z + 1.2))
    assert along < 0.12
    assert across < widest
    c.run(1.0)
    assert c.away_from(0.0, 0.0, -1.2) < 0.05
    assert c.set_mode(LAND) == 0
    assert c.run(15.0, lambda: not c.armed)
    assert c.vehicle.position[2] == 0.0
    assert c.away_from(0.0, 0.0, 0.0) < 0.1
    assert c.px4.failsafes == []
    assert len(c.vehicle.touchdowns) == 1
    assert c.vehicle.touchdowns[0] < 0.6


def test_corners_of_a_smooth_path_are_cut_by_no_more_than_5_cm() -> None:
    c = Companion(Parameters.load(), 3, wind_mps=0.0)
    c.take_off()
    start = c.now_s
    radius, speed = 0.5, 0.8

    def circle(now_s: float) -> tuple[float, ...]:
        """A tight turn at 0.8 m/s (1.28 m/s^2 sideways), eased in and out over 2 s."""
        t = now_s - start
        w = speed / radius
        ease = min(t / 2.0, 1.0)
        angle = w * (t - 1.0) if t > 2.0 else w * t * t / 4.0
        rate, spin = w * ease, (w / 2.0 if t < 2.0 else 0.0)
        cos, sin = math.cos(angle), math.sin(angle)
        return (
            radius * sin, radius * (1 - cos), -1.2, radius * cos * rate, radius * sin * rate, 0.0,
            radius * (cos * spin - sin * rate**2), radius * (sin * spin + cos * rate**2), 0.0, 1.27, 0.0,
        )  # fmt: skip

    c.setpoint = circle
    errors = []
    for _ in range(1000):
        c.run(0.01)
        errors.append(abs(math.hypot(c.ned[0], c.ned[1] - radius) - radius))
    assert max(errors) < 0.05


def test_the_same_seed_gives_the_same_flight_to_the_last_bit() -> None:
    def end(seed: int) -> tuple[Any, ...]:
        c = companion(seed)
        c.take_off(0.5)
        return (c.vehicle.position, c.px4.estimator.position, tuple(c.px4.setpoint_arrivals_s))

    assert end(4) == end(4)
    assert end(4) != end(5)


# -- origin and arming ----------------------------------------------------------------------------------------------


def test_prearm_comes_about_five_seconds_after_the_origin() -> None:
    c = companion()
    c.run(8.0)
    assert c.flags & 8
    assert not c.prearm
    c.send_origin()
    assert 4.5 < seconds_until(c, lambda: c.prearm, 8.0) < 6.0
    assert c.last["GPS_GLOBAL_ORIGIN"].latitude == 473977000
    assert abs(c.last["HOME_POSITION"].z) < 0.1


def test_without_an_origin_loiter_does_not_arm_yet_offboard_does() -> None:
    c = companion()
    c.run(8.0)
    assert c.arm() == 1
    assert any("Global position estimate required" in text for text in c.texts)
    c.go_to(0.0, 0.0, 0.3)
    c.run(1.2)
    assert c.set_mode(OFFBOARD) == 0
    assert c.arm() == 0


def test_an_origin_before_the_first_pose_puts_488_m_into_the_height() -> None:
    c = companion()
    c.pose_on = False
    c.run(0.5)
    c.send_origin()
    c.run(0.2)
    c.pose_on = True
    c.run(3.0)
    assert c.last["LOCAL_POSITION_NED"].z == pytest.approx(488.0, abs=0.2)


def test_nothing_is_told_of_a_position_before_poses_are_fused() -> None:
    c = companion()
    c.pose_on = False
    c.run(3.0)
    assert "LOCAL_POSITION_NED" not in c.last
    assert not c.flags & 8
    assert c.flags & 128


def test_without_a_pose_offboard_does_not_arm() -> None:
    c = companion()
    c.pose_on = False
    c.go_to(0.0, 0.0, -1.0)
    c.run(2.0)
    c.set_mode(OFFBOARD)
    assert c.arm() == 1
    assert any("Position estimate required" in text for text in c.texts)


def test_at_one_setpoint_a_second_arming_is_denied() -> None:
    c = companion()
    c.ready()
    c.setpoint_hz = 1.0
    c.go_to(0.0, 0.0, -1.0)
    c.run(4.0)
    assert c.set_mode(OFFBOARD) == 0
    c.run(3.0)
    assert c.mode == LOITER
    assert c.arm() == 1
    assert any("No offboard signal" in text for text in c.texts)


def test_a_low_battery_and_a_silent_transmitter_forbid_arming() -> None:
    c = companion()
    c.ready()
    c.px4.set_battery(0.25)
    assert c.arm() == 1
    c.px4.set_battery(1.0)
    c.px4.transmitter(heard=False)
    c.run(1.0)
    assert c.arm() == 1
    assert any("No manual control input" in text for text in c.texts)
    c.px4.transmitter(heard=True)
    assert c.arm() == 0


def test_armed_but_not_flying_ends_after_five_seconds() -> None:
    c = companion()
    c.ready()
    assert c.arm() == 0
    c.run(1.0)
    assert c.armed
    assert 3.0 < seconds_until(c, lambda: not c.armed, 8.0) < 5.5


# -- OFFBOARD -------------------------------------------------------------------------------------------------------


def test_an_ack_is_no_proof_and_offboard_engages_later_by_itself() -> None:
    c = companion()
    c.ready()
    assert c.set_mode(OFFBOARD) == 0
    c.run(3.0)
    assert c.mode == LOITER
    c.go_to(0.0, 0.0, 0.0)
    c.run(0.8)
    assert truth_mode(c) == "LOITER"
    c.run(0.5)
    assert truth_mode(c) == "OFFBOARD"


def test_do_set_mode_is_often_acknowledged_twice() -> None:
    c = companion()
    c.ready()
    counts = set()
    for _ in range(12):
        c.acks.clear()
        c.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 3)
        c.run(0.1)
        counts.add(len(c.acks))
    assert counts == {1, 2}


def test_a_setpoint_that_controls_nothing_is_no_proof_of_life() -> None:
    c = companion()
    c.ready()
    c.go_to(0.0, 0.0, -1.0)
    c.type_mask = 0b111111111
    c.run(2.0)
    c.set_mode(OFFBOARD)
    c.run(1.5)
    assert truth_mode(c) == "LOITER"


def test_setpoints_in_other_frames_are_refused_in_words() -> None:
    c = companion()
    c.run(0.5)
    c.send(mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, mavlink.MAV_FRAME_LOCAL_ENU, 0, *[0.0] * 11))
    c.run(0.1)
    assert any("frame not supported" in text for text in c.texts)


def test_masked_fields_are_ignored() -> None:
    c = flying()
    c.setpoint = lambda _t: (99.0, 99.0, 99.0, 0.3, 0.0, 0.0, 9.0, 9.0, 9.0, 1.0, 0.0)
    c.type_mask = 0b110111000111  # velocity alone
    c.run(3.0)
    assert c.last["LOCAL_POSITION_NED"].vx == pytest.approx(0.3, abs=0.1)
    assert abs(c.ned[2] + 1.2) < 0.3


def test_a_far_setpoint_is_flown_at_the_parameters_speed() -> None:
    c = flying()
    c.go_to(20.0, 0.0, -1.2)
    fastest = 0.0
    for _ in range(400):
        c.run(0.01)
        fastest = max(fastest, math.hypot(*c.vehicle.velocity[:2]))
    assert 1.0 < fastest < 1.3


@pytest.mark.parametrize("seed", range(1, 6))
def test_when_setpoints_stop_it_lands_within_1_3_s(seed: int) -> None:
    c = flying(seed)
    c.setpoint = None
    took = seconds_until(c, lambda: truth_mode(c) == "LAND", 3.0)
    assert 0.55 < took < 1.4
    assert c.px4.failsafes == ["offboard signal lost: LAND"]
    c.go_to(1.0, 1.0, -1.2)  # the stream is back: the landing goes on
    c.run(2.0)
    assert truth_mode(c) == "LAND"
    assert c.run(15.0, lambda: not c.armed)
    assert c.vehicle.on_ground


def test_by_default_px4_would_hang_in_position_mode() -> None:
    c = flying(COM_OBL_RC_ACT=0)
    c.setpoint = None
    c.run(5.0)
    assert truth_mode(c) == "POSCTL"
    assert c.vehicle.position[2] > 1.0


def test_gaps_shorter_than_the_timeout_are_invisible() -> None:
    c = flying()
    for _ in range(5):
        c.setpoint = None
        c.run(0.4)
        c.go_to(0.0, 0.0, -1.2)
        c.run(0.3)
    assert truth_mode(c) == "OFFBOARD"
    assert c.px4.failsafes == []


def test_offboard_can_be_asked_for_again_after_a_failsafe() -> None:
    """Why a companion must never ask by itself: the autopilot would obey."""
    c = flying()
    c.setpoint = None
    c.run(1.5)
    c.go_to(0.0, 0.0, -1.2)
    c.run(1.1)
    assert c.set_mode(OFFBOARD) == 0
    c.run(0.2)
    assert truth_mode(c) == "OFFBOARD"


def test_setpoint_arrivals_are_kept_while_armed_in_offboard() -> None:
    c = flying()
    count = len(c.px4.setpoint_arrivals_s)
    c.run(2.0)
    new = c.px4.setpoint_arrivals_s[count:]
    assert len(new) == pytest.approx(60, abs=2)
    assert all(500.0 < t <= c.now_s for t in new)


# -- landing and disarming ------------------------------------------------------------------------------------------


def test_disarming_in_flight_is_refused() -> None:
    c = flying()
    assert c.ask(ARM, 0) == 1
    assert c.armed
    assert any("Disarming denied" in text for text in c.texts)


def test_forced_disarming_drops_it() -> None:
    c = flying()
    assert c.ask(ARM, 0, FORCE) == 0
    c.run(2.0)
    assert c.vehicle.on_ground
    assert c.vehicle.touchdowns[0] > 3.0


def test_land_descends_disarms_by_itself_and_the_mode_reverts() -> None:
    c = flying()
    c.go_to(0.0, 0.0, -1.2)
    assert c.set_mode(LAND) == 0
    c.run(1.1)
    assert c.mode == LAND
    assert c.last["EXTENDED_SYS_STATE"].landed_state == mavlink.MAV_LANDED_STATE_LANDING
    took = seconds_until(c, lambda: not c.armed, 15.0)
    assert 3.0 < took < 9.0
    c.run(1.1)
    assert c.mode == OFFBOARD
    assert c.last["EXTENDED_SYS_STATE"].landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND


def test_it_can_fly_again_after_landing() -> None:
    c = flying()
    c.set_mode(LAND)
    assert c.run(15.0, lambda: not c.armed)
    c.go_to(0.0, 0.0, -1.0)
    c.run(1.5)
    c.set_mode(OFFBOARD)
    c.run(1.1)
    assert c.arm() == 0
    assert c.run(12.0, lambda: c.away_from(0.0, 0.0, -1.0) < 0.06)


def test_takeoff_mode_climbs_to_its_height_and_holds() -> None:
    c = companion()
    c.ready()
    assert c.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 2) == 0
    assert c.arm() == 0
    assert c.run(12.0, lambda: truth_mode(c) == "LOITER")
    c.run(2.0)
    assert c.away_from(0.0, 0.0, -1.2) < 0.12


def test_hold_needs_an_origin_in_flight() -> None:
    c = companion()
    assert c.run(5.0, lambda: "ESTIMATOR_STATUS" in c.last and bool(c.flags & 8))
    c.go_to(0.0, 0.0, -1.0, 1.27)
    c.run(1.2)
    c.set_mode(OFFBOARD)
    c.run(1.1)
    assert c.arm() == 0
    c.run(8.0)
    assert c.set_mode(LOITER) == 1
    assert truth_mode(c) == "OFFBOARD"


def test_return_is_not_flown() -> None:
    c = flying()
    assert c.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 5) == 1
    assert truth_mode(c) == "OFFBOARD"


# -- pose loss ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("timeout_us", "earliest", "latest"), [(5_000_000, 5.2, 5.7), (1_000_000, 1.2, 1.7)])
def test_when_the_pose_stops_it_lands_by_itself(timeout_us: int, earliest: float, latest: float) -> None:
    c = flying(EKF2_NOAID_TOUT=timeout_us)
    place = c.ned
    c.pose_on = False
    took = seconds_until(c, lambda: truth_mode(c) == "LAND", 8.0)
    assert earliest < took < latest
    assert c.px4.failsafes == ["position estimate lost: LAND"]
    assert math.hypot(c.ned[0] - place[0], c.ned[1] - place[1]) < 2.0
    assert c.run(20.0, lambda: not c.armed)
    assert c.vehicle.touchdowns[0] < 1.0


def test_a_pose_that_comes_back_does_not_stop_the_landing() -> None:
    c = flying()
    c.pose_on = False
    c.run(2.0)
    c.pose_on = True
    c.run(2.0)
    assert truth_mode(c) == "LAND"


def test_without_a_position_it_keeps_level_instead_of_chasing_a_wrong_one() -> None:
    c = flying()
    c.pose_on = False
    assert c.run(4.0, lambda: truth_mode(c) == "LAND")
    place = c.ned
    x, y, z = c.px4.estimator.position
    c.px4.estimator.position = (x + 20.0, y, z)
    c.run(2.0)
    assert math.hypot(c.ned[0] - place[0], c.ned[1] - place[1]) < 0.5


def test_a_held_place_moves_along_with_a_reset_of_the_estimate() -> None:
    c = flying()
    c.px4.pilot_takes_over("POSCTL")
    c.run(1.0)
    place = c.ned
    c.pose_offset = (0.6, 0.0, 0.0)
    c.reset_counter = 1
    c.run(3.0)
    assert math.dist(c.ned, place) < 0.15


def test_a_pose_jump_with_its_reset_counter_moves_the_vehicle_back_by_the_jump() -> None:
    c = flying()
    c.pose_offset = (0.6, 0.0, 0.0)
    c.reset_counter = 1
    c.run(0.1)
    assert c.last["LOCAL_POSITION_NED"].x == pytest.approx(c.ned[0] + 0.6, abs=0.1)
    c.run(4.0)
    assert c.ned[0] == pytest.approx(-0.6, abs=0.1)


def test_a_pose_jump_without_a_reset_counter_is_refused_silently() -> None:
    c = flying(EKF2_NOAID_TOUT=5_000_000)
    c.pose_offset = (0.6, 0.0, 0.0)
    c.run(0.8)
    assert abs(c.ned[0]) < 0.15
    assert c.flags & 8
    assert c.last["ESTIMATOR_STATUS"].pos_horiz_ratio > 1.0


def test_only_poses_of_the_body_in_a_local_frame_are_taken() -> None:
    for frame, child, taken in (
        (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD, True),
        (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD, True),
        (mavlink.MAV_FRAME_LOCAL_FLU, mavlink.MAV_FRAME_BODY_FRD, False),
        (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_LOCAL_FRD, False),
    ):
        c = companion()
        c.pose_frame = (frame, child)
        c.run(2.0)
        assert c.px4.estimator.started is taken


# -- time -----------------------------------------------------------------------------------------------------------


def test_timesync_converges_after_500_answers_and_then_old_poses_are_placed_in_time() -> None:
    c = companion()
    c.pose_age_s = 0.15
    c.run(40.0)
    assert not converged(c)
    c.run(15.0)
    assert converged(c)
    c.run(2.0)
    assert position_valid(c)
    assert set(c.px4.estimator.ignored) <= {"repeated"}


def test_unanswered_timesync_never_converges() -> None:
    c = companion()
    c.answer_timesync = False
    c.run(55.0)
    assert not converged(c)


def test_stamps_on_another_clock_than_the_answers_lose_the_pose_once_timesync_has_converged() -> None:
    c = companion()
    c.stamp_shift_s = 5.0
    c.run(45.0)
    assert position_valid(c)
    c.run(15.0)
    assert converged(c)
    assert not position_valid(c)
    assert c.px4.estimator.ignored["future"] > 100


def test_our_timesync_question_is_answered_on_the_autopilots_own_clock() -> None:
    c = companion()
    c.run(1.0)
    c.keep = {"TIMESYNC"}
    c.send(mavlink.MAVLink_timesync_message(0, 123456789))
    c.run(0.05)
    answer = next(m for m in c.messages if m.tc1 != 0)
    assert answer.ts1 == 123456789
    assert answer.tc1 * 1e-9 == pytest.approx(37.5 + 1.0, abs=0.02)


# -- pilot, battery, fence ------------------------------------------------------------------------------------------


def test_a_pilot_takes_over_and_setpoints_no_longer_move_it() -> None:
    c = flying()
    c.px4.pilot_takes_over("POSCTL")
    c.run(1.1)
    assert c.mode == POSCTL
    place = c.ned
    c.go_to(2.0, 0.0, -1.2)
    c.run(3.0)
    assert math.dist(c.ned, place) < 0.3
    assert c.px4.failsafes == []


def test_a_critical_battery_lands() -> None:
    c = flying()
    c.px4.set_battery(0.19)
    c.run(0.2)
    assert truth_mode(c) == "LAND"
    assert c.px4.failsafes == ["battery critical: LAND"]


def test_the_battery_drains_while_flying() -> None:
    c = flying()
    before = c.px4._state.battery.fraction
    c.run(10.0)
    assert 0.005 < before - c.px4._state.battery.fraction < 0.02
    assert 0 < c.last["BATTERY_STATUS"].battery_remaining <= 100
    assert c.last["BATTERY_STATUS"].voltages[0] > 3500


def test_a_transmitter_that_falls_silent_lands_it() -> None:
    c = flying()
    c.px4.transmitter(heard=False)
    assert 1.3 < seconds_until(c, lambda: truth_mode(c) == "LAND", 4.0) < 1.8


def test_the_fence_holds_then_lands() -> None:
    c = flying(GF_MAX_HOR_DIST=2.0, COM_FAIL_ACT_T=5.0)
    c.go_to(6.0, 0.0, -1.2)
    assert c.run(10.0, lambda: truth_mode(c) == "LOITER")
    assert 4.8 < seconds_until(c, lambda: truth_mode(c) == "LAND", 8.0) < 5.3
    assert c.ned[0] < 3.2


def test_without_an_origin_there_is_no_fence_at_all() -> None:
    c = companion(GF_MAX_HOR_DIST=2.0)
    c.run(2.0)
    c.go_to(0.0, 0.0, -1.2, 1.27)
    c.run(1.2)
    c.set_mode(OFFBOARD)
    c.run(1.1)
    assert c.arm() == 0
    c.run(8.0)
    c.go_to(5.0, 0.0, -1.2)
    assert c.run(10.0, lambda: c.ned[0] > 4.5)
    assert c.px4.failsafes == []


def test_heartbeats_that_stop_do_nothing() -> None:
    c = flying()
    c._ticks += 1  # heartbeats go out on every hundredth tick only; setpoints and poses go on
    c.run(3.0)
    assert truth_mode(c) == "OFFBOARD"


# -- protocol -------------------------------------------------------------------------------------------------------


def test_parameters_are_listed_read_and_set() -> None:
    c = companion()
    c.keep = {"PARAM_VALUE"}
    c.send(mavlink.MAVLink_param_request_list_message(1, 1))
    c.run(2.0)
    assert {m.param_index for m in c.messages} == set(range(len(c.px4.parameters)))
    c.messages.clear()
    c.send(mavlink.MAVLink_param_request_read_message(1, 1, b"COM_OF_LOSS_T", -1))
    c.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH_PARAM", -1))
    c.run(0.1)
    assert [(m.param_id, m.param_value) for m in c.messages] == [("COM_OF_LOSS_T", 0.5)]
    c.messages.clear()
    wire = c.px4.parameters.on_wire("COM_OBL_RC_ACT")
    c.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", wire, mavlink.MAV_PARAM_TYPE_INT32))
    c.send(mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_VEL_MAX", 0.4, mavlink.MAV_PARAM_TYPE_REAL32))
    c.run(0.1)
    assert c.px4.parameters.integer("COM_OBL_RC_ACT") == 4
    assert c.px4.parameters["MPC_XY_VEL_MAX"] == pytest.approx(0.4)
    assert len(c.messages) == 2


def test_a_changed_parameter_changes_the_flight() -> None:
    c = flying()
    c.send(mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_VEL_MAX", 0.4, mavlink.MAV_PARAM_TYPE_REAL32))
    c.go_to(9.0, 0.0, -1.2)
    c.run(4.0)
    assert math.hypot(*c.vehicle.velocity[:2]) < 0.5


def test_message_rates_can_be_asked_for() -> None:
    c = companion()
    c.run(2.0)
    c.keep = {"LOCAL_POSITION_NED"}
    assert c.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 32, 10_000.0) == 0
    c.messages.clear()
    c.run(1.0)
    assert len(c.messages) == pytest.approx(100, abs=12)
    assert c.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 32, -1.0) == 0
    c.messages.clear()
    c.run(1.0)
    assert c.messages == []
    assert c.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 9999, 10_000.0) == 2


def test_default_rates() -> None:
    c = companion()
    c.run(3.0)
    c.keep = {"HEARTBEAT", "TIMESYNC", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GIMBAL_DEVICE_ATTITUDE_STATUS"}
    c.run(10.0)
    counts = {kind: sum(m.get_type() == kind for m in c.messages) / 10.0 for kind in c.keep}
    assert counts == pytest.approx(
        {
            "HEARTBEAT": 1,
            "TIMESYNC": 10,
            "ATTITUDE_QUATERNION": 50,
            "LOCAL_POSITION_NED": 30,
            "GIMBAL_DEVICE_ATTITUDE_STATUS": 30,
        },
        rel=0.11,
    )


def test_the_version_is_told_on_request() -> None:
    c = companion()
    assert c.ask(mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == 0
    version = c.last["AUTOPILOT_VERSION"].flight_sw_version
    assert (version >> 24, version >> 16 & 255, version >> 8 & 255) == (1, 17, 0)


def test_unknown_commands_are_refused_and_strangers_targets_ignored() -> None:
    c = companion()
    assert c.ask(mavlink.MAV_CMD_NAV_WAYPOINT) == 3
    assert c.ask(mavlink.MAV_CMD_DO_SET_MODE, 0, 6) == 2
    c.acks.clear()
    c.send(mavlink.MAVLink_command_long_message(7, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0))
    c.run(0.1)
    assert c.acks == []


def test_command_int_works_too() -> None:
    c = companion()
    c.ready()
    c.send(mavlink.MAVLink_command_int_message(1, 1, 0, ARM, 0, 0, 1.0, 0.0, 0.0, 0.0, 0, 0, 0.0))
    c.run(1.1)
    assert c.armed


def test_garbage_on_the_link_does_no_harm() -> None:
    c = companion()
    c.run(1.0)
    for i in range(50):
        c._pipe.write(bytes((j * 37 + i) % 256 for j in range(200)))
    c.run(2.0)
    assert c.px4.estimator.started


def test_a_link_that_fails_is_silence() -> None:
    c = flying()
    c.px4._server._link.close()  # type: ignore[attr-defined]
    c.setpoint = None
    c.pose_on = False
    c.run(3.0)
    assert truth_mode(c) == "LAND"


# -- gimbal ---------------------------------------------------------------------------------------------------------


def test_the_gimbal_obeys_its_owner_only_within_rate_and_range() -> None:
    c = companion()
    c.run(0.5)

    def aim(pitch_rad: float) -> None:
        c.send(mavlink.MAVLink_gimbal_manager_set_pitchyaw_message(1, 1, 0, 0, pitch_rad, math.nan, math.nan, math.nan))

    aim(-0.5)
    c.run(0.5)
    assert c.px4.truth().gimbal_pitch_down_rad == 0.0
    assert c.ask(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, 42, 191, -1, -1) == 0
    aim(-2.0)
    c.run(0.5)
    assert c.px4.truth().gimbal_pitch_down_rad == pytest.approx(math.radians(30.0), abs=0.03)
    c.run(1.0)
    assert c.px4.truth().gimbal_pitch_down_rad == pytest.approx(math.radians(60.0), abs=1e-6)
    w, _, y, _ = c.last["GIMBAL_DEVICE_ATTITUDE_STATUS"].q
    assert 2.0 * math.atan2(y, w) == pytest.approx(-math.radians(60.0), abs=1e-3)
    assert c.ask(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, 10.0, math.nan, math.nan, math.nan) == 0
    c.run(2.0)
    assert c.px4.truth().gimbal_pitch_down_rad == pytest.approx(-math.radians(10.0), abs=1e-6)


# -- physics --------------------------------------------------------------------------------------------------------


def test_physics_runs_in_fixed_steps_whatever_the_callers_rhythm() -> None:
    a, b = companion(), companion()
    a.px4.step(501.0)
    for i in range(1, 1001):
        b.px4.step(500.0 + i * 0.001)
    assert a.px4.truth() == b.px4.truth()
    assert a.px4.truth().stamp_s == pytest.approx(501.0, abs=STEP_S)


class LateReader:
    """A link whose one datagram arrived 0.6 s after the autopilot's first step."""

    arrival_s = 500.6

    def __init__(self) -> None:
        self._codec = mavlink.MAVLink(None, 42, 191)
        self._waiting = [bytes(mavlink.MAVLink_timesync_message(0, 77).pack(self._codec))]
        self.written = b""

    def read(self) -> bytes:
        return self._waiting.pop() if self._waiting else b""

    def write(self, data: bytes) -> None:
        self.written += data


def test_a_late_call_does_not_hear_messages_before_they_arrived() -> None:
    link = LateReader()
    px4 = Px4(Quadrotor(1), link, Parameters.load(), 1)
    px4.step(500.0)
    px4.step(501.0)
    heard = mavlink.MAVLink(None, 1, 1).parse_buffer(link.written)
    answer = next(m for m in heard if m.get_type() == "TIMESYNC" and m.ts1 == 77)
    assert answer.tc1 * 1e-9 == pytest.approx(37.5 + 0.6, abs=2 * STEP_S)


def test_the_camera_tilts_with_the_body() -> None:
    c = flying()
    c.go_to(3.0, 0.0, -1.2)
    steepest = 0.0
    for _ in range(200):
        c.run(0.01)
        w, x, y, _ = c.px4.truth().quat_wxyz
        steepest = max(steepest, 2.0 * math.hypot(x, y) / max(abs(w), 0.5))
    assert math.radians(4.0) < steepest < math.radians(30.0)


def test_an_unsimulated_failsafe_is_refused_at_the_start() -> None:
    with pytest.raises(ValueError, match="COM_OBL_RC_ACT 3"):
        companion(COM_OBL_RC_ACT=3)
