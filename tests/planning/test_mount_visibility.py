"""What a tilt shows of an empty box, against lines of sight worked out by hand."""

from __future__ import annotations

import math

import pytest

from uav_recon.planning.mount_visibility import USUAL_DEG, DepthView, RoomVisibility

SMALL_M, LARGE_M = (3.4, 2.6, 2.5), (8.0, 3.0, 2.5)


@pytest.fixture(scope="module")
def small() -> RoomVisibility:
    return RoomVisibility(SMALL_M, 0.4, DepthView())


def test_a_low_camera_shows_the_floor_and_a_high_one_the_ceiling(small: RoomVisibility) -> None:
    down, up = small.shares(math.radians(45.0)), small.shares(math.radians(-45.0))
    assert (down.floor, down.ceiling) == (1.0, 0.0)
    assert (up.floor, up.ceiling) == (0.0, 1.0)


def test_a_ceiling_is_seen_from_far_enough_away() -> None:
    """15° down looks up by 14°, so a ceiling 0.4 m above the camera is seen from 1.6 m away, and a level camera from 0.7 m."""
    room = RoomVisibility((2.6, 2.6, 2.5), 0.4, DepthView())
    assert room.shares(math.radians(15.0)).ceiling < 0.2
    assert room.shares(0.0).ceiling > 0.9


def test_a_small_room_asks_for_less_tilt_and_a_large_one_for_the_usual(small: RoomVisibility) -> None:
    assert small.recommended_deg() == 5.0
    assert RoomVisibility(LARGE_M, 0.4, DepthView()).recommended_deg() == USUAL_DEG


def test_a_wide_camera_needs_no_other_tilt() -> None:
    assert RoomVisibility(SMALL_M, 0.4, DepthView(vertical_fov_rad=math.radians(100.0))).recommended_deg() == USUAL_DEG


def test_the_far_end_of_a_hall_changes_nothing() -> None:
    hall, half = (RoomVisibility((length, 20.0, 3.0), 0.4, DepthView()) for length in (40.0, 20.0))
    assert hall.shares(0.0) == half.shares(0.0)


def test_a_room_without_space_to_fly_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"no position in a room of 0\.7 x 3 x 2\.5 m"):
        RoomVisibility((0.7, 3.0, 2.5), 0.4, DepthView())
    with pytest.raises(ValueError, match=r"no position in a room of 100 x 0\.5 x 0\.5 m"):
        RoomVisibility((100.0, 0.5, 0.5), 0.1, DepthView())
