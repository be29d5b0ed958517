"""Scenarios of the table on flights that never were: what a scenario is there for breaks one of its own limits, by name."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from made_up_evidence import BOOT_S, DT_S, evidence, rewired, spoilt, turning

from sitl.faults import reason_codes as codes
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.injectors.vehicle_and_autopilot import HEADING_OFF
from sitl.faults.table.all_scenarios import SCENARIOS


def broken(scenario: str, e: FlightEvidence, autopilot: str = "px4") -> set[str]:
    """Names of a scenario's limits that such a flight does not meet."""
    return {limit.name for limit in SCENARIOS[scenario].limits if not limit.holds(limit.measure(e), autopilot)}


def test_odometry_that_takes_up_a_jump_slowly_breaks_b4() -> None:
    e = evidence()
    taken_m = np.clip(0.1 * (e.wire.odometry_s - 6.0), 0.0, 0.5)
    assert broken("B4", e) == set()
    assert broken("B4", rewired(e, odometry_m=e.wire.odometry_m + taken_m[:, None] * (1, 0, 0))) == {"change of the pose error"}


@pytest.mark.parametrize("scenario", ["B5c", "B6", "B6s"])
def test_a_flight_by_odometry_that_is_off_for_half_a_second_breaks(scenario: str) -> None:
    e, astray = evidence(), "flown while off by 0.3 m"
    stamps = e.wire.odometry_s
    for duration_s, off_m, misses in ((0.4, 0.4, False), (0.7, 0.4, True), (2.0, 0.25, False)):
        wrong = (stamps > 6.0) & (stamps < 6.0 + duration_s)
        off = rewired(e, odometry_m=e.wire.odometry_m + off_m * wrong[:, None] * np.array([0.0, 0.0, 1.0]))
        assert (astray in broken(scenario, off)) is misses
    landed = dataclasses.replace(e, mode=tuple("OFFBOARD" if s < 6.0 else "LAND" for s in e.stamp_s))
    always_off = e.wire.odometry_m + 0.4 * (stamps > 6.0)[:, None]
    assert astray not in broken(scenario, rewired(landed, odometry_m=always_off))


def late(e: FlightEvidence, by_s: float) -> FlightEvidence:
    """Poses of an earlier time under new stamps, from the fault on."""
    w = e.wire
    old_s = np.where(w.odometry_s >= e.onset_s, w.odometry_s - by_s, w.odometry_s)
    return rewired(e, odometry_m=np.stack([np.interp(old_s, w.odometry_s, w.odometry_m[:, k]) for k in range(3)], axis=1))


REPORTED = ((5.1, ("refused", "speed-limit")), (6.1, (codes.NO_POSE,)))


def losing_the_pose(last_s: float = 5.4) -> FlightEvidence:
    """Brakes from 5.1 s on and lands at 6.1 s; no ODOMETRY after last_s."""
    e = evidence()
    speed = e.velocity_mps.copy()
    speed[:, 0] = np.where(e.stamp_s < 5.1, speed[:, 0], np.clip(0.5 - (e.stamp_s - 5.1), 0.0, 0.5))
    place = np.cumsum(speed, axis=0) * DT_S
    mode = tuple("OFFBOARD" if s < 6.1 else "LAND" for s in e.stamp_s)
    said, fed = e.stamp_s < 6.1, e.stamp_s <= last_s
    flown = dataclasses.replace(e, velocity_mps=speed, position_m=place, mode=mode, armed=e.stamp_s < 12.0, reported=REPORTED)
    return rewired(
        flown, setpoint_s=e.stamp_s[said], position_m=place[said], velocity_mps=speed[said],
        odometry_s=e.stamp_s[fed], odometry_m=place[fed] + 0.01,
        odometry_yaw_rad=turning(e.stamp_s[fed]), odometry_stamp_us=(e.stamp_s[fed] - BOOT_S) * 1e6,
        reset_counter=np.zeros(np.count_nonzero(fed)),
    )  # fmt: skip


def slow_without_imu(told_s: float) -> FlightEvidence:
    """A flight at 0.3 m/s that tells at told_s why; its inertial samples end at 5 s."""
    e = evidence()
    slow = e.velocity_mps * 0.6
    reported = ((told_s, (codes.REDUCED_SPEED, codes.NO_IMU[0])),)
    flown = dataclasses.replace(e, velocity_mps=slow, reported=reported)
    return rewired(flown, velocity_mps=e.wire.velocity_mps * 0.6)


def test_a_slow_flight_that_does_not_say_why_breaks_b14d() -> None:
    assert "reported" not in broken("B14d", slow_without_imu(5.9))
    assert "reported" in broken("B14d", slow_without_imu(6.1))
    assert "speed 1 s later" not in broken("B14d", slow_without_imu(5.9))
    assert "speed 1 s later" in broken("B14d", dataclasses.replace(evidence(), reported=slow_without_imu(5.9).reported))


