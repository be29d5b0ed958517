import itertools
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.config import MotionConfig
from uav_recon.mapping.distance import distance2_to_not_free
from uav_recon.motion import MotionPlanner
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, GridSpec, VoxelMap
from uav_recon.types.tasks import PlanMode, ViewPath, Viewpoint
from uav_recon.types.trajectory import Setpoint, Trajectory

CONFIG = MotionConfig()
CLEARANCE_M = 0.35
RATE, SPIN = np.radians(CONFIG.yaw_rate_degps), np.radians(CONFIG.yaw_acceleration_degps2)
MOTION = MotionPlanner(CONFIG, CLEARANCE_M)


def room(*boxes: tuple[FloatArray, FloatArray, int], epoch: int = 0) -> VoxelMap:
    """A free hall of 10 x 10 x 3 m with boxes of another state in it."""
    grid = GridSpec(np.array([-5.0, -5.0, 0.0]), 0.1, (100, 100, 30))
    state = np.full(grid.shape, FREE, dtype=np.uint8)
    for low, high, value in boxes:
        i, j = grid.index(np.asarray(low) + 1e-6), grid.index(np.asarray(high) - 1e-6) + 1
        state[i[0] : j[0], i[1] : j[1], i[2] : j[2]] = value
    return VoxelMap.whole(grid, state, distance2_to_not_free(state, 11), 0, epoch)


HALL = room()


def path_of(legs: list[FloatArray], yaws: list[float], pitches: list[float] | None = None) -> ViewPath:
    pitches = pitches or [0.0] * len(legs)
    views = tuple(Viewpoint(leg[-1], yaw, pitch) for leg, yaw, pitch in zip(legs, yaws, pitches, strict=True))
    return ViewPath(views, tuple(legs), PlanMode.EXPLORE, 0, 0, (), 0.0, 0.0)


def flown(path: ViewPath, voxels: VoxelMap = HALL, spacing_m: float = 0.4, yaw_rad: float = 0.0) -> Trajectory:
    trajectory = MOTION.through(path, voxels, Setpoint.hold(path.waypoints_world[0][0], yaw_rad), 5.0, spacing_m, 7)
    assert isinstance(trajectory, Trajectory), trajectory
    return trajectory


def assert_within_limits(trajectory: Trajectory, rise_s: float = CONFIG.smoothing_s / 2) -> None:
    speed = np.linalg.norm(trajectory.velocity_mps, axis=1)
    acceleration = np.linalg.norm(trajectory.acceleration_mps2, axis=1)
    by_difference = np.linalg.norm(np.diff(trajectory.velocity_mps, axis=0), axis=1) / trajectory.step_s
    spin = np.abs(np.diff(trajectory.yaw_rate_radps)) / trajectory.step_s
    jerk = np.linalg.norm(np.diff(trajectory.acceleration_mps2, axis=0), axis=1) / trajectory.step_s
    assert speed.max() <= CONFIG.speed_mps * 1.001
    assert acceleration.max() <= CONFIG.acceleration_mps2 * 1.05
    assert by_difference.max() <= CONFIG.acceleration_mps2 * 1.05
    assert np.abs(trajectory.yaw_rate_radps).max() <= RATE * 1.001
    assert spin.max() <= SPIN * 1.05
    assert jerk[:-2].max(initial=0.0) <= 2.5 * CONFIG.acceleration_mps2 / rise_s  # full ahead to full astern
    moved = np.diff(trajectory.position_m, axis=0) / trajectory.step_s
    np.testing.assert_allclose(moved, (trajectory.velocity_mps[1:] + trajectory.velocity_mps[:-1]) / 2, atol=0.02)


def assert_rests(trajectory: Trajectory, index: int) -> None:
    assert np.linalg.norm(trajectory.velocity_mps[index]) < 1e-6
    assert np.linalg.norm(trajectory.acceleration_mps2[index]) < 1e-6
    assert abs(trajectory.yaw_rate_radps[index]) < 1e-6


