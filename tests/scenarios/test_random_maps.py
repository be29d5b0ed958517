"""A thousand random maps: every plan is a valid path or a stated reason; never an exception, never an unsafe waypoint."""

from __future__ import annotations

import dataclasses
import itertools
import typing
from collections import Counter

import numpy as np
import pytest
from numpy.typing import NDArray
from random_maps import RandomMap, random_map
from scipy import ndimage

from uav_recon.config import PlannerConfig
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.fallback_planner import FallbackPlanner
from uav_recon.planning.tour.travel_time import YawWhileFlying
from uav_recon.planning.view_planner import ViewPlanner
from uav_recon.types.maps import FREE, GridSpec, VoxelMap
from uav_recon.types.tasks import NothingLeft, PlanRequest, ViewPath, Viewpoint

MAPS, BLOCKS = 1000, 10
BORDER = 1e-6  # voxels: a way may bend on the very border of a flyable voxel
VIEW_M = 0.3  # d_s: from a view to the nearest side of anything that is not known free
CLIP = 0.25  # voxels: a line between two waypoints may clip a corner by this much
MOUNT_M = np.array([0.1, 0.0, 0.0])
pytestmark = pytest.mark.slow
TILT_RAD = np.radians(15.0)
FIXED = CameraGeometry(np.radians(87), np.radians(58), MOUNT_M, TILT_RAD, TILT_RAD, 4.5)
GIMBAL = CameraGeometry(np.radians(87), np.radians(58), MOUNT_M, -np.radians(60), np.radians(60), 4.5)
CLEARANCE_M = PlannerConfig().clearance_m  # usual, or of narrow ways for a planner that usually wants ...
MORE_M = 0.45
VARIANTS = typing.get_args(PlannerConfig.model_fields["variant"].annotation)


@pytest.mark.parametrize("block", [0, *(pytest.param(block, marks=pytest.mark.nightly) for block in range(1, BLOCKS))])
def test_every_plan_is_a_valid_path_or_a_stated_reason(block: int) -> None:
    outcomes: Counter[str] = Counter()
    for seed in range(block, MAPS, BLOCKS):
        outcomes += fly_through(seed)
    assert outcomes["maps"] == MAPS // BLOCKS


@pytest.mark.nightly
def test_the_thousand_maps_hold_both_answers() -> None:
    outcomes: Counter[str] = sum((fly_through(seed) for seed in range(60)), Counter())
    assert outcomes["path"] >= 30
    assert outcomes["reason"] >= 30
    assert outcomes["way"] >= 30
    assert outcomes["left by a way out"] >= 10
    assert outcomes["narrow way"] == 0


@pytest.mark.nightly
def test_narrow_ways_are_valid_ones_too() -> None:
    """Of a planner that asks for a lot of room, and for less where that leads nowhere: ways home, mostly."""
    outcomes: Counter[str] = sum((fly_through(seed, usual_m=MORE_M) for seed in range(MAPS, MAPS + 200)), Counter())
    assert outcomes["narrow way"] >= 50


def fly_through(seed: int, usual_m: float | None = None) -> Counter[str]:
    """Plan in one map while it grows and changes, with one planner; what came of it.

    usual_m: clearance of a planner that goes on through narrows, and is asked at rest as well as in motion.
    """
    world = random_map(seed)
    rng = world.rng
    camera = GIMBAL if rng.random() < 0.5 else FIXED
    config = PlannerConfig(variant=VARIANTS[int(rng.integers(len(VARIANTS)))], clearance_m=usual_m or CLEARANCE_M)
    usual = ViewPlanner(config, world.fence_m[0], world.fence_m[1], camera, YawWhileFlying(0.8, 0.8), timer=lambda: 0.0)
    planner = usual if usual_m is None else FallbackPlanner(usual, (CLEARANCE_M,), CLEARANCE_M, timer=lambda: 0.0)
    position, yaw_rad = world.anywhere(), float(rng.uniform(-4, 4))
    home = Viewpoint(position, 0.0, float(np.clip(0.0, camera.pitch_min_rad, camera.pitch_max_rad)))
    if rng.random() < 0.9:  # else the start is unknown
        world.look_from(position, float(rng.uniform(0.3, 2.5)))
    outcomes: Counter[str] = Counter(maps=1)
    for step in range(int(rng.integers(1, 5))):
        surface = world.surface() if rng.random() < 0.6 else None
        request = PlanRequest(
            world.snapshot(), surface, position, yaw_rad, int(rng.integers(0, 12)) if step else 10, rng.uniform(-0.5, 0.5, 3)
        )
        if usual_m is not None and rng.random() < 0.7:
            request = dataclasses.replace(request, velocity_world_mps=np.zeros(3))
        answer = planner.plan(request)
        outcomes[judged(answer, request, world, config.clearance_m, camera)] += 1
        way_home = planner.route(request, home)
        outcomes["way"] += judged(way_home, request, world, config.clearance_m, None) != "reason"
        outcomes["narrow way"] += is_narrow(answer) + is_narrow(way_home)
        if isinstance(answer, ViewPath):
            planner.accept(answer)
            reached = int(rng.integers(len(answer.viewpoints)))
            position, yaw_rad = answer.viewpoints[reached].position_world, answer.viewpoints[reached].yaw_rad
        elif rng.random() < 0.5:
            position = world.anywhere()
        if rng.random() < 0.8:
            world.look_from(position, float(rng.uniform(0.5, 3.0)))
        if rng.random() < 0.4:
            world.change()
        if rng.random() < 0.05:
            world.epoch += 1
    return outcomes


