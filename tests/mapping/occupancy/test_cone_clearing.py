"""What a range finder frees in the map, against angles and distances worked out voxel by voxel."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.mapping.occupancy.cone_clearing import voxels_inside
from uav_recon.mapping.occupancy.occupancy_map import DepthSensor, OccupancyMap
from uav_recon.types.camera import BODY_FROM_OPTICAL, Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import FloatArray
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, GridSpec
from uav_recon.types.pose import Pose

GRID = GridSpec(np.array([-1.0, -0.8, 0.0]), 0.1, (20, 16, 30))
LENS = Intrinsics.from_fov(212, 120, np.radians(87), np.radians(58))
UP = np.array([0.0, 0.0, 1.0])
HERE = np.array([0.0, 0.0, 0.5])
ANGLE = st.floats(-0.2, 0.2)


def cone(reach_m: float = 1.55, half_rad: float = 0.25, apex_m: FloatArray = HERE, epoch: int = 0) -> FreeCone:
    return FreeCone(5.0, epoch, apex_m, UP, half_rad, reach_m)


def voxels(top_m: float = 3.0) -> OccupancyMap:
    return OccupancyMap(GRID, DepthSensor(0.3, 0.04, 0.05), 5.0, (-1.0, -0.8, 0.0), (1.0, 0.8, top_m), 1.1)


def state_at(space: OccupancyMap, place_m: tuple[float, float, float]) -> int:
    i, j, k = space.grid.index(np.array(place_m))
    return int(space.snapshot().state[i, j, k])


def look_up(space: OccupancyMap, range_m: float) -> None:
    """Integrate a depth frame of a ceiling, from where the cones begin."""
    optical = Pose.from_rotation_vector(np.array([0.0, -math.pi / 2.0, 0.0]), HERE) @ Pose.from_matrix(BODY_FROM_OPTICAL)
    depth_m = np.full((120, 212), range_m, dtype=np.float32)
    frame = Frame(0.0, 0, depth_m, LENS, np.zeros((1, 1, 3), dtype=np.uint8), LENS, Pose.identity())
    space.integrate(PosedFrame(frame, optical))


def outside(one: FreeCone, points_m: FloatArray) -> FloatArray:
    """Return how far points (..., 3) lie beyond the side (rad) or the end (m), by the angle between two vectors."""
    away = points_m - one.apex_odom_m
    distance_m = np.sqrt((away**2).sum(axis=-1))
    angle = np.arccos(np.clip((away * one.axis_odom).sum(axis=-1) / np.maximum(distance_m, 1e-12), -1.0, 1.0))
    return np.asarray(np.maximum(np.where(distance_m > 1e-9, angle, 0.0) - one.half_angle_rad, distance_m - one.reach_m))


@settings(max_examples=100, deadline=None)
@given(ANGLE, ANGLE, st.floats(0.05, 0.5), st.floats(0.1, 3.0), st.tuples(*[st.floats(-0.9, 0.9)] * 2, st.floats(-0.3, 2.5)))
def test_a_voxel_is_inside_if_every_point_of_it_is(
    lean_x: float, lean_y: float, half_rad: float, reach_m: float, apex_m: tuple[float, float, float]
) -> None:
    axis = Pose.from_rotation_vector(np.array([lean_x, lean_y, 0.0]), np.zeros(3)).rotation() @ UP
    one = FreeCone(5.0, 0, np.array(apex_m), axis, half_rad, reach_m)
    inside = np.zeros(GRID.shape, dtype=np.bool_)
    inside.reshape(-1)[voxels_inside(one, GRID)] = True
    index = np.stack(np.meshgrid(*map(np.arange, GRID.shape), indexing="ij"), axis=-1)
    offsets = np.vstack([np.array(list(product((0.0, 1.0), repeat=3))), np.random.default_rng(1).random((4, 3))])
    farthest = outside(one, GRID.origin_world_m + GRID.resolution_m * (index[..., None, :] + offsets)).max(axis=-1)
    assert farthest[inside].max(initial=-1.0) < 1e-6
    assert farthest[~inside].min() > -1e-6


def test_four_measurements_free_the_voxels_that_are_wholly_inside() -> None:
    space = voxels()
    assert [space.integrate_cone(cone()) for _ in range(3)] == [0, 0, 0]
    assert space.integrate_cone(cone()) > 20
    assert space.integrate_cone(cone()) == 0
    assert state_at(space, (0.05, 0.05, 1.75)) == FREE
    assert state_at(space, (0.05, 0.05, 0.55)) == UNKNOWN, "there the cone is narrower than a voxel"
    assert state_at(space, (0.45, 0.05, 1.75)) == UNKNOWN


def test_it_ends_a_voxel_before_the_cone() -> None:
    space = voxels()
    for _ in range(4):
        space.integrate_cone(cone(reach_m=1.61))
    assert state_at(space, (0.05, 0.05, 1.95)) == FREE, "its far corner is 1.506 m away"
    assert state_at(space, (0.05, 0.05, 2.05)) == UNKNOWN


def test_a_surface_that_depth_has_seen_stays() -> None:
    space = voxels()
    for _ in range(2):
        look_up(space, 1.0)
    assert state_at(space, (0.05, 0.05, 1.55)) == OCCUPIED
    for _ in range(50):
        space.integrate_cone(cone())
    assert state_at(space, (0.05, 0.05, 1.55)) == OCCUPIED


def test_one_solid_return_takes_back_what_it_freed() -> None:
    space = voxels()
    for _ in range(50):
        space.integrate_cone(cone())
    assert state_at(space, (0.05, 0.05, 1.55)) == FREE
    look_up(space, 1.0)
    assert state_at(space, (0.05, 0.05, 1.55)) != FREE


def test_outside_the_fence_nothing_becomes_free() -> None:
    space = voxels(top_m=1.5)
    for _ in range(4):
        space.integrate_cone(cone())
    assert state_at(space, (0.05, 0.05, 1.45)) == FREE
    assert state_at(space, (0.05, 0.05, 1.55)) == UNKNOWN


@pytest.mark.parametrize("apex_m", [(9.0, 0.0, 0.0), (0.0, 0.0, 3.0), (0.0, 0.0, -9.0)])
def test_a_cone_beside_the_map_frees_nothing(apex_m: tuple[float, float, float]) -> None:
    space = voxels()
    assert [space.integrate_cone(cone(apex_m=np.array(apex_m))) for _ in range(4)] == [0] * 4


def test_a_cone_of_another_map_is_an_error() -> None:
    with pytest.raises(ValueError, match="cone of map epoch 1 given to voxels of epoch 0"):
        voxels().integrate_cone(cone(epoch=1))