def distance_to_polyline(points: FloatArray, corners: FloatArray) -> FloatArray:
    nearest: FloatArray = np.asarray(np.linalg.norm(points - corners[0], axis=1), dtype=np.float64)
    for a, b in itertools.pairwise(corners):
        length2 = max(float((b - a) @ (b - a)), 1e-12)
        share = np.clip((points - a) @ (b - a) / length2, 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
    return nearest


@st.composite
def paths(draw: st.DrawFn) -> ViewPath:
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    short = draw(st.booleans())
    here = rng.uniform([-3, -3, 0.8], [3, 3, 2.2])
    legs, yaws, pitches = [], [], []
    for _ in range(draw(st.integers(1, 5))):
        leg = [here]
        for _ in range(int(rng.integers(0, 5))):
            step = rng.normal(0.0, 0.15 if short else 1.0, 3)
            here = np.clip(here + step, [-4, -4, 0.6], [4, 4, 2.4])
            leg.append(here)
        legs.append(np.array(leg))
        yaws.append(float(rng.uniform(-7, 7)))
        pitches.append(float(rng.uniform(-0.5, 0.5)))
    return path_of(legs, yaws, pitches)


@settings(max_examples=120, deadline=None)
@given(path=paths())
def test_limits_hold_and_views_are_met(path: ViewPath) -> None:
    trajectory = flown(path, yaw_rad=0.3)
    assert_within_limits(trajectory)
    assert_rests(trajectory, 0)
    assert_rests(trajectory, -1)
    assert distance_to_polyline(trajectory.position_m, np.vstack(path.waypoints_world)).max() < 0.05
    for view in path.viewpoints:
        setpoints = [trajectory.setpoint_at(trajectory.start_s + view_s) for view_s in trajectory.views_s]
        off_m = [np.linalg.norm(setpoint.position_m - view.position_world) for setpoint in setpoints]
        off_rad = [abs((s.yaw_rad - view.yaw_rad + np.pi) % (2 * np.pi) - np.pi) for s in setpoints]
        off_pitch_rad = [abs(s.camera_pitch_down_rad - view.pitch_down_rad) for s in setpoints]
        assert any(a < 0.03 and b < 0.03 and c < 0.03 for a, b, c in zip(off_m, off_rad, off_pitch_rad, strict=True))
    np.testing.assert_allclose(trajectory.position_m[-1], path.viewpoints[-1].position_world, atol=1e-9)
    assert np.all(np.diff(trajectory.views_s) >= 0)
    assert trajectory.views_s.min() >= 0 and trajectory.views_s.max() <= trajectory.duration_s


@settings(max_examples=80, deadline=None)
@given(path=paths(), share=st.floats(0.0, 1.0))
def test_stop_brakes_on_the_path(path: ViewPath, share: float) -> None:
    trajectory = flown(path)
    now_s = trajectory.start_s + share * trajectory.duration_s
    before = trajectory.setpoint_at(now_s)
    braked = MOTION.stop(trajectory, now_s, 8)
    assert braked.identifier == 8 and braked.start_s == now_s and not len(braked.views_s)
    np.testing.assert_allclose(braked.position_m[0], before.position_m, atol=1e-9)
    np.testing.assert_allclose(braked.velocity_mps[0], before.velocity_mps, atol=1e-9)
    assert_within_limits(braked, rise_s=0.15)
    assert_rests(braked, -1)
    assert distance_to_polyline(braked.position_m, trajectory.position_m).max() < 1e-3
    speed = float(np.linalg.norm(before.velocity_mps))
    # v²/2a at nine tenths of a, with what is still gained and flown while the brake comes on, and a turn to end as well
    peak = speed + 0.15 * CONFIG.acceleration_mps2
    bound_m = peak**2 / (1.8 * CONFIG.acceleration_mps2) + 0.4 * peak + 0.05
    left_m = float(np.linalg.norm(np.diff(trajectory.position_m[int(share * len(trajectory.yaw_rad)) :], axis=0), axis=1).sum())
    assert float(np.linalg.norm(np.diff(braked.position_m, axis=0), axis=1).sum()) <= min(bound_m, left_m + 0.05)


def test_stop_before_the_start_and_after_the_end_holds() -> None:
    trajectory = flown(path_of([np.array([[0, 0, 1.0], [2, 0, 1.0]])], [0.0]))
    for now_s, at_m in ((0.0, [0, 0, 1.0]), (1e4, [2, 0, 1.0])):
        held = MOTION.stop(trajectory, now_s, 1)
        assert np.allclose(held.position_m, at_m, atol=1e-9) and held.start_s == now_s
        assert_rests(held, -1)


def test_stop_at_cruise_takes_little_more_than_physics() -> None:
    trajectory = flown(path_of([np.array([[-4, 0, 1.5], [4, 0, 1.5]])], [0.0]))
    braked = MOTION.stop(trajectory, trajectory.start_s + trajectory.duration_s / 2, 1)
    assert np.ptp(braked.position_m[:, 0]) <= CONFIG.speed_mps**2 / (2 * CONFIG.acceleration_mps2) + 0.13


def test_straight_flight_is_as_quick_as_the_limits_allow() -> None:
    trajectory = flown(path_of([np.array([[-3, 0, 1.5], [3, 0, 1.5]])], [0.0]))
    ideal_s = 6.0 / CONFIG.speed_mps + CONFIG.speed_mps / CONFIG.acceleration_mps2
    assert trajectory.duration_s <= ideal_s + CONFIG.smoothing_s + 0.1
    np.testing.assert_allclose(np.linalg.norm(trajectory.velocity_mps, axis=1).max(), CONFIG.speed_mps, rtol=1e-3)


def test_views_are_spread_over_the_way() -> None:
    trajectory = flown(path_of([np.array([[0, 0, 1.0], [2.1, 0, 1.0]])], [0.0]), spacing_m=0.5)
    at_m = [trajectory.setpoint_at(trajectory.start_s + view_s).position_m[0] for view_s in trajectory.views_s]
    np.testing.assert_allclose(at_m, [0.5, 1.0, 1.5, 2.1], atol=0.03)  # none at 2.0: too near the view at 2.1
    only = flown(path_of([np.array([[0, 0, 1.0], [2.1, 0, 1.0]])], [0.0]), spacing_m=np.inf)
    assert len(only.views_s) == 1


def test_tight_places_are_flown_slowly() -> None:
    walls = room(
        (np.array([-1, -5, 0]), np.array([1, -0.4, 3]), OCCUPIED), (np.array([-1, 0.4, 0]), np.array([1, 5, 3]), UNKNOWN)
    )
    trajectory = flown(path_of([np.array([[-3, 0.05, 1.5], [3, 0.05, 1.5]])], [0.0]), walls)
    speed, x = np.linalg.norm(trajectory.velocity_mps, axis=1), trajectory.position_m[:, 0]
    assert speed[np.abs(x) < 1.0].max() <= CONFIG.tight_speed_mps + 0.08
    assert speed[np.abs(x) > 2.0].max() > CONFIG.speed_mps - 0.01


def test_turns_take_the_short_way() -> None:
    trajectory = flown(path_of([np.array([[0, 0, 1.0]])], [np.radians(-170)]), yaw_rad=np.radians(170))
    np.testing.assert_allclose(np.ptp(trajectory.yaw_rad), np.radians(20), atol=1e-6)
    assert np.ptp(trajectory.position_m, axis=0).max() < 1e-9


def test_a_way_through_a_wall_is_refused_in_words() -> None:
    wall = room((np.array([0, -5, 0]), np.array([0.2, 5, 3]), UNKNOWN))
    start = Setpoint.hold(np.array([-2, 0, 1.0]), 0.0)
    reason = MOTION.through(path_of([np.array([[-2, 0, 1.0], [2, 0, 1.0]])], [0.0]), wall, start, 0.0, 0.4, 1)
    assert isinstance(reason, str) and "not clear" in reason


def test_an_old_epoch_is_refused_in_words() -> None:
    start = Setpoint.hold(np.array([-2, 0, 1.0]), 0.0)
    reason = MOTION.through(path_of([np.array([[-2, 0, 1.0]])], [0.0]), room(epoch=3), start, 0.0, 0.4, 1)
    assert isinstance(reason, str) and "epoch" in reason


def test_leaves_a_tight_spot_through_free_space_only() -> None:
    pocket = room(
        (np.array([-2.4, -5, 0]), np.array([-1, -0.2, 3]), OCCUPIED), (np.array([-2.4, 0.2, 0]), np.array([-1, 5, 3]), OCCUPIED)
    )
    way = path_of([np.array([[-1.6, 0.05, 1.0], [1, 0.05, 1.0]])], [0.0])
    assert flown(way, pocket).duration_s > 0
    back = path_of([np.array([[1, 0.05, 1.0], [-1.6, 0.05, 1.0]])], [0.0])
    assert isinstance(MOTION.through(back, pocket, Setpoint.hold(np.array([1, 0.05, 1.0]), 0.0), 0.0, 0.4, 1), str)


def test_still_clear_looks_only_ahead() -> None:
    trajectory = flown(path_of([np.array([[-3, 0, 1.0], [3, 0, 1.0]])], [0.0]))
    wall = room((np.array([-0.5, -1, 0]), np.array([-0.3, 1, 3]), OCCUPIED))
    assert MOTION.still_clear(trajectory, trajectory.start_s, HALL)
    assert not MOTION.still_clear(trajectory, trajectory.start_s, wall)
    assert MOTION.still_clear(trajectory, trajectory.start_s + 0.75 * trajectory.duration_s, wall)
    assert not MOTION.still_clear(trajectory, trajectory.start_s, room(epoch=1))


@pytest.mark.parametrize("total_rad", [2 * np.pi, -np.pi])
def test_look_round(total_rad: float) -> None:
    start = Setpoint.hold(np.array([0, 0, 1.0]), 0.5, 0.2)
    trajectory = MOTION.turn(start, 2.0, total_rad, 8, 3)
    assert_within_limits(trajectory)
    assert_rests(trajectory, -1)
    headings = [trajectory.setpoint_at(2.0 + view_s).yaw_rad - 0.5 for view_s in trajectory.views_s]
    np.testing.assert_allclose(headings, total_rad * np.arange(1, 9) / 8, atol=0.02)
    assert np.allclose(trajectory.camera_pitch_down_rad, 0.2)


def test_take_off_is_a_line() -> None:
    trajectory = MOTION.line(Setpoint.hold(np.zeros(3), 0.5, 0.26), np.array([0, 0, 1.1]), 0.5, 1.0, 3)
    assert_within_limits(trajectory)
    assert np.linalg.norm(trajectory.velocity_mps, axis=1).max() <= CONFIG.tight_speed_mps + 1e-6
    np.testing.assert_allclose(trajectory.position_m[-1], [0, 0, 1.1], atol=1e-9)
    assert np.allclose(trajectory.camera_pitch_down_rad, 0.26) and not len(trajectory.views_s)


def test_the_same_request_gives_the_same_motion() -> None:
    path = path_of([np.array([[-3, 0, 1.0], [0, 2, 1.0], [1, 2, 2]]), np.array([[1, 2, 2.0], [1, 0, 1]])], [2.0, -1.0])
    assert flown(path).position_m.tobytes() == flown(path).position_m.tobytes()


def test_is_quick() -> None:
    MOTION.warm_up()
    path = path_of([np.array([[-3, 0, 1.0], [0, 2, 1.0], [1, 2, 2]]), np.array([[1, 2, 2.0], [1, 0, 1]])], [2.0, -1.0])
    took_s = []
    for _ in range(5):
        began_s = time.perf_counter()
        flown(path)
        took_s.append(time.perf_counter() - began_s)
    assert min(took_s) < 0.05  # a few milliseconds on an idle core
