"""Where the camera does not look the way is flown slowly, and long ways are flown nose ahead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hall import CLEARANCE_M, CONFIG, HALL, RATE, assert_rests, assert_sees, assert_within_limits, flown, path_of, paths
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uav_recon.motion import MotionPlanner
from uav_recon.motion.clearance import ClearanceMap
from uav_recon.motion.sight_forecast import EnteredHull, SightForecast
from uav_recon.motion.yaw_policy import AT_VIEWS, BLIND_SHARE, SHARE, YawAlongPath
from uav_recon.safety.sight_speed_limit import SightSpeedLimit
from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.recent_views import RecentViews
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Setpoint, Trajectory

HALF_TAN = (float(np.tan(np.radians(87.0) / 2)), float(np.tan(np.radians(58.0) / 2)))
ALLOWED_MPS = 0.30  # by the guard
BLIND_MPS = BLIND_SHARE * ALLOWED_MPS
LIMIT = SightSpeedLimit(
    full_speed_mps=1.0, blind_speed_mps=BLIND_MPS, blind_fresh_s=3.0, blind_stale_s=10.0, blind_memory_s=60.0
)
NOSE_AHEAD = YawAlongPath(HALF_TAN, LIMIT, EnteredHull(0.2, 0.25), CONFIG.speed_mps, RATE)
MOTION = MotionPlanner(CONFIG, CLEARANCE_M, yaw_policy=NOSE_AHEAD)
TILT_RAD = float(np.radians(15.0))


def in_picture(way: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray, share: float) -> BoolArray:
    """By scipy's rotations: directions (N, 3) in the camera's own axes, z ahead, x right, y down."""
    world_from_body = Rotation.from_euler("ZY", np.column_stack([yaw_rad, pitch_down_rad]))
    x, y, z = (world_from_body.inv().apply(way) @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])).T
    return np.asarray((z > 0.0) & (np.abs(x) <= share * HALF_TAN[0] * z) & (np.abs(y) <= share * HALF_TAN[1] * z))


def nose_ahead(path: ViewPath, start: Setpoint) -> Trajectory:
    trajectory = MOTION.plan_from_rest(path, HALL, start, 5.0, 0.4, 7)
    assert isinstance(trajectory, Trajectory), trajectory
    return trajectory


def leant(change_mps2: FloatArray) -> Rotation:
    """The smallest turn from the vertical to where a body thrusts that gains speed by (N, 3)."""
    thrust = change_mps2 + np.array([0.0, 0.0, 9.81])
    axis = np.cross((0.0, 0.0, 1.0), thrust)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    return Rotation.from_rotvec(axis / np.maximum(sine, 1e-12) * np.arctan2(sine, thrust[:, 2:]))


def assert_slow_where_blind(trajectory: Trajectory) -> None:
    speed_mps = np.linalg.norm(trajectory.velocity_mps, axis=1)
    fast = speed_mps > ALLOWED_MPS
    way = leant(trajectory.acceleration_mps2[fast]).inv().apply(trajectory.velocity_mps[fast])
    looks = in_picture(way, trajectory.yaw_rad[fast], trajectory.camera_pitch_down_rad[fast], 1.0)
    assert looks.all(), f"{speed_mps[fast][~looks].max():.2f} m/s where it does not look"


@settings(deadline=None)
@given(st.integers(0, 2**31))
def test_what_it_sees_is_what_the_picture_shows(seed: int) -> None:
    rng = np.random.default_rng(seed)
    way, yaw, pitch = rng.normal(size=(200, 3)), rng.uniform(-7, 7, 200), rng.uniform(-1, 1, 200)
    np.testing.assert_array_equal(NOSE_AHEAD.sees(way, yaw, pitch), in_picture(way, yaw, pitch, SHARE))


@settings(deadline=None, max_examples=60)
@given(paths())
def test_every_way_is_slow_where_it_does_not_look_and_passes_its_views(path: ViewPath) -> None:
    trajectory = nose_ahead(path, Setpoint.hold(path.waypoints_world[0][0], 0.0))
    assert_slow_where_blind(trajectory)
    assert_within_limits(trajectory)
    assert_sees(trajectory, path)
    assert_rests(trajectory, -1)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, -135.0])
def test_a_long_way_is_flown_nose_ahead_and_ends_at_its_view(yaw_deg: float) -> None:
    path = path_of([np.array([[-3.0, 0.0, 1.2], [3.0, 0.0, 1.2]])], [float(np.radians(yaw_deg))], [TILT_RAD])
    start = Setpoint.hold(np.array([-3.0, 0.0, 1.2]), float(np.radians(yaw_deg)), TILT_RAD)
    trajectory, sideways = nose_ahead(path, start), flown(path, yaw_rad=float(np.radians(yaw_deg)))
    assert_slow_where_blind(trajectory)
    middle = trajectory.setpoint_at(trajectory.start_s + trajectory.duration_s / 2)
    assert abs(np.degrees(middle.yaw_rad)) % 360.0 <= 43.0
    assert middle.velocity_mps[0] > 0.9
    at_rest_s = 2.0 * np.radians(abs(yaw_deg)) / RATE
    assert trajectory.duration_s <= sideways.duration_s + at_rest_s + 3.0


def test_a_short_way_is_not_worth_a_turn() -> None:
    path = path_of([np.array([[0.0, 0.0, 1.2], [0.0, 0.3, 1.2]])], [0.0], [TILT_RAD])
    trajectory = nose_ahead(path, Setpoint.hold(np.array([0.0, 0.0, 1.2]), 0.0, TILT_RAD))
    assert_slow_where_blind(trajectory)
    assert np.abs(trajectory.yaw_rad).max() < 0.05


def test_what_looks_at_its_views_flies_as_fast_anywhere() -> None:
    slope, place = np.random.default_rng(0).normal(size=(2, 50, 5))
    assert np.isinf(AT_VIEWS.max_speed_mps(slope, place, None, np.zeros(50))).all()
    slow = NOSE_AHEAD.max_speed_mps(slope, place, None, np.zeros(50)) == BLIND_MPS
    np.testing.assert_array_equal(slow, ~in_picture(slope[:, :3], place[:, 3], place[:, 4], SHARE))


@settings(deadline=None, max_examples=30)
@given(paths(np.array([0.0, 0.0, 1.2])), st.floats(0.2, 0.8))
def test_out_of_a_motion_it_brakes_before_it_turns_away(path: ViewPath, share: float) -> None:
    first = path_of([np.array([[0.0, 0.0, 1.2], [2.0, 0.0, 1.2]])], [0.0], [TILT_RAD])
    flying = nose_ahead(first, Setpoint.hold(np.array([0.0, 0.0, 1.2]), 0.0, TILT_RAD))
    trajectory = MOTION.plan_from_motion(path, HALL, flying, 5.0 + share * flying.duration_s, 0.4, 8)
    if isinstance(trajectory, Trajectory):
        assert_slow_where_blind(trajectory)
        assert_rests(trajectory, -1)


def seen_all_around(*bearings_rad: float) -> SightForecast:
    """A forecast from an old view, in a round bare room with corners at bearings from the hall's middle."""
    turn, up = (axis.ravel() for axis in np.meshgrid(np.arange(-np.pi, np.pi, 0.05), np.arange(-1.5, 4.0, 0.2)))
    normal = -np.stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))], axis=1)
    off = np.min([np.abs(np.remainder(turn - one + np.pi, 2 * np.pi) - np.pi) for one in bearings_rad], axis=0)
    cells = SurfaceCells(
        0.2, -2.5 * normal + up[:, None] * (0.0, 0.0, 1.0), normal, np.zeros(len(turn)), np.full(len(turn), 0.04),
        np.where(off < 0.3, 2.0, 0.0),
    )  # fmt: skip
    views = RecentViews(
        np.zeros(1), np.eye(3)[None], np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 2, 2), np.float32), np.ones(2)
    )
    clearance = ClearanceMap.of(HALL, np.full(3, -np.inf), np.full(3, np.inf), CLEARANCE_M)
    forecast = NOSE_AHEAD.forecast(views, cells, clearance, 100.0)
    assert forecast is not None
    return forecast


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_on_its_way_it_looks_at_what_shows_the_place(side: float) -> None:
    """Ahead is a bare wall, 1.2 rad beside the path are corners, which the camera can see with the path in view."""
    leg = np.array([[-1.0, 0.0, 1.2], [1.0, 0.0, 1.2]])
    begin, goal = np.array([-1.0, 0.0, 1.2, 0.0, 0.1]), np.array([1.0, 0.0, 1.2, 0.0, 0.1])
    seeing = seen_all_around(side * 1.2)
    plain, _ = NOSE_AHEAD.along(leg, begin, goal, replace(seeing, sight=None))
    chosen, _ = NOSE_AHEAD.along(leg, begin, goal, seeing)
    assert np.abs(plain[:, 3]).max() < 1e-9
    assert (side * chosen[:-1, 3]).max() > 0.25
    assert np.abs(chosen[:, 3]).max() <= NOSE_AHEAD.max_offset_rad + 1e-9
    assert chosen[-1, 3] == 0.0


def test_it_flies_straight_ahead_where_all_shows_the_place() -> None:
    leg = np.array([[-1.0, 0.0, 1.2], [1.0, 0.0, 1.2]])
    begin, goal = np.array([-1.0, 0.0, 1.2, 0.0, 0.1]), np.array([1.0, 0.0, 1.2, 0.0, 0.1])
    chosen, _ = NOSE_AHEAD.along(leg, begin, goal, seen_all_around(*np.arange(0.0, 6.2, 0.3)))
    assert np.abs(chosen[:, 3]).max() < 1e-9
