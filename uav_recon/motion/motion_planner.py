"""Motion planner: from paths to smooth trajectories within limits, and braking.

A trajectory starts at rest or out of another motion and ends at rest in known-free space. The path becomes an elastic band
in position, yaw and camera pitch (elastic_band), which is passed as fast as the limits allow (speed_limits,
time_parameterization). The samples then pass two box filters: an average keeps every bound on speed, acceleration and
turning, and bounds the jerk. The result is checked against the map, sample by sample.
"""

from __future__ import annotations

import copy
import dataclasses

import numpy as np

from uav_recon.config import MotionConfig
from uav_recon.motion import sight_forecast
from uav_recon.motion.clearance import ClearanceMap, blocked, is_clear
from uav_recon.motion.corridor_centring import centred
from uav_recon.motion.elastic_band import ElasticBand, PathCourse
from uav_recon.motion.initial_state import InitialState
from uav_recon.motion.sight_forecast import SightForecast
from uav_recon.motion.time_scaling import braking, joined, rescaled
from uav_recon.motion.trajectory_generation import TrajectoryGenerator, TrajectorySamples
from uav_recon.motion.yaw_policy import AT_VIEWS, YawPolicy
from uav_recon.types.frames import FloatArray
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.maps import FREE, GridSpec, VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.recent_views import RecentViews
from uav_recon.types.tasks import PlanMode, ViewPath, Viewpoint
from uav_recon.types.trajectory import Setpoint, Trajectory

TOLERANCE_M = 0.05  #: brake: the clearance of the rest of a motion falls by more in a newer map; less is half a voxel
PLANNED_M = 0.01  #: refuse: a plan whose clearance is smaller by more than this
NEAR_VIEW = (0.10, float(np.radians(2.0)))  # tolerance of the band at a view, m and rad; smoothing and late frames add to it
#: plan: kept on a narrow path beyond the usual clearance where there is room: path error reduces it
NARROW_EXTRA_CLEARANCE_M = 0.1
NARROW_MPS = 0.2  #: brake: speed on a narrow path with only the usual clearance: the faster it is, the later it follows bends
BRAKE_SHARE = 0.9  # share of the limits: the rest covers the step of the integration
OVERRUN_SHARES = (
    0.0,
    0.4,
    1.0,
)  # shares of the braking distance flown straight on before the new path; the last ends in a stop
MIN_FORWARD_COS = -0.5  # cosine of the angle between present and new direction, below which only the stop is tried
ON_THE_SPOT_M = 0.05
PLANNED_S = 0.3  # from the newest view to the start of a motion from rest
BACK_STEPS = 5  # samples of a braked path between consecutive waypoints of the path back


