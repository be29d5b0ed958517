"""Headings of the views of a tour: they turn no farther than the views need, and the views still show their cells."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.candidate_view import CandidateView
from uav_recon.planning.place_sight import PlaceSight
from uav_recon.planning.view_headings import KEPT_SHARE, MAX_STEPS, OFF_RAD, STEP_RAD, suited_to_path
from uav_recon.types.frames import FloatArray
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

SHAPE = (100, 100, 30)
TILT_RAD = math.radians(15.0)
CAMERA = CameraGeometry(math.radians(87), math.radians(58), np.array([0.1, 0.0, 0.0]), TILT_RAD, TILT_RAD, 4.5)
LENS = CAMERA.lens(0.1, 4.5)
PLACE = np.array([50.5, 50.5, 15.5])


def view_of(yaw_rad: float, half_width_rad: float, yaw_of_view_rad: float | None = None) -> CandidateView:
    """A view from PLACE of cells two metres away, over a range of bearings and 0.4 m of height."""
    bearings = yaw_rad + np.linspace(-half_width_rad, half_width_rad, 15)
    flat = np.stack([np.cos(bearings), np.sin(bearings), np.zeros(15)], axis=1) * 20.0
    cells = np.concatenate([PLACE + flat + (0.0, 0.0, up - 5.0) for up in range(5)])
    promised = np.unique(np.ravel_multi_index(tuple(np.floor(cells).astype(np.int64).T), SHAPE))
    view = Viewpoint(PLACE * 0.1, yaw_rad if yaw_of_view_rad is None else yaw_of_view_rad, TILT_RAD)
    return CandidateView(Task(TaskKind.EXPLORE, PLACE * 0.1, view, 1.0), PLACE + 1.0, promised, np.ones(len(promised)))


def shown_share(view: CandidateView) -> float:
    """The share of a view's cells in its picture, by matrices."""
    yaw, pitch = view.task.viewpoint.yaw_rad, view.task.viewpoint.pitch_down_rad
    about_z = np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[math.cos(pitch), 0.0, math.sin(pitch)], [0.0, 1.0, 0.0], [-math.sin(pitch), 0.0, math.cos(pitch)]])
    cells = np.stack(np.unravel_index(view.expected_voxels, SHAPE), axis=1) + 0.5
    x, y, z = ((cells - PLACE - about_z @ (1.0, 0.0, 0.0)) @ about_z @ about_y).T
    return float(np.mean((np.abs(y) <= LENS[0] * x) & (np.abs(z) <= LENS[1] * x)))


def leg(length_m: float, bearing_rad: float = 0.0) -> FloatArray:
    end = PLACE * 0.1
    return np.array([end - length_m * np.array([math.cos(bearing_rad), math.sin(bearing_rad), 0.0]), end])


