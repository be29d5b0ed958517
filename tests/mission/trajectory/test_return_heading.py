"""The nose points ahead on a way that is flown to be somewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.mission.trajectory.return_heading import AHEAD_M, OFF_RAD, yaw_along_path
from uav_recon.types.frames import FloatArray
from uav_recon.types.tasks import PlanMode, ViewPath, Viewpoint

PITCH_RAD = 0.26


def home(way: FloatArray) -> ViewPath:
    goal = Viewpoint(way[-1], 2.0, PITCH_RAD)
    return ViewPath((goal,), (way,), PlanMode.EXPLORE, 7, 3, (), 0.0, 0.0, 0.35)


def headings(path: ViewPath) -> list[float]:
    return [view.yaw_rad for view in path.viewpoints]


def test_it_turns_on_the_spot_and_then_flies() -> None:
    way = np.array([[4.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    path = yaw_along_path(home(way), 0.3)
    assert headings(path) == pytest.approx([math.pi, math.pi])
    np.testing.assert_array_equal(path.waypoints_world[0], way[:1])
    np.testing.assert_array_equal(path.waypoints_world[1], way)
    assert {view.pitch_down_rad for view in path.viewpoints} == {PITCH_RAD}
    assert (path.map_revision, path.map_epoch, path.clearance_m) == (7, 3, 0.35)


def test_a_corner_is_turned_at_and_a_bend_is_not() -> None:
    way = np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 2.0, 1.0], [2.5, 4.0, 1.0]])
    path = yaw_along_path(home(way), 0.0)
    assert headings(path) == pytest.approx([0.0, math.pi / 2, math.pi / 2])
    assert [len(leg) for leg in path.waypoints_world] == [2, 1, 3]


def test_up_or_down_or_the_last_bit_turn_nothing() -> None:
    assert headings(yaw_along_path(home(np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 2.0]])), 2.5)) == [2.5]
    assert headings(yaw_along_path(home(np.array([[0.0, 0.0, 1.0], [0.9 * AHEAD_M, 0.0, 1.0]])), 2.5)) == [2.5]
    assert headings(yaw_along_path(home(np.array([[0.0, 0.0, 1.0]])), 2.5)) == [2.5]


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)), min_size=1, max_size=12), st.floats(-math.pi, math.pi))
def test_the_way_is_the_same_and_the_nose_is_never_far_off_it(places: list[tuple[float, float]], yaw_rad: float) -> None:
    way = np.column_stack([np.array(places).reshape(-1, 2), np.full(len(places), 1.0)])
    path = yaw_along_path(home(way), yaw_rad)
    flown = [point.tolist() for leg in path.waypoints_world for point in leg]
    assert [point for k, point in enumerate(flown) if k == 0 or point != flown[k - 1]] == [
        point for k, point in enumerate(way.tolist()) if k == 0 or point != way.tolist()[k - 1]
    ]
    assert all(
        leg[-1].tolist() == view.position_world.tolist()
        for leg, view in zip(path.waypoints_world, path.viewpoints, strict=True)
    )
    begin_rad = yaw_rad
    for leg, view in zip(path.waypoints_world, path.viewpoints, strict=True):
        if len(leg) > 1:
            assert view.yaw_rad == begin_rad, "what is flown is flown with one heading"
            for k in range(len(leg) - 1):
                far = np.flatnonzero(np.linalg.norm(leg[k + 1 :] - leg[k], axis=1) >= AHEAD_M)
                if len(far):
                    dx, dy, _ = (leg[k + 1 + far[0]] - leg[k]).tolist()
                    assert abs(math.remainder(math.atan2(dy, dx) - begin_rad, math.tau)) <= OFF_RAD + 1e-9
        begin_rad = view.yaw_rad