class MotionPlanner:
    """Motion planner without clock or state.

    Trajectories are in odom. The world frame is taken as odom, which holds within a map epoch.
    """

    def __init__(
        self, config: MotionConfig, clearance_m: float, low_m: FloatArray | None = None, high_m: FloatArray | None = None,
        braking_mps2: float | None = None, hull_m: float = 0.0, yaw_policy: YawPolicy = AT_VIEWS,
        passage_m: float | None = None,
    ) -> None:  # fmt: skip
        """Set the limits.

        clearance_m: distance from the body's centre to anything not known free, on a path that does not state its own
            clearance. tight_speed_mps is flown where there is no more, and NARROW_MPS on a path that states its clearance.
        low_m, high_m: (3,) corners of the box that the body's centre stays in; None = no box.
        braking_mps2: deceleration when a path turns out to be blocked; None = that of planned motion.
        hull_m: radius of the vehicle, which touches nothing while its autopilot flies on without setpoints for config.run_on_s.
        yaw_policy: where the vehicle looks on its path. passage_m: clearance that is enough where a fine map shows it, at
            PASSAGE_MPS; None = clearance_m.
        """
        self._low_m = np.full(3, -np.inf) if low_m is None else low_m
        self._high_m = np.full(3, np.inf) if high_m is None else high_m
        self._clearance_m = clearance_m
        self._fine_credit_m = max(clearance_m - (clearance_m if passage_m is None else passage_m), 0.0)
        self._generator = TrajectoryGenerator.of(config, clearance_m, hull_m, yaw_policy)
        self._braking_ratio = (braking_mps2 or config.acceleration_mps2) / config.acceleration_mps2
        self._slow_generator = TrajectoryGenerator.of(
            config.model_copy(update={"speed_mps": config.tight_speed_mps}), clearance_m, hull_m
        )
        narrow_mps = min(NARROW_MPS, config.tight_speed_mps)
        self._narrow_generator = TrajectoryGenerator.of(
            config.model_copy(update={"tight_speed_mps": narrow_mps}), clearance_m, hull_m, yaw_policy
        )

    def plan_from_rest(
        self, path: ViewPath, voxels: VoxelMap, start: Setpoint, start_s: float, views_at_spacing_m: float, identifier: int,
        views: RecentViews | None = None, cells: SurfaceCells | None = None,
    ) -> Trajectory | Reason:  # fmt: skip
        """Plan from rest at ``start`` through every view of the path to rest at the last one.

        Each view is captured where it is passed, within 0.15 m and 3 degrees and without motion blur. Further captures follow
        every ``views_at_spacing_m`` (may be infinite) along the path. The trajectory is checked against the map. If there is
        none, the reason is returned. views: of the last seconds; it may be flown later than start_s, but soon after them.
        cells: surface by which the camera tells where it is, None if that does not matter.
        """
        fault = _fault(path, voxels)
        if fault:
            return fault
        entry, clearance_map = InitialState.at_rest(start, self._generator.box), self._clearance_map(voxels)
        forecast = self._forecast(views, cells, clearance_map, start_s)
        course = PathCourse.through(entry.place, path.waypoints_world, path.viewpoints, self._generator.yaw_policy, forecast)
        samples = self._clear(course, None, entry, clearance_map, views_at_spacing_m, path.clearance_m, forecast)
        kept_m = self._asked_m(path.clearance_m)
        return samples if isinstance(samples, Reason) else samples.trajectory(start_s, path.map_epoch, identifier, kept_m)

    def plan_from_motion(
        self, path: ViewPath, voxels: VoxelMap, flying: Trajectory, leave_s: float, views_at_spacing_m: float, identifier: int,
        views: RecentViews | None = None, cells: SurfaceCells | None = None,
    ) -> Trajectory | Reason:  # fmt: skip
        """Plan out of a motion that is being flown, at ``leave_s``, through every view of the path.

        Limits and result are those of ``plan_from_rest``. The path begins where ``flying`` is at ``leave_s``. The trajectory
        begins KEPT_S before that with ``flying``'s own samples. It leaves ``flying`` without a jump in position, velocity,
        acceleration or heading, and may continue for a short distance before it turns. If that is not clear, it brakes along
        ``flying`` first. views_s contains the views of the path only.
        """
        fault = _fault(path, voxels)
        if fault:
            return fault
        at = max(int((leave_s - flying.start_s) / flying.step_s + 1e-6), 0)  # past its end it rests
        entry = InitialState.in_motion(flying, at, self._generator.box, self._generator.max_acceleration())
        clearance_map = self._clearance_map(voxels)
        start_s, kept_m = flying.start_s + (at - entry.left + 1) * flying.step_s, self._asked_m(path.clearance_m)
        forecast, yaw_policy = self._forecast(views, cells, clearance_map, leave_s), self._generator.yaw_policy
        if not entry.is_moving:
            course = PathCourse.through(entry.place, _ahead(path, entry, entry.place), path.viewpoints, yaw_policy, forecast)
            still = self._clear(course, None, entry, clearance_map, views_at_spacing_m, path.clearance_m, forecast)
            return still if isinstance(still, Reason) else still.trajectory(start_s, path.map_epoch, identifier, kept_m)
        for overrun in OVERRUN_SHARES if _leads_on(path, entry) else OVERRUN_SHARES[-1:]:
            rolled, begin = self._generator.continued_positions(entry, overrun)
            course = PathCourse.through(begin, _ahead(path, entry, begin), path.viewpoints, yaw_policy, forecast)
            if overrun > 0.0:
                course = course.with_start(rolled, overrun >= 1.0)
            samples = self._clear(course, entry.place, entry, clearance_map, views_at_spacing_m, path.clearance_m, forecast)
            if isinstance(samples, TrajectorySamples) and not self._generator.exceeds_limit(samples, entry, forecast).any():
                return samples.trajectory(start_s, path.map_epoch, identifier, kept_m)
        return self._after_braking(path, voxels, flying, at, views_at_spacing_m, identifier, views, cells)

    def plan_turn(self, start: Setpoint, start_s: float, total_yaw_rad: float, views: int, identifier: int) -> Trajectory:
        """Turn on the spot and capture ``views`` views.

        They are equally spaced in angle; the last is at the end.
        """
        entry = InitialState.at_rest(start, self._generator.box)
        vertex = np.tile(entry.place, (max(views, 1) + 1, 1))
        vertex[:, 3] += np.linspace(0.0, total_yaw_rad, len(vertex))
        course = PathCourse(vertex, np.arange(1, views + 1), np.zeros(len(vertex), dtype=np.bool_))
        band = ElasticBand.along(course, self._generator.span_rad, None)
        return self._generator.generate(band, entry, None, np.inf).trajectory(start_s, 0, identifier)

    def plan_line(self, start: Setpoint, goal_m: FloatArray, yaw_rad: float, start_s: float, identifier: int) -> Trajectory:
        """Fly straight from rest to rest at the tight speed, for take-off and descent.

        The map is not checked.
        """
        entry = InitialState.at_rest(start, self._generator.box)
        goal = np.asarray(goal_m, dtype=np.float64)
        course = PathCourse.through(entry.place, [goal[None]], [Viewpoint(goal, yaw_rad, start.camera_pitch_down_rad)])
        band = ElasticBand.along(course, self._slow_generator.span_rad, None)
        flown = self._slow_generator.generate(band, entry, None, np.inf).trajectory(start_s, 0, identifier)
        return dataclasses.replace(flown, views_s=np.zeros(0))

    def plan_stop(self, trajectory: Trajectory, now_s: float, identifier: int) -> Trajectory:
        """Brake to rest along the same path, with the deceleration for a blocked path; no captures."""
        return self._braked(trajectory, now_s, identifier, self._braking_ratio)

    def is_still_clear(self, trajectory: Trajectory, now_s: float, voxels: VoxelMap) -> bool:
        """Return True if the rest of the trajectory is clear in a newer map.

        False for a map of another epoch.
        """
        if trajectory.map_epoch != voxels.map_epoch:
            return False
        first = int(np.clip((now_s - trajectory.start_s) / trajectory.step_s, 0, len(trajectory.yaw_rad) - 1))
        return is_clear(
            self._clearance_map(voxels), trajectory.position_m, first, self._asked_m(trajectory.clearance_m) - TOLERANCE_M
        )

    def _braked(self, trajectory: Trajectory, now_s: float, identifier: int, braking_ratio: float) -> Trajectory:
        """Brake to rest along the same path.

        braking_ratio: deceleration; 1 = the limits of planned motion.
        """
        into_s = now_s - trajectory.start_s
        if into_s <= 0.0 or into_s >= trajectory.duration_s:
            still = np.zeros(2)
            return rescaled(trajectory, min(max(into_s, 0.0), trajectory.duration_s), (still, still, still), now_s, identifier)
        share = BRAKE_SHARE * braking_ratio
        pace = braking(trajectory, into_s, share * self._generator.acceleration, share * self._generator.yaw_acceleration)
        return rescaled(trajectory, into_s, pace, now_s, identifier)

    def _asked_m(self, clearance_m: float | None) -> float:
        return self._clearance_m if clearance_m is None else clearance_m

    def _forecast(
        self, views: RecentViews | None, cells: SurfaceCells | None, clearance_map: ClearanceMap, start_s: float
    ) -> SightForecast | None:
        newest_s = -np.inf if views is None else float(views.stamp_s[-1])
        return self._generator.yaw_policy.forecast(views, cells, clearance_map, max(start_s, newest_s + PLANNED_S))

    def _clearance_map(self, voxels: VoxelMap) -> ClearanceMap:
        return ClearanceMap.of(voxels, self._low_m, self._high_m, self._clearance_m, self._fine_credit_m)

    def warm_up(self) -> None:
        """Compile the kernels, in a map of its own without the box to stay in."""
        sight_forecast.warm_up()
        planner = copy.copy(self)
        planner._low_m, planner._high_m = np.full(3, -np.inf), np.full(3, np.inf)
        grid = GridSpec(np.zeros(3), 1.0, (3, 3, 3))
        voxels = VoxelMap.whole(grid, np.full(grid.shape, FREE, dtype=np.uint8), np.full(grid.shape, 81, dtype=np.uint8), 0)
        goal = Viewpoint(np.array([2.0, 1.0, 1.0]), 0.5, 0.0)
        path = ViewPath((goal,), (goal.position_world[None],), PlanMode.EXPLORE, 0, 0, (), 0.0, 0.0)
        flown = planner.plan_from_rest(path, voxels, Setpoint.hold(np.ones(3), 0.0), 0.0, 0.5, 0)
        fine = dataclasses.replace(voxels, fine=(voxels,))
        planner.plan_from_rest(path, fine, Setpoint.hold(np.ones(3), 0.0), 0.0, 0.5, 0)
        if isinstance(flown, Trajectory):
            planner.plan_stop(flown, 1.0, 1)
            planner.is_still_clear(flown, 1.0, voxels)
            planner.plan_from_motion(path, voxels, flown, 1.0, 0.5, 2)
            planner.plan_from_rest(
                dataclasses.replace(path, clearance_m=1.0), voxels, Setpoint.hold(np.ones(3), 0.0), 0.0, 0.5, 0
            )

    def _clear(
        self,
        course: PathCourse,
        before: FloatArray | None,
        entry: InitialState,
        clearance_map: ClearanceMap,
        spacing_m: float,
        clearance_m: float | None,
        forecast: SightForecast | None,
    ) -> TrajectorySamples | Reason:
        """Return a trajectory along the course with ``clearance_m``, or the reason for the failure.

        If the relaxed band comes too close to something, the nearest corners become stops. If that is not enough, all corners
        become stops and the band is not relaxed.
        """
        stop, min_m = course.stop.copy(), self._asked_m(clearance_m) - PLANNED_M
        generator, wanted_m = self._generator, self._clearance_m
        if clearance_m is not None:
            generator, wanted_m = self._narrow_generator, self._clearance_m + NARROW_EXTRA_CLEARANCE_M
        elif clearance_map.is_finer_than_needed(course.vertex, self._clearance_m):
            wanted_m = self._clearance_m + NARROW_EXTRA_CLEARANCE_M
        narrow = wanted_m > self._clearance_m
        for attempt in range(3):
            strung = course.with_stops(stop)
            band = ElasticBand.along(strung, self._generator.span_rad, before)
            if attempt < 2 and narrow:
                band = centred(band, clearance_map, wanted_m)
            if attempt < 2:
                band = band.relaxed(strung, clearance_map, wanted_m, min_m, NEAR_VIEW)
            samples = generator.generate(band, entry, clearance_map, spacing_m, forecast)
            if not samples.feasible:
                return Reason(ReasonCode.PATH_ENTRY_TOO_FAST)
            bad = blocked(clearance_map, samples.rows, entry.left, min_m)
            if not bad.any():
                return samples
            if attempt == 0:
                reach_m = course.vertex[:, None, :3] - samples.rows[bad][None, :, :3]
                stop[np.argmin(np.linalg.norm(reach_m, axis=2), axis=0)] = True
            else:
                stop[:] = True
        return Reason(ReasonCode.PATH_CLEARANCE, (min_m, *samples.rows[np.argmax(bad), :3].tolist()))

    def _after_braking(
        self, path: ViewPath, voxels: VoxelMap, flying: Trajectory, at: int, spacing_m: float, identifier: int,
        views: RecentViews | None, cells: SurfaceCells | None,
    ) -> Trajectory | Reason:  # fmt: skip
        """Brake along the present motion, then fly the path from rest.

        It joins the path directly, or returns to where the path begins if that is not clear.
        """
        leave_s = flying.start_s + at * flying.step_s
        braked = self._braked(flying, leave_s, identifier, 1.0)
        rest = braked.setpoint_at(leave_s + braked.duration_s)
        here = Setpoint.hold(rest.position_m, rest.yaw_rad, rest.camera_pitch_down_rad)
        first, *others = path.waypoints_world
        back = braked.position_m[::-BACK_STEPS]
        start_s = leave_s + braked.duration_s

        def along(leg: FloatArray) -> Trajectory | Reason:
            way = dataclasses.replace(path, waypoints_world=(leg, *others))
            return self.plan_from_rest(way, voxels, here, start_s, spacing_m, identifier, views, cells)

        flown = along(first[1:])
        if isinstance(flown, Reason):
            flown = along(np.vstack([back, first]))
        return flown if isinstance(flown, Reason) else joined(flying, at, braked, flown)


