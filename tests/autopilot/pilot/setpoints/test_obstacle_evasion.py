"""Something new before a vehicle that hovers at the middle of a free hall, or flies there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from flight_rig import BOUNDS

from uav_recon.autopilot.pilot.setpoints.obstacle_evasion import IDENTIFIER, ObstacleEvasion
from uav_recon.autopilot.pilot.situation.sudden_obstacle import SuddenObstacle
from uav_recon.safety.envelope import Envelope, Fence
from uav_recon.safety.free_space_check import FreeSpaceCheck
from uav_recon.safety.guard import Guard, GuardInputs
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.frames import BoolArray
from uav_recon.types.maps import FreeSpace, GridSpec
from uav_recon.types.polygon import Polygon
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Setpoint, Trajectory

GRID = GridSpec(np.array([-4.0, -4.0, -1.0]), 0.1, (80, 80, 40))
HERE = np.array([0.0, 0.0, 1.1])
REST = Setpoint.hold(HERE, 0.0)
MANY, FEW = 8, 7


def _free(free: BoolArray | None = None) -> FreeSpaceCheck:
    whole = np.ones(GRID.shape, np.bool_) if free is None else free
    return FreeSpaceCheck(FreeSpace(GRID, np.packbits(whole), 1), 0.2, 0.2)


def _inputs(now_s: float, free: FreeSpaceCheck | None = None) -> GuardInputs:
    return GuardInputs(now_s, (0.0, 0.0, 1.1), 0.0, np.eye(3), 0.03, 0.05, 0, free or _free(), None)


def _seen(stamp_s: float, away_m: float, cells: int = MANY, sights: int = 3, shown_s: float = 0.3) -> SuddenObstacle:
    return SuddenObstacle(stamp_s, np.tile(HERE + np.array([away_m, 0.0, 0.0]), (cells, 1)), away_m, sights, shown_s)


@pytest.fixture
def evasion() -> ObstacleEvasion:
    return _evasion(0.20)


def _evasion(vehicle_radius_m: float) -> ObstacleEvasion:
    """Evasion of a vehicle with this hull in the same hall."""
    envelope = Envelope(
        fence=Fence(plan=Polygon.box((-3.0, -3.0), (3.0, 3.0)), floor_m=-0.2, ceiling_m=2.5, inset_m=0.3),
        max_speed_mps=1.0,
        max_acceleration_mps2=2.0,
        max_yaw_rate_radps=0.8,
    )
    return ObstacleEvasion(
        Guard(
            envelope,
            BOUNDS,
            RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=vehicle_radius_m),
        ),
        vehicle_radius_m=vehicle_radius_m,
    )


def test_nothing_stops_a_vehicle_before_which_nothing_came(evasion: ObstacleEvasion) -> None:
    evasion.update(None)
    assert not evasion.must_stop(1.0)


def test_much_of_it_stops_at_once_and_little_of_it_at_its_second_sight(evasion: ObstacleEvasion) -> None:
    evasion.update(_seen(1.0, 1.5, FEW))
    assert not evasion.must_stop(1.1)
    evasion.update(_seen(1.17, 1.5, FEW))
    assert evasion.must_stop(1.2)
    assert evasion.why() == Reason(ReasonCode.NEW_OBSTACLE, (1.5,))


def test_two_sights_far_apart_are_two_first_ones(evasion: ObstacleEvasion) -> None:
    evasion.update(_seen(1.0, 1.5, FEW))
    evasion.update(_seen(1.6, 1.5, FEW))
    assert not evasion.must_stop(1.6)


def test_the_same_sight_heard_twice_is_one(evasion: ObstacleEvasion) -> None:
    little = _seen(1.0, 1.5, FEW)
    evasion.update(little)
    evasion.update(little)
    assert not evasion.must_stop(1.0)


@pytest.mark.parametrize(
    ("sights", "shown_s", "confirmed"), [(1, 0.0, False), (2, 0.3, False), (3, 0.19, False), (3, 0.2, True)]
)
def test_a_camera_that_showed_a_ghost_stops_the_vehicle_for_what_several_frames_show(
    evasion: ObstacleEvasion, sights: int, shown_s: float, confirmed: bool
) -> None:
    seen = _seen(40.0, 1.2, sights=sights, shown_s=shown_s)
    evasion.update(seen, ghost_s=10.0)
    assert evasion.must_stop(40.0) is confirmed, "30 s after a ghost"
    evasion.update(seen, ghost_s=9.9)
    assert evasion.must_stop(40.0)


@pytest.mark.parametrize(("sights", "shown_s", "aside"), [(2, 0.3, False), (3, 0.19, False), (3, 0.2, True)])
def test_it_steps_aside_only_from_what_several_frames_show(
    evasion: ObstacleEvasion, sights: int, shown_s: float, aside: bool
) -> None:
    """As it was with a ghost in 15 % of the frames: two of them seemed to approach, and with no room aside it landed."""
    for stamp_s, away_m in ((1.0, 2.3), (1.1, 2.2)):
        evasion.update(_seen(stamp_s, away_m))
    evasion.update(_seen(1.2, 2.1, sights=sights, shown_s=shown_s))
    assert (evasion.step_aside(REST, _inputs(1.2)) is not None) is aside


@pytest.mark.parametrize(("away_m", "aside"), [((2.0, 1.9, 1.8), True), ((2.0, 1.7, 1.8), False), ((2.3, 1.9, 1.8), False)])
def test_what_does_not_come_on_steadily_is_not_stepped_aside_from(
    evasion: ObstacleEvasion, away_m: tuple[float, float, float], aside: bool
) -> None:
    for n, range_m in enumerate(away_m):
        evasion.update(_seen(1.0 + 0.15 * n, range_m, sights=n + 1, shown_s=0.15 * n))
    assert (evasion.step_aside(REST, _inputs(1.3)) is not None) is aside


@pytest.mark.parametrize(("away_m", "stops"), [(1.6, True), (1.61, False)])
def test_what_stands_stops_within_a_metre_and_a_half(evasion: ObstacleEvasion, away_m: float, stops: bool) -> None:
    evasion.update(_seen(1.0, away_m))
    assert evasion.must_stop(1.0) is stops
    assert evasion.must_stop(1.5) is stops
    assert not evasion.must_stop(1.51), "half a second old"


@pytest.mark.parametrize(("away_m", "mps", "stops"), [(2.5, 0.3, True), (2.51, 0.3, False), (2.4, 0.2, False)])
def test_what_comes_on_stops_from_farther_off(evasion: ObstacleEvasion, away_m: float, mps: float, stops: bool) -> None:
    evasion.update(_seen(1.0, away_m + 0.2 * mps))
    evasion.update(_seen(1.2, away_m))
    assert evasion.must_stop(1.2) is stops
    assert (evasion.step_aside(REST, _inputs(1.2)) is not None) is stops


def test_a_step_aside_leads_out_of_its_way(evasion: ObstacleEvasion) -> None:
    evasion.update(_seen(1.0, 2.2))
    evasion.update(_seen(1.2, 2.04))
    way = evasion.step_aside(REST, _inputs(1.2))
    assert isinstance(way, Trajectory)
    assert way.identifier == IDENTIFIER
    gone = way.position_m[-1] - HERE
    assert np.linalg.norm(gone) == pytest.approx(1.2, abs=0.01)
    assert abs(gone[1]) > 0.8, "aside, and not before it"
    assert np.linalg.norm(way.velocity_mps, axis=1).max() <= 0.5
    assert not evasion.over(way, way.start_s + way.duration_s + 0.9)
    assert evasion.over(way, way.start_s + way.duration_s + 1.1)


def test_a_step_aside_goes_where_it_is_known_free_and_inside_the_fence(evasion: ObstacleEvasion) -> None:
    evasion.update(_seen(1.0, 2.2))
    evasion.update(_seen(1.2, 2.04))
    left = np.ones(GRID.shape, np.bool_)
    left[:, 50:] = False  # y from 1 m on
    way = evasion.step_aside(REST, _inputs(1.2, _free(left)))
    assert isinstance(way, Trajectory)
    assert way.position_m[-1][1] < -0.8
    nowhere = np.zeros(GRID.shape, np.bool_)
    assert evasion.step_aside(REST, _inputs(1.2, _free(nowhere))) == Reason(ReasonCode.NO_ROOM_TO_EVADE)
    assert evasion.step_aside(REST, dataclasses.replace(_inputs(1.2), free=None)) == Reason(ReasonCode.NO_ROOM_TO_EVADE)


def _cone(half_rad: float) -> BoolArray:
    """Known free: what a camera looks at along the x axis, and a column about the pad."""
    x, y = np.meshgrid(*(-4.0 + 0.1 * (np.arange(80) + 0.5) for _ in range(2)), indexing="ij")
    seen = (np.abs(np.arctan2(y, x)) <= half_rad) | (np.hypot(x, y) <= 0.45)
    return np.repeat(seen[..., None], GRID.shape[2], axis=2)


@pytest.mark.parametrize(("half_deg", "away_m", "leads"), [(43.0, 2.24, False), (65.0, 2.24, True), (65.0, 1.6, False)])
def test_a_step_aside_does_not_lead_into_what_comes_on(
    evasion: ObstacleEvasion, half_deg: float, away_m: float, leads: bool
) -> None:
    evasion.update(_seen(1.0, away_m + 0.16))
    evasion.update(_seen(1.2, away_m))
    way = evasion.step_aside(REST, _inputs(1.2, _free(_cone(np.radians(half_deg)))))
    assert isinstance(way, Trajectory) if leads else way == Reason(ReasonCode.NO_ROOM_TO_EVADE)


@pytest.mark.parametrize("left", [1.0, -1.0])
def test_a_step_aside_reckons_with_all_that_is_seen_of_what_comes_on(evasion: ObstacleEvasion, left: float) -> None:
    wide = HERE + np.column_stack([np.full(MANY, 2.4), left * np.linspace(0.0, 1.2, MANY), np.zeros(MANY)])
    for stamp_s, nearer_m in ((1.0, 0.0), (1.2, 0.16)):
        evasion.update(SuddenObstacle(stamp_s, wide - np.array([nearer_m, 0.0, 0.0]), 2.4 - nearer_m, 3, 0.3))
    way = evasion.step_aside(REST, _inputs(1.2, _free(_cone(np.radians(90.0)))))
    assert isinstance(way, Trajectory)
    assert left * way.position_m[-1][1] < -0.8, "its nearest corner is straight ahead, and the rest of it to one side"


def _crossing(away_m: float, passes_m: float, mps: float = 1.0) -> list[SuddenObstacle]:
    """A body 0.5 m wide; its near side passes before the vehicle at passes_m, and is away_m ahead of that at first."""
    sights = []
    for n in range(4):
        left_m = away_m - mps * 0.15 * n + np.linspace(-0.25, 0.25, MANY)
        places = HERE + np.column_stack([np.full(MANY, passes_m), left_m, np.zeros(MANY)])
        away = np.linalg.norm((places - HERE)[:, :2], axis=1)
        sights.append(SuddenObstacle(1.0 + 0.15 * n, places[np.argsort(away)], float(away.min()), n + 1, 0.15 * n))
    return sights


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("passes_m", "comes"), [(0.0, True), (0.35, True), (0.45, False), (0.8, False), (1.5, False)])
def test_what_crosses_is_waited_for_and_what_comes_is_stepped_aside_from(
    evasion: ObstacleEvasion, passes_m: float, comes: bool, side: float
) -> None:
    """Both come nearer all the time; only the path of the second one leads to the vehicle."""
    for sight in _crossing(side * 1.8, passes_m, side):
        evasion.update(sight)
    assert evasion.must_stop(1.5)
    assert (evasion.step_aside(REST, _inputs(1.5)) is not None) is comes


def test_what_crosses_does_not_land_a_vehicle_without_room_aside(evasion: ObstacleEvasion) -> None:
    for sight in _crossing(1.8, 1.0):
        evasion.update(sight)
    nowhere = np.zeros(GRID.shape, np.bool_)
    assert evasion.step_aside(REST, _inputs(1.5, _free(nowhere))) is None


def test_what_stands_is_not_given_way_to_while_the_vehicle_still_comes_nearer(evasion: ObstacleEvasion) -> None:
    box = np.tile(HERE + np.array([0.9, 0.0, 0.0]), (MANY, 1))
    evasion.update(SuddenObstacle(1.0, box, 1.1))  # seen from 0.2 m before the rest, then from 0.1 m
    evasion.update(SuddenObstacle(1.2, box, 1.0))
    assert evasion.must_stop(1.2)
    assert evasion.step_aside(REST, _inputs(1.2)) is None


@pytest.mark.parametrize(("radius_m", "stop_m"), [(0.10, 1.5), (0.20, 1.6), (0.35, 1.75), (0.60, 2.0)])
def test_the_stopping_distance_follows_the_hull(radius_m: float, stop_m: float) -> None:
    for away_m, stops in ((stop_m - 1e-6, True), (stop_m + 1e-6, False)):
        evasion = _evasion(radius_m)
        evasion.update(_seen(1.0, away_m))
        assert evasion.must_stop(1.0) is stops


@pytest.mark.parametrize(("radius_m", "leads"), [(0.20, True), (0.60, False)])
def test_a_wide_hull_does_not_pass_where_a_narrow_one_does(radius_m: float, leads: bool) -> None:
    """The widest step in view passes at 0.54 m from centre to obstacle: within the wide hull."""
    evasion = _evasion(radius_m)
    evasion.update(_seen(1.0, 2.4))
    evasion.update(_seen(1.2, 2.24))
    way = evasion.step_aside(REST, _inputs(1.2, _free(_cone(np.radians(65.0)))))
    assert isinstance(way, Trajectory) if leads else way == Reason(ReasonCode.NO_ROOM_TO_EVADE)


def _lane(half_m: float) -> BoolArray:
    """Known free to a distance on both sides of the x axis; the nearest voxels that are not lie half a voxel beyond."""
    free, half = np.zeros(GRID.shape, np.bool_), round(half_m / 0.1)
    free[:, 40 - half : 40 + half] = True
    return free


@pytest.mark.parametrize(("half_m", "sideways_m"), [(1.3, 0.95), (0.9, 0.55), (0.4, 0.15), (0.3, 0.05), (0.2, 0.0)])
def test_a_step_aside_keeps_the_room_of_planned_ways_where_there_is_any(
    evasion: ObstacleEvasion, half_m: float, sideways_m: float
) -> None:
    evasion.update(_seen(1.0, 2.2))
    evasion.update(_seen(1.2, 2.04))
    way = evasion.step_aside(REST, _inputs(1.2, _free(_lane(half_m))))
    assert isinstance(way, Trajectory)
    assert abs(way.position_m[-1][1]) <= sideways_m + 1e-9


def test_a_step_aside_along_the_fence_keeps_inside_its_inset(evasion: ObstacleEvasion) -> None:
    here = np.array([0.0, 2.2, 1.1])
    for stamp_s, away_m in ((1.0, 2.2), (1.2, 2.04)):
        evasion.update(SuddenObstacle(stamp_s, np.tile(here - np.array([0.0, away_m, 0.0]), (MANY, 1)), away_m, 3, 0.3))
    way = evasion.step_aside(Setpoint.hold(here, 0.0), _inputs(1.2))
    assert isinstance(way, Trajectory)
    assert way.position_m[-1][1] <= 2.6 + 1e-9, "0.1 m inside the inset, which ends at 2.7"
