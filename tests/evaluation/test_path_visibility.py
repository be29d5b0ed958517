"""Shares of a path within the camera's field of view, for paths whose shares are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from uav_recon.evaluation.path_visibility import PathVisibility, path_visibility

FOV_RAD = (math.radians(87.0), math.radians(58.0))
DOWN_RAD = math.radians(15.0)


def seen_along(direction: tuple[float, float, float], attitude: Rotation, metres: float = 2.0) -> PathVisibility:
    """Return the visibility of a straight path of two seconds."""
    stamps = np.linspace(0.0, 2.0, 401)
    way = np.array(direction) / np.linalg.norm(direction)
    quat = np.roll(attitude.as_quat(), 1)
    place = np.array([3.0, 4.0, 1.0]) + metres / 2.0 * stamps[:, None] * way
    return path_visibility(stamps, place, np.tile(quat, (len(stamps), 1)), DOWN_RAD, FOV_RAD)


@pytest.mark.parametrize(("bearing_deg", "seen"), [(0, 1), (40, 1), (-40, 1), (50, 0), (-50, 0), (180, 0)])
def test_a_level_path_is_visible_within_half_the_field_of_view(bearing_deg: float, seen: float) -> None:
    yaw = math.radians(30.0)
    way = (math.cos(yaw + math.radians(bearing_deg)), math.sin(yaw + math.radians(bearing_deg)), 0.0)
    assert seen_along(way, Rotation.from_euler("z", yaw)) == PathVisibility(seen, 1.0)


@pytest.mark.parametrize(("up_deg", "seen"), [(13, 1), (15, 0), (-43, 1), (-45, 0), (90, 0), (-90, 0)])
def test_a_climb_steeper_than_the_field_of_view_is_not_visible(up_deg: float, seen: float) -> None:
    """The field of view is 29 degrees up and down from an axis pitched 15 degrees down."""
    up = math.radians(up_deg)
    found = seen_along((math.cos(up), 0.0, math.sin(up)), Rotation.identity())
    assert (found.seen, found.nose_first) == (seen, seen)


def test_a_vehicle_tilted_forwards_looks_lower() -> None:
    ten_up = (math.cos(math.radians(10.0)), 0.0, math.sin(math.radians(10.0)))
    assert seen_along(ten_up, Rotation.from_euler("y", math.radians(8.0))) == PathVisibility(0.0, 1.0)


def test_shares_are_of_path_length_and_rest_does_not_count() -> None:
    """One second ahead at 3 m/s, one at rest, one back at 1 m/s."""
    stamps = np.linspace(0.0, 3.0, 601)
    x = np.interp(stamps, [0.0, 1.0, 2.0, 3.0], [9.0, 12.0, 12.0, 11.0])
    place = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=1)
    found = path_visibility(stamps, place, np.tile([1.0, 0.0, 0.0, 0.0], (len(stamps), 1)), DOWN_RAD, FOV_RAD)
    assert found.seen == pytest.approx(0.75, abs=0.02)
    assert found.nose_first == 1.0


def test_the_column_over_the_pad_does_not_count() -> None:
    """The path climbs 2 m, flies 1 m away, half of it inside the column, and descends."""
    stamps = np.linspace(0.0, 5.0, 1001)
    x, z = np.interp(stamps, [2.0, 3.0], [0.0, 1.0]), np.interp(stamps, [0.0, 2.0, 3.0, 5.0], [0.0, 2.0, 2.0, 1.5])
    place, ahead = np.stack([x, np.zeros_like(x), z], axis=1), np.tile([1.0, 0.0, 0.0, 0.0], (len(stamps), 1))
    assert path_visibility(stamps, place, ahead, DOWN_RAD, FOV_RAD).seen == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("count", [0, 1, 400])
def test_a_vehicle_at_rest_has_no_shares(count: int) -> None:
    stamps = np.arange(count) / 200.0
    still = np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    assert path_visibility(stamps, *still, DOWN_RAD, FOV_RAD) == PathVisibility(None, None)