def _fault(path: ViewPath, voxels: VoxelMap) -> Reason | None:
    """Return the reason why a path of any shape cannot be flown, None if there is none."""
    if path.map_epoch != voxels.map_epoch:
        return Reason(ReasonCode.PATH_MAP_EPOCH, (path.map_epoch, voxels.map_epoch))
    return None if path.viewpoints else Reason(ReasonCode.PATH_WITHOUT_VIEW)


def _leads_on(path: ViewPath, entry: InitialState) -> bool:
    """Return True if the path begins in about the direction of motion, or with a turn."""
    first = np.vstack([path.waypoints_world[0], path.viewpoints[0].position_world]) - entry.place[:3]
    away_m = np.linalg.norm(first, axis=1)
    if not (away_m > ON_THE_SPOT_M).any():
        return True
    way = first[int(np.argmax((away_m > ON_THE_SPOT_M) & (np.arange(len(first)) > 0)))]
    velocity = entry.velocity[:3]
    return bool(way @ velocity >= MIN_FORWARD_COS * np.linalg.norm(way) * np.linalg.norm(velocity))


def _ahead(path: ViewPath, entry: InitialState, begin: FloatArray) -> list[FloatArray]:
    """Return the legs without the waypoints that are passed while the old motion ends."""
    left = entry.rows[entry.left, :3]
    first, *others = path.waypoints_world
    coast_m = float(np.linalg.norm(begin[:3] - left))
    away_m = np.linalg.norm(first - left, axis=1)
    passed = int(np.argmax(away_m > coast_m)) if (away_m > coast_m).any() else len(first)
    return [first[passed:], *others]