def test_a_reason_that_is_told_before_arming_is_in_time_for_b14() -> None:
    arm_s = 0.8
    assert "reported after the arm command" not in broken("B14", slow_without_imu(0.3))
    assert "reported after the arm command" not in broken("B14", slow_without_imu(arm_s + 0.9))
    assert "reported after the arm command" in broken("B14", slow_without_imu(arm_s + 1.1))
    assert "reported after the arm command" in broken("B14", evidence())


def test_odometry_of_another_origin_breaks_b16() -> None:
    e, off = evidence(), "ODOMETRY off the world at the pad"
    assert off not in broken("B16", e)
    lifted = e.wire.odometry_m + np.array([0.0, 0.0, 0.3])
    assert off in broken("B16", rewired(e, odometry_m=lifted))
    assert off in broken("B16", rewired(e, odometry_m=lifted[:0], odometry_s=e.wire.odometry_s[:0]))


def test_old_poses_under_new_stamps_break_b8() -> None:
    assert broken("B8", evidence()) == set()
    assert broken("B8", late(evidence(), 0.12)) == {"change of the pose error"}


def test_poses_too_old_for_use_are_answered_as_lost_ones() -> None:
    assert broken("B8l", losing_the_pose()) == set()
    assert broken("B8l", late(losing_the_pose(), 0.3)) == {"change of the pose error"}
    assert broken("B8l", evidence()) == {"hold commanded", "landing mode"}


def test_a_heading_that_reaches_the_wire_for_one_pose_breaks_b9() -> None:
    e = evidence()
    flipped = np.isclose(e.wire.odometry_s, 6.0, atol=1e-6)
    assert np.count_nonzero(flipped) == 1
    assert broken("B9", e) == set()
    assert broken("B9", rewired(e, odometry_yaw_rad=e.wire.odometry_yaw_rad + np.where(flipped, np.pi, 0.0))) == {
        "heading error"
    }
    assert broken("B9", rewired(e, odometry_yaw_rad=e.wire.odometry_yaw_rad - np.where(flipped, 0.05, 0.0))) == {
        "heading error"
    }
    assert broken("B9", rewired(e, odometry_yaw_rad=np.full(len(flipped), np.nan))) == {"heading error"}


@pytest.mark.parametrize("scenario", ["B1", "B7"])
def test_odometry_that_goes_on_without_poses_breaks(scenario: str) -> None:
    assert broken(scenario, losing_the_pose()) - {"drift"} == set()
    assert "ODOMETRY ends" in broken(scenario, losing_the_pose(last_s=6.0))
    still = losing_the_pose()
    repeated = still.wire.odometry_m.copy()
    repeated[still.wire.odometry_s > 5.0] = repeated[still.wire.odometry_s <= 5.0][-1]
    assert "change of the pose error" in broken(scenario, rewired(still, odometry_m=repeated)), (
        "the last pose, under new stamps"
    )


def test_setpoints_that_do_not_arrive_break_d3() -> None:
    e = evidence(onset_s=2.0)
    lost = np.arange(len(e.arrived_s)) % 5 > 1
    hole = (e.arrived_s > 8.0) & (e.arrived_s < 8.6)
    few, gap = "setpoints received per second, over 10 s", "gap between setpoints received"
    assert broken("D3", e) & {few, gap} == set()
    assert broken("D3", dataclasses.replace(e, arrived_s=e.arrived_s[~lost])) & {few, gap} == {few}
    assert broken("D3", dataclasses.replace(e, arrived_s=e.arrived_s[~hole])) & {few, gap} == {gap}


TELLING = {
    "A1": ("reported", (codes.MISSION_SILENT,)),
    "B1": ("reported", (codes.NO_POSE,)),
    "B5": ("reported", (codes.SOURCE_EXCLUDED,)),
    "C1b": ("reported", (codes.NO_DEPTH,)),
    "D2": ("reported", (codes.AUTOPILOT_LANDS,)),
    "E4": ("reported", (codes.INTRUDER_STATE,)),
    "E4b": ("reported", (codes.TWO_AUTOPILOTS,)),
    "E4c": ("reported", (codes.CONTROL_RELEASED, codes.MODE_CHANGED)),
    "E4d": ("reported", (codes.AUTOPILOT_LANDS,)),
    "E6": ("reason reported", (codes.ARMING_GIVEN_UP, "motors-stay-off")),
    "E10": ("reported", (codes.MISSION_LAND,)),
    "H5": ("reported", ("accelerometer-rejected",)),
    "H5d": ("reported", ("no-imu",)),
    "H5f": ("reported", ("imu-frozen",)),
    "H5s": ("reported", ("imu-disagrees",)),
    "H10": ("reported", (codes.ESTIMATE_POSITION,)),
}


