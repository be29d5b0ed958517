"""How fast a motion is planned where the camera does not look, by what it will have seen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hall import CLEARANCE_M, CONFIG, HALL, RATE, path_of, room

from uav_recon.motion import MotionPlanner
from uav_recon.motion.clearance import ClearanceMap
from uav_recon.motion.sight_forecast import KNOWN_S, OLDER_S, EnteredHull, SightForecast
from uav_recon.motion.yaw_policy import YawAlongPath
from uav_recon.safety.sight_speed_limit import SightSpeedLimit
from uav_recon.types.camera import body_from_camera
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import OCCUPIED, VoxelMap
from uav_recon.types.pose import Pose
from uav_recon.types.recent_views import RecentViews
from uav_recon.types.trajectory import Setpoint, Trajectory

HALF_TAN = (math.tan(math.radians(43.5)), math.tan(math.radians(29.0)))
LIMIT = SightSpeedLimit(full_speed_mps=1.08, blind_speed_mps=0.27, blind_fresh_s=3.0, blind_stale_s=10.0, blind_memory_s=60.0)
GAZE = YawAlongPath(HALF_TAN, LIMIT, EnteredHull(0.2, 0.25), CONFIG.speed_mps, RATE)
MOTION = MotionPlanner(CONFIG, CLEARANCE_M, yaw_policy=GAZE)
HERE = np.array([0.0, 0.0, 1.5])


def looked_round(stamp_s: float, range_m: float = 9.0) -> RecentViews:
    """Eight views in all directions from HERE, all of them old."""
    bodies = [Pose.from_yaw(n * math.pi / 4, HERE) for n in range(8)]
    depths = [body @ body_from_camera(np.zeros(3), 0.0) for body in bodies]
    return RecentViews(
        np.full(8, stamp_s), np.array([depth.rotation().T for depth in depths]), np.tile(HERE, (8, 1)),
        np.tile(HERE, (8, 1)), np.full((8, 12, 16), range_m, dtype=np.float32), np.array(HALF_TAN),
    )  # fmt: skip


def sideways(views: RecentViews | None) -> Trajectory:
    """A metre to the left and two to the right, with all views to the front: too short for turns to both sides."""
    aside = np.array([0.0, 1.0, 0.0])
    legs = [np.array([HERE, HERE + aside]), np.array([HERE + aside, HERE - aside])]
    flown = MOTION.plan_from_rest(path_of(legs, [0.0, 0.0]), HALL, Setpoint.hold(HERE, 0.0), 100.0, np.inf, 1, views)
    assert isinstance(flown, Trajectory), flown
    return flown


@pytest.mark.parametrize(
    ("age_s", "least_mps", "most_mps"), [(0.5, 0.75, 1.0), (7.0, 0.3, 0.6), (20.0, 0.2, 0.28), (None, 0.2, 0.28)]
)
def test_space_seen_lately_is_entered_faster(age_s: float | None, least_mps: float, most_mps: float) -> None:
    flown = sideways(None if age_s is None else looked_round(100.0 - age_s))
    blind = np.abs(flown.yaw_rad) < 0.1
    fastest_mps = float(np.linalg.norm(flown.velocity_mps, axis=1)[blind].max())
    assert least_mps <= fastest_mps <= most_mps


def test_no_sample_is_faster_than_its_age_allows() -> None:
    """The space around was seen 2 s before the start and is not seen again: what is flown later is slower."""
    flown = sideways(looked_round(98.0))
    into_s: FloatArray = np.arange(len(flown.yaw_rad), dtype=np.float64) * flown.step_s
    speed_mps = np.linalg.norm(flown.velocity_mps, axis=1)
    allowed_mps = LIMIT.at(2.0 + into_s) / 0.9 + 1e-6
    ahead = flown.velocity_mps[:, 0] > 0.9 * speed_mps
    assert (speed_mps <= np.maximum(allowed_mps, 0.3))[~ahead].all()


def forecast(voxels: VoxelMap) -> SightForecast:
    space = ClearanceMap.of(voxels, np.full(3, -np.inf), np.full(3, np.inf), CLEARANCE_M)
    nothing = looked_round(-1e3, range_m=0.0)
    return SightForecast(nothing, space, LIMIT, EnteredHull(0.2, 0.25), 0.85 * np.array(HALF_TAN), 100.0)


def then_aside(reached_s: FloatArray, voxels: VoxelMap) -> float:
    """The limit to the left at HERE, reached last, after a view of that space from two metres behind."""
    place = np.zeros((3, 5))
    place[:, :3] = HERE - (2.0, 0.0, 0.0), HERE - (0.5, 0.0, 0.0), HERE
    place[1:, 3] = -math.pi / 2  # afterwards it looks to the right
    way = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return float(forecast(voxels).max_speed_mps(way, place, reached_s, np.array([False, False, True]))[2])


def test_what_is_seen_on_the_way_counts_from_when_it_can_be_known() -> None:
    assert then_aside(np.array([100.0, 102.0, 103.0]), HALL) == pytest.approx(LIMIT.at(np.array([3.0 + OLDER_S]))[0])
    assert then_aside(np.array([100.0, 106.0, 107.0]), HALL) == pytest.approx(LIMIT.at(np.array([7.0 + OLDER_S]))[0])
    too_soon = 100.0 + KNOWN_S - 0.01
    assert then_aside(np.array([100.0, too_soon - 0.1, too_soon]), HALL) == 0.0


def test_behind_an_obstacle_nothing_is_seen() -> None:
    post = room(([-1.2, -0.3, 0.0], [-1.0, 0.8, 3.0], OCCUPIED))
    assert then_aside(np.array([100.0, 102.0, 103.0]), post) == 0.0
