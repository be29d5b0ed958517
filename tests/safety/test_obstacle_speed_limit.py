"""The nearest return in the way, and how fast it may be approached."""

from __future__ import annotations

import math

import numpy as np
import pytest
from guard_rooms import HULL_RADIUS_M, MOUNT, frame

from uav_recon.safety.obstacle_speed_limit import ForwardDepth, Margins, fastest_mps
from uav_recon.types.camera import body_from_camera
from uav_recon.types.min_range_grid import MinRangeGrid

AHEAD = np.array([1.0, 0.0, 0.0])
MARGINS = Margins(stop_clearance_m=0.1, fast_clearance_m=0.4)


def seen(row: int, column: int, range_m: float) -> ForwardDepth:
    ranges = np.full((12, 16), np.nan, dtype=np.float32)
    ranges[row, column] = range_m
    return ForwardDepth(MinRangeGrid(5.0, MOUNT, ranges, (0.95, 0.55), 0.9), HULL_RADIUS_M)


def test_room_is_what_is_left_before_the_hull() -> None:
    assert seen(6, 8, 2.0).room_m(AHEAD) == pytest.approx(0.1 + 2.0 - 0.2, abs=0.02)
    assert ForwardDepth(frame(2.0), HULL_RADIUS_M).room_m(AHEAD) == pytest.approx(1.9, abs=0.05)
    assert ForwardDepth(frame(math.nan), HULL_RADIUS_M).room_m(AHEAD) == math.inf


def test_only_the_hulls_own_way_counts() -> None:
    """A return in the outermost column lies 0.89 of its depth to the left: beside the way ahead, in the way to the left."""
    ahead = seen(6, 0, 1.0)
    x, y, z = 0.1 + 1.0 / math.sqrt(1 + 0.890625**2 + 0.0458**2), 0.890625 / math.sqrt(1 + 0.890625**2), 0.0
    towards = np.array([x, y, z]) / math.hypot(x, y)
    assert ahead.room_m(AHEAD) == math.inf
    assert ahead.room_m(towards) == pytest.approx(math.hypot(x, y) - 0.2, abs=0.01)
    assert ahead.room_m(-towards) == math.inf, "behind is not ahead"
    for off, met in ((0.24, True), (0.26, False)):
        angle = math.asin(off / math.hypot(x, y))
        turned = np.array([towards[0] * math.cos(angle) + towards[1] * math.sin(angle), 0.0, 0.0])
        turned[1] = towards[1] * math.cos(angle) - towards[0] * math.sin(angle)
        assert math.isfinite(ahead.room_m(turned)) is met


@pytest.mark.parametrize(
    ("direction", "sees"),
    [
        ((1, 0, 0), True), ((-1, 0, 0), False), ((0, 1, 0), False), ((0, 0, 1), False),
        ((1, 0.94, 0), True), ((1, 0.96, 0), False), ((1, -0.96, 0), False), ((1, 0, 0.54), True), ((1, 0, 0.56), False),
        ((1, 0, -0.56), False),
    ],
)  # fmt: skip
def test_the_camera_looks_inside_its_frustum(direction: tuple[float, float, float], sees: bool) -> None:
    unit = np.array(direction, dtype=np.float64)
    assert ForwardDepth(frame(), HULL_RADIUS_M).sees(unit / np.linalg.norm(unit)) is sees


def test_a_nearly_empty_frame_tells_nothing() -> None:
    assert ForwardDepth.has_enough_returns(frame(share=0.2))
    assert ForwardDepth.has_enough_returns(frame(share=0.9))
    assert not ForwardDepth.has_enough_returns(frame(share=0.199))
    assert not ForwardDepth.has_enough_returns(frame(share=math.nan))
    assert seen(6, 8, 2.0).has_enough_returns(frame(share=0.2))


@pytest.mark.parametrize("speed", [0.0, 0.3, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("room_m", np.linspace(-0.1, 2.0, 43).tolist())
def test_what_is_allowed_can_be_stopped_in_time(speed: float, room_m: float) -> None:
    """Flown out by hand: react, then brake; fast, the hull is down to 0.5 m/s at 0.4 m; slow, at rest at 0.1 m."""
    allowed = fastest_mps(room_m, 2.0, MARGINS, speed)
    left = room_m - 0.25 * speed
    if left <= 0.1:
        assert allowed == 0.0
    elif left <= 0.4:
        assert allowed == pytest.approx(min(math.sqrt(4.0 * (left - 0.1)), 0.5))
    else:
        assert allowed**2 - 0.25 == pytest.approx(4.0 * (left - 0.4))
    assert fastest_mps(math.inf, 2.0, MARGINS, speed) == math.inf


@pytest.mark.parametrize("row", range(5))
@pytest.mark.parametrize("column", range(4))
def test_each_cell_lies_where_its_ray_leads(row: int, column: int) -> None:
    """By hand: the middle of the cell on the image plane at depth one, the camera turned down by 0.3 rad and off the centre."""
    mount = body_from_camera(np.array([0.12, -0.05, 0.04]), 0.3)
    ranges = np.full((5, 4), np.nan)
    ranges[row, column] = 1.7
    right, down = 0.9 * (2 * column + 1 - 4) / 4, 0.6 * (2 * row + 1 - 5) / 5
    forward, left, up = (1.7 * part / math.sqrt(1.0 + right**2 + down**2) for part in (1.0, -right, -down))
    cos, sin = math.cos(0.3), math.sin(0.3)
    place = np.array([0.12 + cos * forward + sin * up, -0.05 + left, 0.04 - sin * forward + cos * up])
    away_m = float(np.linalg.norm(place))
    ahead = ForwardDepth(MinRangeGrid(5.0, mount, ranges, (0.9, 0.6), 0.9), HULL_RADIUS_M)
    assert ahead.room_m(place / away_m) == pytest.approx(away_m - HULL_RADIUS_M, abs=1e-6)


def test_what_is_just_beside_is_not_ahead() -> None:
    beside = MinRangeGrid(5.0, body_from_camera(np.zeros(3), 0.0), np.full((1, 1), 0.2), (0.9, 0.6), 0.9)
    assert ForwardDepth(beside, HULL_RADIUS_M).room_m(np.array([1.0, 0.0, 0.0])) == pytest.approx(0.0, abs=1e-6)
    assert ForwardDepth(beside, HULL_RADIUS_M).room_m(np.array([0.0, 1.0, 0.0])) == math.inf


@pytest.mark.parametrize("braking", [0.3, 1.5, 3.0])
def test_a_weaker_brake_allows_less(braking: float) -> None:
    assert fastest_mps(0.9, braking, MARGINS, 0.0) == pytest.approx(math.sqrt(0.25 + 2.0 * braking * 0.5))
    assert fastest_mps(0.12, braking, MARGINS, 0.0) == pytest.approx(math.sqrt(2.0 * braking * 0.02))
    assert fastest_mps(0.9, braking, Margins(stop_clearance_m=0.1, fast_clearance_m=0.4, slow_mps=0.7), 0.0) == pytest.approx(
        math.sqrt(0.49 + 2.0 * braking * 0.5)
    )
    assert fastest_mps(0.4, braking, MARGINS, 0.0) == pytest.approx(min(math.sqrt(2.0 * braking * 0.3), 0.5))
