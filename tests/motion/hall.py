"""A hall to fly in, random paths through it, and what every trajectory owes."""

from __future__ import annotations

import functools
import itertools

import numpy as np
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from uav_recon.config import MotionConfig
from uav_recon.motion import MotionPlanner
from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, VoxelMap
from uav_recon.types.tasks import PlanMode, ViewPath, Viewpoint
from uav_recon.types.trajectory import Setpoint, Trajectory

CONFIG = MotionConfig()
CLEARANCE_M = 0.35
HALL_CORNER_M = np.array([-5.0, -5.0, 0.0])
RATE, SPIN = np.radians(CONFIG.yaw_rate_degps), np.radians(CONFIG.yaw_acceleration_degps2)
BLUR_RADPS = CONFIG.blur_px / (CONFIG.focal_px * CONFIG.exposure_s)
MOTION = MotionPlanner(CONFIG, CLEARANCE_M)
JERK = 2.5 * CONFIG.acceleration_mps2 / (CONFIG.smoothing_s / 2)  # full ahead to full astern
START = Setpoint.hold(np.zeros(3), 0.0)


def voxel_map(state: FloatArray, epoch: int = 0) -> VoxelMap:
    """A map with scipy's exact distances; what is outside the grid is not free."""
    grid = GridSpec(HALL_CORNER_M, 0.1, state.shape)
    distance = distance_transform_edt(np.pad(state == FREE, 1))[1:-1, 1:-1, 1:-1]
    return VoxelMap.whole(grid, state.astype(np.uint8), np.minimum(np.round(distance**2), 121).astype(np.uint8), 0, epoch)


def room(*boxes: tuple[list[float], list[float], int], epoch: int = 0) -> VoxelMap:
    """A free hall of 10 x 10 x 3 m with boxes of another state in it."""
    state = np.full((100, 100, 30), FREE)
    for low, high, value in boxes:
        i = np.floor((np.array(low) - HALL_CORNER_M + 1e-6) / 0.1).astype(int)
        j = np.floor((np.array(high) - HALL_CORNER_M - 1e-6) / 0.1).astype(int) + 1
        state[i[0] : j[0], i[1] : j[1], i[2] : j[2]] = value
    return voxel_map(state, epoch)


HALL = room()


def path_of(legs: list[FloatArray], yaws: list[float], pitches: list[float] | None = None, epoch: int = 0) -> ViewPath:
    """A path with a view at the end of each leg."""
    pitches = pitches or [0.0] * len(legs)
    views = tuple(Viewpoint(leg[-1], yaw, pitch) for leg, yaw, pitch in zip(legs, yaws, pitches, strict=True))
    return ViewPath(views, tuple(np.asarray(leg, dtype=np.float64) for leg in legs), PlanMode.EXPLORE, 0, epoch, (), 0.0, 0.0)


def straight(*points: list[float], yaw: float = 0.0) -> ViewPath:
    """One leg."""
    return path_of([np.array(points)], [yaw])


def flown(path: ViewPath, voxels: VoxelMap = HALL, spacing_m: float = 0.4, yaw_rad: float = 0.0) -> Trajectory:
    """From rest at the path's first waypoint."""
    trajectory = MOTION.plan_from_rest(path, voxels, Setpoint.hold(path.waypoints_world[0][0], yaw_rad), 5.0, spacing_m, 7)
    assert isinstance(trajectory, Trajectory), trajectory
    return trajectory


