"""Each figure on a flight whose figures are known by hand, and on one that is worse."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from made_up_evidence import BOOT_S, DT_S, evidence, rewired, spoilt

from sitl.faults import reason_codes as codes
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.injectors.base import TAKEN_OVER
from sitl.faults.judges import odometry_metrics
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.judges.manual_takeover import mode_taken_back
from sitl.faults.judges.statustext_checks import statustext_after_arming, statustext_delay, statustext_on_floor
from sitl.faults.wire_capture import CapturedCommand

NEAR = 2.5 * DT_S


def stopping(from_s: float) -> FlightEvidence:
    """Setpoints and vehicle brake at 1 m/s² from an instant on, out of 0.5 m/s."""
    e = evidence()
    left = np.clip(0.5 - (e.stamp_s - from_s), 0.0, 0.5)
    speed = np.zeros_like(e.velocity_mps)
    speed[:, 0] = np.where(e.stamp_s > 2.0, left, 0.0)
    place = np.cumsum(speed, axis=0) * DT_S + [0.0, 0.0, 1.0]
    n = len(e.wire.setpoint_s)
    return rewired(
        dataclasses.replace(e, velocity_mps=speed, position_m=place), velocity_mps=speed[:n], position_m=place[:n],
        odometry_m=place[:n],
    )  # fmt: skip


def test_hold_is_where_braking_begins() -> None:
    assert m.held_after()(stopping(5.2)) == pytest.approx(0.2, abs=NEAR)
    assert m.held_after()(stopping(6.5)) == pytest.approx(1.5, abs=NEAR)
    assert m.held_after(1.0)(stopping(6.5)) == pytest.approx(0.5, abs=NEAR)


def test_stop_distance_counts_reaction_and_braking() -> None:
    assert m.stopped_within()(stopping(5.2)) == pytest.approx(0.1 + 0.125, abs=0.03)
    assert m.stopped_within()(stopping(7.0)) == pytest.approx(1.0 + 0.125, abs=0.03)


def test_landing_and_disarming() -> None:
    assert m.landing_after()(evidence()) == pytest.approx(10.0, abs=NEAR)
    assert m.disarmed_after()(evidence()) == pytest.approx(13.0, abs=NEAR)
    assert m.landing_after()(evidence(mode=("OFFBOARD",) * 600, armed=np.ones(600, bool))) == math.inf
    assert m.drift_landing(evidence()) == pytest.approx(2.62, abs=0.05)
    assert m.rests_at(evidence()) == pytest.approx(evidence().position_m[-1, 2])
    assert m.rests_at(evidence(armed=np.ones(600, bool))) == math.inf
    relaunch = evidence()
    again = tuple("OFFBOARD" if t > 16.0 else mode for t, mode in zip(relaunch.stamp_s, relaunch.mode, strict=True))
    assert m.relaunched(relaunch) == 0
    assert m.relaunched(dataclasses.replace(relaunch, mode=again)) > 0


def test_a_hole_in_the_stream_is_measured() -> None:
    e = evidence()
    assert m.longest_gap()(e) == pytest.approx(DT_S, abs=1e-3)
    assert m.slowest_second(e) >= 29
    keep = (e.wire.setpoint_s < 8.0) | (e.wire.setpoint_s > 8.6)
    holed = rewired(e, setpoint_s=e.wire.setpoint_s[keep])
    assert m.longest_gap()(holed) == pytest.approx(0.6, abs=NEAR)
    assert m.slowest_second(holed) <= 13
    ended = rewired(e, setpoint_s=e.wire.setpoint_s[e.wire.setpoint_s < 8.0])
    assert m.longest_gap()(ended) == pytest.approx(7.0, abs=NEAR)
    assert m.streams_after(ended) == pytest.approx(3.0, abs=NEAR)


def test_poses_on_the_wire() -> None:
    e = evidence()
    assert odometry_metrics.pose_error_step()(e) < 0.02
    assert odometry_metrics.pose_step(e) < 0.02
    assert odometry_metrics.pose_age(e) < 1e-3
    assert odometry_metrics.pose_rate(e) >= 29
    jumped = rewired(e, odometry_m=e.wire.odometry_m + np.where(e.wire.odometry_s > 6.0, 0.5, 0.0)[:, None] * (1, 0, 0))
    assert odometry_metrics.pose_error_step()(jumped) == pytest.approx(0.5, abs=0.03)
    assert odometry_metrics.pose_step(jumped) == pytest.approx(0.5, abs=0.03)
    told = rewired(jumped, reset_counter=np.where(e.wire.odometry_s > 6.0, 1.0, 0.0))
    assert odometry_metrics.pose_step(told) < 0.02
    assert odometry_metrics.resets(told) == 1
    assert odometry_metrics.pose_age(rewired(e, odometry_stamp_us=(e.wire.odometry_s - BOOT_S - 0.4) * 1e6)) == pytest.approx(
        0.4
    )
    assert (odometry_metrics.misdated_for(e), odometry_metrics.dated_after(e)) == (0.0, 0.0)
    again = np.where((e.wire.odometry_s > 6.0) & (e.wire.odometry_s < 6.5), 30e6, 0.0)
    assert odometry_metrics.misdated_for(rewired(e, odometry_stamp_us=e.wire.odometry_stamp_us + again)) == pytest.approx(
        1.5, abs=0.05
    )
    assert odometry_metrics.dated_after(rewired(e, odometry_stamp_us=e.wire.odometry_stamp_us - 1e6)) == math.inf
    few = rewired(e, odometry_s=e.wire.odometry_s[::6], odometry_m=e.wire.odometry_m[::6])
    assert odometry_metrics.pose_rate(few) <= 6


def test_orders_are_counted() -> None:
    e = evidence()
    assert m.commands()(e) == 1
    assert m.commands()(rewired(e, orders=e.wire.orders[:2])) == 0
    assert m.arm_tries(e) == 1
    assert m.forced(e) == 0
    assert m.forced(rewired(e, orders=(CapturedCommand(1.0, 400, 1.0, 21196.0),))) == 1
    assert m.last_try_after(rewired(e, orders=tuple(CapturedCommand(t, 400, 1.0, 0.0) for t in (1.0, 6.0, 30.0)))) == 29.0
    assert m.first_arm(e) == pytest.approx(0.8)
    assert m.asked_to_land(e) == pytest.approx(10.0)


def test_only_the_codes_that_are_asked_for_count_as_told() -> None:
    lost = (codes.NO_POSE,)
    e = evidence(reported=((4.0, lost), (5.3, ("refused", "speed-limit")), (6.0, lost), (19.0, lost)))
    assert statustext_delay(codes.NO_POSE, codes.POSE_STALE)(e) == pytest.approx(1.0), (
        "what was said before the fault is not about it"
    )
    assert statustext_delay(codes.POSE_STALE)(e) == math.inf
    assert statustext_delay()(e) == math.inf
    assert statustext_delay("speed-limit")(e) == pytest.approx(0.3), "a detail too"
    down_s = float(e.stamp_s[np.flatnonzero((e.stamp_s > 5.0) & (e.position_m[:, 2] <= e.position_m[-1, 2] + 0.05))[0]])
    assert down_s == pytest.approx(17.6, abs=0.1)
    assert statustext_on_floor(codes.NO_POSE)(e) == pytest.approx(19.0 - down_s)
    assert statustext_on_floor("refused")(e) == math.inf, "in the air"
    assert statustext_after_arming(codes.NO_POSE)(e) == pytest.approx(4.0 - 0.8)
    assert statustext_after_arming(codes.NO_POSE)(rewired(e, orders=())) == math.inf


def test_a_landing_is_measured_from_the_last_setpoint_that_leads_anywhere_or_turns() -> None:
    """It flies until 10.45 s, slower then, and lands at 15 s."""
    e = evidence()
    assert m.landing_after_a_stop(e) == pytest.approx(4.55, abs=NEAR)
    down = np.where((e.wire.setpoint_s > 12.0)[:, None], (0.0, 0.0, -0.4), e.wire.velocity_mps)
    assert m.landing_after_a_stop(rewired(e, velocity_mps=down)) == pytest.approx(4.55, abs=NEAR), "down is nowhere"
    turns = np.remainder(3.0 + 0.3 * np.minimum(e.wire.setpoint_s, 13.0), 2.0 * np.pi)
    assert m.landing_after_a_stop(rewired(e, yaw_rad=turns)) == pytest.approx(2.0, abs=NEAR)
    assert m.landing_after_a_stop(evidence(onset_s=12.0)) == pytest.approx(3.0, abs=NEAR), "it stood as the fault began"
    assert m.landing_after_a_stop(evidence(mode=("OFFBOARD",) * 600, armed=np.ones(600, bool))) == math.inf


def test_how_soon_it_no_longer_goes_on() -> None:
    assert m.stopped_after(0.1)(evidence()) == pytest.approx(5.4, abs=NEAR)
    assert m.stopped_after(0.6)(evidence()) == 0.0
    assert m.stopped_after(0.1)(evidence(velocity_mps=np.full((600, 3), 0.2))) == math.inf
    e = evidence()
    swung = np.where((e.stamp_s > e.onset_s + 2.0)[:, None], (-0.4, 0.3, 0.0), (0.5, 0.0, 0.0))
    assert m.stopped_after(0.1)(evidence(velocity_mps=swung)) == pytest.approx(2.0, abs=NEAR), "it swings back"
    assert m.stopped_after(0.1)(evidence(velocity_mps=-swung)) == pytest.approx(2.0, abs=NEAR), "whichever way it went"
    assert m.stopped_after(0.1)(evidence(onset_s=math.inf)) == math.inf, "the fault never came"


def test_off_its_way_is_aside_of_its_setpoints_while_it_follows_them() -> None:
    e = evidence()
    late = np.stack([np.interp(e.stamp_s - 0.4, e.stamp_s, e.position_m[:, k]) for k in range(3)], axis=1)
    assert m.off_its_way(dataclasses.replace(e, position_m=late)) < 0.02, "behind is not aside"
    aside = dataclasses.replace(e, position_m=spoilt(late, (200, 1), 0.4))
    assert m.off_its_way(aside) == pytest.approx(0.4, abs=0.01)
    assert m.off_its_way(dataclasses.replace(aside, onset_s=7.0)) < 0.02, "before the fault"
    assert m.off_its_way(dataclasses.replace(e, position_m=spoilt(e.position_m, (500, 1), 0.4))) < 0.02, "it lands by then"
    assert m.off_its_way(rewired(e, setpoint_s=e.wire.setpoint_s - 20.0)) == math.inf


def test_speed_clearance_and_fence() -> None:
    e = evidence()
    assert m.speed_from(1.0)(e) == pytest.approx(0.5)
    assert m.speed_from(5.5)(e) == 0.0
    assert m.clearance(e) == 0.5
    assert m.clearance(dataclasses.replace(e, obstacle_distance_m=np.full(len(e.stamp_s), 0.2))) == pytest.approx(0.2)
    assert m.overshoot(e) == 0.0
    assert m.overshoot(dataclasses.replace(e, position_m=spoilt(e.position_m, (200, 0), 8.4))) == pytest.approx(0.4)
    out = np.where((e.stamp_s > 6.0) & (e.stamp_s < 8.0), 2.9, 0.0)
    assert m.back_inside(dataclasses.replace(e, position_m=e.position_m + out[:, None] * (0, 1, 0))) == pytest.approx(
        2.0, abs=0.1
    )
    assert m.setpoint_jump(rewired(e, position_m=spoilt(e.wire.position_m, (200, 1), 0.7))) == pytest.approx(0.7, abs=0.02)


def test_how_far_from_what_appeared_it_comes_down() -> None:
    e = evidence()
    first_s = e.stamp_s[e.landing][0]
    past = dataclasses.replace(e, obstacle_distance_m=np.where(e.stamp_s < first_s, 0.2, 0.5))
    assert m.lands_beside(past) == 0.5, "how near it flies by is its clearance"
    assert m.clearance(past) == 0.2
    assert m.lands_beside(dataclasses.replace(past, obstacle_distance_m=0.7 - past.obstacle_distance_m)) == pytest.approx(0.2)
    assert m.lands_beside(dataclasses.replace(past, mode=("OFFBOARD",) * len(e.stamp_s))) == -math.inf


def test_where_a_vehicle_drifts_that_a_pilot_took_is_not_answered_for() -> None:
    e = evidence()
    near = dataclasses.replace(
        e,
        mode=tuple("OFFBOARD" if s < 6.0 else "ALTCTL" for s in e.stamp_s),
        hull_m=np.where(e.hull_s < 9.1, 0.5, 0.0),
        obstacle_distance_m=np.where(e.stamp_s < 9.1, 0.4, 0.0),
        position_m=e.position_m + np.where(e.stamp_s < 9.1, 0.0, 9.0)[:, None],
    )
    assert m.clearance(near) == 0.0, "no pilot took it: the autopilot did that by itself"
    assert m.overshoot(near) > 5.0
    taken = dataclasses.replace(near, notes={TAKEN_OVER: 8.7})
    assert (m.clearance(taken), m.overshoot(taken)) == (0.4, 0.0)
    late = dataclasses.replace(near, notes={TAKEN_OVER: 8.9})
    assert (m.clearance(late), m.overshoot(late) > 5.0) == (0.0, True), "it may have heard us until then"
    fallen = dataclasses.replace(taken, mode=tuple("ALTCTL" if 6.0 < s < 9.05 else "LAND" for s in e.stamp_s))
    assert (m.clearance(fallen), m.overshoot(fallen)) == (0.4, 0.0), "the autopilot landed what the pilot had"
    back = dataclasses.replace(taken, mode=tuple("ALTCTL" if 6.0 < s < 9.05 else "OFFBOARD" for s in e.stamp_s))
    assert (m.clearance(back), m.overshoot(back) > 5.0) == (0.0, True), "it is ours again"


def going_after_a_rest(*, along: float, aside: float) -> FlightEvidence:
    """At rest from 5.2 to 7 s, then 0.5 m/s on along its way (back where negative) or aside of it until 9 s."""
    e = evidence()
    going = (e.stamp_s >= 7.0) & (e.stamp_s < 9.0)
    speed = np.where(((e.stamp_s < 5.2) | (e.stamp_s > 15.0))[:, None], e.velocity_mps, 0.0)
    speed[going, :2] = (along, aside)
    place, n = np.cumsum(speed, axis=0) * DT_S, len(e.wire.setpoint_s)
    flown = dataclasses.replace(e, velocity_mps=speed, position_m=place)
    return rewired(flown, velocity_mps=speed[:n], position_m=place[:n], odometry_m=place[:n])


def test_a_retreat_goes_back_along_the_way() -> None:
    assert m.retreat_after(going_after_a_rest(along=-0.5, aside=0.0)) == pytest.approx(2.0, abs=NEAR)
    assert m.retreat_after(going_after_a_rest(along=0.5, aside=0.0)) == math.inf, "it flies on"
    assert m.retreat_after(going_after_a_rest(along=-0.3, aside=0.4)) == math.inf, "nearer to the pad, but not as it came"
    assert m.retreat_after(going_after_a_rest(along=-0.1, aside=0.0)) == math.inf, "it does not get away"
    stays = evidence()
    assert m.retreat_after(rewired(stays, velocity_mps=np.zeros_like(stays.wire.velocity_mps))) == math.inf


def test_moving_on() -> None:
    e = evidence()
    pause = (e.wire.setpoint_s > 5.2) & (e.wire.setpoint_s < 7.0)
    paused = rewired(e, velocity_mps=np.where(pause[:, None], 0.0, e.wire.velocity_mps))
    assert m.moves_again_after(0.5)(paused) == pytest.approx(1.5, abs=NEAR)
    turning = rewired(paused, yaw_rad=0.3 * np.maximum(e.wire.setpoint_s - 6.0, 0.0))
    assert m.moves_again_after(0.5)(turning) == pytest.approx(0.5, abs=NEAR)


def test_how_a_flight_ended() -> None:
    e = evidence()
    home = dataclasses.replace(e, position_m=spoilt(e.position_m, -1, (0.1, 0.0, 0.0)))
    assert m.unfinished(home) == 0
    assert m.unfinished(e) == 1, "not on the pad"
    assert m.unfinished(dataclasses.replace(home, failsafes=("x",))) == 1
    hopped = np.where(home.position_m[:, :1] > 1.9, 0.0, home.position_m)
    assert m.unfinished(dataclasses.replace(home, position_m=hopped)) == 1, "up, and down again"
    for_battery = m.ended_for(*codes.BATTERY)
    assert for_battery(e) == 1, "it gave no reason"
    said = [dataclasses.replace(home, stop_codes=(why, "frontiers-in-last-plan")) for why in (codes.BATTERY[-1], "views-spent")]
    assert [for_battery(flight) for flight in said] == [1, 0]
    assert m.motors_ran(e) == pytest.approx(18.0, abs=0.1)
    assert m.armed_at_all(e) == 1
    kept = tuple("POSCTL" if t > 5.2 else mode for t, mode in zip(e.stamp_s, e.mode, strict=True))
    assert m.mode_lost(dataclasses.replace(e, mode=kept)) == 0
    assert m.mode_lost(e) == math.inf
    taken = tuple("OFFBOARD" if t > 8.0 else mode for t, mode in zip(e.stamp_s, kept, strict=True))
    assert m.mode_lost(dataclasses.replace(e, mode=taken)) > 100
    assert m.position_mode(dataclasses.replace(e, mode=kept)) > 0


def raced(*lands: tuple[float, float], asked_s: tuple[float, ...] = ()) -> FlightEvidence:
    """A pilot switches at 8 s and the product hears of it at 8.2 s; it lands between these instants, and was asked to then."""
    e = evidence()

    def mode(t: float) -> str:
        landing = any(from_s <= t < until_s for from_s, until_s in lands)
        return "LAND" if landing else "POSCTL" if t > 8.0 else "OFFBOARD"

    flown = dataclasses.replace(
        e, mode=tuple(map(mode, e.stamp_s)), notes={TAKEN_OVER: 8.0}, heard=((7.9, 6 << 16, True), (8.2, 3 << 16, True)),
    )  # fmt: skip
    return rewired(flown, orders=tuple(CapturedCommand(s, 176, 1.0, 4.0) for s in asked_s))


def test_the_mode_stays_the_pilots_but_for_a_landing_that_nobody_could_know_better_than_to_ask_for() -> None:
    assert mode_taken_back(raced(asked_s=(7.97,))) == 0, "the pilot came after it"
    assert mode_taken_back(raced((7.99, 8.2), asked_s=(7.97,))) == 0, "and took it back"
    assert mode_taken_back(raced((8.15, 99.0), asked_s=(8.1,))) == 0, "on its way as the pilot switched"
    assert mode_taken_back(raced((8.0, 99.0), asked_s=(7.99,))) == 0, "the pilot's mode never showed"
    assert mode_taken_back(raced((8.35, 99.0), asked_s=(8.3,))) > 200, "it knew by then"
    assert mode_taken_back(raced((9.7, 99.0), asked_s=(8.1, 9.6))) > 200, "that it had asked before is no excuse"
    assert mode_taken_back(raced((9.0, 99.0))) > 200, "nobody asked"
    assert mode_taken_back(raced((8.0, 99.0))) == math.inf
    assert mode_taken_back(evidence()) == math.inf
    back = raced((8.15, 9.0), asked_s=(8.1,))
    again = tuple("OFFBOARD" if t > 9.0 else mode for t, mode in zip(back.stamp_s, back.mode, strict=True))
    assert mode_taken_back(dataclasses.replace(back, mode=again)) > 200, "it flies on by itself"


def test_stopping_short_of_what_appears_is_measured_until_the_vehicle_rests() -> None:
    plain = evidence()
    gaps = np.where(plain.stamp_s < 11.0, 0.5, 0.1)  # it rests at 10.5 s, and goes nearer after that
    assert m.stopped_short(dataclasses.replace(plain, onset_s=8.0, obstacle_distance_m=gaps)) == pytest.approx(0.5)
    moving = dataclasses.replace(plain, onset_s=8.0, obstacle_distance_m=gaps, velocity_mps=np.ones_like(plain.velocity_mps))
    assert m.stopped_short(moving) == -math.inf
