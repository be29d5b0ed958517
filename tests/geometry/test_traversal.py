from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from uav_recon.geometry.traversal import first_obstacle, is_visible, visible_targets
from uav_recon.mapping.occupancy.distance_field import distance2_to_not_free
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, HeightMeasure


def crossed_length(voxel: FloatArray, a: FloatArray, b: FloatArray) -> float:
    """Return the length of a segment inside a unit cube by the slab method, as the oracle."""
    direction = b - a
    with np.errstate(divide="ignore", invalid="ignore"):
        t0, t1 = (voxel - a) / direction, (voxel + 1 - a) / direction
    enter = np.nanmax(np.append(np.minimum(t0, t1), 0.0))
    leave = np.nanmin(np.append(np.maximum(t0, t1), 1.0))
    return float(max(leave - enter, 0.0) * np.linalg.norm(direction))


@pytest.mark.parametrize("tail", [0.0, 1.5])
def test_agrees_with_slab_intersections_of_every_voxel(tail: float) -> None:
    rng = np.random.default_rng(3)
    decided = {True: 0, False: 0}
    for _ in range(400):
        state = rng.choice([FREE, FREE, FREE, FREE, FREE, FREE, FREE, FREE, OCCUPIED, UNKNOWN], (9, 8, 7)).astype(np.uint8)
        a, b = (rng.uniform(0, state.shape) for _ in range(2))
        end = a + (b - a) * max(1 - tail / float(np.linalg.norm(b - a)), 0.0)
        blocking = [v for v in np.argwhere(state != FREE) if not np.array_equal(v, np.floor(b))]
        crossed = max(crossed_length(v.astype(float), a, end) for v in blocking)
        if 0 < crossed < 1e-9:
            continue
        decided[crossed == 0] += 1
        assert is_visible(state, a[0], a[1], a[2], b[0], b[1], b[2], tail) == (crossed == 0)
    assert min(decided.values()) > 50


def test_the_targets_own_voxel_is_not_checked_but_unknown_and_outside_block() -> None:
    state = np.full((5, 1, 1), FREE, dtype=np.uint8)
    state[4] = OCCUPIED
    assert is_visible(state, 0.5, 0.5, 0.5, 4.5, 0.5, 0.5, 0.0)
    state[2] = UNKNOWN
    assert not is_visible(state, 0.5, 0.5, 0.5, 4.5, 0.5, 0.5, 0.0)
    assert not is_visible(state, 0.5, 0.5, 0.5, 0.5, 3.5, 0.5, 0.0)
    assert is_visible(state, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.0)


def test_many_targets_at_once_give_the_same_results_as_one_by_one() -> None:
    rng = np.random.default_rng(4)
    state = rng.choice([FREE, FREE, FREE, OCCUPIED], (6, 6, 6)).astype(np.uint8)
    targets = rng.uniform(-1, 7, (100, 3))
    eye = np.array([3.2, 3.1, 2.7])
    assert [is_visible(state, eye[0], eye[1], eye[2], t[0], t[1], t[2], 0.0) for t in targets] == visible_targets(
        state, eye, targets, 0.0
    ).tolist()


def rays(rng: np.random.Generator, state: NDArray[np.uint8], count: int) -> tuple[FloatArray, FloatArray]:
    shape = np.array(state.shape)
    return rng.uniform(0, shape, (count, 3)), rng.uniform(0, shape, (count, 3))


def test_leaps_over_free_space_equal_a_walk_through_every_voxel() -> None:
    rng = np.random.default_rng(5)
    answers = {True: 0, False: 0}
    for density in (0.0, 0.002, 0.01, 0.1):
        state = np.where(rng.random((40, 30, 25)) < density, OCCUPIED, FREE).astype(np.uint8)
        state[rng.random(state.shape) < density / 2] = UNKNOWN
        distance = ndimage.distance_transform_edt(np.pad(state == FREE, 1))[1:-1, 1:-1, 1:-1]
        distance2 = np.round(np.minimum(distance, 11.0) ** 2).astype(np.uint8).ravel()
        for a, b in zip(*rays(rng, state, 800), strict=True):
            voxel = first_obstacle(distance2, 30, 25, a[0], a[1], a[2], b[0], b[1], b[2])
            # is_visible checks the voxel of its start and not of its end, so the ends are swapped
            assert (voxel < 0) == is_visible(state, b[0], b[1], b[2], a[0], a[1], a[2], 0.0)
            answers[voxel < 0] += 1
            if voxel >= 0:
                hit = np.array(np.unravel_index(voxel, state.shape))
                assert state[tuple(hit)] != FREE
                assert crossed_length(hit.astype(float), a, b) > 0
                before = a + (b - a) * (np.linalg.norm(hit + 0.5 - a) - 2.0) / np.linalg.norm(b - a)
                if np.dot(before - a, b - a) > 0:
                    assert is_visible(state, before[0], before[1], before[2], a[0], a[1], a[2], 0.0)
    assert min(answers.values()) > 500


def test_lines_along_the_axes_and_through_edges_terminate() -> None:
    state = np.full((9, 9, 9), FREE, dtype=np.uint8)
    state[4, 4, 4] = OCCUPIED
    distance2 = (
        np.round(ndimage.distance_transform_edt(np.pad(state == FREE, 1))[1:-1, 1:-1, 1:-1] ** 2).astype(np.uint8).ravel()
    )
    middle = int(np.ravel_multi_index((4, 4, 4), state.shape))
    for axis in range(3):
        a, b = np.full(3, 4.5), np.full(3, 4.5)
        a[axis], b[axis] = 0.5, 8.5
        assert first_obstacle(distance2, 9, 9, a[0], a[1], a[2], b[0], b[1], b[2]) == middle
        assert first_obstacle(distance2, 9, 9, b[0], b[1], b[2], a[0], a[1], a[2]) == middle
    assert first_obstacle(distance2, 9, 9, 0.5, 0.5, 0.5, 8.5, 8.5, 8.5) == middle
    assert first_obstacle(distance2, 9, 9, 4.5, 4.5, 4.5, 8.5, 8.5, 8.5) == -1  # the start's own voxel is not checked
    assert first_obstacle(distance2, 9, 9, 2.2, 2.2, 2.2, 2.8, 2.8, 2.8) == -1


@pytest.mark.parametrize("heights", [HeightMeasure(1.0, 2.29), HeightMeasure(0.0, 1.6)])
def test_leaps_over_distances_of_a_flat_body_skip_nothing(heights: HeightMeasure) -> None:
    rng = np.random.default_rng(6)
    state = np.where(rng.random((40, 30, 25)) < 0.003, OCCUPIED, FREE).astype(np.uint8)
    distance2 = distance2_to_not_free(state, 11, heights).ravel()
    for a, b in zip(*rays(rng, state, 1500), strict=True):
        voxel = first_obstacle(distance2, 30, 25, a[0], a[1], a[2], b[0], b[1], b[2], heights.weight)
        assert (voxel < 0) == is_visible(state, b[0], b[1], b[2], a[0], a[1], a[2], 0.0)
