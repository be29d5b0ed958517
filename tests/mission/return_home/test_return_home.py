"""The way home: over the pad, back along the breadcrumbs, or beside; and what stops it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conductor_fixture import Desk

from uav_recon.mission.state_machine import Phase
from uav_recon.recording.flight_log import read_timeline
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Trajectory
from uav_recon.types.vehicle import FlightPhase


@pytest.fixture()
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.journal.close()


def call_home(desk: Desk) -> None:
    """From a metre away or more."""
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.distance_m() < 1.0:
        desk.run(0.5)
    desk.conductor.requests.return_home()


def stop_on_the_way(desk: Desk) -> None:
    """As the guard does, once it flies there."""
    while not (flies_home(desk) and desk.speed_mps() > 0.05):
        assert desk.conductor.phase is not Phase.DONE
        desk.run(0.1)
    desk.refusals += 1
    desk.run(0.1)


def flies_home(desk: Desk) -> bool:
    trajectory = desk.intent.trajectory
    return trajectory is not None and bool(np.linalg.norm(trajectory.position_m[-1, :2]) < 0.1)


def test_no_way_home_retreats_along_the_breadcrumbs(desk: Desk) -> None:
    desk.planner.no_way_home = True
    desk.conductor.requests.start()
    desk.run(120.0, until=Phase.DONE)
    assert Phase.RETREAT in desk.seen
    assert desk.retreat.ways == 1
    assert desk.conductor.close(desk.clock.now_s()) is None


def test_it_does_not_climb_on_its_way_home(desk: Desk) -> None:
    desk.planner.left = [np.array([2.5, 0.0, 0.7])]
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk._place_m[2] > 0.71:
        desk.run(0.1)
    desk.conductor.requests.return_home()
    heights = []
    while desk.conductor.phase is not Phase.DONE:
        desk.run(0.1)
        heights.append(float(desk._place_m[2]))
    assert max(heights) < 0.75
    assert desk.distance_m() < 0.1
    assert desk.conductor.close(desk.clock.now_s()) is None


def test_a_landing_of_the_autopilots_own_on_the_way_home_is_not_home(desk: Desk) -> None:
    call_home(desk)
    while desk.distance_m() > 0.6:
        desk.run(0.1)
    desk.phase, desk.note = FlightPhase.LANDING, Reason(ReasonCode.MODE_CHANGED, ("AUTO.LAND",))
    desk.run(10.0, until=Phase.DONE)
    assert desk.distance_m() > 0.3
    assert desk.conductor.close(desk.clock.now_s()) == Reason(ReasonCode.MODE_CHANGED, ("AUTO.LAND",))


@pytest.mark.parametrize(("times", "ends_at_home"), [(2, True), (4, False)])
def test_a_way_home_that_the_guard_stopped_is_begun_again_a_few_times(desk: Desk, times: int, ends_at_home: bool) -> None:
    call_home(desk)
    for _ in range(times):
        stop_on_the_way(desk)
    desk.run(60.0, until=Phase.DONE)
    assert (desk.distance_m() < 0.1) is ends_at_home
    assert desk.conductor.close(desk.clock.now_s()) == (None if ends_at_home else Reason(ReasonCode.RETURN_STOPPED, (4,)))


def test_stops_with_progress_between_them_are_not_counted_together(desk: Desk) -> None:
    desk.planner.left = [np.array([2.5, 0.0, 1.1])]
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.distance_m() < 2.4:
        desk.run(0.1)
    desk.conductor.requests.return_home()
    for _ in range(3):
        stop_on_the_way(desk)
    while desk.distance_m() > 1.2:
        assert desk.conductor.phase is Phase.RETURN
        desk.run(0.1)
    for _ in range(3):
        stop_on_the_way(desk)
        assert desk.conductor.phase is Phase.RETURN
    desk.run(120.0, until=Phase.DONE)
    assert desk.distance_m() < 0.1
    assert desk.conductor.close(desk.clock.now_s()) is None


def test_stopped_twice_on_the_way_home_it_looks_round(desk: Desk) -> None:
    call_home(desk)
    turns = []
    for _ in range(2):
        stop_on_the_way(desk)
        turned_rad = 0.0
        while not flies_home(desk):
            desk.run(0.1)
            assert desk.intent.trajectory is not None
            turned_rad = max(turned_rad, float(np.ptp(desk.intent.trajectory.yaw_rad)))
        turns.append(turned_rad > 6.0)
    assert turns == [False, True]


def test_it_turns_towards_home_on_the_spot_and_leaves_after_that(desk: Desk) -> None:
    """A way that turns while it leaves may begin with centimetres in a direction that the camera has not seen lately."""
    call_home(desk)
    flown = list[Trajectory]()
    while not flies_home(desk):
        desk.run(0.1)
        trajectory = desk.intent.trajectory
        if desk.conductor.phase is Phase.RETURN and trajectory is not None and (not flown or trajectory is not flown[-1]):
            flown.append(trajectory)
    turn, way = flown[-2:]
    assert abs(turn.yaw_rad[-1] - turn.yaw_rad[0]) > 1.0
    assert np.ptp(turn.position_m, axis=0).max() < 1e-6
    begun = np.linalg.norm(way.position_m - way.position_m[0], axis=1) < 0.1
    assert np.ptp(way.yaw_rad[begun]) < math.radians(30.0)


def test_what_is_stopped_too_often_lands_beside_the_table_that_it_hovers_over(desk: Desk) -> None:
    call_home(desk)
    middle = desk._place_m
    i, j = ((middle[:2] + 3.0) / 0.1).astype(int)
    desk.voxels.table = (slice(i - 8, i + 8), slice(j - 8, j + 8), slice(9, 15))
    stopped = [desk._place_m]
    for _ in range(4):
        stop_on_the_way(desk)
        stopped.append(desk._place_m)
    assert all(np.max(np.abs(place - middle)[:2]) < 0.8 for place in stopped), "over the table"
    desk.run(60.0, until=Phase.DONE)
    assert 0.45 < np.max(np.abs(desk._place_m - middle)[:2]) - 0.8 < 1.5, "beside it, on the floor"
    assert desk.conductor.close(desk.clock.now_s()) == Reason(ReasonCode.RETURN_STOPPED, (4,))


@pytest.mark.parametrize("stays", [False, True])
def test_what_stands_on_the_pad_is_judged_from_near(desk: Desk, stays: bool) -> None:
    """From afar the noise of a floor that is looked along looks the same."""
    desk.planner.left = [np.array([2.5, 0.0, 1.1])]
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.distance_m() < 2.3:
        desk.run(0.1)
    desk.voxels.table = (slice(28, 32), slice(28, 32), slice(12, 14))
    desk.conductor.requests.return_home()
    while desk.distance_m() > 2.1:
        desk.run(0.1)
    assert desk.intent.trajectory is not None
    assert np.hypot(*desk.intent.trajectory.position_m[-1, :2]) < 0.1, "it flies home until then"
    desk.voxels.table = desk.voxels.table if stays else None
    desk.run(60.0, until=Phase.DONE)
    assert (desk.distance_m() < 0.1) is not stays
    assert not stays or desk.distance_m() > 0.6


def seconds_home(folder: Path, slow_s: float) -> float:
    """From the operator's call, 2.3 m away, until it lands; until then nothing fast is let pass."""
    folder.mkdir()
    desk = Desk(folder)
    desk.planner.left = [np.array([2.5, 0.0, 1.1])]
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk.distance_m() < 2.3:
        desk.run(0.1)
    desk.max_speed_mps = 0.25
    desk.conductor.requests.return_home()
    began_s = desk.clock.now_s()
    desk.run(slow_s)
    desk.max_speed_mps = np.inf
    desk.run(60.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) is None
    desk.journal.close()
    return desk.clock.now_s() - began_s


