"""Depth in cells, against frames whose answer is known by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.geometry.min_range_binning import nearest_in_cells
from uav_recon.types.camera import Frame, Intrinsics, body_from_camera
from uav_recon.types.frames import Float32Array
from uav_recon.types.pose import Pose

MOUNT = body_from_camera(np.array([0.1, 0.0, 0.0]), 0.26)


def frame(depth_m: Float32Array) -> Frame:
    height, width = depth_m.shape
    lens = Intrinsics.from_fov(width, height, math.radians(87), math.radians(58))
    return Frame(7.0, 1, depth_m, lens, np.zeros((2, 2, 3), np.uint8), lens, Pose.identity())


def wall(distance_m: float, shape: tuple[int, int] = (120, 212)) -> Float32Array:
    return np.full(shape, distance_m, dtype=np.float32)


@pytest.mark.parametrize("shape", [(120, 212), (480, 848), (6, 8)])
def test_a_wall_is_as_far_as_it_is_along_each_ray(shape: tuple[int, int]) -> None:
    nearby = nearest_in_cells(frame(wall(2.0, shape)), MOUNT)
    rows, columns = nearby.range_m.shape
    assert nearby.stamp_s == 7.0
    assert nearby.share == 1.0
    x = ((np.arange(columns) + 0.5) / columns * 2 - 1) * nearby.half_tan[0]
    y = ((np.arange(rows) + 0.5) / rows * 2 - 1) * nearby.half_tan[1]
    expected = 2.0 * np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
    assert np.all(nearby.range_m <= expected + 1e-6)
    np.testing.assert_allclose(nearby.range_m, expected, atol=0.12)


def test_a_thin_post_counts_and_a_speckle_does_not() -> None:
    depth = wall(3.0)
    depth[:, 30] = 1.0
    depth[60, 150] = 0.4
    nearby = nearest_in_cells(frame(depth), MOUNT)
    assert np.all((nearby.range_m < 1.7).sum(axis=1) == 1)
    assert nearby.range_m.min() >= 1.0


@pytest.mark.parametrize("nothing", [math.nan, 0.0, -1.0, math.inf])
def test_no_return_says_nothing(nothing: float) -> None:
    nearby = nearest_in_cells(frame(wall(nothing)), MOUNT)
    assert np.isnan(nearby.range_m).all()
    assert nearby.share == 0.0
    half = wall(1.5)
    half[:, :106] = nothing
    assert nearest_in_cells(frame(half), MOUNT).share == pytest.approx(0.5, abs=0.01)


def test_a_cell_is_full_where_most_of_it_came_back() -> None:
    depth = wall(3.0)
    depth[:50:2] = math.nan  # five rows of cells, half of each
    depth[50:60:3] = math.nan
    full = nearest_in_cells(frame(depth), MOUNT).full
    assert full.shape == (12, 16)
    assert not full[:5].any()
    assert full[5:].all()
