"""What the pilot does on its own when the mission, the depth or the way is gone; each test is a promise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from flight_rig import ARM, BODY_FROM_DEPTH, MODE, SETPOINT, Rig, setpoints, smooth_way

from uav_recon.types.frames import FloatArray
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import PoseHealth
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase

ORDERS = (SETPOINT, f"COMMAND_LONG {MODE}", f"COMMAND_LONG {ARM}")


def silenced(rig: Rig) -> tuple[float, FloatArray]:
    """The mission falls silent in the middle of a way out along x; when, and where the vehicle was then."""
    rig.run(rig.fly((2.5, 0.0, 1.1), identifier=2).duration_s / 2)
    assert rig.px4.truth().velocity[0] > 0.6
    rig.intent = None
    return rig.clock.now_s(), np.array(rig.px4.truth().position)


def test_a_silent_mission_brakes_holds_retreats_and_lands(hovering: Rig) -> None:
    silent_s, place = silenced(hovering)
    hovering.run(2.0)
    assert np.linalg.norm(np.array(hovering.px4.truth().position) - place) <= 0.6
    assert np.linalg.norm(hovering.px4.truth().velocity) < 0.05
    times, places = setpoints(hovering, silent_s)
    still = times[np.flatnonzero(np.linalg.norm(np.diff(places, axis=0), axis=1) < 1e-9)[0]]
    assert still - silent_s <= 0.6 + 0.25, "decided within 0.6 s, then v over a"
    hovering.run(silent_s + 4.9 - hovering.clock.now_s())
    held = np.array(hovering.px4.truth().position)
    hovering.run(7.0)
    assert hovering.px4.truth().position[0] < held[0] - 0.1, "back the way it came"
    hovering.until(FlightPhase.LANDING, 13.0)
    assert 19.0 <= hovering.clock.now_s() - silent_s <= 20.2, "back before its time, it waits for the mission there"
    assert np.linalg.norm(np.array(hovering.px4.truth().position)[:2]) < 0.25, "over the pad again"
    hovering.until(FlightPhase.LANDED, 15.0)
    assert hovering.px4.failsafes == []


def test_a_mission_that_was_away_for_a_moment_flies_on(hovering: Rig) -> None:
    silenced(hovering)
    hovering.run(4.0)
    hovering.fly((2.5, 0.0, 1.1), identifier=3)
    begin = hovering.clock.now_s()
    hovering.run(1.0)
    assert hovering.state.trajectory_id == 3
    _, places = setpoints(hovering, begin - 0.1)
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 0.05
    assert hovering.px4.truth().velocity[0] > 0.1


def test_a_mission_that_comes_back_late_is_heard_after_two_seconds(hovering: Rig) -> None:
    silent_s, _ = silenced(hovering)
    hovering.run(silent_s + 8.0 - hovering.clock.now_s())
    assert hovering.px4.truth().velocity[0] < -0.1
    hovering.intent = (Goal.FLY, None)
    hovering.run(1.8)
    assert hovering.px4.truth().velocity[0] < -0.1, "still retreating"
    hovering.run(1.2)
    assert np.linalg.norm(hovering.px4.truth().velocity) < 0.1
    assert hovering.pilot.phase is FlightPhase.FLYING


def test_a_mission_restarted_in_the_air_is_not_waited_for(hovering: Rig) -> None:
    silent_s, _ = silenced(hovering)
    hovering.run(silent_s + 4.0 - hovering.clock.now_s())
    hovering.intent = (Goal.STANDBY, None)
    hovering.run(8.0)
    assert hovering.note_codes[0] == ReasonCode.MISSION_SILENT
    hovering.until(FlightPhase.LANDING, 9.0)
    assert 19.0 <= hovering.clock.now_s() - silent_s <= 20.2
    hovering.until(FlightPhase.LANDED, 15.0)


def test_a_retreat_that_is_blocked_lands(hovering: Rig) -> None:
    silent_s, _ = silenced(hovering)
    hovering.free[:, :, :] &= np.arange(100)[:, None, None] != 43  # a door closed behind it, at x = 0.3 m
    hovering.publish_free()
    hovering.until(FlightPhase.LANDING, 19.0)
    assert hovering.clock.now_s() - silent_s >= 5.0
    hovering.run(0.1)
    assert ReasonCode.RETREAT_BLOCKED in hovering.note_codes
    assert hovering.px4.truth().position[0] > 0.5


def test_what_stands_in_the_way_back_is_not_felt_along(hovering: Rig) -> None:
    """A wall that came behind it, 0.8 m from where it held: refused once, it lands where it then rests, clear of it."""
    silent_s, _ = silenced(hovering)
    hovering.run(silent_s + 5.0 - hovering.clock.now_s())
    wall_m, before = float(hovering.px4.truth().position[0]) - 0.8, hovering.state.refusals
    while hovering.pilot.phase is not FlightPhase.LANDING:
        assert hovering.clock.now_s() - silent_s < 12.0
        if hovering.px4.truth().velocity[0] < -0.1:  # the nose points back
            hovering.wall_m = max(float(hovering.px4.truth().position[0]) - wall_m - 0.1, 0.05)
        hovering.step()
    assert abs(hovering.px4.truth().velocity[0]) < 0.05, "at rest first"
    hovering.until(FlightPhase.LANDED, 15.0)
    assert ReasonCode.RETREAT_BLOCKED in hovering.note_codes
    assert min(place[0] for at_s, place in hovering.track if at_s >= silent_s) - wall_m >= 0.2 + 0.1
    assert hovering.state.refusals == before + 1


def test_a_retreat_outlives_a_moment_without_poses(hovering: Rig) -> None:
    silent_s, _ = silenced(hovering)
    hovering.run(silent_s + 6.5 - hovering.clock.now_s())
    assert hovering.px4.truth().velocity[0] < -0.1
    hovering.poses = False
    hovering.run(0.3)  # longer than a hold waits, shorter than a landing does
    hovering.poses = True
    hovering.run(2.0)
    assert hovering.pilot.phase is FlightPhase.FLYING
    assert hovering.px4.truth().velocity[0] < -0.1, "on the way back again"


def test_uncertain_of_its_place_it_goes_back_to_what_it_has_seen_before(hovering: Rig) -> None:
    """With the headings of the way out: back along x it still looks along x. It flies on once the place is sure again."""
    hovering.run(hovering.fly((2.5, 0.0, 1.1), identifier=2).duration_s / 2)
    place_m, began_s = np.array(hovering.px4.truth().position), hovering.clock.now_s()
    hovering.health, hovering.health_reason = PoseHealth.DEGRADED, Reason(ReasonCode.PLACE_UNSURE, (0.09,))
    hovering.run(4.0)
    _, places = setpoints(hovering, began_s + 2.0)
    assert places[-1][0] < place_m[0], "on its way back"
    assert abs(hovering.state.world_from_body.yaw_rad()) < 0.1
    assert hovering.note_codes[0] == ReasonCode.PLACE_UNSURE
    hovering.health = PoseHealth.GOOD
    hovering.run(2.5)
    hovering.fly((2.5, 0.0, 1.1), identifier=3)
    hovering.run(1.5)
    assert hovering.state.trajectory_id == 3
    assert hovering.pilot.phase is FlightPhase.FLYING


@pytest.mark.parametrize(("seeing_yaw_rad", "turns"), [(1.2, True), (math.nan, False), (None, False)])
def test_uncertain_of_its_place_it_turns_first_to_what_shows_it(
    hovering: Rig, seeing_yaw_rad: float | None, turns: bool
) -> None:
    hovering.run(hovering.fly((2.5, 0.0, 1.1), identifier=2).duration_s / 2)
    hovering.seeing_yaw_rad = seeing_yaw_rad
    hovering.run(0.2)
    hovering.health, hovering.health_reason = PoseHealth.DEGRADED, Reason(ReasonCode.PLACE_UNSURE, (0.09,))
    yaws_rad, places_m = [], []
    for _ in range(40):
        hovering.run(0.1)
        yaws_rad.append(hovering.state.world_from_body.yaw_rad())
        places_m.append(float(hovering.px4.truth().position[0]))
    there = [n for n, yaw_rad in enumerate(yaws_rad) if abs(yaw_rad - 1.2) < 0.1]
    assert bool(there) == turns
    if turns:
        assert max(places_m) - places_m[there[0]] < 0.15, "it turns on the spot"
        assert len(there) >= 8, "and looks there for a while"
    else:
        assert max(places_m) - places_m[-1] > 0.3, "back through the flown views"


def test_uncertain_of_its_place_on_the_pad_it_takes_off() -> None:
    """From the pad little is seen, and there is no view to go back to."""
    rig = Rig()
    rig.health, rig.health_reason = PoseHealth.DEGRADED, Reason(ReasonCode.PLACE_UNSURE, (0.05,))
    rig.until(FlightPhase.READY, 20.0)
    rig.intent = (Goal.FLY, None)
    rig.until(FlightPhase.FLYING, 8.0)
    way = smooth_way(rig.clock.now_s() + 0.1, [(0.0, 0.0, 0.0), (0.0, 0.0, 1.1)], 1, 0.12)
    rig.intent = (Goal.FLY, way)
    rig.run(way.duration_s + 1.0)
    assert rig.pilot.phase is FlightPhase.FLYING
    assert rig.height_m > 0.9


def test_a_climb_that_loses_its_place_goes_back_down_to_where_it_knew_it() -> None:
    """Before a bare wall the floor is in view near the pad only."""
    rig = Rig()
    rig.until(FlightPhase.READY, 20.0)
    rig.intent = (Goal.FLY, None)
    rig.until(FlightPhase.FLYING, 8.0)
    way = smooth_way(rig.clock.now_s() + 0.1, [(0.0, 0.0, 0.0), (0.0, 0.0, 1.1)], 1, 0.12)
    rig.intent = (Goal.FLY, way)
    while rig.height_m < 0.5:
        rig.run(0.1)
    rig.health, rig.health_reason = PoseHealth.DEGRADED, Reason(ReasonCode.PLACE_UNSURE, (0.05,))
    rig.run(2.0)
    assert rig.height_m == pytest.approx(0.2, abs=0.08), "down at once: the place is lost after three seconds"
    assert abs(rig.state.world_from_body.yaw_rad()) < 0.1
    rig.run(1.0)
    assert rig.height_m == pytest.approx(0.2, abs=0.05), "it does not land"
    rig.health = PoseHealth.GOOD
    rig.run(2.5)
    rig.intent = (Goal.FLY, smooth_way(rig.clock.now_s() + 0.1, [(0.0, 0.0, 0.2), (0.0, 0.0, 1.1)], 2, 0.12))
    rig.run(way.duration_s + 1.0)
    assert rig.pilot.phase is FlightPhase.FLYING
    assert rig.height_m > 0.9


@pytest.mark.parametrize("in_a_row", [1, 2])
def test_one_missing_frame_at_the_rate_of_a_slow_camera_stops_nothing_and_two_do(hovering: Rig, in_a_row: int) -> None:
    """A camera of 6 Hz, whose frames arrive 0.08 s late: every sixth one shows nothing."""
    frames = 0
    delayed: list[tuple[float, float]] = []
    hovering.depth = False
    ways = [(1.5, 0.0, 1.1), (0.0, 0.0, 1.1), (1.5, 0.0, 1.1)]
    ranges = np.full((12, 16), 9.0, dtype=np.float32)

    def run(seconds: float, lossy: bool) -> None:
        nonlocal frames
        end_s = hovering.clock.now_s() + seconds
        while hovering.clock.now_s() < end_s:
            if hovering.turn % 17 == 0:
                frames += 1
                missing = lossy and frames % 6 < in_a_row
                delayed.append((hovering.clock.now_s(), 0.0 if missing else 0.9))
            while delayed and hovering.clock.now_s() - delayed[0][0] >= 0.08:
                stamp_s, share = delayed.pop(0)
                hovering.channels.nearby.publish(MinRangeGrid(stamp_s, BODY_FROM_DEPTH, ranges, (0.95, 0.55), share))
            hovering.step()

    run(4.0, lossy=False)
    begin_s, refusals = hovering.clock.now_s(), hovering.state.refusals
    run(hovering.fly(*ways, identifier=5).duration_s + 1.0, lossy=True)
    times_s, _ = setpoints(hovering, begin_s)
    flown = hovering.state.refusals == refusals and abs(float(hovering.track[-1][1][0]) - 1.5) < 0.1
    assert flown is (in_a_row == 1)
    assert len(times_s) > 100


def test_no_depth_stops_then_retreats_then_lands(hovering: Rig) -> None:
    hovering.fly((2.5, 0.0, 1.1), identifier=2)
    hovering.run(2.5)
    lost_s, hovering.depth = hovering.clock.now_s(), False
    hovering.run(1.0)
    held = np.array(hovering.px4.truth().position)
    assert np.linalg.norm(hovering.px4.truth().velocity) < 0.1
    hovering.run(5.0)
    assert hovering.px4.truth().position[0] < held[0] - 0.1
    hovering.until(FlightPhase.LANDING, 5.0)
    assert hovering.clock.now_s() - lost_s <= 10.2
    hovering.until(FlightPhase.LANDED, 15.0)


def test_something_that_appears_ahead_stops_the_vehicle(hovering: Rig) -> None:
    hovering.run(hovering.fly((2.5, 0.0, 1.1), identifier=2).duration_s / 2)
    begin, place = hovering.clock.now_s(), hovering.px4.truth().position[0]
    obstacle_m = place + 1.0  # before the hull's centre; nobody tells the map
    while hovering.clock.now_s() - begin < 3.0:
        hovering.wall_m = max(obstacle_m - hovering.px4.truth().position[0] - 0.1, 0.3)
        hovering.step()
    assert hovering.state.refusals == 1
    assert ReasonCode.NEW_OBSTACLE in hovering.note_codes
    assert obstacle_m - hovering.px4.truth().position[0] - 0.2 >= 0.10


def test_what_comes_on_makes_a_hovering_vehicle_step_aside_slowly(hovering: Rig) -> None:
    hovering.wall_m = 3.0
    hovering.run(1.5)
    place, begin = np.array(hovering.px4.truth().position), hovering.clock.now_s()
    while hovering.clock.now_s() - begin < 3.0:
        hovering.wall_m = 3.0 - 0.7 * (hovering.clock.now_s() - begin)
        hovering.step()
    hovering.run(3.0)
    assert hovering.pilot.phase is FlightPhase.FLYING
    assert np.linalg.norm(np.array(hovering.px4.truth().position) - place) > 0.9
    speeds = np.linalg.norm(np.diff([p for _, p in hovering.track[-600:]], axis=0), axis=1) / 0.01
    assert np.percentile(speeds, 99) < 0.6


@pytest.mark.parametrize("frame_ticks", [7, 17])
def test_a_person_a_metre_ahead_at_full_speed_is_braked_for_in_time(hovering: Rig, frame_ticks: int) -> None:
    hovering.depth, wall_m, begin_s, braked_s = False, math.inf, math.inf, math.inf
    way = smooth_way(hovering.clock.now_s() + 0.1, [hovering.autopilot.truth().position, (3.5, 0.0, 1.1)], 2, mean_mps=0.53)
    hovering.intent = (Goal.FLY, way)
    for tick in range(800):
        truth, now_s = hovering.autopilot.truth(), hovering.clock.now_s()
        if wall_m == math.inf and truth.velocity[0] >= 0.9:
            wall_m, begin_s = truth.position[0] + 0.2 + 1.0, now_s
        if tick % frame_ticks == 0:
            ranges = np.full((12, 16), min(max(wall_m - truth.position[0] - 0.1, 0.3), 9.0), dtype=np.float32)
            hovering.channels.nearby.publish(MinRangeGrid(now_s, BODY_FROM_DEPTH, ranges, (0.95, 0.55), 0.9))
        hovering.step()
        braked_s = min(
            braked_s, now_s if {ReasonCode.NEW_OBSTACLE, ReasonCode.OBSTACLE_NEAR} & set(hovering.note_codes) else math.inf
        )
    assert braked_s - begin_s <= 0.25
    assert wall_m - 0.2 - max(place[0] for _, place in hovering.track) >= 0.40


def test_pushed_off_its_way_it_is_led_no_further_and_flies_on_when_the_push_is_over(hovering: Rig) -> None:
    hovering.run(hovering.fly((2.5, 0.0, 1.1), identifier=2).duration_s / 2)
    pushed_s = hovering.clock.now_s()
    hovering.vehicle.external_acceleration_mps2 = (2.5, 0.0, 0.0)
    hovering.run(1.5)
    assert ReasonCode.OFF_PATH in hovering.note_codes
    times, places = setpoints(hovering, pushed_s)
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
    assert speed[:3].max() > 0.6
    brakes = int(np.argmax(speed < speed[0] - 0.05))
    assert times[brakes] - pushed_s <= 0.6, "before it is 0.35 m off, which takes 0.7 s"
    assert speed[-3:].max() == 0.0, "braked to rest, though its way goes on"
    hovering.vehicle.external_acceleration_mps2 = (0.0, 0.0, 0.0)
    hovering.run(8.0)
    assert np.linalg.norm(np.array(hovering.px4.truth().position) - places[-1]) < 0.2
    hovering.fly((2.8, 0.0, 1.1), identifier=3)
    hovering.run(1.5)
    assert hovering.state.trajectory_id == 3
    assert hovering.pilot.phase is FlightPhase.FLYING


def test_held_back_on_its_way_it_is_late_and_not_off_it(hovering: Rig) -> None:
    hovering.run(hovering.fly((2.5, 0.0, 1.1), identifier=2).duration_s / 3)
    hovering.vehicle.external_acceleration_mps2 = (-2.5, 0.0, 0.0)
    hovering.run(0.9)
    _, places = setpoints(hovering, hovering.clock.now_s() - 0.1)
    assert places[-1][0] - hovering.px4.truth().position[0] > 0.4
    assert ReasonCode.OFF_PATH not in hovering.note_codes


@pytest.mark.nightly
def test_over_a_slow_link_it_is_flown_slowly(hovering: Rig) -> None:
    """Answers 0.3 s late: what moves fast is refused and people are told, until ten seconds after the link is quick again."""
    read, late = hovering.tap.read, list[tuple[float, bytes]]()

    def slowly() -> bytes:
        late.append((hovering.clock.now_s() + 0.3, read()))
        due = [data for due_s, data in late if due_s <= hovering.clock.now_s()]
        del late[: len(due)]
        return b"".join(due)

    hovering.tap.read = slowly  # type: ignore[method-assign]
    assert hovering.state.max_speed_mps == math.inf
    hovering.run(3.0)
    assert hovering.state.max_speed_mps == 0.3
    assert (ReasonCode.LINK_SLOW,) in [codes for _, codes in hovering.reported()]
    note = hovering.state.note
    assert note is not None
    assert (note.code, int(10.0 * float(note.values[0]))) == (ReasonCode.LINK_SLOW, 3)
    before = hovering.state.refusals
    hovering.fly((2.5, 0.0, 1.1), identifier=2)
    hovering.run(4.0)
    assert hovering.state.refusals == before + 1
    assert hovering.px4.truth().position[0] < 0.5
    hovering.tap.read = read  # type: ignore[method-assign]
    hovering.run(13.0)
    assert hovering.state.max_speed_mps == math.inf
    assert hovering.pilot.phase is FlightPhase.FLYING
