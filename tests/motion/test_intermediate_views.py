from __future__ import annotations

import itertools
import time

import numpy as np
from hall import (
    BLUR_RADPS,
    CLEARANCE_M,
    CONFIG,
    HALL,
    MOTION,
    assert_rests,
    assert_sees,
    assert_within_limits,
    flown,
    is_free,
    path_of,
    paths,
    random_path,
    room,
    room_around,
    straight,
    to_polyline,
    voxel_map,
    wall,
    wrapped,
)  # fmt: skip
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Setpoint, Trajectory


@settings(max_examples=120, deadline=None)
@given(path=paths())
def test_limits_hold_and_views_are_met(path: ViewPath) -> None:
    trajectory = flown(path, yaw_rad=0.3)
    assert_within_limits(trajectory)
    assert_rests(trajectory, 0)
    assert_rests(trajectory, -1)
    assert_sees(trajectory, path)


@settings(max_examples=60, deadline=None)
@given(path=paths())
def test_images_are_sharp_at_the_views(path: ViewPath) -> None:
    trajectory = flown(path, spacing_m=np.inf)
    for view_s in trajectory.views_s:
        for late_s in (0.0, 0.034):  # the frame comes up to a period later
            at = trajectory.setpoint_at(trajectory.start_s + view_s + late_s)
            moving = float(np.linalg.norm(at.velocity_mps)) / CONFIG.blur_distance_m
            assert abs(at.yaw_rate_radps) + moving <= 1.1 * BLUR_RADPS


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_no_sample_comes_nearer_than_it_may(seed: int) -> None:
    """In random clutter: what is flown has room everywhere, and where there is none it is a reason in words."""
    rng = np.random.default_rng(seed)
    state = np.full((100, 100, 30), FREE)
    for _ in range(12):
        low = rng.integers([5, 5, 0], [90, 90, 20])
        high = low + rng.integers(3, 15, 3)
        state[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = OCCUPIED if rng.random() < 0.6 else UNKNOWN
    voxels = voxel_map(state)
    path = random_path(rng, short=False)
    answer = MOTION.plan_from_rest(path, voxels, Setpoint.hold(path.waypoints_world[0][0], 0.0), 0.0, np.inf, 1)
    if isinstance(answer, Reason):
        way = np.vstack(
            [np.linspace(a, b, 50) for leg in path.waypoints_world for a, b in itertools.pairwise(leg)]
            or [path.waypoints_world[0]]
        )
        assert room_around(way, voxels).min() < CLEARANCE_M + 0.1 or not is_free(way, voxels).all()
        assert answer.code is ReasonCode.PATH_CLEARANCE
        return
    travelled_m = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(answer.position_m, axis=0), axis=1))))
    room_m = room_around(answer.position_m, voxels)
    begun = np.logical_or.accumulate(room_m >= CLEARANCE_M) | (travelled_m > 2.0)
    assert is_free(answer.position_m[travelled_m > 0.32], voxels).all()
    # beyond the tolerance a lookup may be wrong by what is left of half a voxel's diagonal
    assert room_m[begun & (travelled_m > 0.32)].min(initial=1.0) >= CLEARANCE_M - 0.05 - 0.037


def test_a_way_with_room_is_flown_with_room() -> None:
    """Round the end of a wall, on the shortest way there is: the corner is not cut."""
    walled = room(wall([-0.2, -5, 0], [0.2, 0, 3]))
    voxels = walled
    path = path_of([np.array([[-2, -1.5, 1.2], [-0.65, 0.35, 1.2], [0.65, 0.35, 1.2], [2, -1.5, 1.2]])], [0.5])
    trajectory = flown(path, voxels)
    assert room_around(trajectory.position_m, voxels).min() >= CLEARANCE_M - 0.03
    assert trajectory.duration_s < 9.0


