"""Selection of keyframes: views are spent on surface that no keyframe has shown well."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.mapping.keyframe_selection import (
    BUDGET_RESERVE_FACTOR,
    FIXED_POINT_SCALE,
    OBSERVATIONS_PER_VOXEL,
    REPEATED,
    KeyframeSelection,
    _value,
)
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame, body_from_camera
from uav_recon.types.maps import GridSpec
from uav_recon.types.pose import Pose

LENS = Intrinsics.from_fov(106, 60, np.radians(87.0), np.radians(58.0))
MANY = 600  # views left: each one needs only a small gain
LOW, HIGH = np.array([0.0, -2.0, 0.0]), np.array([4.0, 2.0, 2.5])


def wall_seen(y: float, yaw_rad: float, depth_m: float = 2.0) -> PosedFrame:
    """Return a frame that sees a wall at depth_m, perpendicular to the view direction."""
    depth = np.full((LENS.height, LENS.width), depth_m, np.float32)
    frame = Frame(0.0, 1, depth, LENS, np.zeros((60, 106, 3), np.uint8), LENS, Pose.identity())
    body = Pose.from_yaw(yaw_rad, np.array([2.0, y, 1.2]))
    return PosedFrame(frame, body @ body_from_camera(np.zeros(3), 0.0))


@pytest.fixture()
def coverage() -> KeyframeSelection:
    grid = GridSpec.covering(LOW - 0.3, HIGH + 0.3, 0.1)
    return KeyframeSelection(grid, LOW, HIGH, noise_px=0.01, baseline_m=0.05)


def test_new_surface_is_worth_a_view_and_a_repeated_image_is_not(coverage: KeyframeSelection) -> None:
    posed = wall_seen(0.0, 0.0)
    assert coverage.selects(posed, views_left=MANY, explored=False)
    coverage.keep(posed)
    assert not coverage.selects(posed, views_left=MANY, explored=False)
    assert not coverage.selects(wall_seen(0.05, 0.0), views_left=MANY, explored=False)  # moved less than the baseline


def test_surface_needs_several_views_and_then_no_more(coverage: KeyframeSelection) -> None:
    for i in range(int(OBSERVATIONS_PER_VOXEL) + 4):
        posed = wall_seen(0.3 * (i % 2), 0.0)
        coverage.keep(posed)
    assert not coverage.selects(
        wall_seen(0.3, 0.0), views_left=10_000, explored=False
    )  # the surface in this view has been seen well
    assert coverage.selects(wall_seen(0.0, np.pi), views_left=MANY, explored=False)


def test_the_sum_of_views_is_kept_and_a_query_changes_nothing(coverage: KeyframeSelection) -> None:
    rng = np.random.default_rng(4)
    for step in range(40):
        posed = wall_seen(float(rng.uniform(-1, 1)), float(rng.uniform(-0.3, 0.3)), float(rng.uniform(0.5, 1.9)))
        before = coverage._looks.copy()
        coverage.selects(posed, views_left=MANY, explored=False)
        np.testing.assert_array_equal(coverage._looks, before)
        if step % 2:
            coverage.keep(posed)
    looks = coverage._looks[coverage._looks > 0].tolist()
    np.testing.assert_allclose(coverage.total_observation_weight(), sum(_value(count) for count in looks))
    assert coverage.total_observation_weight() > 500 and coverage._looks.max() == OBSERVATIONS_PER_VOXEL * FIXED_POINT_SCALE


def test_a_further_observation_counts_less_than_the_first(coverage: KeyframeSelection) -> None:
    posed, given = wall_seen(0.0, 0.0), [0.0]
    for _ in range(4):
        coverage.keep(posed)
        given.append(coverage.total_observation_weight())
    gains = np.diff(given)
    np.testing.assert_allclose(gains / gains[0], [1.0, REPEATED, REPEATED**2, 0.0], atol=1e-3)


def test_noisy_depth_counts_for_less() -> None:
    grid = GridSpec.covering(LOW - 6.0, HIGH + 6.0, 0.1)
    gains = []
    for noise_px in (0.01, 0.2):
        coverage = KeyframeSelection(grid, LOW, HIGH, noise_px=noise_px, baseline_m=0.05)
        coverage.keep(wall_seen(0.0, 0.0, depth_m=4.0))
        gains.append(coverage.total_observation_weight())
    assert gains[1] < 0.5 * gains[0]


def test_no_budget_and_no_depth_are_worth_nothing(coverage: KeyframeSelection) -> None:
    assert not coverage.selects(wall_seen(0.0, 0.0), views_left=0, explored=False)
    assert not coverage.selects(wall_seen(0.0, 0.0, depth_m=float("nan")), views_left=60, explored=False)


def test_a_smaller_budget_needs_a_larger_gain(coverage: KeyframeSelection) -> None:
    """The gain that each view must bring grows as the budget shrinks."""
    posed = wall_seen(0.0, 0.0, depth_m=1.0)  # a small area is in view
    assert coverage.selects(posed, views_left=2000, explored=False)
    assert not coverage.selects(posed, views_left=5, explored=False)


def test_an_explored_room_keeps_no_views_for_tasks_to_come(coverage: KeyframeSelection) -> None:
    """Once nothing is left to explore, a view that brings its share is taken."""
    posed = wall_seen(0.0, 0.0, depth_m=1.0)
    views = next(n for n in range(5, 2000) if coverage.selects(posed, views_left=n, explored=True))
    assert not coverage.selects(posed, views_left=views, explored=False)
    assert coverage.selects(posed, views_left=math.ceil(BUDGET_RESERVE_FACTOR * views), explored=False)
