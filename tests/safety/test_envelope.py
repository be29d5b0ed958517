"""Where a setpoint may stand: tried densely about every border."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
from guard_rooms import ENVELOPE, may_stand

from uav_recon.safety.envelope import Envelope, Fence, Vec3
from uav_recon.types.polygon import Polygon

ELL = Polygon(((-2.0, -2.0), (4.0, -2.0), (4.0, 1.0), (1.0, 1.0), (1.0, 5.0), (-2.0, 5.0)))
IN_ELL = Envelope(
    fence=Fence(plan=ELL, floor_m=-0.2, ceiling_m=2.5, inset_m=0.3),
    max_speed_mps=1.0,
    max_acceleration_mps2=2.0,
    max_yaw_rate_radps=0.8,
)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("millimetres", range(-3, 4))
def test_the_border_is_where_it_was_written_down(axis: int, millimetres: int) -> None:
    for sign, border in ((-1, (-0.7, -1.7, 0.2)[axis]), (1, (4.7, 1.7, 2.1)[axis])):
        place = [2.0, 0.0, 1.0]
        place[axis] = border + sign * millimetres * 1e-3
        assert may_stand(ENVELOPE, (place[0], place[1], place[2])) is (millimetres <= 0)


@pytest.mark.parametrize(
    ("place", "inside"),
    [
        ((0.0, 0.0, 0.0), True),
        ((0.0, 0.0, -0.2), True),
        ((0.0, 0.0, -0.201), False),
        ((0.5, 0.0, 0.1), True),
        ((0.501, 0.0, 0.1), False),
        ((0.0, 0.0, 2.1), True),
        ((0.0, 0.0, 2.101), False),
        ((math.nan, 0.0, 1.0), False),
        ((0.0, math.inf, 1.0), False),
        ((0.0, 0.0, math.nan), False),
    ],
)
def test_over_the_pad_the_floor_is_lower(place: Vec3, inside: bool) -> None:
    assert may_stand(ENVELOPE, place) is inside


def test_the_column_stands_where_the_pad_is() -> None:
    aside = dataclasses.replace(ENVELOPE, pad_m=(2.0, -0.6, 0.1), pad_radius_m=0.4, pad_depth_m=0.15)
    for twelfth in range(12):
        x, y = math.cos(twelfth * math.pi / 6), math.sin(twelfth * math.pi / 6)
        for way_m, inside in ((0.399, True), (0.401, False)):
            assert aside.in_column((2.0 + way_m * x, -0.6 + way_m * y, 0.0)) is inside
    assert aside.in_column((2.0, -0.6, -0.0499))
    assert not aside.in_column((2.0, -0.6, -0.0501))


def test_the_column_does_not_lead_through_the_fence() -> None:
    near_side = dataclasses.replace(ENVELOPE, pad_m=(-0.5, 0.0, 0.0))
    assert may_stand(near_side, (-0.7, 0.0, 0.0))
    assert not may_stand(near_side, (-0.701, 0.0, 0.0))


def test_a_straight_way_round_a_corner_is_no_straight_way() -> None:
    assert may_stand(IN_ELL, (3.0, 0.0, 1.0))
    assert may_stand(IN_ELL, (0.0, 4.0, 1.0))
    assert not may_stand(IN_ELL, (3.0, 3.0, 1.0))
    assert not IN_ELL.admits((3.0, 0.0, 1.0), (0.0, 4.0, 1.0)), "across the inner corner"
    assert IN_ELL.admits((3.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    assert not IN_ELL.admits((0.0, 0.0, 0.05), (2.0, 0.0, 1.0)), "out of the column below the floor's inset"


@pytest.mark.parametrize("tenth", range(-10, 11))
def test_the_inner_corner_keeps_its_inset_all_round(tenth: int) -> None:
    angle = math.pi + (tenth + 10) / 20 * math.pi / 2
    for room_m, inside in ((0.299, False), (0.301, True)):
        place = (1.0 + room_m * math.cos(angle), 1.0 + room_m * math.sin(angle), 1.0)
        assert may_stand(IN_ELL, place) is inside


@pytest.mark.parametrize(
    ("place", "nearest"),
    [
        ((1.0, 0.0, 1.0), (1.0, 0.0, 1.0)),
        ((9.0, 0.0, 1.0), (4.7, 0.0, 1.0)),
        ((9.0, 9.0, 9.0), (4.7, 1.7, 2.1)),
        ((1.0, 0.0, -5.0), (1.0, 0.0, 0.2)),
    ],
)
def test_what_is_outside_is_drawn_inside(place: Vec3, nearest: Vec3) -> None:
    assert ENVELOPE.nearest_inside(place) == pytest.approx(nearest)
    assert may_stand(ENVELOPE, ENVELOPE.nearest_inside(place))


def test_where_no_side_helps_there_is_the_pad() -> None:
    assert ENVELOPE.nearest_inside((math.nan, 0.0, 1.0)) == ENVELOPE.pad_m


@pytest.mark.parametrize("speed", [0.0, 0.3, 1.0])
def test_stopping_takes_v_squared_over_2a(speed: float) -> None:
    assert ENVELOPE.stopping_point((1.0, 2.0, 3.0), (0.0, -speed, 0.0)) == pytest.approx((1.0, 2.0 - speed**2 / 4.0, 3.0))


@pytest.mark.parametrize("push_mps2", [1.5, 2.0, 3.0])
def test_it_stops_along_its_way_in_every_direction(push_mps2: float) -> None:
    envelope = dataclasses.replace(ENVELOPE, max_acceleration_mps2=push_mps2)
    share = 0.9**2 / (2.0 * push_mps2)
    assert envelope.stopping_point((1.0, 2.0, 3.0), (0.54, -0.432, 0.576)) == pytest.approx(
        (1.0 + 0.6 * share, 2.0 - 0.48 * share, 3.0 + 0.64 * share)
    )


def test_a_rounding_error_is_inside_and_twice_that_is_not() -> None:
    fence, column = ENVELOPE.fence, dataclasses.replace(ENVELOPE, pad_depth_m=0.0)
    inset_m = fence.inset_m - 1e-9
    assert ENVELOPE.in_band((2.0, 0.0, fence.floor_m + inset_m))
    assert ENVELOPE.in_band((2.0, 0.0, fence.ceiling_m - inset_m))
    assert ENVELOPE.in_column((0.0, 0.0, fence.ceiling_m - inset_m))
    assert ENVELOPE.in_column((ENVELOPE.pad_radius_m + 1e-9, 0.0, 1.0))
    assert column.in_column((0.0, 0.0, -1e-9))
    assert not ENVELOPE.in_band((2.0, 0.0, 0.2 - 2e-9))
    assert not ENVELOPE.in_band((2.0, 0.0, 2.1 + 2e-9))
    assert not ENVELOPE.in_column((0.0, 0.0, 2.1 + 2e-9))
    assert not ENVELOPE.in_column((0.5 + 2e-9, 0.0, 1.0))
    assert not column.in_column((0.0, 0.0, -2e-9))
    assert may_stand(ENVELOPE, (4.7 + 0.5e-9, 0.0, 1.0))
    assert not may_stand(ENVELOPE, (4.7 + 2e-9, 0.0, 1.0))


def test_both_ends_of_a_way_lie_in_the_band() -> None:
    assert ENVELOPE.admits((2.0, 0.0, 0.5), (2.0, 0.0, 2.0))
    assert not ENVELOPE.admits((2.0, 0.0, 0.5), (2.0, 0.0, 2.2))
    assert not ENVELOPE.admits((2.0, 0.0, 0.5), (2.0, 0.0, 0.1))
    assert not ENVELOPE.admits((2.0, 0.0, 0.1), (2.0, 0.0, 0.5))
    assert not ENVELOPE.admits((0.0, 0.0, 0.05), (0.0, 0.0, 2.2))


def test_the_fence_itself_is_without_inset() -> None:
    fence = ENVELOPE.fence
    assert fence.holds((4.999, 0.0, 1.0))
    assert not fence.holds((5.001, 0.0, 1.0))
    assert fence.holds((0.0, 0.0, -0.1))
    assert not fence.holds((0.0, 0.0, -0.101))
    assert fence.holds((0.0, 0.0, 2.4))
    assert not fence.holds((0.0, 0.0, 2.401))
    assert not fence.holds((0.0, math.nan, 1.0))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"max_speed_mps": 0.0}, "positive"),
        ({"max_acceleration_mps2": -1.0}, "positive"),
        ({"max_yaw_rate_radps": math.inf}, "finite"),
        ({"pad_radius_m": 0.0}, "positive"),
        ({"pad_depth_m": -0.1}, "not negative"),
        ({"pad_m": (0.0, math.nan, 0.0)}, "finite"),
        ({"pad_m": (4.8, 0.0, 0.0)}, "take-off place"),
    ],
)
def test_limits_that_are_none_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(ENVELOPE, **changes)
    assert dataclasses.replace(ENVELOPE, pad_depth_m=0.0).pad_depth_m == 0.0


@pytest.mark.parametrize(
    ("floor", "ceiling", "inset"),
    [
        (0.0, 0.6, 0.3),
        (1.0, 1.59, 0.3),
        (-1.0, -0.41, 0.3),
        (2.0, 0.0, 0.3),
        (0.0, 2.0, -0.1),
        (math.nan, 2.0, 0.3),
        (0.0, math.inf, 0.3),
        (1.0, math.inf, 0.3),
        (-math.inf, 2.0, 0.3),
        (0.0, 2.0, math.nan),
    ],
)
def test_a_fence_without_height_is_refused(floor: float, ceiling: float, inset: float) -> None:
    with pytest.raises(ValueError, match="floor"):
        Fence(plan=ELL, floor_m=floor, ceiling_m=ceiling, inset_m=inset)
    assert Fence(plan=ELL, floor_m=0.0, ceiling_m=0.61, inset_m=0.3).inset_m == 0.3
    assert Fence(plan=ELL, floor_m=0.0, ceiling_m=0.61, inset_m=0.0).inset_m == 0.0
    assert Fence(plan=ELL, floor_m=3.0, ceiling_m=3.61, inset_m=0.3).floor_m == 3.0