def test_a_corner_is_not_a_stop() -> None:
    trajectory = flown(path_of([np.array([[-2, 0, 1.5], [0, 0, 1.5], [0, 2, 1.5]])], [0.0]))
    corner = int(np.argmin(np.linalg.norm(trajectory.position_m - [0, 0, 1.5], axis=1)))
    assert np.linalg.norm(trajectory.velocity_mps[corner]) > 0.55
    assert to_polyline(trajectory.position_m, np.array([[-2, 0, 1.5], [0, 0, 1.5], [0, 2, 1.5]])).max() < 0.4


def test_straight_flight_is_as_quick_as_the_limits_allow() -> None:
    trajectory = flown(straight([-3, 0, 1.5], [3, 0, 1.5]))
    ideal_s = 6.0 / CONFIG.speed_mps + CONFIG.speed_mps / CONFIG.acceleration_mps2
    assert trajectory.duration_s <= ideal_s + CONFIG.smoothing_s + 0.2
    np.testing.assert_allclose(np.linalg.norm(trajectory.velocity_mps, axis=1).max(), CONFIG.speed_mps, rtol=0.01)


def test_five_views_on_five_metres_take_a_few_seconds() -> None:
    corners = np.array([[0, 0, 1.2], [1, 0, 1.2], [1.7, 0.7, 1.2], [2.7, 0.7, 1.4], [3.4, 0, 1.4], [3.4, -1, 1.2]])
    legs = [corners[i : i + 2] for i in range(5)]
    trajectory = flown(path_of(legs, [0.3, 0.8, 1.2, 0.6, 0.0]), spacing_m=np.inf)
    assert trajectory.duration_s < 8.0
    assert len(trajectory.views_s) == 5


def test_views_are_spread_over_the_way() -> None:
    trajectory = flown(straight([0, 0, 1.0], [2.1, 0, 1.0]), spacing_m=0.5)
    at_m = [trajectory.setpoint_at(trajectory.start_s + view_s).position_m[0] for view_s in trajectory.views_s]
    np.testing.assert_allclose(at_m, [0.5, 1.0, 1.5, 2.1], atol=0.03)  # none at 2.0: too near the view at 2.1
    assert len(flown(straight([0, 0, 1.0], [2.1, 0, 1.0]), spacing_m=np.inf).views_s) == 1


def test_tight_places_are_flown_slowly() -> None:
    walls = room(wall([-1, -5, 0], [1, -0.4, 3]), ([-1, 0.4, 0], [1, 5, 3], UNKNOWN))
    trajectory = flown(straight([-3, 0.05, 1.5], [3, 0.05, 1.5]), walls)
    speed, x = np.linalg.norm(trajectory.velocity_mps, axis=1), trajectory.position_m[:, 0]
    assert (
        speed[np.abs(x) < 1.0].max() <= CONFIG.tight_speed_mps + (CONFIG.speed_mps - CONFIG.tight_speed_mps) / 6 + 0.01
    )  # 0.05 m to spare
    assert speed[np.abs(x) > 1.8].max() > 0.9 * CONFIG.speed_mps


def test_turns_take_the_short_way() -> None:
    trajectory = flown(path_of([np.array([[0, 0, 1.0]])], [np.radians(-170)]), yaw_rad=np.radians(170))
    np.testing.assert_allclose(np.ptp(trajectory.yaw_rad), np.radians(20), atol=1e-6)
    assert np.ptp(trajectory.position_m, axis=0).max() < 1e-9


def test_two_views_on_one_spot_are_both_met() -> None:
    here = np.array([[0, 0, 1.0], [1, 0, 1.0]])
    path = path_of([here, here[1:], here[1:]], [0.0, 1.5, 1.5], [0.0, 0.0, 0.3])
    assert_sees(flown(path, spacing_m=np.inf), path)
    nothing_to_do = path_of([here[:1]], [0.0])
    assert flown(nothing_to_do).duration_s < 1.0


def test_a_way_through_a_wall_is_refused_in_words() -> None:
    walled = room(([0, -5, 0], [0.2, 5, 3], UNKNOWN))
    start = Setpoint.hold(np.array([-2, 0, 1.0]), 0.0)
    reason = MOTION.plan_from_rest(straight([-2, 0, 1.0], [2, 0, 1.0]), walled, start, 0.0, 0.4, 1)
    assert isinstance(reason, Reason) and reason.code is ReasonCode.PATH_CLEARANCE


