"""The speed limit by age, and the points that a hull enters, worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.safety.sight_speed_limit import SightSpeedLimit, entered_points

LIMIT = SightSpeedLimit(full_speed_mps=1.0, blind_speed_mps=0.3, blind_fresh_s=3.0, blind_stale_s=10.0, blind_memory_s=60.0)


@pytest.mark.parametrize(
    ("age_s", "limit_mps"),
    [(0.0, 1.0), (3.0, 1.0), (4.0, 0.9), (6.5, 0.65), (10.0, 0.3), (60.0, 0.3), (60.01, 0.0), (math.inf, 0.0)],
)
def test_the_limit_falls_evenly_with_age(age_s: float, limit_mps: float) -> None:
    assert LIMIT.at(np.array([age_s])) == pytest.approx([limit_mps])


def test_equal_ages_make_a_step() -> None:
    step = SightSpeedLimit(full_speed_mps=1.0, blind_speed_mps=0.3, blind_fresh_s=3.0, blind_stale_s=3.0, blind_memory_s=60.0)
    assert step.at(np.array([0.0, 3.0, 3.001])) == pytest.approx([1.0, 1.0, 0.3])


@pytest.mark.parametrize(
    "direction", [(1.0, 0.0, 0.0), (0.48, 0.64, 0.6), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]
)
def test_the_points_lie_in_front_of_the_hull_and_around_its_front(direction: tuple[float, float, float]) -> None:
    here, way = np.array([1.0, 2.0, 3.0]), np.array(direction)
    (points,) = entered_points(here[None], way[None], np.array([0.4]), 0.2, 0.25)
    along, off = (points - here) @ way, points - here - ((points - here) @ way)[:, None] * way
    beside_m = 0.25 - 0.2 + math.sqrt(0.2**2 - 0.14**2)
    assert along == pytest.approx([0.25, 0.45, 0.65, *[beside_m] * 4, *[beside_m + 0.4] * 4])
    assert np.linalg.norm(off, axis=1) == pytest.approx([0.0] * 3 + [0.14] * 8, abs=1e-12)
    assert off[3:7].sum(axis=0) == pytest.approx([0.0] * 3, abs=1e-12)
    assert abs(off[3] @ off[5]) < 1e-12, "to both sides, and above and below"


@pytest.mark.parametrize(("level", "side"), [(0.0999, (1.0, 0.0, 0.0)), (0.1, (0.0, 1.0, 0.0)), (0.1001, (0.0, 1.0, 0.0))])
def test_a_steep_motion_takes_x_for_its_side_and_any_other_its_left(level: float, side: tuple[float, float, float]) -> None:
    way = np.array([level, 0.0, math.sqrt(1.0 - level**2)])
    (points,) = entered_points(np.zeros((1, 3)), way[None], np.array([0.4]), 0.2, 0.25)
    assert (points[3] - points[4]) / 0.28 == pytest.approx(side)
