"""The conductor gives the stages their order: a flight on paper, with stand-ins for every stage."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conductor_fixture import TOO_NARROW, Desk

from uav_recon.clock import InlineExecutor
from uav_recon.mission.conductor import Conductor
from uav_recon.mission.state_machine import Phase
from uav_recon.mission.survey.survey import MOST_UNSURE_STOPS
from uav_recon.recording.flight_log import read_timeline
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.pose import MapCorrection, Pose
from uav_recon.types.reason import Reason, codes_of
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import NextView, NothingLeft, PlanRequest, ViewPath
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase


@pytest.fixture()
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.journal.close()


def test_nothing_moves_before_the_operator_says_so(desk: Desk) -> None:
    desk.run(5.0)
    assert desk.conductor.phase is Phase.READY
    assert desk.intent.goal is Goal.STANDBY


def test_a_flight_from_pad_to_pad(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(120.0, until=Phase.DONE)
    assert desk.seen == [Phase.READY, Phase.TAKEOFF, Phase.SURVEY, Phase.RETURN, Phase.LANDING, Phase.DONE]
    assert desk.conductor.close(desk.clock.now_s()) is None
    assert len(desk.mapper.stamps) == 4 + 3  # the look round, and each task's own view
    timeline = read_timeline(desk.folder)
    assert timeline.outcomes[-1].stop_codes == TOO_NARROW.codes()
    assert {plan.mode for plan in timeline.plans[:-1]} == {"explore"} and timeline.plans[-1].mode == ""
    waits = [plan.hover_wait_s for plan in timeline.plans]
    assert 0.0 < waits[0] < 0.5 and 0.0 < waits[-1] < 0.5 and not any(waits[1:-1])  # only the first and the last at rest
    assert len(timeline.views) == 7


def test_the_budget_is_told_when_nothing_is_left_to_explore(desk: Desk) -> None:
    desk.planner.explored = True
    desk.conductor.requests.start()
    desk.run(120.0, until=Phase.SURVEY)
    desk.run(1.0)
    assert desk.budget.asked_as_explored == {False}  # nothing is planned yet
    desk.run(120.0, until=Phase.DONE)
    assert desk.budget.asked_as_explored == {False, True}


def test_the_view_budget_ends_the_survey(tmp_path: Path) -> None:
    desk = Desk(tmp_path, views=5)
    desk.conductor.requests.start()
    desk.run(120.0, until=Phase.DONE)
    assert len(desk.mapper.stamps) == 5
    assert desk.conductor.close(desk.clock.now_s()) is None
    desk.journal.close()
    assert read_timeline(tmp_path).outcomes[-1].stop_codes[0] == ReasonCode.VIEWS_SPENT


def test_frames_lost_holds_and_goes_on_when_they_are_back(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.frames = False
    desk.run(5.0, until=Phase.HOLD)
    desk.run(2.0)
    here = desk.intent.trajectory
    assert here is not None
    assert np.linalg.norm(here.setpoint_at(desk.clock.now_s()).velocity_mps) < 1e-9
    desk.frames = True
    desk.run(120.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) is None


def test_the_reason_for_a_reduced_speed_is_in_the_timeline_and_is_no_refusal(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.max_speed_mps, desk.slow_reason = 0.3, Reason(ReasonCode.NO_IMU)
    desk.run(2.0)
    desk.max_speed_mps, desk.slow_reason = math.inf, None
    desk.run(2.0)
    timeline = read_timeline(desk.folder)
    limits = [(limit.max_speed_mps, limit.codes) for limit in timeline.speed_limits]
    assert limits == [(0.3, (ReasonCode.NO_IMU,)), (None, ())]
    assert not timeline.refusals


def test_a_battery_that_falls_for_a_moment_ends_nothing_and_one_that_stays_low_ends_the_survey(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.battery = 0.20
    desk.run(2.5)
    desk.battery = 0.40
    desk.run(2.5)
    assert desk.seen[-1] is Phase.SURVEY
    desk.battery = 0.24
    desk.run(3.5, until=Phase.RETURN)
    desk.run(120.0, until=Phase.DONE)


@pytest.mark.parametrize("without_frames", [False, True])
def test_a_battery_of_which_nothing_is_heard_any_more_brings_it_home(tmp_path: Path, desk: Desk, without_frames: bool) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.frames = not without_frames
    desk.battery = math.nan
    desk.run(4.8)
    assert desk.seen[-1] is (Phase.HOLD if without_frames else Phase.SURVEY)
    desk.run(0.5, until=Phase.RETURN)
    desk.run(120.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) is None
    desk.journal.close()
    assert read_timeline(tmp_path).outcomes[-1].stop_codes[0] == ReasonCode.BATTERY_UNKNOWN


def test_an_abort_lands_at_once(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.conductor.requests.abort(Reason(ReasonCode.OPERATOR_LAND))
    desk.run(0.2, until=Phase.LANDING)
    desk.run(1.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) == Reason(ReasonCode.OPERATOR_LAND)


def test_an_abort_ends_it_where_no_pilot_was_ever_heard(desk: Desk) -> None:
    desk.conductor.step(desk.clock.now_s())
    assert desk.conductor.phase is Phase.IDLE
    desk.conductor.requests.abort(Reason(ReasonCode.OPERATOR_LAND))
    desk.conductor.step(desk.clock.now_s())
    assert desk.conductor.finished
    assert desk.conductor.close(desk.clock.now_s()) == Reason(ReasonCode.OPERATOR_LAND)


def test_the_setpoint_does_not_climb_away_from_a_vehicle_that_still_stands(desk: Desk) -> None:
    desk.stands = True
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.TAKEOFF)
    desk.run(4.0)  # a pilot gives the take-off up by then
    assert desk.intent.trajectory is not None
    assert desk.intent.trajectory.position_m[:, 2].max() == pytest.approx(0.3)
    assert desk.conductor.phase is Phase.TAKEOFF
    desk.stands = False
    desk.run(30.0, until=Phase.SURVEY)
    assert desk.distance_m() < 0.1


def test_what_the_pilot_waits_for_and_why_it_lands_is_told(desk: Desk) -> None:
    desk.phase, desk.note = FlightPhase.CONNECTING, Reason(ReasonCode.PREARM_FAILED)
    desk.run(1.0)
    assert codes_of(desk.progress.note) == (ReasonCode.PREARM_FAILED,)
    desk.phase, desk.note = FlightPhase.READY, None
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    assert codes_of(desk.progress.note) == ()
    desk.phase, desk.note = FlightPhase.LANDING, Reason(ReasonCode.NO_POSE, (0.7,))
    desk.run(0.5, until=Phase.LANDING)
    desk.phase = FlightPhase.LANDED
    desk.run(1.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) == Reason(ReasonCode.NO_POSE, (0.7,))


def test_home_is_clear_above_as_well_as_beside(desk: Desk) -> None:
    radius_m, bottom_m, top_m = desk.voxels.declared
    assert radius_m == 0.6
    assert bottom_m == pytest.approx(-0.1)  # half the vehicle's height below the body on its pad
    assert top_m == pytest.approx(1.1 + 0.3)  # else what nobody looked at above the pad closes the way home


@pytest.mark.parametrize(
    ("known_m", "declared"),
    [(2.2, (0.5, 1.4, 2.2)), (1.3, (0.6, -0.1, 1.4))],  # no lower than the way home
)
def test_the_column_above_the_pad_is_free_to_the_height_that_the_operator_knows(
    tmp_path: Path, known_m: float, declared: tuple[float, ...]
) -> None:
    desk = Desk(tmp_path, takeoff_top_m=known_m)
    assert desk.voxels.declared == pytest.approx(declared)
    desk.journal.close()


@pytest.mark.parametrize(("alive", "elements"), [(True, None), (False, 0)])
def test_a_mapper_that_died_early_leaves_the_bare_surface_of_the_map(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, alive: bool, elements: int | None
) -> None:
    asked: list[PlanRequest] = []
    plan = desk.planner.plan

    def remember(request: PlanRequest) -> ViewPath | NothingLeft:
        asked.append(request)
        return plan(request)

    monkeypatch.setattr(desk.planner, "plan", remember)
    monkeypatch.setattr(desk.mapper, "alive", lambda: alive)
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.RETURN)
    assert asked
    assert {None if request.surface is None else len(request.surface.position_world) for request in asked} == {elements}


def test_a_new_map_epoch_holds_maps_again_and_goes_on(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.run(12.0)
    assert desk.planner.accepted
    desk.epoch = 1
    desk.run(5.0, until=Phase.HOLD)  # frames of a map that nobody has announced are as good as none
    views, plans = len(desk.mapper.stamps), len(desk.planner.accepted)
    there = MapCorrection(1, np.array(desk.mapper.stamps), tuple(Pose.identity() for _ in desk.mapper.stamps))
    desk.channels.correction.publish(there)
    desk.run(0.1)
    assert [c.map_epoch for c in desk.mapper.corrections] == [desk.voxels.epoch] == [1]
    assert desk.intent.trajectory is not None
    assert desk.intent.trajectory.map_epoch == 1
    assert desk.voxels.declared[0] == 0.3  # about the places where it flew
    desk.run(120.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) is None
    assert len(desk.mapper.stamps) >= views + 4  # a look round, as at first
    assert {path.map_epoch for path in desk.planner.accepted[plans:]} == {1}


def test_frames_of_an_uncertain_place_are_not_mapped_and_do_not_hold_it(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.run(2.0)
    desk.unsure = True
    revision, views = desk.voxels.revision, len(desk.mapper.stamps)
    desk.run(5.0)
    assert (desk.voxels.revision, len(desk.mapper.stamps)) == (revision, views)
    assert Phase.HOLD not in desk.seen
    desk.unsure = False
    desk.run(5.0)
    assert desk.voxels.revision > revision
    assert len(desk.mapper.stamps) > views


def test_a_correction_from_before_the_flight_is_ignored(tmp_path: Path, desk: Desk) -> None:
    desk.channels.correction.publish(MapCorrection(9, np.zeros(0), ()))
    again = Conductor(desk.stages, desk.channels, desk.parameters, InlineExecutor(desk.clock), desk.journal)
    again.step(desk.clock.now_s())
    assert not desk.mapper.corrections


def test_a_human_with_the_sticks_ends_the_mission(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.human = True
    desk.run(0.2, until=Phase.YIELDED)
    assert desk.intent.goal is Goal.STANDBY


def test_an_obstacle_on_the_way_brakes(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.speed_mps() < 0.3:
        desk.run(0.1)
    before = desk.intent.trajectory
    desk.voxels.closed = True
    desk.run(2.0)
    after = desk.intent.trajectory
    assert before is not None
    assert after is not None
    assert after.identifier != before.identifier
    assert np.linalg.norm(after.setpoint_at(desk.clock.now_s()).velocity_mps) < 1e-9
    assert any(ReasonCode.MAP_BLOCKS_PATH in refusal.codes for refusal in read_timeline(desk.folder).refusals)


def test_a_refused_trajectory_is_not_flown_on(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    before = desk.intent.trajectory
    desk.refusals = 1
    desk.run(0.1)
    after = desk.intent.trajectory
    assert before is not None
    assert after is not None
    assert after.identifier != before.identifier
    assert dataclasses.asdict(after)["views_s"].size == 0


def test_stopped_twice_running_it_looks_round_without_taking_views(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.speed_mps() < 0.3:
        desk.run(0.1)
    turns = []
    for _ in range(2):
        desk.refusals += 1
        desk.run(0.2)
        views, turned_rad = len(desk.mapper.stamps), 0.0
        while desk.speed_mps() < 0.05 and turned_rad < 6.0:
            desk.run(0.1)
            assert desk.intent.trajectory is not None
            turned_rad = float(np.ptp(desk.intent.trajectory.yaw_rad))
        turns.append(turned_rad > 6.0)
    desk.run(5.0)
    assert turns == [False, True]
    assert len(desk.mapper.stamps) == views


def test_a_view_on_whose_way_the_place_is_uncertain_is_given_up_once(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.speed_mps() < 0.3:
        desk.run(0.1)
    turned_rad = 0.0
    for _ in range(2):  # as the pilot goes back, and as it refuses what no longer begins where the vehicle is
        desk.note = Reason(ReasonCode.PLACE_UNSURE, (0.09,)) if desk.refusals == 0 else Reason(ReasonCode.REFUSED)
        desk.refusals += 1
        desk.run(0.5)
        assert desk.intent.trajectory is not None
        turned_rad = max(turned_rad, float(np.ptp(desk.intent.trajectory.yaw_rad)))
    desk.run(2.0)
    assert [request.next_view for request in desk.planner.asked].count(NextView.LEFT) == 1
    assert turned_rad < 6.0, "it looks round, past the same wall again"


def test_where_the_place_becomes_uncertain_again_and_again_it_flies_home(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.speed_mps() < 0.3:
        desk.run(0.1)
    desk.note, views = Reason(ReasonCode.PLACE_UNSURE, (0.09,)), len(desk.mapper.stamps)
    for _ in range(MOST_UNSURE_STOPS):
        assert desk.conductor.phase is Phase.SURVEY
        desk.refusals += 1
        desk.run(0.2)
    desk.run(1.0, until=Phase.RETURN)
    assert len(desk.mapper.stamps) == views, "no view in between"
    desk.run(60.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) is None


def test_stopped_by_space_not_seen_it_asks_for_another_view_and_looks_round_at_the_third_time(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.speed_mps() < 0.3:
        desk.run(0.1)
    desk.planner.asked.clear()
    desk.note = Reason(ReasonCode.REFUSED, details=(Reason(ReasonCode.NOT_SEEN_RECENTLY, (1.0, 0.0, 1.1)),))
    turns = []
    for _ in range(3):
        desk.conductor._log.views += 1  # a keyframe on the way does not show what is ahead
        desk.refusals += 1
        desk.run(0.2)
        turned_rad = 0.0
        while desk.speed_mps() < 0.05 and turned_rad < 6.0:
            desk.run(0.1)
            assert desk.intent.trajectory is not None
            turned_rad = float(np.ptp(desk.intent.trajectory.yaw_rad))
        turns.append(turned_rad > 6.0)
    assert turns == [False, False, True]
    assert [request.next_view for request in desk.planner.asked] == [NextView.REFUSED, NextView.REFUSED]


def test_stopped_by_space_not_seen_its_nose_turns_before_it_flies_another_way(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.speed_mps() < 0.3:
        desk.run(0.1)
    desk.planner.left = [np.array([-3.0, 0.0, 1.1])]
    desk.note = Reason(ReasonCode.REFUSED, details=(Reason(ReasonCode.NOT_SEEN_RECENTLY, (1.0, 0.0, 1.1)),))
    desk.refusals += 1
    desk.run(0.5)
    turned_rad = 0.0
    while desk.speed_mps() < 0.05:
        assert desk.intent.trajectory is not None
        turned_rad = max(turned_rad, float(np.ptp(desk.intent.trajectory.yaw_rad)))
        desk.run(0.1)
    assert desk.intent.trajectory is not None
    assert 2.0 < turned_rad < 4.0 and abs(math.remainder(float(desk.intent.trajectory.yaw_rad[0]) - math.pi, math.tau)) < 0.1


def test_no_views_are_taken_while_its_pilot_holds_the_vehicle_elsewhere(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.distance_m() < 0.7 or desk.speed_mps() < 0.3:
        desk.run(0.1)
    desk.stands = True
    desk.run(3.0)  # the way goes on without it
    taken = len(desk.mapper.stamps)
    desk.run(20.0)
    assert len(desk.mapper.stamps) == taken
    desk.stands = False
    desk.run(120.0, until=Phase.DONE)
    assert len(desk.mapper.stamps) > taken
    assert desk.conductor.close(desk.clock.now_s()) is None


def test_where_nothing_fast_is_let_pass_nothing_fast_is_planned_until_it_is_again(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.speed_mps() < 0.3:
        desk.run(0.1)
    desk.max_speed_mps = 0.25
    desk.refusals += 1
    desk.run(0.2)
    slow = [desk.speed_mps()]
    for _ in range(100):
        desk.run(0.1)
        slow.append(desk.speed_mps())
    assert 0.1 < max(slow) < 0.25
    assert desk.planner.left, "it was not there yet"
    desk.max_speed_mps = math.inf
    fast = []
    for _ in range(100):
        desk.run(0.1)
        fast.append(desk.speed_mps())
    assert max(fast) > 0.3


def test_it_does_not_stop_between_plans(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while not desk.planner.accepted:
        desk.run(0.1)
    desk.run(1.5)
    speeds = []
    while len(desk.planner.left) > 1 and desk.conductor.phase is Phase.SURVEY:
        desk.run(1 / 30)
        speeds.append(desk.speed_mps())
    assert min(speeds) > 0.2
    assert len(desk.planner.accepted) >= 2


def test_what_was_seen_in_passing_is_not_flown_to(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while not desk.planner.accepted:
        desk.run(0.1)
    desk.run(0.5)
    asked = len(desk.planner.accepted)
    desk.planner.settled = True
    desk.planner.left.pop(0)
    desk.run(1.0)
    assert len(desk.planner.accepted) > asked
    np.testing.assert_allclose(desk.planner.accepted[-1].viewpoints[0].position_world, [1.5, 1.5, 1.1])


def test_a_plan_that_comes_too_late_is_not_flown(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while not desk.planner.accepted:
        desk.run(0.1)
    asked = len(desk.planner.accepted)
    monkeypatch.setattr(desk.conductor._actions.survey, "_lead_s", 0.05)  # the declared cost of a plan is 0.1 s
    desk.run(20.0, until=Phase.RETURN)
    timeline = read_timeline(desk.folder)
    assert len(desk.planner.accepted) > asked
    flown = [plan for plan in timeline.plans if plan.views]
    assert all(plan.hover_wait_s > 0.0 for plan in flown)  # each was asked again at rest
    assert len(timeline.plans) > len(flown)
    assert desk.conductor._log.planning_s == pytest.approx(sum(plan.step_s for plan in timeline.plans))


def test_a_hold_stops_it_and_a_start_lets_it_go_on(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.run(6.0)
    desk.conductor.requests.hold()
    desk.run(0.1, until=Phase.HOLD)
    desk.run(40.0)
    assert desk.conductor.phase is Phase.HOLD
    assert desk.speed_mps() < 1e-9
    desk.conductor.requests.resume()
    desk.run(0.2, until=Phase.SURVEY)
    desk.run(120.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) is None


def test_a_hold_outlasts_the_end_of_the_flight_time_but_not_a_human(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.conductor.requests.hold()
    desk.run(310.0)
    assert desk.conductor.phase is Phase.HOLD
    desk.human = True
    desk.run(0.2, until=Phase.YIELDED)


def test_a_take_off_that_was_held_begins_again_where_it_is(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.TAKEOFF)
    desk.run(0.5)
    first = desk.intent.trajectory
    assert first is not None
    desk.conductor.requests.hold()
    desk.run(20.0)
    assert desk.conductor.phase is Phase.TAKEOFF
    desk.conductor.requests.resume()
    desk.run(0.1)
    again = desk.intent.trajectory
    assert again is not None and again.identifier > first.identifier
    assert again.start_s == pytest.approx(desk.clock.now_s(), abs=0.2)
    desk.run(30.0, until=Phase.SURVEY)


def cone(stamp_s: float, map_epoch: int = 0) -> FreeCone:
    return FreeCone(stamp_s, map_epoch, np.array([0.0, 0.0, 1.1]), np.array([0.0, 0.0, 1.0]), 0.2, 1.0)


def test_what_the_range_finder_found_empty_goes_into_the_map_once(desk: Desk) -> None:
    desk.run(1.0)
    desk.frames = False
    before = desk.conductor.map
    desk.channels.cones.publish(cone(101.0))
    desk.run(1.0)
    assert [one.stamp_s for one in desk.voxels.cones] == [101.0]
    assert before is not None and desk.conductor.map is not None
    assert desk.conductor.map.revision == before.revision + 1
    free = desk.channels.free.latest()
    assert free is not None
    assert free.revision == desk.conductor.map.revision
    desk.channels.cones.publish(cone(102.0))
    desk.run(1.0)
    assert [one.stamp_s for one in desk.voxels.cones] == [101.0, 102.0]


def test_a_cone_of_another_map_is_not_used(desk: Desk) -> None:
    desk.run(1.0)
    desk.channels.cones.publish(cone(101.0, map_epoch=1))
    desk.run(1.0)
    assert desk.voxels.cones == []


def test_cones_alone_are_no_map(desk: Desk) -> None:
    desk.frames = False
    desk.channels.cones.publish(cone(101.0))
    desk.run(1.0)
    assert desk.conductor.map is None
    assert desk.voxels.cones == []


def test_it_plans_no_motion_while_the_pilot_goes_back(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.speed_mps() < 0.3:
        desk.run(0.1)
    desk.note = desk.slow_reason = Reason(ReasonCode.PLACE_UNSURE, (0.09,))
    desk.refusals += 1
    desk.run(0.3)
    asked, held = len(desk.planner.asked), desk.intent.trajectory
    desk.run(3.0)
    assert len(desk.planner.asked) == asked, "a plan would begin where the vehicle is no more"
    assert held is not None and desk.intent.trajectory is not None
    assert desk.intent.trajectory.start_s > desk.clock.now_s() - 0.3 > held.start_s, "it holds where the pilot is now"
    desk.slow_reason = None
    desk.run(1.0)
    assert len(desk.planner.asked) > asked


def test_places_left_unseen_are_said_when_the_flight_ends(desk: Desk) -> None:
    left = Reason(ReasonCode.PLACES_LEFT_UNSEEN, (2,), (Reason(ReasonCode.FRONTIERS_VIEWED_WITHOUT_RESULT, (2,)), TOO_NARROW))
    desk.planner.nothing = left
    desk.conductor.requests.start()
    desk.run(120.0, until=Phase.DONE)
    desk.conductor.close(desk.clock.now_s())
    outcome = read_timeline(desk.folder).outcomes[-1]
    assert (outcome.outcome, outcome.ended_early) == ("completed", "2 place(s) left unseen")
    assert outcome.stop_reason == "2 place(s) left unseen: 2 viewed without result, 2 frontiers left: 2 too narrow"
