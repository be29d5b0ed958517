"""Depth-only mapper: surface elements on the observed wall, facing the camera.

They become more certain with each view.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sitl.camera.depth_surfels import PRIOR_SIGMA_M, DepthSurfels

LENS = np.array([110.0, 110.0, 105.5, 59.5])
NOISE = 0.0036  # 14 mm at 2 m
LOOK_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # world_from_camera rotation, looking along x


def wall(distance_m: float, slope: float = 0.0) -> NDArray[np.float32]:
    """Return the depth of the plane z = distance + slope * x_right, (120, 212)."""
    u = (np.arange(212) - LENS[2]) / LENS[0]
    return np.tile(distance_m / (1.0 - slope * u), (120, 1)).astype(np.float32)


def memory() -> DepthSurfels:
    return DepthSurfels(np.array([-1.0, -4.0, -4.0]), np.array([6.0, 4.0, 4.0]), 0.1)


def test_elements_lie_on_the_wall_and_face_the_camera() -> None:
    m = memory()
    m.look(wall(2.0), LENS, LOOK_X, np.array([0.5, 0.0, 1.0]), NOISE)
    position, normal, sigma = m.elements()
    assert len(m) == len(position) > 300
    assert position[:, 0] == pytest.approx(2.5, abs=1e-5)
    assert normal == pytest.approx(np.tile([-1.0, 0.0, 0.0], (len(m), 1)), abs=1e-5)
    assert (sigma < 0.06).all()


def test_there_is_one_element_per_cube() -> None:
    m = memory()
    m.look(wall(2.0), LENS, LOOK_X, np.zeros(3), NOISE)
    cubes = {tuple(c) for c in np.floor((m.elements()[0] - np.array([-1.0, -4.0, -4.0])) / 0.1 + 1e-6).astype(int)}
    assert len(cubes) == len(m)


def test_a_slanted_wall_has_a_slanted_normal() -> None:
    m = memory()
    m.look(wall(2.0, slope=0.5), LENS, LOOK_X, np.zeros(3), NOISE)
    expected = np.array([-1.0, -0.5, 0.0]) / np.hypot(1.0, 0.5)  # depth grows to the right, so the wall faces left and back
    assert np.abs(m.elements()[1] @ expected) == pytest.approx(1.0, abs=1e-3)


def test_uncertainty_falls_with_each_view_and_faster_for_near_perpendicular_ones() -> None:
    def after(*looks: tuple[float, float]) -> float:
        m = memory()
        for distance_m, slope in looks:
            m.look(wall(distance_m, slope), LENS, LOOK_X, np.array([3.0 - distance_m, 0.0, 0.0]), NOISE)
        position, _, sigma = m.elements()
        return float(sigma[np.argmin(np.linalg.norm(position - np.array([3.0, 0.0, 0.0]), axis=1))])

    once, twice, nearer, slanted = after((2.0, 0.0)), after((2.0, 0.0), (2.0, 0.0)), after((1.0, 0.0)), after((2.0, 0.9))
    assert once == pytest.approx(1.0 / np.sqrt((1.0 / (NOISE * 4.0)) ** 2 + 1.0 / PRIOR_SIGMA_M**2), rel=0.02)
    assert twice == pytest.approx(once / np.sqrt(2.0), rel=0.02)
    assert nearer < 0.3 * once
    assert slanted > 1.2 * once


def test_edges_and_holes_give_no_elements() -> None:
    depth = wall(2.0)
    depth[:, 106:] = 4.0
    depth[:, :20] = np.nan
    m = memory()
    m.look(depth, LENS, LOOK_X, np.zeros(3), NOISE)
    x = m.elements()[0][:, 0]
    assert (np.minimum(np.abs(x - 2.0), np.abs(x - 4.0)) < 1e-4).all()
    empty = memory()
    empty.look(np.full((120, 212), np.nan, np.float32), LENS, LOOK_X, np.zeros(3), NOISE)
    assert len(empty) == 0


def test_a_ceiling_seen_at_a_small_angle_is_no_edge() -> None:
    height_m, v = 0.5, (np.arange(120) - LENS[3]) / LENS[1]
    depth = np.full((120, 212), np.nan, np.float32)
    above = np.flatnonzero(-v > height_m / 5.0)
    depth[above] = (height_m / -v[above])[:, None]
    m = memory()
    m.look(depth, LENS, LOOK_X, np.zeros(3), NOISE)
    position, normal, _ = m.elements()
    assert position[:, 2] == pytest.approx(height_m, abs=1e-4)
    assert np.count_nonzero(position[:, 0] > 2.0) > 300
    assert normal == pytest.approx(np.tile([0.0, 0.0, -1.0], (len(m), 1)), abs=1e-3)
