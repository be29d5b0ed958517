import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from uav_recon.mapping.occupancy.distance_field import CHUNK, DistanceField, distance2_to_not_free, warm_up
from uav_recon.types.frames import ByteArray, FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, TILE, UNKNOWN, HeightMeasure


def by_scipy(state: ByteArray, reach: int) -> FloatArray:
    padded = np.pad(state == FREE, 1, constant_values=False)
    distance: FloatArray = ndimage.distance_transform_edt(padded)[1:-1, 1:-1, 1:-1]
    return np.round(np.minimum(distance, reach) ** 2)


@settings(max_examples=60, deadline=None)
@given(
    shape=st.tuples(*[st.integers(1, 26)] * 3),
    blocked=st.sampled_from([0.0, 0.0005, 0.005, 0.05, 0.5, 1.0]),
    reach=st.sampled_from([1, 4, 11, 15]),
    seed=st.integers(0, 2**31),
)
def test_is_the_exact_transform_of_scipy(shape: tuple[int, int, int], blocked: float, reach: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    other = rng.choice(np.array([UNKNOWN, OCCUPIED], dtype=np.uint8), shape)
    state = np.where(rng.random(shape) < blocked, other, np.uint8(FREE)).astype(np.uint8)
    np.testing.assert_array_equal(distance2_to_not_free(state, reach), by_scipy(state, reach))


@settings(max_examples=60, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 60), st.integers(1, 60), st.integers(1, 33)),
    blocked=st.sampled_from([0.0, 0.001, 0.05, 1.0]),
    reach=st.sampled_from([1, 2, 11, 15]),
    seed=st.integers(0, 2**31),
)
def test_incremental_updates_are_exact_and_set_the_tile_revisions(
    shape: tuple[int, int, int], blocked: float, reach: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    state = np.where(rng.random(shape) < blocked, np.uint8(UNKNOWN), np.uint8(FREE)).astype(np.uint8)
    field, memory = DistanceField(shape, reach), np.zeros(state.size + CHUNK, dtype=np.uint8)
    distance2 = memory[: state.size].reshape(shape)
    dated = np.zeros((-(-shape[0] // TILE), -(-shape[1] // TILE)), dtype=np.int64)
    field.invalidate_all()
    field.update(state.reshape(-1), memory, dated, 1)
    for revision in range(2, 7):  # boxes freed, occupied, forgotten, and freed again
        before, picture = state.copy(), distance2.copy()
        for _ in range(rng.integers(0, 4)):
            low = rng.integers(0, shape)
            high = low + rng.integers(1, 6, 3)
            state[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = rng.choice([UNKNOWN, FREE, FREE, OCCUPIED])
        for x, y, _ in np.argwhere((before == FREE) != (state == FREE)):
            field.first[x], field.last[x] = min(field.first[x], y), max(field.last[x], y + 1)
        field.update(state.reshape(-1), memory, dated, revision)
        np.testing.assert_array_equal(distance2, by_scipy(state, reach))
        changed = np.zeros(dated.shape, dtype=bool)
        changed[tuple(np.argwhere((picture != distance2).any(axis=2)).T // TILE)] = True
        np.testing.assert_array_equal(dated == revision, changed)


def test_refuses_a_reach_whose_square_exceeds_a_byte() -> None:
    with pytest.raises(ValueError, match="reach 16"):
        DistanceField((2, 2, 2), 16)


def test_empty_grid_is_limited_by_its_own_border() -> None:
    distance2 = distance2_to_not_free(np.full((50, 50, 30), FREE, dtype=np.uint8), 11)
    assert distance2[0, 25, 15] == 1
    assert distance2[25, 25, 15] == 121


@pytest.mark.parametrize("state", [UNKNOWN, OCCUPIED])
def test_space_that_is_not_free_has_distance_zero(state: int) -> None:
    assert not distance2_to_not_free(np.full((4, 5, 6), state, dtype=np.uint8), 11).any()


def test_is_fast_enough_to_be_recomputed_in_full() -> None:
    warm_up()
    state = np.full((90, 45, 30), FREE, dtype=np.uint8)
    state[40:50, 20:30, :10] = OCCUPIED
    took_s = []
    for _ in range(5):
        began_s = time.perf_counter()
        distance2_to_not_free(state, 11)
        took_s.append(time.perf_counter() - began_s)
    assert min(took_s) < 0.02  # 1-2 ms on an idle core; this only catches a lost optimisation


@pytest.mark.parametrize("heights", [HeightMeasure(1.0, 2.29), HeightMeasure(0.0, 1.5), HeightMeasure(1.5, 2.4)])
def test_heights_count_as_the_measure_says(heights: HeightMeasure) -> None:
    rng, reach = np.random.default_rng(3), 9
    state = np.where(rng.random((14, 13, 12)) < 0.004, OCCUPIED, FREE).astype(np.uint8)
    padded = np.pad(state == FREE, reach)  # what is outside is not free
    blocked, cells = np.argwhere(~padded), np.argwhere(state == FREE)
    apart = np.abs(cells[:, None] + reach - blocked)
    squared = apart[..., 0] ** 2 + apart[..., 1] ** 2 + heights.squares(apart[..., 2])
    expected = np.minimum(squared.min(axis=1), reach**2)
    found = distance2_to_not_free(state, reach, heights)
    np.testing.assert_array_equal(found[tuple(cells.T)], expected)
    assert not found[state != FREE].any()