@st.composite
def paths(draw: st.DrawFn, start: FloatArray | None = None) -> ViewPath:
    """One to five views with up to four corners between, long legs or short ones, views on the same spot among them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    short = draw(st.booleans())
    return random_path(rng, short, start)


def random_path(rng: np.random.Generator, short: bool, start: FloatArray | None = None) -> ViewPath:
    here = rng.uniform([-3, -3, 0.8], [3, 3, 2.2]) if start is None else start
    legs, yaws, pitches = [], [], []
    for _ in range(int(rng.integers(1, 6))):
        leg = [here]
        for _ in range(int(rng.integers(0, 5))):
            step = rng.normal(0.0, 0.15 if short else 1.0, 3)
            here = np.clip(here + step, [-4, -4, 0.6], [4, 4, 2.4])
            leg.append(here)
        legs.append(np.array(leg))
        yaws.append(float(rng.uniform(-7, 7)))
        pitches.append(float(rng.uniform(-0.5, 0.5)))
    return path_of(legs, yaws, pitches)


def wrapped(angle_rad: float) -> float:
    return float((angle_rad + np.pi) % (2 * np.pi) - np.pi)


def jerks(trajectory: Trajectory) -> FloatArray:
    change = np.diff(trajectory.acceleration_mps2, axis=0)
    return np.asarray(np.linalg.norm(change, axis=1) / trajectory.step_s)


def assert_within_limits(trajectory: Trajectory, jerk: float = JERK) -> None:
    """The config's limits, by the trajectory's own numbers and by differences of its places."""
    velocity = trajectory.velocity_mps
    by_difference = np.diff(velocity, axis=0) / trajectory.step_s
    spin = np.abs(np.diff(trajectory.yaw_rate_radps)) / trajectory.step_s
    assert np.linalg.norm(velocity, axis=1).max() <= CONFIG.speed_mps + 1e-9
    assert velocity[:, 2].max() <= CONFIG.climb_mps + 1e-9
    assert velocity[:, 2].min() >= -CONFIG.descent_mps - 1e-9
    assert np.linalg.norm(trajectory.acceleration_mps2, axis=1).max() <= CONFIG.acceleration_mps2 * 1.05
    assert np.linalg.norm(by_difference, axis=1).max() <= CONFIG.acceleration_mps2 * 1.05
    assert np.abs(trajectory.yaw_rate_radps).max() <= RATE + 1e-9
    assert spin.max() <= SPIN * 1.05
    assert jerks(trajectory)[:-2].max(initial=0.0) <= jerk
    moved = np.diff(trajectory.position_m, axis=0) / trajectory.step_s
    np.testing.assert_allclose(moved, (velocity[1:] + velocity[:-1]) / 2, atol=0.02)
    turned = np.diff(trajectory.yaw_rad) / trajectory.step_s
    np.testing.assert_allclose(turned, (trajectory.yaw_rate_radps[1:] + trajectory.yaw_rate_radps[:-1]) / 2, atol=0.02)


def assert_rests(trajectory: Trajectory, index: int) -> None:
    assert np.linalg.norm(trajectory.velocity_mps[index]) < 1e-6
    assert np.linalg.norm(trajectory.acceleration_mps2[index]) < 1e-6
    assert abs(trajectory.yaw_rate_radps[index]) < 1e-6


def assert_sees(trajectory: Trajectory, path: ViewPath) -> None:
    """Each view is passed within 0.15 m and 3 degrees, in order, sharp, and with the last one reached exactly."""
    since_s = -1.0
    for view in path.viewpoints:
        instants = [float(t) for t in trajectory.views_s if t >= since_s]
        close = [t for t in instants if _meets(trajectory.setpoint_at(trajectory.start_s + t), view)]
        assert close, f"{view} is not met"
        since_s = close[0]
    np.testing.assert_allclose(trajectory.position_m[-1], path.viewpoints[-1].position_world, atol=1e-9)
    assert abs(wrapped(trajectory.yaw_rad[-1] - path.viewpoints[-1].yaw_rad)) < 1e-9
    assert np.all(np.diff(trajectory.views_s) >= 0)
    assert trajectory.views_s.min() >= 0 and trajectory.views_s.max() <= trajectory.duration_s + 1e-9


def _meets(setpoint: Setpoint, view: Viewpoint) -> bool:
    return bool(
        np.linalg.norm(setpoint.position_m - view.position_world) <= 0.15
        and abs(wrapped(setpoint.yaw_rad - view.yaw_rad)) <= np.radians(3)
        and abs(setpoint.camera_pitch_down_rad - view.pitch_down_rad) <= np.radians(3)
    )


def room_around(points_m: FloatArray, voxels: VoxelMap) -> FloatArray:
    """True distance (N,) in metres to the nearest centre of a voxel that is not free, by brute force; nothing outside is."""
    return np.asarray(_not_free(voxels).query(points_m)[0])


@functools.lru_cache(maxsize=4)
def _not_free(voxels: VoxelMap) -> cKDTree:
    state = np.pad(voxels.state, 1)
    return cKDTree(voxels.grid.origin_world_m + (np.argwhere(state != FREE) - 0.5) * voxels.grid.resolution_m)


def is_free(points_m: FloatArray, voxels: VoxelMap) -> BoolArray:
    index = voxels.grid.index(points_m)
    inside = voxels.grid.contains(index)
    i, j, k = np.where(inside[:, None], index, 0).T
    return np.asarray(inside & (voxels.state[i, j, k] == FREE))


def to_polyline(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Distance (N,) of points from a polyline."""
    nearest: FloatArray = np.asarray(np.linalg.norm(points - corners[0], axis=1), dtype=np.float64)
    for a, b in itertools.pairwise(corners):
        length2 = max(float((b - a) @ (b - a)), 1e-12)
        share = np.clip((points - a) @ (b - a) / length2, 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
    return nearest


def wall(low: list[float], high: list[float]) -> tuple[list[float], list[float], int]:
    return low, high, OCCUPIED
