"""The visibility bound of a position is never less than what is visible from it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from box_world import FIXED, GIMBAL

from uav_recon.geometry.traversal import is_visible
from uav_recon.planning.camera_frustum import PITCH_MIN, RANGE, CameraGeometry, in_view, sight
from uav_recon.planning.frontier.view_cache import targets
from uav_recon.planning.frontier.visibility_bound import FITTING, FRAMED, TURNED, cells_with, distinct_targets, visibility_bound
from uav_recon.types.frames import ByteArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN

SHAPE = (30, 24, 20)


def random_world(seed: int) -> tuple[ByteArray, ByteArray, IntArray]:
    """Return a state, bits of unknown neighbours, and flat indices of some frontier cells."""
    rng = np.random.default_rng(seed)
    state = np.full(SHAPE, FREE, dtype=np.uint8)
    for value in (OCCUPIED, UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN):
        corner, size = rng.integers(0, 18, 3), rng.integers(2, 9, 3)
        state[tuple(slice(a, a + s) for a, s in zip(corner, size, strict=True))] = value
    faces = np.zeros(SHAPE, dtype=np.uint8)
    padded = np.pad(state, 1, constant_values=FREE)
    for face in range(6):
        step = np.roll(padded, 1 if face % 2 == 0 else -1, axis=face // 2)[1:-1, 1:-1, 1:-1]
        faces |= ((state == FREE) & (step == UNKNOWN)).astype(np.uint8) << face
    cells = np.flatnonzero(faces)
    return state, faces, np.sort(rng.choice(cells, min(60, len(cells)), replace=False)).astype(np.int64)


@pytest.mark.parametrize("camera", [FIXED, GIMBAL], ids=["fixed", "gimbal"])
def test_every_visible_cell_faces_the_camera_and_is_within_the_bound(camera: CameraGeometry) -> None:
    lens = camera.lens(0.1, 2.5)
    rng = np.random.default_rng(3)
    seen = promised = 0
    for seed in range(6):
        state, faces, flat = random_world(seed)
        points, first = targets(faces, flat)
        found = distinct_targets((state == FREE).astype(np.uint8).reshape(-1), SHAPE, points, first)
        centres, _, links, _ = found
        np.testing.assert_array_equal(centres.T[links], points)
        assert len(np.unique(points, axis=0)) == centres.shape[1]
        facing = np.zeros(centres.shape[1], dtype=np.int32)
        for _ in range(60):
            place, yaw = rng.uniform(2.0, np.array(SHAPE) - 2.0), rng.uniform(-np.pi, np.pi)
            line = sight(lens, place, yaw, lens[PITCH_MIN] if camera is FIXED else rng.uniform(-0.8, 0.8))
            turned, framed = visibility_bound(found, lens, line, facing)
            assert (turned, framed) == ((facing & TURNED > 0).sum(), (facing & FRAMED > 0).sum())
            for u, centre in enumerate(centres.T.astype(np.float64)):
                away = np.linalg.norm(centre - line[:3])
                clear = lens[3] > away > 3.5 and is_visible(
                    state, line[0], line[1], line[2], centre[0], centre[1], centre[2], 0.0
                )
                shown = clear and in_view(lens, line, *centre)
                assert not clear or facing[u] & TURNED
                assert not shown or (facing[u] & FITTING and facing[u] & FRAMED)
                seen, promised = seen + shown, promised + bool(facing[u] & FRAMED)
            fitting_cells, framed_cells = cells_with(found, facing)
            of_cells = [facing[links[a:b]] for a, b in pairwise(first)]
            assert fitting_cells == sum(bool((bits & FITTING).any()) for bits in of_cells)
            assert framed_cells == sum(bool((bits & FRAMED).any()) for bits in of_cells)
    assert lens[RANGE] == lens[3]
    assert 0.5 * promised < seen <= promised
