"""Thin gaps of unknown voxels between free ones."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from uav_recon.mapping.occupancy.log_odds import FREE_AT
from uav_recon.mapping.occupancy.thin_gaps import close_thin_gaps
from uav_recon.types.frames import ByteArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN


def closed(state: ByteArray) -> ByteArray:
    """Return the state after one pass, by the log-odds that it leaves."""
    odds = np.zeros(state.size, dtype=np.int8)
    listed = np.zeros(state.size, dtype=np.int64)
    number = close_thin_gaps(np.ascontiguousarray(state).reshape(-1), state.shape, odds, listed)
    assert (np.sort(listed[:number]) == np.flatnonzero(odds == FREE_AT)).all()
    after = state.copy()
    after.reshape(-1)[listed[:number]] = FREE
    return after


def test_a_sheet_one_voxel_thick_is_free_and_one_of_two_is_not() -> None:
    state = np.full((9, 9, 9), FREE, dtype=np.uint8)
    state[3], state[6:8] = UNKNOWN, UNKNOWN
    after = closed(state)
    assert (after[3, 1:-1, 1:-1] == FREE).all() and (after[6:8] == UNKNOWN).all()


def test_what_touches_a_surface_stays_unknown() -> None:
    state = np.full((9, 9, 9), FREE, dtype=np.uint8)
    state[4], state[4, 4, 4] = UNKNOWN, OCCUPIED
    after = closed(state)
    assert (after[4, 3:6, 3:6] != FREE).all() and after[4, 1, 1] == FREE


@given(st.integers(0, 2**32 - 1))
def test_no_space_two_voxels_wide_is_ever_freed(seed: int) -> None:
    """A block of 2 x 2 x 2 unknown voxels stays, however often gaps are closed."""
    rng = np.random.default_rng(seed)
    state = rng.choice(np.array([UNKNOWN, FREE], dtype=np.uint8), (8, 8, 8), p=[0.4, 0.6])
    i, j, k = rng.integers(1, 6, 3)
    state[i : i + 2, j : j + 2, k : k + 2] = UNKNOWN
    for _ in range(4):
        state = closed(state)
    assert (state[i : i + 2, j : j + 2, k : k + 2] == UNKNOWN).all()
