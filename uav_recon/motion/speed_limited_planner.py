"""Motion planner whose speed limit changes in flight.

With a degraded pose the guard rejects fast setpoints, so trajectories are planned at a lower speed.
"""

from __future__ import annotations

import math

from uav_recon.config import Config
from uav_recon.motion.motion_planner import MotionPlanner
from uav_recon.motion.yaw_policy import yaw_policy_of
from uav_recon.types.frames import FloatArray
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.maps import VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.recent_views import RecentViews
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Setpoint, Trajectory

SLOW_SHARE = 0.8  #: brake: planned speed with a degraded pose, of retreat_speed_mps: the transition between motions adds to it


class SpeedLimitedPlanner:
    """Two planners: the usual one, and a slow one while less than usual_mps is allowed.

    A trajectory that is already flown is braked and checked by the usual planner, whose acceleration limits hold for both.
    """

    def __init__(self, usual: MotionPlanner, slow: MotionPlanner, usual_mps: float) -> None:
        self._usual = usual
        self._slow = slow
        self._usual_mps = usual_mps
        self._max_speed_mps = math.inf
        self._views: RecentViews | None = None
        self._cells: SurfaceCells | None = None

    @staticmethod
    def of(
        config: Config, clearance_m: float, low_m: FloatArray, high_m: FloatArray, passage_m: float | None = None
    ) -> SpeedLimitedPlanner:
        """Return the planner of a config.

        low_m, high_m: (3,) box that the body's centre stays in. passage_m: see MotionPlanner.
        """
        safety, usual = config.safety, config.motion
        limits = (
            clearance_m,
            low_m,
            high_m,
            safety.max_acceleration_mps2,
            safety.vehicle_radius_m,
            yaw_policy_of(config),
            passage_m,
        )
        slow = usual.at_most(SLOW_SHARE * safety.retreat_speed_mps)
        return SpeedLimitedPlanner(MotionPlanner(usual, *limits), MotionPlanner(slow, *limits), usual.speed_mps)

    def set_max_speed(self, max_speed_mps: float) -> None:
        """Set the speed limit from now on.

        The speed never falls below that of the slow planner.
        """
        self._max_speed_mps = max_speed_mps

    def set_recent_views(self, views: RecentViews) -> None:
        """Set the views of the last seconds: where the camera does not look, speed depends on them."""
        self._views = views

    def set_surface(self, cells: SurfaceCells) -> None:
        """Set the surface by which the camera tells where it is: headings along a path depend on it."""
        self._cells = cells

    @property
    def _motion(self) -> MotionPlanner:
        return self._usual if self._max_speed_mps >= self._usual_mps else self._slow

    def plan_from_rest(
        self, path: ViewPath, voxels: VoxelMap, start: Setpoint, start_s: float, views_at_spacing_m: float, identifier: int
    ) -> Trajectory | Reason:
        """Plan from rest through the views; see MotionPlannerInterface."""
        return self._motion.plan_from_rest(
            path, voxels, start, start_s, views_at_spacing_m, identifier, self._views, self._cells
        )

    def plan_from_motion(
        self, path: ViewPath, voxels: VoxelMap, flying: Trajectory, leave_s: float, views_at_spacing_m: float, identifier: int
    ) -> Trajectory | Reason:
        """Plan out of a motion through the views; see MotionPlannerInterface."""
        return self._motion.plan_from_motion(
            path, voxels, flying, leave_s, views_at_spacing_m, identifier, self._views, self._cells
        )

    def plan_turn(self, start: Setpoint, start_s: float, total_yaw_rad: float, views: int, identifier: int) -> Trajectory:
        """Turn on the spot, always with the usual limits."""
        return self._usual.plan_turn(start, start_s, total_yaw_rad, views, identifier)

    def plan_line(self, start: Setpoint, goal_m: FloatArray, yaw_rad: float, start_s: float, identifier: int) -> Trajectory:
        """Fly straight, from rest to rest."""
        return self._motion.plan_line(start, goal_m, yaw_rad, start_s, identifier)

    def plan_stop(self, trajectory: Trajectory, now_s: float, identifier: int) -> Trajectory:
        """Brake to rest along the same path."""
        return self._usual.plan_stop(trajectory, now_s, identifier)

    def warm_up(self) -> None:
        """Compile the kernels, which both planners use."""
        self._usual.warm_up()

    def is_still_clear(self, trajectory: Trajectory, now_s: float, voxels: VoxelMap) -> bool:
        """Return True if the rest of the trajectory is clear in a newer map."""
        return self._usual.is_still_clear(trajectory, now_s, voxels)
