"""String pulling: a path keeps its ends, stays open, and becomes nearly the shortest."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from uav_recon.planning.paths.segments import length_of, segment_is_open
from uav_recon.planning.paths.string_pulling import pull_taut
from uav_recon.types.frames import ByteArray, FloatArray


def taut(mask: ByteArray, points: list[tuple[float, float, float]]) -> FloatArray:
    room = np.empty((64, 3))
    room[: len(points)] = points
    return room[: pull_taut(mask, room, len(points))].copy()


def hall() -> ByteArray:
    mask = np.zeros((42, 42, 22), dtype=np.uint8)
    mask[1:-1, 1:-1, 1:-1] = 1
    return mask


def test_in_an_open_hall_the_path_is_a_straight_line() -> None:
    way = taut(hall(), [(3.5, 3.5, 3.5), (30.5, 5.5, 10.5), (8.5, 30.5, 15.5), (35.5, 35.5, 4.5)])
    np.testing.assert_array_equal(way, [(3.5, 3.5, 3.5), (35.5, 35.5, 4.5)])


def test_a_path_around_a_wall_touches_its_edge_at_the_right_height() -> None:
    mask = hall()
    mask[20:22, :30] = 0
    way = taut(mask, [(5.5, 8.5, 4.5), (18.5, 32.5, 8.5), (24.5, 33.5, 7.5), (37.5, 8.5, 4.5)])
    shortest = np.hypot(14.5, 21.5) + 2.0 + np.hypot(15.5, 21.5)  # around both edges of the wall's end
    assert all(segment_is_open(mask, *a, *b) for a, b in itertools.pairwise(way))
    assert length_of(way) == pytest.approx(shortest, rel=0.02)
    assert np.ptp(way[:, 2]) < 2.0


def test_a_path_around_a_pillar_is_as_long_as_its_tangents_and_the_arc() -> None:
    mask = hall()
    i, j = np.meshgrid(np.arange(42) + 0.5, np.arange(42) + 0.5, indexing="ij")
    mask[np.hypot(i - 21, j - 21) < 10] = 0
    way = taut(mask, [(3.5, 21.0, 10.5), (9.5, 34.5, 9.5), (21.5, 36.5, 11.5), (33.5, 34.5, 10.5), (38.5, 21.0, 10.5)])
    reach, radius = 17.5, 10.0
    tangent = np.sqrt(reach**2 - radius**2)
    shortest = 2 * tangent + radius * (np.pi - 2 * np.arccos(radius / reach))
    assert length_of(way) == pytest.approx(shortest, rel=0.04)


def test_paths_among_random_voxels_stay_open_and_never_grow() -> None:
    rng = np.random.default_rng(0)
    shorter = 0
    for _ in range(60):
        mask = hall()
        mask[1:-1, 1:-1, 1:-1] = rng.random((40, 40, 20)) < 0.995
        points = [tuple(rng.choice(np.argwhere(mask[2:-2, 2:-2, 2:-2])) + 2.5)]
        while len(points) < 6:
            ahead = np.clip(points[-1] + rng.normal(0, 8, 3), 2, (40, 40, 20))
            if segment_is_open(mask, *points[-1], *ahead):
                points.append(tuple(ahead))
        before = np.array(points)
        way = taut(mask, points)
        assert all(segment_is_open(mask, *a, *b) for a, b in itertools.pairwise(way))
        np.testing.assert_array_equal(way[[0, -1]], before[[0, -1]])
        assert length_of(way) <= length_of(before) + 1e-9
        shorter += length_of(way) < length_of(before) - 1.0
    assert shorter > 30


def test_a_full_point_buffer_is_no_error() -> None:
    mask = hall()
    mask[20:22, :30] = 0
    points = np.array([(5.5, 8.5, 4.5), (12.5, 36.5, 18.5), (28.5, 38.5, 18.5), (37.5, 8.5, 4.5)])
    count = pull_taut(mask, points, 4)
    assert 3 <= count <= 4
    assert all(segment_is_open(mask, *a, *b) for a, b in itertools.pairwise(points[:count]))
