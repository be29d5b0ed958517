from __future__ import annotations

import numpy as np
import pytest

from uav_recon.geometry.traversal import is_visible, visible_targets
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN


def crossed_length(voxel: FloatArray, a: FloatArray, b: FloatArray) -> float:
    """Oracle: length of a segment inside a unit cube, by slabs."""
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


def test_the_targets_own_voxel_is_not_asked_but_unknown_and_outside_block() -> None:
    state = np.full((5, 1, 1), FREE, dtype=np.uint8)
    state[4] = OCCUPIED
    assert is_visible(state, 0.5, 0.5, 0.5, 4.5, 0.5, 0.5, 0.0)
    state[2] = UNKNOWN
    assert not is_visible(state, 0.5, 0.5, 0.5, 4.5, 0.5, 0.5, 0.0)
    assert not is_visible(state, 0.5, 0.5, 0.5, 0.5, 3.5, 0.5, 0.0)
    assert is_visible(state, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.0)


def test_many_targets_are_answered_as_one_by_one() -> None:
    rng = np.random.default_rng(4)
    state = rng.choice([FREE, FREE, FREE, OCCUPIED], (6, 6, 6)).astype(np.uint8)
    targets = rng.uniform(-1, 7, (100, 3))
    eye = np.array([3.2, 3.1, 2.7])
    assert [is_visible(state, eye[0], eye[1], eye[2], t[0], t[1], t[2], 0.0) for t in targets] == visible_targets(
        state, eye, targets, 0.0
    ).tolist()
