import numpy as np

from uav_recon.bench.planner import path_lengths, path_oracle
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, VoxelMap


def test_in_an_empty_room_every_path_is_a_straight_line() -> None:
    state = np.full((30, 25, 15), FREE, dtype=np.uint8)
    grid = GridSpec(np.zeros(3), 0.1, state.shape)
    found = path_lengths.compare(state, grid, (np.zeros(3), np.array([3.0, 2.5, 1.5])), 0.35, pairs=8)
    assert found is not None
    assert found.pairs == 8
    assert abs(found.mean_excess) < 1e-9
    assert found.mean_m == found.oracle_mean_m


def test_around_walls_paths_are_hardly_longer_than_an_exact_search() -> None:
    state = np.full((60, 40, 15), FREE, dtype=np.uint8)
    state[20, :28], state[40, 12:] = OCCUPIED, OCCUPIED
    grid = GridSpec(np.zeros(3), 0.1, state.shape)
    found = path_lengths.compare(state, grid, (np.zeros(3), np.array([6.0, 4.0, 1.5])), 0.35, pairs=12)
    assert found is not None
    assert -0.02 < found.mean_excess < 0.01
    assert found.mean_m > 2.0


def test_planner_and_oracle_agree_on_flyable_space() -> None:
    from uav_recon.mapping.occupancy.distance_field import distance2_to_not_free

    rng = np.random.default_rng(2)
    state = np.full((30, 25, 15), FREE, dtype=np.uint8)
    state[rng.random(state.shape) < 0.002] = OCCUPIED
    grid = GridSpec(np.zeros(3), 0.1, state.shape)
    voxels = VoxelMap.whole(grid, state, distance2_to_not_free(state, 6), 1)
    low, high = np.array([2, 3, 1]), np.array([28, 20, 12])
    mask = path_oracle.flyable(voxels, 0.3, low, high)
    np.testing.assert_array_equal(path_lengths.space_of(voxels, 0.3, (low, high)).mask[1:-1, 1:-1, 1:-1] > 0, mask)


def test_without_flyable_space_there_is_nothing_to_compare() -> None:
    state = np.zeros((10, 10, 10), dtype=np.uint8)
    assert path_lengths.compare(state, GridSpec(np.zeros(3), 0.1, (10, 10, 10)), (np.zeros(3), np.ones(3)), 0.35) is None
