import numpy as np
from numpy.typing import NDArray

from uav_recon.bench.planner.view_oracle import OracleFrontier, OracleLens, best_seen, cells_seen
from uav_recon.types.maps import FREE, OCCUPIED

LENS = OracleLens(tan_h=1.0, tan_v=0.7, near=1.0, reach=30.0, pitch_min_rad=-1.0, pitch_max_rad=1.0)
SHAPE = np.array([30, 20, 15])


def half_known() -> tuple[NDArray[np.uint8], OracleFrontier]:
    """Return a map that is free up to x = 20 and unknown beyond, and its frontier.

    The frontier is the free side of a part of the border.
    """
    state = np.full(SHAPE, FREE, dtype=np.uint8)
    state[20:] = 0
    cells = np.array([[19, j, k] for j in range(6, 13) for k in range(4, 9)])
    return state, OracleFrontier(cells, np.zeros(3, dtype=np.int64), SHAPE)


def view(x: float, y: float, z: float, yaw: float = 0.0, pitch: float = 0.0) -> NDArray[np.float64]:
    return np.array([x, y, z, yaw, pitch])


def test_sees_all_from_in_front_none_from_behind_or_too_far() -> None:
    state, frontier = half_known()
    assert cells_seen(state, LENS, view(9.5, 9.5, 6.5), frontier) == 35
    assert cells_seen(state, LENS, view(9.5, 9.5, 6.5, np.pi), frontier) == 0
    near_sighted = OracleLens(1.0, 0.7, 1.0, 9.0, -1.0, 1.0)
    assert cells_seen(state, near_sighted, view(9.5, 9.5, 6.5), frontier) == 0


def test_the_field_of_view_is_limited() -> None:
    state, frontier = half_known()
    narrow = OracleLens(0.25, 0.15, 1.0, 30.0, -1.0, 1.0)
    # the unknown voxels are 11 ahead: the view covers 2.75 to each side, 1.65 up and down
    assert cells_seen(state, narrow, view(9.5, 9.5, 6.5), frontier) == 5 * 3


def test_a_post_hides_cells_behind_it_and_so_does_unknown_space() -> None:
    for value in (OCCUPIED, 0):
        state, frontier = half_known()
        state[14, 9, 4:9] = value
        seen = cells_seen(state, LENS, view(9.5, 9.5, 6.5), frontier)
        assert 35 - 2 * 5 - 5 <= seen <= 35 - 5


def test_a_cut_corner_hides_a_cell_but_a_touched_edge_does_not() -> None:
    state, frontier = half_known()
    cells = np.array([[19, 9, 6]])
    one = OracleFrontier(cells, frontier.low, frontier.high)
    state[20:, :] = FREE
    state[20, 9, 6] = 0
    # the line to the centre of voxel (20, 9, 6) passes the edge of (15, 9, 5): it touches it, or cuts 0.006 voxel off
    state[15, 9, 5] = OCCUPIED
    at_edge = view(11.5, 9.5, 6.5 - 9.0 / 11.0)
    assert cells_seen(state, LENS, at_edge, one) == 1
    assert cells_seen(state, LENS, at_edge - [0, 0, 0.01, 0, 0], one) == 0


def test_pitch_looks_down() -> None:
    state, frontier = half_known()
    flat = OracleLens(1.0, 0.2, 1.0, 40.0, -1.0, 1.0)
    above = view(12.5, 9.5, 13.5, 0.0, np.arctan2(7.0, 8.0))
    assert cells_seen(state, flat, above, frontier) > 10
    assert cells_seen(state, flat, view(12.5, 9.5, 13.5), frontier) == 0


def test_brute_force_finds_a_view_of_everything_and_is_repeatable() -> None:
    state, frontier = half_known()
    reachable = np.zeros(SHAPE, dtype=bool)
    reachable[3:17, 3:17, 3:12] = True
    found = [best_seen(state, LENS, reachable, frontier, (4.0, 20.0), 1) for _ in range(2)]
    assert found == [35, 35]
    assert best_seen(state, LENS, np.zeros_like(reachable), frontier, (4.0, 20.0), 1) == 0


def test_brute_force_respects_the_walls() -> None:
    state, frontier = half_known()
    state[16, :, :] = OCCUPIED
    state[16, 8:11, 5:8] = FREE
    reachable = np.zeros(SHAPE, dtype=bool)
    reachable[3:12, 3:17, 3:12] = True
    assert 9 <= best_seen(state, LENS, reachable, frontier, (4.0, 20.0), 1) < 35