@pytest.mark.parametrize("start_rad", [-2.5, -0.7, -0.2, 0.0, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("at_rad", [0.0, 2.9])
def test_a_view_is_turned_towards_the_heading_before_it_as_far_as_it_shows_its_cells(start_rad: float, at_rad: float) -> None:
    view = view_of(at_rad, 0.3)
    (suited,) = suited_to_path([view], [leg(0.5)], at_rad + start_rad, LENS, SHAPE)
    turned = math.remainder(suited.task.viewpoint.yaw_rad - at_rad, math.tau)
    assert shown_share(suited) >= KEPT_SHARE * shown_share(view) - 1e-9
    assert abs(turned) <= min(abs(start_rad), MAX_STEPS * STEP_RAD) + 1e-9
    assert turned * start_rad >= 0.0
    if abs(turned) < min(abs(start_rad), MAX_STEPS * STEP_RAD) - 1e-9:
        farther = suited.with_heading(suited.task.viewpoint.yaw_rad + math.copysign(STEP_RAD, start_rad))
        assert shown_share(farther) < KEPT_SHARE * shown_share(view)
    assert abs(turned) > 0.15 or abs(start_rad) < 0.25, "cells of a third of the picture leave room"


def test_cells_that_fill_the_picture_are_aimed_at() -> None:
    (suited,) = suited_to_path([view_of(0.0, 0.74)], [leg(0.5)], 1.5, LENS, SHAPE)
    assert abs(suited.task.viewpoint.yaw_rad) <= STEP_RAD


def test_on_a_long_leg_the_nose_turns_to_the_path_and_a_later_view_begins_where_the_earlier_ended() -> None:
    views = [view_of(0.0, 0.1), view_of(0.0, 0.1)]
    first, second = suited_to_path(views, [leg(3.0, 0.1), leg(0.5)], -2.0, LENS, SHAPE)
    assert first.task.viewpoint.yaw_rad == pytest.approx(0.1 - OFF_RAD)
    assert second.task.viewpoint.yaw_rad == pytest.approx(first.task.viewpoint.yaw_rad)
    assert second.task.viewpoint.position_world is views[1].task.viewpoint.position_world
    assert second.expected_voxels is views[1].expected_voxels


def marked_wall(bearing_rad: float) -> SurfaceCells:
    """Bare cells all around at 2.5 m, and corners only within 0.25 rad of a bearing."""
    turn, up = (axis.ravel() for axis in np.meshgrid(np.arange(-math.pi, math.pi, 0.08), np.arange(-2.6, 2.7, 0.2)))
    normal = -np.stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))], axis=1)
    place = PLACE * 0.1 - 2.5 * normal + up[:, None] * (0.0, 0.0, 1.0)
    corners = np.where(np.abs(np.remainder(turn - bearing_rad + math.pi, math.tau) - math.pi) < 0.25, 2.0, 0.0)
    return SurfaceCells(0.2, place, normal, np.zeros(len(turn)), np.full(len(turn), 0.04), corners)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_view_is_turned_to_what_shows_the_place(side: float) -> None:
    """The corners are on one side: there the heading goes, and no farther than the view still shows its cells."""
    view, bearing_rad = view_of(0.0, 0.15), side * 0.95
    sight = PlaceSight(marked_wall(bearing_rad), CAMERA)
    (plain,) = suited_to_path([view], [leg(0.5)], -side * 0.6, LENS, SHAPE)
    (suited,) = suited_to_path([view], [leg(0.5)], -side * 0.6, LENS, SHAPE, sight)
    assert plain.task.viewpoint.yaw_rad * side < 0.0
    assert suited.task.viewpoint.yaw_rad * side > 0.1
    assert shown_share(suited) >= KEPT_SHARE * shown_share(view) - 1e-9


def test_a_heading_that_shows_the_place_is_kept() -> None:
    view, start_rad = view_of(0.0, 0.15), 0.4
    sight = PlaceSight(marked_wall(0.2), CAMERA)
    (plain,), (suited,) = (suited_to_path([view], [leg(0.5)], start_rad, LENS, SHAPE, one) for one in (None, sight))
    assert suited.task.viewpoint.yaw_rad == plain.task.viewpoint.yaw_rad


def test_a_view_that_shows_no_place_is_no_goal_and_a_weak_one_counts_for_less() -> None:
    sight = PlaceSight(marked_wall(0.0), CAMERA)
    to_marks, to_bare = view_of(0.0, 0.1), view_of(2.5, 0.1)
    (kept,) = sight.weighed([to_marks, to_bare])
    assert kept.expected_voxels is to_marks.expected_voxels
    assert kept.task.gain == pytest.approx(to_marks.task.gain)
    bare = marked_wall(0.0)
    weak = replace(bare, corners=0.085 * bare.corners)
    (weighed,) = PlaceSight(weak, CAMERA).weighed([to_marks])
    assert 0.2 < weighed.task.gain / to_marks.task.gain < 0.98
    (unknown,) = PlaceSight(SurfaceCells.none(0.2), CAMERA).weighed([to_bare])
    assert unknown.task.gain > 0.5 * to_bare.task.gain, "space that no camera has seen is entered"