def test_what_cannot_be_flown_whatever_the_map_is_refused_in_words() -> None:
    start = Setpoint.hold(np.array([-2, 0, 1.0]), 0.0)
    reason = MOTION.plan_from_rest(straight([-2, 0, 1.0]), room(epoch=3), start, 0.0, 0.4, 1)
    assert reason == Reason(ReasonCode.PATH_MAP_EPOCH, (0, 3))
    reason = MOTION.plan_from_rest(path_of([], []), HALL, start, 0.0, 0.4, 1)
    assert reason == Reason(ReasonCode.PATH_WITHOUT_VIEW)


def test_leaves_a_tight_spot_through_free_space_only() -> None:
    pocket = room(wall([-2.4, -5, 0], [-1, -0.2, 3]), wall([-2.4, 0.2, 0], [-1, 5, 3]))
    assert flown(straight([-1.6, 0.05, 1.0], [1, 0.05, 1.0]), pocket).duration_s > 0
    back = straight([1, 0.05, 1.0], [-1.6, 0.05, 1.0])
    assert isinstance(MOTION.plan_from_rest(back, pocket, Setpoint.hold(np.array([1, 0.05, 1.0]), 0.0), 0.0, 0.4, 1), Reason)


def test_still_clear_looks_only_ahead() -> None:
    trajectory = flown(straight([-3, 0, 1.0], [3, 0, 1.0]))
    walled = room(wall([-0.5, -1, 0], [-0.3, 1, 3]))
    assert MOTION.is_still_clear(trajectory, trajectory.start_s, HALL)
    assert not MOTION.is_still_clear(trajectory, trajectory.start_s, walled)
    assert MOTION.is_still_clear(trajectory, trajectory.start_s + 0.75 * trajectory.duration_s, walled)
    assert not MOTION.is_still_clear(trajectory, trajectory.start_s, room(epoch=1))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_what_was_clear_stays_clear_on_the_same_map(seed: int) -> None:
    rng = np.random.default_rng(seed)
    voxels = room(wall([-0.4, -5, 0], [0.4, -0.3, 3]), wall([-0.4, 0.5, 0], [0.4, 5, 3]))
    ends = rng.uniform([-3, -1, 0.8], [-1, 1, 2]), rng.uniform([1, -1, 0.8], [3, 1, 2])
    path = path_of([np.array([ends[0], [-0.8, 0.1, 1.3], [0.8, 0.1, 1.3], ends[1]])], [float(rng.uniform(-3, 3))])
    trajectory = MOTION.plan_from_rest(path, voxels, Setpoint.hold(ends[0], 0.0), 0.0, np.inf, 1)
    assert isinstance(trajectory, Trajectory), trajectory
    for share in np.linspace(0.0, 1.0, 23):
        assert MOTION.is_still_clear(trajectory, share * trajectory.duration_s, voxels)


def test_the_same_request_gives_the_same_motion() -> None:
    path = path_of([np.array([[-3, 0, 1.0], [0, 2, 1.0], [1, 2, 2]]), np.array([[1, 2, 2.0], [1, 0, 1]])], [2.0, -1.0])
    assert flown(path).position_m.tobytes() == flown(path).position_m.tobytes()


def test_is_quick() -> None:
    MOTION.warm_up()
    path = path_of([np.array([[-3, 0, 1.0], [0, 2, 1.0], [1, 2, 2]]), np.array([[1, 2, 2.0], [1, 0, 1]])], [2.0, -1.0])
    took_s = []
    for _ in range(5):
        began_s = time.perf_counter()
        trajectory = flown(path)
        took_s.append(time.perf_counter() - began_s)
    assert min(took_s) < 0.02  # about one millisecond on an idle core
    assert wrapped(trajectory.yaw_rad[-1] + 1.0) == 0.0 or abs(wrapped(trajectory.yaw_rad[-1] + 1.0)) < 1e-9
