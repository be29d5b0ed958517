"""Clearance of positions that are not voxel centres, against all voxels by brute force."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from uav_recon.planning.candidate_view import PlanningContext
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.free_space.subvoxel_clearance import CLEAR, LOW, OUTSIDE, SIDES2, blocking_voxel, make_clearance_box
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, VoxelMap

CLEARANCE_M = 0.35
LOWEST, HIGHEST = np.array([5, 0, 0]), np.array([20, 18, 22])


def cluttered(rng: np.random.Generator) -> tuple[PlanningContext, NDArray[np.float64]]:
    """Return a planning context, and the centres (N, 3) of all voxels that are not known free.

    The voxels around the map are included. Centres are in voxel units.
    """
    shape = (26, 24, 22)
    state = np.full(shape, FREE, dtype=np.uint8)
    for point in rng.integers(0, shape, (5, 3)):
        state[tuple(point)] = rng.choice([0, OCCUPIED])
    solid = np.pad(state != FREE, 1, constant_values=True)
    distance = ndimage.distance_transform_edt(~solid)[1:-1, 1:-1, 1:-1]
    grid = GridSpec(np.array([1.0, -2.0, 0.5]), 0.1, shape)
    space = FlyableSpace(grid, CLEARANCE_M, LOWEST, HIGHEST)
    voxels = VoxelMap.whole(grid, state, np.round(np.minimum(distance, 11.0) ** 2).astype(np.uint8), 1)
    space.update(voxels)
    start = space.world_from_padded(rng.choice(np.argwhere(space.mask)) + 0.5)
    exit_cells = space.locate_vehicle(start)
    assert exit_cells is not None
    return PlanningContext(voxels, space, exit_cells, start), np.argwhere(solid) - np.float64(0.5)


def to_sides(closed: NDArray[np.float64], place: NDArray[np.float64]) -> float:
    return float(np.sqrt((np.maximum(np.abs(closed - place) - 0.5, 0.0) ** 2).sum(axis=1)).min())


@pytest.mark.parametrize("seed", range(8))
def test_an_accepted_position_has_at_least_the_clearance_of_a_voxel_centre(seed: int) -> None:
    rng = np.random.default_rng(seed)
    context, closed = cluttered(rng)
    reachable = context.space.reachable
    centres = np.argwhere(reachable) - 0.5
    least = min(to_sides(closed, place) for place in centres)
    promised = np.sqrt(context.space.clearance_box[SIDES2])
    assert promised * 0.1 >= 0.3  # d_s of the paper
    assert promised <= least
    held = refused = 0
    for cell in rng.permutation(np.argwhere(reachable))[:400]:
        place = cell - 1.0 + rng.random(3)
        inside = bool(((place >= LOWEST + 0.5) & (place <= HIGHEST - 0.5)).all())
        holds = context.is_clear(place + 1.0)
        assert holds == (inside and to_sides(closed, place) >= promised)
        held, refused = held + holds, refused + (not holds)
    assert held > 100
    assert refused > 20


def test_reachable_voxel_centres_are_accepted_and_others_are_not() -> None:
    rng = np.random.default_rng(0)
    context, _ = cluttered(rng)
    reachable = context.space.reachable
    for cell in np.argwhere((reachable > 0) | (rng.random(reachable.shape) < 0.1)):
        assert context.is_clear(cell + np.float64(0.5)) == bool(reachable[tuple(cell)])


@pytest.mark.parametrize("needed2", [1, 6, 9, 13, 16, 24, 57, 256])
def test_the_clearance_box_follows_from_the_nearest_allowed_voxel(needed2: int) -> None:
    most = int(np.sqrt(needed2)) + 1
    steps = [s for s in itertools.product(range(-most, most + 1), repeat=3) if np.dot(s, s) >= needed2]
    sides2 = (np.maximum(np.abs(np.array(steps)) - 0.5, 0.0) ** 2).sum(axis=1)
    clearance_box = make_clearance_box((90, 80, 70), np.array([0, 9, 40]), np.array([90, 60, 70]), needed2)
    border = np.sqrt(sides2.min())
    assert clearance_box[SIDES2] == sides2.min()
    np.testing.assert_allclose(clearance_box[LOW:SIDES2], [border, max(9.5, border), 40.5, 90 - border, 59.5, 70 - border])


def test_the_blocking_voxel_is_not_free_and_too_near() -> None:
    rng = np.random.default_rng(3)
    context, _ = cluttered(rng)
    voxels, clearance_box = context.voxels, context.space.clearance_box
    answers = []
    for place in rng.uniform(2.0, 24.0, (2000, 3)):
        at = blocking_voxel(voxels.distance2.reshape(-1), voxels.grid.shape, clearance_box, *place)
        answers.append(min(at, 0))
        if at >= 0:
            voxel = np.array(np.unravel_index(at, voxels.grid.shape))
            assert voxels.state[tuple(voxel)] != FREE
            assert to_sides(voxel[None] + np.float64(0.5), place) ** 2 < clearance_box[SIDES2]
    assert min(answers.count(kind) for kind in (CLEAR, OUTSIDE, 0)) > 50


@pytest.mark.parametrize("place", [(np.nan, 9.0, 9.0), (9.0, np.inf, 9.0), (9.0, 9.0, -np.inf), (1e30, 9.0, 9.0)])
def test_positions_that_are_not_finite_or_far_away_are_outside(place: tuple[float, float, float]) -> None:
    context, _ = cluttered(np.random.default_rng(1))
    voxels = context.voxels
    assert blocking_voxel(voxels.distance2.reshape(-1), voxels.grid.shape, context.space.clearance_box, *place) == OUTSIDE
