"""Surface that is in the map but not in the model, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from uav_recon.planning.reconstruction.unmodelled_surface import BESIDE, OUT, unmodelled_surface
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN

CROSS = ndimage.generate_binary_structure(3, 1)


def test_unmodelled_surface_is_occupied_voxels_next_to_free_ones_without_an_element_nearby() -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        shape = tuple(rng.integers(8, 20, 3))
        noise = ndimage.uniform_filter(rng.normal(size=shape), 3)
        state = np.where(noise > 0.1, FREE, np.where(noise > -0.05, OCCUPIED, UNKNOWN)).astype(np.uint8)
        low, high = rng.integers(0, 3, 3), np.array(shape) - rng.integers(0, 3, 3)
        modelled = rng.choice(state.size, 30)
        at = np.zeros(shape, dtype=np.bool_)
        at.ravel()[modelled] = True
        inside = np.zeros(shape, dtype=np.bool_)
        inside[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
        near = ndimage.binary_dilation(at, np.ones((2 * BESIDE + 1,) * 3))
        expected = (state == OCCUPIED) & ndimage.binary_dilation(state == FREE, CROSS) & ~near & inside
        position, normal = unmodelled_surface(state, low, high, np.concatenate([np.argwhere(at), [[-9, 0, 0], [0, 99, 0]]]))
        found = np.zeros(shape, dtype=np.bool_)
        found[tuple(np.floor(position).astype(int).T)] = True
        assert not (found & ~expected).any()
        missing = np.argwhere(expected & ~found)
        for i, j, k in missing:  # equally much free space on opposite sides: no normal
            around = np.argwhere(np.pad(state, 1)[i : i + 3, j : j + 3, k : k + 3] == FREE) - 1
            assert np.linalg.norm(around.sum(axis=0)) < 1.0
        np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_walls_normal_points_into_the_room(axis: int, sign: int) -> None:
    state = np.full((12, 12, 12), UNKNOWN, dtype=np.uint8)
    face = np.moveaxis(state, axis, 0)
    face[6], face[6 + sign], face[6 + 2 * sign] = OCCUPIED, FREE, FREE
    position, normal = unmodelled_surface(state, np.full(3, 2), np.full(3, 10), np.zeros((0, 3), dtype=np.int64))
    assert len(position) == 64
    np.testing.assert_allclose(position[:, axis], 6.5 + OUT * sign)
    np.testing.assert_allclose(normal[:, axis], sign)
