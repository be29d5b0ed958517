"""Which points a free cone contains, compared with angles and distances worked out one by one."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from uav_recon.safety.free_cone_rule import points_in_cones
from uav_recon.types.frames import BoolArray

NEAR = st.floats(-3.0, 3.0)
POINT = st.tuples(NEAR, NEAR, NEAR)


def inside(points_m: list[tuple[float, float, float]], apex_m: tuple[float, float, float], half_rad: float) -> BoolArray:
    """Return the mask (N,) for an upright cone of two metres."""
    cos, axis = np.array([math.cos(half_rad)]), np.array([[0.0, 0.0, 1.0]])
    mask: BoolArray = points_in_cones(np.array(points_m), np.array([apex_m]), axis, cos, np.array([2.0]))[0]
    return mask


@given(POINT, POINT, st.floats(0.05, 1.5))
def test_a_point_is_inside_by_its_angle_and_its_distance(
    point_m: tuple[float, float, float], apex_m: tuple[float, float, float], half_rad: float
) -> None:
    off_m = [a - b for a, b in zip(point_m, apex_m, strict=True)]
    distance_m = math.sqrt(sum(value * value for value in off_m))
    angle_rad = math.atan2(math.hypot(off_m[0], off_m[1]), off_m[2])
    if abs(angle_rad - half_rad) > 1e-6 and abs(distance_m - 2.0) > 1e-6 and distance_m > 1e-6:
        assert inside([point_m], apex_m, half_rad)[0] == (angle_rad < half_rad and distance_m < 2.0)


def test_each_cone_has_its_own_row() -> None:
    points_m = np.array([(0.0, 0.0, 1.0), (5.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
    apex_m, axis = np.array([(0.0, 0.0, 0.0), (5.0, 0.0, 2.0)]), np.array([(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
    mask = points_in_cones(points_m, apex_m, axis, np.array([0.9, 0.9]), np.array([1.0, 0.5]))
    assert mask.tolist() == [[True, False, False], [False, False, False]]
    mask = points_in_cones(points_m, apex_m, axis, np.array([0.9, 0.9]), np.array([0.5, 1.0]))
    assert mask.tolist() == [[False, False, False], [False, True, False]]


def test_the_apex_and_the_end_belong_to_the_cone_and_a_negative_reach_holds_nothing() -> None:
    ends_m = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, 2.0)])
    one = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([0.9])
    assert points_in_cones(ends_m, *one, np.array([2.0])).all()
    assert not points_in_cones(ends_m, *one, np.array([-0.1])).any()
