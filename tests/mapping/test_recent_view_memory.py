"""The mission's memory of the last views, beside that of the guard."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.geometry.min_range_binning import nearest_in_cells
from uav_recon.mapping.recent_view_memory import RecentViewMemory
from uav_recon.motion.clearance import ClearanceMap
from uav_recon.motion.sight_forecast import OLDER_S, EnteredHull, SightForecast
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.safety.sight_speed_limit import SightSpeedLimit, entered_points
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame, body_from_camera
from uav_recon.types.maps import FREE, GridSpec, VoxelMap
from uav_recon.types.pose import Pose
from uav_recon.types.recent_views import RecentViews

LENS = Intrinsics.from_fov(212, 120, math.radians(87), math.radians(58))
POSITION_M = np.array([0.1, 0.02, -0.03])
MOUNT = body_from_camera(POSITION_M, math.radians(15.0))
RADIUS_M = 0.2


def posed(stamp_s: float, body: Pose, depth_m: float = 2.0, epoch: int = 0) -> PosedFrame:
    depth = np.full((120, 212), depth_m, dtype=np.float32)
    frame = Frame(stamp_s, 1, depth, LENS, np.zeros((2, 2, 3), np.uint8), LENS, Pose.identity())
    return PosedFrame(frame, body @ MOUNT, epoch)


def test_it_spaces_its_views_and_forgets_the_old_ones_and_those_of_another_map() -> None:
    sight, here = RecentViewMemory(10.0, POSITION_M), Pose.from_yaw(0.7, np.array([1.0, 2.0, 1.5]))
    assert sight.add(posed(5.0, here)) is not None
    assert sight.add(posed(5.2, here)) is None
    assert sight.add(posed(5.9, here, depth_m=math.nan)) is None, "an empty frame shows nothing"
    views = sight.add(posed(6.0, here))
    assert views is not None
    assert views.stamp_s.tolist() == [5.0, 6.0]
    np.testing.assert_allclose(views.body_world, [[1.0, 2.0, 1.5]] * 2, atol=1e-9)
    later = sight.add(posed(15.5, here))
    assert later is not None
    assert later.stamp_s.tolist() == [6.0, 15.5]
    restarted = sight.add(posed(15.6, here, epoch=1))
    assert restarted is not None
    assert restarted.stamp_s.tolist() == [15.6]


def test_motion_plans_by_the_ages_that_the_guard_will_find() -> None:
    """Views in random directions, motions in random directions: the same ages, from the same frames."""
    rng = np.random.default_rng(3)
    mission, guard = RecentViewMemory(30.0, POSITION_M), RecentlySeenSpace(blind_memory_s=60.0, vehicle_radius_m=RADIUS_M)
    views: RecentViews | None = None
    for n in range(20):
        body = Pose.from_yaw(rng.uniform(-3, 3), np.array([0.0, 0.0, 1.5]) + rng.uniform(-0.4, 0.4, 3))
        frame = posed(float(n), body, rng.uniform(0.8, 3.0))
        views = mission.add(frame)
        guard.add(nearest_in_cells(frame.frame, MOUNT), body)
    assert views is not None
    place, direction = rng.uniform(-0.5, 0.5, (300, 5)), rng.normal(size=(300, 3))
    place[:, 2] += 1.5
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    grid = GridSpec(np.full(3, -5.0), 0.5, (20, 20, 20))
    free = VoxelMap.whole(grid, np.full(grid.shape, FREE, dtype=np.uint8), np.full(grid.shape, 81, dtype=np.uint8), 0)
    # a limit that is the age itself, in m/s
    age = SightSpeedLimit(
        full_speed_mps=0.0, blind_speed_mps=100.0, blind_fresh_s=0.0, blind_stale_s=100.0, blind_memory_s=60.0
    )
    space = ClearanceMap.of(free, np.full(3, -np.inf), np.full(3, np.inf), 0.3)
    forecast = SightForecast(views, space, age, EnteredHull(RADIUS_M, 0.25), np.zeros(2), 20.0)
    at_once = np.full(300, 20.0)
    planned_s = forecast.max_speed_mps(direction, place, at_once, np.ones(300, dtype=np.bool_))
    hulls = entered_points(place[:, :3], direction, np.full(300, 0.25), RADIUS_M, guard.reach_m)
    found_s = np.array([guard.ages_s(hull, 20.0).max() for hull in hulls])
    np.testing.assert_allclose(planned_s, np.where(np.isfinite(found_s), found_s + OLDER_S, 0.0), atol=1e-6)
    assert 0.1 < np.isfinite(found_s).mean() < 0.9
    for older_s in (0.0, 45.0, 65.0, 170.0):  # views of up to 20 s more
        now_s = 20.0 + older_s
        refused = forecast.is_refused(direction, place, np.full(300, now_s), np.ones(300, dtype=np.bool_))
        ahead = (place[:, :3] + guard.reach_m * direction).tolist()
        seen = [guard.saw_free((x, y, z), now_s, unit) for (x, y, z), unit in zip(ahead, direction, strict=True)]
        differ = refused != ~np.array(seen)
        assert not (differ & ~refused).any() and differ.mean() < 0.03, "motion is refused OLDER_S sooner"
        assert older_s > 100.0 or 0.05 < refused.mean() < 0.95


def test_older_views_are_farther_apart_and_none_is_lost_at_once() -> None:
    sight, now_s = RecentViewMemory(180.0, POSITION_M), 0.0
    views: RecentViews | None = None
    for n in range(600):
        now_s = 0.4 * n
        views = sight.add(posed(now_s, Pose.from_yaw(0.0, np.array([0.0, 0.0, 1.0])))) or views
    assert views is not None
    ages_s, apart_s = now_s - views.stamp_s, np.diff(views.stamp_s)
    assert len(ages_s) < 170 and 170.0 < ages_s[0] <= 180.0 and ages_s[-1] == 0.0
    assert (apart_s <= np.maximum(0.41, 0.07 * ages_s[:-1])).all()
    np.testing.assert_allclose(apart_s[ages_s[:-1] < 10.0], 0.4, atol=1e-9)
