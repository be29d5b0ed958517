"""A wall far ahead, and a box before it in some cells."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.autopilot.pilot.situation.sudden_obstacle import SuddenObstacle, SuddenObstacleDetector
from uav_recon.types.camera import body_from_camera
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import Pose

MOUNT = body_from_camera(np.zeros(3), 0.0)
HERE = Pose.from_yaw(0.3, np.array([1.0, 2.0, 1.2]))
PERIOD_S = 1.0 / 6.0


def _look(
    around: SuddenObstacleDetector, n: int, box_m: float = np.nan, wall_m: float = 4.0, here: Pose = HERE
) -> SuddenObstacle | None:
    range_m = np.full((12, 16), wall_m, np.float32)
    if np.isfinite(box_m):
        range_m[4:8, 6:10] = box_m
    return around.look(MinRangeGrid(n * PERIOD_S, MOUNT, range_m, (0.95, 0.55), 0.9), here)


@pytest.fixture
def around() -> SuddenObstacleDetector:
    made = SuddenObstacleDetector()
    assert all(_look(made, n) is None for n in range(6))
    return made


def test_what_appears_is_told_of_at_once_and_where(around: SuddenObstacleDetector) -> None:
    found = _look(around, 6, box_m=1.2)
    assert found is not None
    assert found.away_m == pytest.approx(1.2, abs=0.05)
    ahead = (found.places_m[0] - HERE.translation_m)[:2] @ np.array([np.cos(0.3), np.sin(0.3)])
    assert ahead == pytest.approx(1.2, abs=0.05)
    away = np.linalg.norm((found.places_m - HERE.translation_m)[:, :2], axis=1)
    assert len(away) == 16
    assert np.all(np.diff(away) >= 0.0)


def test_what_stands_there_for_a_second_is_no_intruder_any_more(around: SuddenObstacleDetector) -> None:
    told = [_look(around, 6 + n, box_m=1.2) is not None for n in range(10)]
    assert told[0]
    assert not any(told[6:])


def test_what_comes_on_is_told_of_again_and_again(around: SuddenObstacleDetector) -> None:
    found = [_look(around, 6 + n, box_m=2.6 - 0.8 * n * PERIOD_S) for n in range(10)]
    assert all(intruder is not None for intruder in found)


def test_frames_in_a_row_that_show_it_are_counted(around: SuddenObstacleDetector) -> None:
    seen = [_look(around, 6 + n, box_m=1.5) for n in range(3)]
    assert [found and found.sights for found in seen] == [1, 2, 3]
    assert seen[2] is not None
    assert seen[2].shown_s == pytest.approx(2 * PERIOD_S)
    assert around.ghost_s == -np.inf
    jumped = _look(around, 9, box_m=0.7)  # 0.8 m in a sixth of a second
    assert jumped is not None
    assert (jumped.sights, jumped.shown_s) == (1, 0.0)


def test_what_comes_and_goes_is_a_ghost(around: SuddenObstacleDetector) -> None:
    assert _look(around, 6, box_m=1.3) is not None
    assert around.ghost_s == -np.inf
    assert _look(around, 7) is None
    assert around.ghost_s == pytest.approx(7 * PERIOD_S)
    again = _look(around, 8, box_m=1.3)
    assert again is not None
    assert again.sights == 1


def test_what_left_the_view_is_no_ghost(around: SuddenObstacleDetector) -> None:
    assert _look(around, 6, box_m=1.3) is not None
    _look(around, 7, here=Pose.from_yaw(0.3 + 2.0, HERE.translation_m))
    assert around.ghost_s == -np.inf


def test_noise_of_depth_and_pose_is_nothing() -> None:
    around, dice = SuddenObstacleDetector(), np.random.default_rng(2)
    for n in range(60):
        off = Pose.from_yaw(0.3 + dice.normal() * 0.005, np.array([1.0, 2.0, 1.2]) + dice.normal(size=3) * 0.014)
        assert _look(around, n, box_m=1.5 + dice.normal() * 0.02, wall_m=2.8 + dice.normal() * 0.04, here=off) is None


def test_where_nothing_came_back_nothing_was_seen_free() -> None:
    around = SuddenObstacleDetector()
    for n in range(6):
        _look(around, n, wall_m=np.nan)
    assert _look(around, 6, box_m=1.2, wall_m=np.nan) is None


def test_a_cell_above_one_without_a_return_looked_past_nothing() -> None:
    """Low over the floor: it is too near to be seen, and comes into view as the vehicle climbs."""
    for missing, told in ((9, False), (12, True)):
        around = SuddenObstacleDetector()
        for n in range(6):
            range_m = np.full((12, 16), 4.0, np.float32)
            range_m[missing:] = np.nan
            around.look(MinRangeGrid(n * PERIOD_S, MOUNT, range_m, (0.95, 0.55), 0.9), HERE)
        floor = np.full((12, 16), 4.0, np.float32)
        floor[8, 2:14] = 1.2
        found = around.look(MinRangeGrid(6 * PERIOD_S, MOUNT, floor, (0.95, 0.55), 0.9), HERE)
        assert (found is not None) is told


def test_a_cell_most_of_which_is_not_seen_looked_past_nothing() -> None:
    """A table's top at a flat angle: the wall behind its far edge comes back, the top itself does not until one is above it."""
    for unseen, told in (((5, 8), False), ((0, 3), True)):
        around, full = SuddenObstacleDetector(), np.ones((12, 16), dtype=bool)
        full[unseen[0] : unseen[1]] = False
        range_m = np.full((12, 16), 4.0, np.float32)
        for n in range(6):
            around.look(MinRangeGrid(n * PERIOD_S, MOUNT, range_m, (0.95, 0.55), 0.9, full=full), HERE)
        top = range_m.copy()
        top[6, 4:12] = 1.2
        found = around.look(MinRangeGrid(6 * PERIOD_S, MOUNT, top, (0.95, 0.55), 0.9), HERE)
        assert (found is not None) is told


def test_views_of_another_camera_are_not_asked(around: SuddenObstacleDetector) -> None:
    range_m = np.full((6, 8), 1.2, np.float32)
    assert around.look(MinRangeGrid(6 * PERIOD_S, MOUNT, range_m, (0.95, 0.55), 0.9), HERE) is None


def test_one_cell_or_one_view_says_nothing() -> None:
    around = SuddenObstacleDetector()
    assert _look(around, 0) is None
    assert _look(around, 1, box_m=1.2) is None, "looked past once"
    around = SuddenObstacleDetector()
    assert all(_look(around, n) is None for n in range(6))
    range_m = np.full((12, 16), 4.0, np.float32)
    range_m[6, 8] = 1.2
    assert around.look(MinRangeGrid(6 * PERIOD_S, MOUNT, range_m, (0.95, 0.55), 0.9), HERE) is None


def test_after_a_jump_of_odom_nothing_is_remembered(around: SuddenObstacleDetector) -> None:
    around.forget()
    assert _look(around, 6, box_m=1.2) is None
