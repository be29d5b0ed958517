"""What the camera may see before a take-off."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.safety.takeoff_view import takeoff_view_fault
from uav_recon.types.frames import AnyArray
from uav_recon.types.min_range_grid import MinRangeGrid, ray_directions
from uav_recon.types.pose import Pose
from uav_recon.types.reason_code import ReasonCode

HALF_TAN = (0.95, 0.55)
FLOOR_M = -0.10  # from the body's centre
WALL_M = 3.0
LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # body from depth imager, of a level camera


def _mount(pitch_down_deg: float) -> Pose:
    half = math.radians(pitch_down_deg) / 2.0
    tilt = Pose(np.array([math.cos(half), 0.0, math.sin(half), 0.0]), np.array([0.10, 0.0, 0.0]))
    return tilt @ Pose(np.array([0.5, -0.5, 0.5, -0.5]), np.zeros(3))


def _view(pitch_down_deg: float, range_m: AnyArray | None = None) -> MinRangeGrid:
    """Return the view of a wall ahead and of the floor, or of given ranges."""
    mount = _mount(pitch_down_deg)
    empty = MinRangeGrid(0.0, mount, np.full((12, 16), np.nan), HALF_TAN, 0.9)
    rays = ray_directions(empty) @ mount.rotation().T
    wall_m = (WALL_M - 0.1) / np.maximum(rays[..., 0], 1e-6)
    floor_m = np.where(rays[..., 2] < 0.0, FLOOR_M / np.minimum(rays[..., 2], -1e-6), np.inf)
    return MinRangeGrid(0.0, mount, np.minimum(wall_m, floor_m) if range_m is None else range_m, HALF_TAN, 0.9)


def _code(view: MinRangeGrid) -> ReasonCode | None:
    fault = takeoff_view_fault(view)
    return None if fault is None else fault.code


def test_the_mount_of_this_test_is_the_usual_one() -> None:
    np.testing.assert_allclose(_mount(0.0).rotation(), LEVEL, atol=1e-12)
    assert _mount(15.0).rotation()[2, 2] == pytest.approx(-math.sin(math.radians(15.0)))


@pytest.mark.parametrize("pitch_down_deg", [0.0, 15.0, 40.0, 90.0])
def test_floor_and_wall_do_not_prevent_a_take_off(pitch_down_deg: float) -> None:
    assert _code(_view(pitch_down_deg)) is None


@pytest.mark.parametrize("pitch_down_deg", [0.0, 15.0])
def test_a_floor_without_returns_does_not_either(pitch_down_deg: float) -> None:
    range_m = _view(pitch_down_deg).range_m.copy()
    range_m[range_m < 2.0] = np.nan
    assert np.isnan(range_m).mean() > 0.3
    assert _code(_view(pitch_down_deg, range_m)) is None


@pytest.mark.parametrize(("away_m", "code"), [(0.30, True), (0.50, True), (0.60, False)])
def test_a_hand_before_the_camera_prevents_it(away_m: float, code: bool) -> None:
    range_m = _view(15.0).range_m.copy()
    range_m[1:4, 7:9] = away_m
    assert _code(_view(15.0, range_m)) is (ReasonCode.TAKEOFF_VIEW_BLOCKED if code else None)


def test_two_cells_are_noise() -> None:
    range_m = _view(15.0).range_m.copy()
    range_m[2, 7:9] = 0.4
    assert _code(_view(15.0, range_m)) is None


@pytest.mark.parametrize(("columns", "blank"), [(6, False), (7, True), (16, True)])
def test_a_covered_view_prevents_it(columns: int, blank: bool) -> None:
    range_m = _view(15.0).range_m.copy()
    range_m[:, :columns] = np.nan
    assert _code(_view(15.0, range_m)) is (ReasonCode.TAKEOFF_VIEW_BLANK if blank else None)


def test_the_words_name_value_and_range() -> None:
    range_m = _view(15.0).range_m.copy()
    range_m[1:4, 7:9] = 0.41
    fault = takeoff_view_fault(_view(15.0, range_m))
    assert fault is not None
    assert fault.text() == "something stands 0.41 m before the camera; it must be free for 0.55 m"
