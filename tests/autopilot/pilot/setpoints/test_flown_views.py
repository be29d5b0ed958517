"""The way back through the views of the flight: positions and headings in reverse, within the guard's limits."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from uav_recon.autopilot.pilot.setpoints.flown_views import FlownViews, way_down
from uav_recon.autopilot.pilot.situation.message_validation import trajectory_fault
from uav_recon.types.pose import Pose
from uav_recon.types.trajectory import Setpoint, Trajectory

HEIGHT_M = 1.0
TURN_RADPS = 1.2


def _flown(*views: tuple[float, float, float, float]) -> FlownViews:
    """Straight between views (x, y, z, yaw)."""
    out = FlownViews()
    for a, b in itertools.pairwise(views):
        for share in np.linspace(0.0, 1.0, 60):
            x, y, z, yaw_rad = (np.array(a) + share * (np.array(b) - np.array(a))).tolist()
            out.add(Pose.from_yaw(yaw_rad, np.array([x, y, z])))
    return out


def _back(views: FlownViews, x: float, yaw_rad: float, z: float = 1.1) -> Trajectory:
    return views.way_back(Setpoint.hold(np.array([x, 0.0, z]), yaw_rad), HEIGHT_M, 50.0, 0.3, TURN_RADPS / 0.7, 0)


@pytest.mark.parametrize("z", [0.15, 0.5, 1.0])
def test_the_way_down_is_straight_quick_and_ends_off_the_floor(z: float) -> None:
    way = way_down(Setpoint.hold(np.array([0.3, -0.2, z]), 0.7), 50.0, 0.3, 0)
    assert trajectory_fault(way) is None
    np.testing.assert_allclose(way.position_m[:, :2], np.tile([0.3, -0.2], (len(way.position_m), 1)), atol=1e-9)
    np.testing.assert_allclose(way.yaw_rad, 0.7)
    assert way.position_m[-1, 2] == pytest.approx(min(z, 0.2))
    assert way.duration_s <= max(z - 0.2, 0.0) / 0.27 + 1.0
    assert np.linalg.norm(way.velocity_mps, axis=1).max() <= 0.3
    assert np.linalg.norm(way.acceleration_mps2, axis=1).max() <= 1.5


def test_it_turns_back_on_the_spot_and_then_flies_back_as_it_looked() -> None:
    """Two metres ahead, then a turn to a bare wall."""
    way = _back(_flown((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.1, 0.0), (2.0, 0.0, 1.1, 0.0), (2.0, 0.0, 1.1, 1.4)), 2.0, 1.4)
    assert trajectory_fault(way) is None
    np.testing.assert_allclose(way.position_m[0], [2.0, 0.0, 1.1])
    turned = np.flatnonzero(np.abs(way.yaw_rad) < 0.1)[0]
    assert way.position_m[turned, 0] > 1.85
    assert turned * way.step_s < 1.4 / TURN_RADPS + 0.4  # with its corners rounded
    assert way.position_m[-1][0] < 0.1
    np.testing.assert_allclose(way.yaw_rad[-1], 0.0, atol=0.06)
    assert way.position_m[:, 2].min() >= HEIGHT_M
    assert np.linalg.norm(way.velocity_mps, axis=1).max() <= 0.3
    assert np.linalg.norm(way.acceleration_mps2, axis=1).max() <= 1.0
    assert np.abs(way.yaw_rate_radps).max() <= TURN_RADPS + 1e-6


def test_it_turns_back_on_the_spot_from_a_turn_in_a_climb() -> None:
    way = _back(_flown((0.0, 0.0, 1.1, 0.0), (0.0, 0.0, 1.5, 1.4)), 0.0, 1.4, z=1.5)
    turned = np.flatnonzero(np.abs(way.yaw_rad) < 0.1)[0]
    assert turned * way.step_s < 1.4 / TURN_RADPS + 0.4
    np.testing.assert_allclose(way.position_m, np.tile([0.0, 0.0, 1.5], (len(way.position_m), 1)), atol=1e-9)


def test_it_turns_back_below_the_hover_height() -> None:
    way = _back(_flown((0.0, 0.0, 0.78, 0.0), (0.0, 0.0, 0.78, 1.4)), 0.0, 1.4, z=0.8)
    np.testing.assert_allclose(way.yaw_rad[-1], 0.0, atol=0.06)
    np.testing.assert_allclose(way.position_m[:, 2], 0.8)


def test_a_view_a_little_lower_does_not_end_the_way_back() -> None:
    """As in a low room: the flight dipped on the way to the bare wall."""
    way = _back(_flown((0.0, 0.0, 1.1, 0.0), (1.0, 0.0, 0.8, 0.0), (2.0, 0.0, 1.1, 0.0)), 2.0, 0.0)
    assert way.position_m[-1][0] < 0.1
    assert way.position_m[:, 2].min() >= HEIGHT_M - 1e-9


def test_headings_are_followed_the_short_way_round() -> None:
    way = _back(_flown((0.0, 0.0, 1.1, math.pi - 0.2), (0.0, 0.0, 1.1, math.pi + 0.4)), 0.0, -math.pi + 0.4)
    assert np.ptp(way.yaw_rad) < 0.7


def test_without_views_it_holds() -> None:
    views = _flown((0.0, 0.0, 1.1, 0.0), (2.0, 0.0, 1.1, 0.0))
    views.forget()
    way = _back(views, 2.0, 0.3)
    assert not way.velocity_mps.any()
    assert np.ptp(way.yaw_rad) == 0.0


def test_it_turns_first_to_where_the_map_shows_the_place() -> None:
    """A metre ahead with the nose to a bare wall; the corner of the room is behind the left shoulder."""
    views = _flown((0.0, 0.0, 1.1, 0.0), (1.0, 0.0, 1.1, 0.0))
    rest = Setpoint.hold(np.array([1.0, 0.0, 1.1]), 0.0)
    way = views.way_back(rest, HEIGHT_M, 50.0, 0.3, TURN_RADPS / 0.7, 0, 1.5)
    assert trajectory_fault(way) is None
    there = np.flatnonzero(np.abs(way.yaw_rad - 1.5) < 0.05)
    assert there[0] * way.step_s < 1.5 / TURN_RADPS + 0.4
    assert len(there) * way.step_s > 0.8, "it looks there for a while"
    np.testing.assert_allclose(way.position_m[: there[-1], 0], 1.0, atol=0.05)
    assert way.position_m[-1][0] < 0.1, "and goes on back if the place stays unknown"
    assert np.abs(way.yaw_rate_radps).max() <= TURN_RADPS + 1e-6


def test_a_view_behind_the_back_is_no_shorter_than_the_way_back() -> None:
    views = _flown((0.0, 0.0, 1.1, 0.0), (1.0, 0.0, 1.1, 0.0))
    rest = Setpoint.hold(np.array([1.0, 0.0, 1.1]), 0.0)
    for yaw_rad in (None, 3.0, 0.02):
        way = views.way_back(rest, HEIGHT_M, 50.0, 0.3, TURN_RADPS / 0.7, 0, yaw_rad)
        assert np.abs(way.yaw_rad).max() < 0.05
