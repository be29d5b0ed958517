"""Polygons on the floor plan: invalid ones, and distances against a brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.types.polygon import Polygon, Vec2

ELL = Polygon(((-2.0, -2.0), (4.0, -2.0), (4.0, 1.0), (1.0, 1.0), (1.0, 5.0), (-2.0, 5.0)))


@pytest.mark.parametrize(
    ("corners", "words"),
    [
        (((0, 0), (4, 4), (4, 0), (0, 4)), "crosses itself"),
        (((0, 0), (4, 0), (4, 4), (2, 0), (0, 4)), "crosses itself"),
        (((0, 0), (4, 0), (2, 0), (4, 4)), "crosses itself"),
        (((0, 0), (4, 0), (4, 4), (0, 0), (0, 4)), "crosses itself"),
        ((), "open"),
        (((0, 0), (4, 4)), "open"),
        (((0, 0), (4, 4), (0, 0)), "open"),
        (((0, 0), (1.9, 0), (1.9, 4)), "along x"),
        (((0, 0), (3, 0), (3, 501)), "along y"),
        (((0, 0), (math.nan, 0), (3, 3)), "finite"),
    ],
)
def test_an_invalid_polygon_is_a_one_line_error(corners: tuple[Vec2, ...], words: str) -> None:
    with pytest.raises(ValueError, match=words) as error:
        Polygon(corners)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("polygon", [ELL, Polygon(ELL.corners_m[::-1]), Polygon.box((-2.0, -2.0), (3.0, 4.0))])
def test_room_is_the_distance_to_the_border_and_zero_outside(polygon: Polygon) -> None:
    rng = np.random.default_rng(1)
    border = np.concatenate(
        [np.array(a) + np.linspace(0.0, 1.0, 2001)[:, None] * (np.array(b) - np.array(a)) for a, b in polygon.sides()]
    )
    angles = np.array(polygon.corners_m)
    for _ in range(150):
        x, y, u, v = rng.uniform(-3.0, 6.0, 4).tolist()
        way = np.array([x, y]) + np.linspace(0.0, 1.0, 101)[:, None] * np.array([u - x, v - y])
        nearest = np.linalg.norm(way[:, None] - border[None, ::5], axis=-1).min()
        turns = np.unwrap(np.arctan2(*(np.vstack([angles, angles[:1]]) - [x, y]).T[::-1]), period=math.tau)
        assert polygon.holds((x, y)) is bool(abs(turns[-1] - turns[0]) > 1.0), (x, y)
        room_m = polygon.room_m((x, y), (u, v))
        if room_m > 0.0:
            assert room_m == pytest.approx(nearest, abs=0.05)
        elif polygon.holds((x, y)) and polygon.holds((u, v)):
            assert nearest < 0.1, "it leaves and comes back"


def test_the_nearest_position_with_room_is_inside_and_has_that_room() -> None:
    rng = np.random.default_rng(2)
    for _ in range(60):
        x, y = rng.uniform(-4.0, 7.0, 2).tolist()
        place = ELL.nearest_with_clearance((x, y), 0.3)
        assert place is not None
        assert ELL.room_m(place, place) >= 0.3 - 1e-9
    assert ELL.nearest_with_clearance((0.0, 0.0), 9.0) is None
    assert ELL.nearest_with_clearance((-5.0, 0.0), 0.3) == pytest.approx((-1.7, 0.0))