@pytest.mark.parametrize("scenario", TELLING)
def test_a_row_that_asks_for_a_reason_takes_no_other(scenario: str) -> None:
    limit, reason = TELLING[scenario]
    at_s = 5.9
    assert limit not in broken(scenario, evidence(reported=((at_s, reason),)))
    assert limit in broken(scenario, evidence(reported=((at_s, ("refused", "position-step")), (at_s, ("operator-back",)))))


def test_an_alert_before_the_floor_is_none_for_a_landing_that_does_not_end() -> None:
    alert = (codes.LANDING_NOT_ENDING,)
    assert broken("E9", evidence(reported=((19.0, alert),))) == set()
    assert broken("E9", evidence(reported=((16.0, alert), (19.0, (codes.MISSION_LAND,))))) == {"alert"}


def retreating(from_s: float) -> FlightEvidence:
    """Stands from 5.2 s on and goes back along its way at from_s."""
    e = evidence()
    going = (e.stamp_s >= from_s) & (e.stamp_s < from_s + 3.0)
    speed = np.where((e.stamp_s < 5.2)[:, None], e.velocity_mps, 0.0)
    speed[going, 0] = -0.3
    place, said = np.cumsum(speed, axis=0) * DT_S, e.stamp_s < 15.0
    flown = dataclasses.replace(e, velocity_mps=speed, position_m=place)
    return rewired(flown, velocity_mps=speed[said], position_m=place[said])


def test_a_retreat_begins_neither_late_nor_early_in_a2() -> None:
    retreats = {"retreat begun", "retreat not before"}
    assert broken("A2", retreating(10.0)) & retreats == set()
    assert broken("A2", retreating(9.0)) & retreats == {"retreat not before"}
    assert broken("A2", retreating(10.8)) & retreats == {"retreat begun"}


def test_only_an_arducopter_may_not_go_on_before_it_lands_in_a6() -> None:
    flies_on = evidence(onset_s=8.0)
    assert "forward speed below 0.1 m/s" in broken("A6", flies_on, "ardupilot")
    assert "forward speed below 0.1 m/s" not in broken("A6", flies_on, "px4")
    assert "forward speed below 0.1 m/s" not in broken("A6", evidence(onset_s=9.0), "ardupilot"), "1.4 s later"


def test_a_vehicle_that_circles_breaks_b9p_while_it_is_ours() -> None:
    e = evidence(mode=tuple("OFFBOARD" if s < 6.4 else "LAND" for s in evidence().stamp_s))
    assert broken("B9p", e) & {"distance from the path"} == set()
    circling = dataclasses.replace(e, position_m=spoilt(e.position_m, (185, 1), 0.35))
    assert broken("B9p", circling) & {"distance from the path"} == {"distance from the path"}


def test_a_speed_that_is_cut_late_breaks_b10() -> None:
    def slow(from_s: float) -> FlightEvidence:
        e = evidence()
        return rewired(e, velocity_mps=np.where((e.wire.setpoint_s > from_s)[:, None], 0.4, 1.0) * e.wire.velocity_mps)

    assert broken("B10", slow(6.9)) == set()
    assert broken("B10", slow(7.1)) == {"speed 1 s later"}


def test_a_map_that_is_marked_free_by_nothing_breaks_c4b() -> None:
    freed, claimed = "known occupied freed", "voxels marked free"
    assert broken("C4b", evidence(notes={freed: 0.0, claimed: 0.0})) == set()
    assert broken("C4b", evidence(notes={freed: 0.01, claimed: 0.0})) == {freed}
    assert broken("C4b", evidence(notes={freed: 0.0, claimed: 1.0})) == {claimed}
    assert broken("C4b", evidence()) == {freed, claimed}, "what nobody measured"


def test_a_hold_counts_from_the_time_at_which_the_heading_is_off_in_h9() -> None:
    hold = "hold after 10 degrees"
    flies_on = evidence()
    assert hold in broken("H9", dataclasses.replace(flies_on, notes={HEADING_OFF: 6.0}))
    assert hold in broken("H9", losing_the_pose()), "what nobody noted"
    for off_s, misses in ((6.0, False), (2.0, True)):
        assert (hold in broken("H9", dataclasses.replace(losing_the_pose(), notes={HEADING_OFF: off_s}))) is misses


def test_a_flight_that_an_alarm_ends_at_the_pad_breaks_h5g() -> None:
    alarm = "flights ended by an alarm"
    assert alarm in broken("H5g", evidence(reported=((18.0, (codes.ODOMETRY_DRIFT,)),), stop_codes=("views-spent",)))
    assert alarm not in broken("H5g", evidence(reported=((18.0, (codes.MISSION_LAND,)),)))


def test_who_hovers_before_the_wall_breaks_f5() -> None:
    stops_late = evidence(onset_s=6.0)
    assert broken("F5", stops_late) == set()
    dithers = evidence(mode=tuple("OFFBOARD" if s < 17.0 else "LAND" for s in evidence().stamp_s), onset_s=6.0)
    assert broken("F5", dithers) == {"landing mode after the last stop"}