def judged(
    answer: ViewPath | NothingLeft, request: PlanRequest, world: RandomMap, clearance_m: float, camera: CameraGeometry | None
) -> str:
    """Assert what must hold of any answer; say which kind it is. A view has ``clearance_m`` even where its way keeps less."""
    if isinstance(answer, NothingLeft):
        assert len(answer.reason.text()) > 5
        return "reason"
    assert 1 <= len(answer.viewpoints) == len(answer.waypoints_world) == len(answer.tasks)
    assert answer.map_revision == request.voxels.revision
    assert answer.map_epoch == request.voxels.map_epoch
    if camera is not None:
        assert len(answer.viewpoints) <= request.views_left
        for view in answer.viewpoints:
            assert camera.pitch_min_rad - 1e-9 <= view.pitch_down_rad <= camera.pitch_max_rad + 1e-9
            assert np.isfinite(view.yaw_rad)
    keeps_m = answer.clearance_m or clearance_m
    for view in answer.viewpoints:
        assert_clear(view.position_world, request.voxels, world.fence_m, clearance_m if camera is not None else keeps_m)
    return assert_flyable(answer, request, flyable(request.voxels, world, keeps_m))


def is_narrow(answer: ViewPath | NothingLeft) -> bool:
    return isinstance(answer, ViewPath) and answer.clearance_m is not None


def assert_clear(place: NDArray[np.float64], voxels: VoxelMap, fence_m: NDArray[np.float64], clearance_m: float) -> None:
    """The very place of a view, and not its voxel's centre, is d_s from all that is not known free, and inside the fence."""
    resolution_m = voxels.grid.resolution_m
    at = (place - voxels.grid.origin_world_m) / resolution_m
    reach = int(np.ceil(VIEW_M / resolution_m)) + 1
    around = np.stack(np.meshgrid(*(np.arange(-reach, reach + 1),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = np.floor(at).astype(int) + around
    away_m = np.abs(cells + 0.5 - at)[~_at(voxels.state == FREE, cells)] * resolution_m
    sides_m = np.maximum(away_m - 0.5 * resolution_m, 0.0)
    assert (np.linalg.norm(sides_m, axis=1) >= VIEW_M).all()
    assert ((place >= fence_m[0] + clearance_m - 1e-4) & (place <= fence_m[1] - clearance_m + 1e-4)).all()


def flyable(voxels: VoxelMap, world: RandomMap, clearance_m: float) -> NDArray[np.bool_]:
    """Known-free voxels with clearance, inside the fence by as much: (nx, ny, nz)."""
    resolution_m = voxels.grid.resolution_m
    away_m = ndimage.distance_transform_edt(np.pad(voxels.state == FREE, 1))[1:-1, 1:-1, 1:-1] * resolution_m
    axes = (np.arange(n) for n in voxels.grid.shape)
    centres = voxels.grid.centre(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    low, high = world.fence_m[0] + clearance_m - 1e-4, world.fence_m[1] - clearance_m + 1e-4
    return np.asarray(
        (away_m >= clearance_m + 0.5 * resolution_m - 1e-3) & np.all((centres >= low) & (centres <= high), axis=-1)
    )


def assert_flyable(path: ViewPath, request: PlanRequest, may: NDArray[np.bool_]) -> str:
    """Legs join up; each waypoint may be stood on; each line between two stays there, but for the clip of a corner.

    A vehicle that stands where it may not leaves through known-free voxels (its own is exempt) to the first that it may.
    """
    grid, kind = request.voxels.grid, "path"
    at = request.position_world
    for view, way in zip(path.viewpoints, path.waypoints_world, strict=True):
        assert np.isfinite(way).all()
        np.testing.assert_allclose(way[0], at, atol=1e-9)
        np.testing.assert_allclose(way[-1], view.position_world, atol=1e-9)
        assert (np.linalg.norm(np.diff(way, axis=0), axis=1) > 0).all()
        first = 0
        if way is path.waypoints_world[0] and not _at(may, grid.index(way[:1])).all():
            kind = "left by a way out"
            first = int(np.argmax(_at(may, grid.index(way))))
            assert first > 0
            assert _at(request.voxels.state == FREE, grid.index(way[1 : first + 1])).all()
            assert (np.linalg.norm(np.diff(way[: first + 1], axis=0), axis=1) <= 3.5 * grid.resolution_m).all()
        assert _touches(may, grid, way[first:], BORDER).all()
        for a, b in itertools.pairwise(way[first:]):
            count = 2 + int(np.linalg.norm(b - a) / grid.resolution_m * 8)
            samples = a + np.linspace(0.0, 1.0, count)[:, None] * (b - a)
            assert _touches(may, grid, samples, CLIP).all()
        at = way[-1]
    return kind


def _touches(mask: NDArray[np.bool_], grid: GridSpec, points: NDArray[np.float64], within: float) -> NDArray[np.bool_]:
    """Which points (N, 3) lie in a voxel of the mask or at most ``within`` voxels beside one."""
    corners = np.array(list(itertools.product((-within, within), repeat=3))) * grid.resolution_m
    return np.asarray(np.any([_at(mask, grid.index(points + corner)) for corner in corners], axis=0))


def _at(mask: NDArray[np.bool_], index: NDArray[np.int64]) -> NDArray[np.bool_]:
    inside = np.all((index >= 0) & (index < mask.shape), axis=-1)
    i, j, k = np.where(inside[..., None], index, 0).T
    return np.asarray(inside & mask[i, j, k])