def test_a_way_home_that_was_planned_slow_goes_fast_when_that_is_let_pass_again(tmp_path: Path) -> None:
    assert seconds_home(tmp_path / "soon", 4.0) < seconds_home(tmp_path / "late", 16.0) - 5.0


def test_a_way_home_that_the_map_closes_is_left_and_where_none_is_left_it_lands(desk: Desk) -> None:
    call_home(desk)
    while desk.speed_mps() > 1e-6:
        desk.run(0.1)
    while desk.speed_mps() < 0.1:
        desk.run(0.1)
    before, away_m = desk.intent.trajectory, desk.distance_m()
    desk.voxels.closed = True
    desk.run(2.0)
    assert before is not None
    assert desk.intent.trajectory is not None
    assert desk.intent.trajectory.identifier != before.identifier
    desk.run(60.0, until=Phase.DONE)
    assert desk.distance_m() > away_m - 0.6, "where it came to rest"
    assert desk.conductor.close(desk.clock.now_s()) is not None


def test_stopped_too_often_over_a_good_floor_it_lands_from_where_it_is(desk: Desk) -> None:
    desk.planner.left = [np.array([2.0, 0.0, 1.9])]
    desk.conductor.requests.start()
    desk.run(60.0, until=Phase.SURVEY)
    while desk._place_m[2] < 1.89:
        desk.run(0.1)
    desk.conductor.requests.return_home()
    for _ in range(4):
        stop_on_the_way(desk)
    high_m = float(desk._place_m[2])
    desk.run(10.0, until=Phase.DONE)
    assert float(desk._place_m[2]) > high_m - 0.1 > 1.3
    assert desk.conductor.close(desk.clock.now_s()) == Reason(ReasonCode.RETURN_STOPPED, (4,))


@pytest.mark.parametrize(("held_s", "ends_at_home"), [(20.0, True), (300.0, False)])
def test_what_its_pilot_holds_on_the_way_home_does_not_land_there(desk: Desk, held_s: float, ends_at_home: bool) -> None:
    call_home(desk)
    desk.run(1.0)
    desk.stands, away_m = True, desk.distance_m()
    desk.run(held_s)
    assert (desk.conductor.phase is Phase.RETURN) is ends_at_home
    desk.stands = False
    desk.run(60.0, until=Phase.DONE)
    assert away_m > 0.5
    assert (desk.distance_m() < 0.1) is ends_at_home
    assert desk.conductor.close(desk.clock.now_s()) == (None if ends_at_home else Reason(ReasonCode.RETURN_STOPPED, (4,)))


def test_a_hold_on_the_way_home_is_no_arrival(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(120.0, until=Phase.RETURN)
    desk.run(1.0)
    desk.conductor.requests.hold()
    desk.run(30.0)
    assert desk.conductor.phase is Phase.HOLD
    desk.conductor.requests.resume()
    desk.run(60.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) is None


def test_the_operator_calls_it_home(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.conductor.requests.hold()
    desk.run(1.0, until=Phase.HOLD)
    desk.conductor.requests.return_home()
    desk.run(0.2, until=Phase.RETURN)
    desk.run(60.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) is None
    assert read_timeline(desk.folder).outcomes[-1].stop_codes[0] == ReasonCode.OPERATOR_RETURN
