"""An opening is found in the voxels, measured in a fine map, and opened where the body fits."""

from __future__ import annotations

import numpy as np
import pytest
from doorway import CAMERA, HERE, MIDDLE_M, PASSAGE_M, WALL_M, Doorway

from uav_recon.planning.candidate_view import PlanningContext
from uav_recon.types.frames import FloatArray


@pytest.mark.parametrize("width_m", [0.66, 0.7, 0.8, 0.9])
def test_an_opening_is_open_once_a_fine_map_shows_it_wide_enough(width_m: float) -> None:
    door = Doorway(width_m)
    door.plan()
    assert not door.leads_through()
    (place,) = door.passages.places
    np.testing.assert_allclose(place, [3.0, MIDDLE_M, HERE[2]], atol=0.25)
    door.plan(door.fine(width_m))
    assert door.leads_through()


@pytest.mark.parametrize("width_m", [0.5, 0.55])
def test_an_opening_that_is_too_narrow_stays_closed(width_m: float) -> None:
    door = Doorway(width_m)
    door.plan()
    if door.passages.places:
        door.plan(door.fine(width_m))
    assert not door.leads_through()


def test_a_wide_opening_is_no_passage() -> None:
    door = Doorway(1.3)
    door.plan()
    assert door.leads_through() and not door.passages.places


def test_an_open_passage_closes_when_its_fine_map_does() -> None:
    door = Doorway(0.8)
    door.plan()
    door.plan(door.fine(0.8))
    assert door.leads_through()
    door.plan(door.fine(0.5, revision=2))  # a door leaf
    assert not door.leads_through()
    door.plan(door.fine(0.8, revision=3))
    assert door.leads_through()


def test_a_path_through_it_leads_along_the_middle() -> None:
    door = Doorway(0.7)
    door.plan()
    door.plan(door.fine(0.7))
    aside = MIDDLE_M + 0.1
    leg = np.array([[1.2, 2.5, 1.1], [2.5, aside, 1.1], [3.5, aside, 1.1], [4.8, 2.5, 1.1]])
    for way, ends in ((leg, leg[[0, -1]]), (leg[::-1], leg[[-1, 0]])):
        through = door.passages.along(way)
        np.testing.assert_array_equal(through[[0, -1]], ends)
        crossing = np.array([np.interp(x, *(np.sort(through[:, 0]), through[np.argsort(through[:, 0]), 1])) for x in WALL_M])
        np.testing.assert_allclose(crossing, MIDDLE_M, atol=0.06)
    stays = np.array([[1.2, 2.5, 1.1], [2.5, 1.0, 1.1]])
    np.testing.assert_array_equal(door.passages.along(stays), stays)
    inside = np.array([[3.0, aside, 1.1], [4.8, 2.5, 1.1]])  # it begins in the opening, beside the middle
    np.testing.assert_array_equal(door.passages.along(inside)[[0, -1]], inside)


def test_a_closed_passage_is_looked_at_twice_from_before_it_and_from_two_places() -> None:
    door, places = Doorway(0.8), []
    door.plan()
    for most_aside_m, most_rad in ((0.4, 0.3), (0.8, 0.7)):
        context = PlanningContext(door.voxels, door.usual, np.zeros(1, dtype=np.int64), HERE)
        (view,) = door.passages.looks(context)
        place, yaw_rad = view.task.viewpoint.position_world, view.task.viewpoint.yaw_rad
        places.append(place)
        assert 0.9 <= 3.0 - place[0] <= 2.0 and abs(place[1] - MIDDLE_M) < most_aside_m
        assert abs(yaw_rad) < most_rad and view.task.viewpoint.pitch_down_rad == CAMERA.pitch_min_rad
        door.plan(position=place, yaw_rad=yaw_rad)
    assert np.linalg.norm(places[1] - places[0]) > 0.4
    assert not door.passages.looks(PlanningContext(door.voxels, door.usual, np.zeros(1, dtype=np.int64), HERE))


def test_a_passage_without_a_fine_map_is_closed_again() -> None:
    door = Doorway(0.8)
    door.plan()
    door.plan(door.fine(0.8))
    assert door.leads_through()
    door.plan()
    assert not door.leads_through()
    door.plan(door.fine(0.8))
    assert door.leads_through()


def test_the_measured_width_is_that_of_the_opening() -> None:
    for width_m in (0.7, 0.8):
        door = Doorway(width_m)
        door.plan()
        door.plan(door.fine(width_m))
        (passage,) = door.passages._known
        assert width_m - 0.1 <= passage.width_m <= width_m
        assert passage.width_m >= 2 * PASSAGE_M - 0.025 - 1e-9


def look_at(door: Doorway) -> tuple[FloatArray, float]:
    """The next look at the passage: position and heading."""
    (view,) = door.passages.looks(PlanningContext(door.voxels, door.usual, np.zeros(1, dtype=np.int64), HERE))
    return view.task.viewpoint.position_world, view.task.viewpoint.yaw_rad


def test_an_opening_that_is_too_narrow_is_named_once_it_was_looked_at() -> None:
    door = Doorway(0.7)
    door.plan()
    place, yaw_rad = look_at(door)
    assert not door.passages.too_narrow(), "not measured yet"
    door.plan(door.fine(0.57))
    assert not door.passages.too_narrow(), "seen in passing: a look comes first"
    look_at(door)
    door.plan(door.fine(0.57, revision=2), position=place, yaw_rad=yaw_rad)
    (reason,) = door.passages.too_narrow()
    width_m, needed_m, x, y = (float(value) for value in reason.values)
    assert 0.45 <= width_m < needed_m == pytest.approx(2 * PASSAGE_M - 0.025, abs=0.006)
    np.testing.assert_allclose((x, y), (3.0, MIDDLE_M), atol=0.25)
    door.plan(door.fine(0.4, revision=3))
    assert door.passages.too_narrow() == [reason], "a look that shows less of it does not make it narrower"
    assert f"is too narrow: the map shows {width_m:.2f} m, {needed_m:.2f} m are needed" in reason.text()


def test_an_opening_that_is_open_or_closed_entirely_is_not_named() -> None:
    for width_m in (0.8, 0.0):
        door = Doorway(0.8)
        door.plan()
        place, yaw_rad = look_at(door)
        door.plan(door.fine(width_m), position=place, yaw_rad=yaw_rad)
        assert not door.passages.too_narrow()
        door.plan(door.fine(0.5 if width_m else 0.0, revision=2))  # a door leaf after the vehicle could pass
        assert not door.passages.too_narrow()
