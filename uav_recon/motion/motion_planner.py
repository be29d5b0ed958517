"""Paths to trajectories: smooth, under limits, from rest or out of another motion to rest in known-free space; braking.

The path becomes an elastic band in place, yaw and camera pitch (band), which is passed as fast as the limits allow (bounds,
pace). The samples then pass two box filters: an average keeps every bound on speed, acceleration and turning, and bounds the
jerk. What comes out is checked, sample by sample, against the map.
"""

from __future__ import annotations

import copy
import dataclasses

import numpy as np

from uav_recon.config import MotionConfig
from uav_recon.motion.clearance import ClearanceMap, blocked, is_clear
from uav_recon.motion.corridor_centring import centred
from uav_recon.motion.elastic_band import ElasticBand, PathCourse
from uav_recon.motion.initial_state import InitialState
from uav_recon.motion.time_scaling import braking, joined, replayed
from uav_recon.motion.trajectory_generation import Pacer, TrajectoryGenerator
from uav_recon.motion.yaw_policy import AT_VIEWS, YawPolicy
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, GridSpec, VoxelMap
from uav_recon.types.tasks import PlanMode, ViewPath, Viewpoint
from uav_recon.types.trajectory import Setpoint, Trajectory

TOLERANCE_M = 0.05  # half a voxel: a map that changes by so much does not stop a motion ...
PLANNED_M = 0.01  # ... but none is planned nearer than the clearance by more than this
NEAR_VIEW = (0.10, float(np.radians(2.0)))  # of the band off a view; smoothing and the frame's lateness add to it
MIDDLE_M = 0.1  # more than usual it keeps on a narrow way where there is so much: what a vehicle strays there comes off it
NARROW_MPS = 0.2  # on a narrow way, where there is no more room than usual: the faster, the later a vehicle follows its bends
BRAKE_SHARE = 0.9  # of the limits: the rest covers the step of the integration
OVERRUNS = (0.0, 0.4, 1.0)  # of the braking distance, straight on before a new way is taken up; the last ends in a stop
BACK = -0.5  # cosine of present and new direction from which on only the stop is tried
ON_THE_SPOT_M = 0.05
BACK_STEPS = 5  # samples of a braked way from one waypoint back to the next


class MotionPlanner:
    """Pure: no clock, no state. Trajectories are in odom; world is taken as odom, as it is within a map epoch."""

    def __init__(
        self, config: MotionConfig, clearance_m: float, low_m: FloatArray | None = None, high_m: FloatArray | None = None,
        braking_mps2: float | None = None, hull_m: float = 0.0, gaze: YawPolicy = AT_VIEWS,
    ) -> None:  # fmt: skip
        """clearance_m: from the body's centre to anything not known free, on a path that does not say what its way keeps;
        tight_speed_mps is flown where there is no more, and NARROW_MPS on a path that says so.

        low_m, high_m: (3,) corners of the box that the body's centre stays in; none = no box. braking_mps2: with which a way
        that turns out to be blocked is left; none = what is planned with. hull_m: radius of the vehicle,
        which touches nothing where its autopilot flies on by itself for config.run_on_s. gaze: where it looks on its way.
        """
        self._low_m = np.full(3, -np.inf) if low_m is None else low_m
        self._high_m = np.full(3, np.inf) if high_m is None else high_m
        self._clearance_m = clearance_m
        self._pacer = Pacer.of(config, clearance_m, hull_m, gaze)
        self._hardness = (braking_mps2 or config.acceleration_mps2) / config.acceleration_mps2
        self._creeper = Pacer.of(config.model_copy(update={"speed_mps": config.tight_speed_mps}), clearance_m, hull_m)
        narrow_mps = min(NARROW_MPS, config.tight_speed_mps)
        self._threader = Pacer.of(config.model_copy(update={"tight_speed_mps": narrow_mps}), clearance_m, hull_m, gaze)

    def through(
        self, path: ViewPath, voxels: VoxelMap, start: Setpoint, start_s: float, views_at_spacing_m: float, identifier: int
    ) -> Trajectory | str:
        """From rest at ``start`` through every view of the path to rest at the last, or the reason why not, in words.

        Each view is captured where it is passed, within 0.15 m and 3 degrees and without blur, and one every
        ``views_at_spacing_m`` (may be infinite) on the way to it. What is flown is checked against the map.
        """
        fault = _fault(path, voxels)
        if fault:
            return fault
        entry = InitialState.resting(start, self._pacer.box)
        course = PathCourse.through(entry.place, path.waypoints_world, path.viewpoints, self._pacer.gaze)
        flight = self._clear(course, None, entry, self._space(voxels), views_at_spacing_m, path.clearance_m)
        kept_m = self._asked_m(path.clearance_m)
        return flight if isinstance(flight, str) else flight.trajectory(start_s, path.map_epoch, identifier, kept_m)

    def onward(
        self, path: ViewPath, voxels: VoxelMap, flying: Trajectory, leave_s: float, views_at_spacing_m: float, identifier: int
    ) -> Trajectory | str:
        """Out of a motion that is being flown, at ``leave_s``, through every view of the path, as ``through`` does.

        The path begins where ``flying`` is at ``leave_s``. The answer begins KEPT_S before with ``flying``'s own samples,
        leaves it without a jump in place, velocity, acceleration or heading, and may run on a little before it turns. Where
        that is not clear it brakes along ``flying`` first. views_s are those of the path alone.
        """
        fault = _fault(path, voxels)
        if fault:
            return fault
        at = max(int((leave_s - flying.start_s) / flying.step_s + 1e-6), 0)  # past its end it rests
        entry, space = InitialState.leaving(flying, at, self._pacer.box, self._pacer.most()), self._space(voxels)
        start_s, kept_m = flying.start_s + (at - entry.left + 1) * flying.step_s, self._asked_m(path.clearance_m)
        if not entry.is_moving:
            course = PathCourse.through(entry.place, _ahead(path, entry, entry.place), path.viewpoints, self._pacer.gaze)
            still = self._clear(course, None, entry, space, views_at_spacing_m, path.clearance_m)
            return still if isinstance(still, str) else still.trajectory(start_s, path.map_epoch, identifier, kept_m)
        for overrun in OVERRUNS if _leads_on(path, entry) else OVERRUNS[-1:]:
            rolled, begin = self._pacer.begun(entry, overrun)
            course = PathCourse.through(begin, _ahead(path, entry, begin), path.viewpoints, self._pacer.gaze)
            if overrun > 0.0:
                course = course.after(rolled, overrun >= 1.0)
            flight = self._clear(course, entry.place, entry, space, views_at_spacing_m, path.clearance_m)
            if isinstance(flight, TrajectoryGenerator) and not self._pacer.gaze.hasty(flight.rows[entry.left :]).any():
                return flight.trajectory(start_s, path.map_epoch, identifier, kept_m)
        return self._after_braking(path, voxels, flying, at, views_at_spacing_m, identifier)

    def turn(self, start: Setpoint, start_s: float, total_yaw_rad: float, views: int, identifier: int) -> Trajectory:
        """Look round on the spot; ``views`` captures, equally spread over the angle, the last at its end."""
        entry = InitialState.resting(start, self._pacer.box)
        vertex = np.tile(entry.place, (max(views, 1) + 1, 1))
        vertex[:, 3] += np.linspace(0.0, total_yaw_rad, len(vertex))
        course = PathCourse(vertex, np.arange(1, views + 1), np.zeros(len(vertex), dtype=np.bool_))
        band = ElasticBand.along(course, self._pacer.span_rad, None)
        return self._pacer.flown(band, entry, None, np.inf).trajectory(start_s, 0, identifier)

    def line(self, start: Setpoint, goal_m: FloatArray, yaw_rad: float, start_s: float, identifier: int) -> Trajectory:
        """Straight, rest to rest, at the tight speed and without a look at the map: take-off and descent."""
        entry = InitialState.resting(start, self._pacer.box)
        goal = np.asarray(goal_m, dtype=np.float64)
        course = PathCourse.through(entry.place, [goal[None]], [Viewpoint(goal, yaw_rad, start.camera_pitch_down_rad)])
        band = ElasticBand.along(course, self._creeper.span_rad, None)
        flown = self._creeper.flown(band, entry, None, np.inf).trajectory(start_s, 0, identifier)
        return dataclasses.replace(flown, views_s=np.zeros(0))

    def stop(self, trajectory: Trajectory, now_s: float, identifier: int) -> Trajectory:
        """Brake along the same path, as hard as a blocked way asks for, to rest; captures nothing."""
        return self._braked(trajectory, now_s, identifier, self._hardness)

    def still_clear(self, trajectory: Trajectory, now_s: float, voxels: VoxelMap) -> bool:
        """Whether what is left of the trajectory is clear in a newer map; False for a map of another epoch."""
        if trajectory.map_epoch != voxels.map_epoch:
            return False
        first = int(np.clip((now_s - trajectory.start_s) / trajectory.step_s, 0, len(trajectory.yaw_rad) - 1))
        return is_clear(self._space(voxels), trajectory.position_m, first, self._asked_m(trajectory.clearance_m) - TOLERANCE_M)

    def _braked(self, trajectory: Trajectory, now_s: float, identifier: int, hardness: float) -> Trajectory:
        """hardness: 1 for the limits of planned motion."""
        into_s = now_s - trajectory.start_s
        if into_s <= 0.0 or into_s >= trajectory.duration_s:
            still = np.zeros(2)
            return replayed(trajectory, min(max(into_s, 0.0), trajectory.duration_s), (still, still, still), now_s, identifier)
        share = BRAKE_SHARE * hardness
        pace = braking(trajectory, into_s, share * self._pacer.acceleration, share * self._pacer.spin)
        return replayed(trajectory, into_s, pace, now_s, identifier)

    def _asked_m(self, clearance_m: float | None) -> float:
        return self._clearance_m if clearance_m is None else clearance_m

    def _space(self, voxels: VoxelMap) -> ClearanceMap:
        return ClearanceMap.of(voxels, self._low_m, self._high_m, self._clearance_m)

    def warm_up(self) -> None:
        """Compile the kernels, in a map of its own without the box to stay in."""
        planner = copy.copy(self)
        planner._low_m, planner._high_m = np.full(3, -np.inf), np.full(3, np.inf)
        grid = GridSpec(np.zeros(3), 1.0, (3, 3, 3))
        voxels = VoxelMap.whole(grid, np.full(grid.shape, FREE, dtype=np.uint8), np.full(grid.shape, 81, dtype=np.uint8), 0)
        goal = Viewpoint(np.array([2.0, 1.0, 1.0]), 0.5, 0.0)
        path = ViewPath((goal,), (goal.position_world[None],), PlanMode.EXPLORE, 0, 0, (), 0.0, 0.0)
        flown = planner.through(path, voxels, Setpoint.hold(np.ones(3), 0.0), 0.0, 0.5, 0)
        if isinstance(flown, Trajectory):
            planner.stop(flown, 1.0, 1)
            planner.still_clear(flown, 1.0, voxels)
            planner.onward(path, voxels, flown, 1.0, 0.5, 2)
            planner.through(dataclasses.replace(path, clearance_m=1.0), voxels, Setpoint.hold(np.ones(3), 0.0), 0.0, 0.5, 0)

    def _clear(
        self,
        course: PathCourse,
        before: FloatArray | None,
        entry: InitialState,
        space: ClearanceMap,
        spacing_m: float,
        clearance_m: float | None,
    ) -> TrajectoryGenerator | str:
        """A flight along the course that is clear by ``clearance_m``, or why there is none.

        Where the relaxed band comes too close to something, the nearest corner is made a stop; if that does not do, all are,
        and the band is left as the polyline is.
        """
        stop, min_m = course.stop.copy(), self._asked_m(clearance_m) - PLANNED_M
        pacer, room_m = self._pacer, self._clearance_m
        if clearance_m is not None:
            pacer, room_m = self._threader, self._clearance_m + MIDDLE_M
        for attempt in range(3):
            strung = course.with_stops(stop)
            band = ElasticBand.along(strung, self._pacer.span_rad, before)
            if attempt < 2 and clearance_m is not None:
                band = centred(band, space, room_m)
            if attempt < 2:
                band = band.relaxed(strung, space, room_m, min_m, NEAR_VIEW)
            flight = pacer.flown(band, entry, space, spacing_m)
            if not flight.feasible:
                return "the present motion is too fast for the way that was planned"
            bad = blocked(space, flight.rows, entry.left, min_m)
            if not bad.any():
                return flight
            if attempt == 0:
                reach_m = course.vertex[:, None, :3] - flight.rows[bad][None, :, :3]
                stop[np.argmin(np.linalg.norm(reach_m, axis=2), axis=0)] = True
            else:
                stop[:] = True
        where = ", ".join(f"{value:.2f}" for value in flight.rows[np.argmax(bad), :3])
        return f"the way is not clear by {min_m:.2f} m at ({where})"

    def _after_braking(
        self, path: ViewPath, voxels: VoxelMap, flying: Trajectory, at: int, spacing_m: float, identifier: int
    ) -> Trajectory | str:
        """Brake along what is being flown, then from rest, straight to the path's own way or back to where it begins."""
        leave_s = flying.start_s + at * flying.step_s
        braked = self._braked(flying, leave_s, identifier, 1.0)
        rest = braked.setpoint_at(leave_s + braked.duration_s)
        here = Setpoint.hold(rest.position_m, rest.yaw_rad, rest.camera_pitch_down_rad)
        first, *others = path.waypoints_world
        back = braked.position_m[::-BACK_STEPS]
        flown: Trajectory | str = ""
        for leg in (first[1:], np.vstack([back, first])):
            way = dataclasses.replace(path, waypoints_world=(leg, *others))
            flown = self.through(way, voxels, here, leave_s + braked.duration_s, spacing_m, identifier)
            if isinstance(flown, Trajectory):
                return joined(flying, at, braked, flown)
        return flown


def _fault(path: ViewPath, voxels: VoxelMap) -> str:
    """Why a path cannot be flown whatever its shape, '' if it can."""
    if path.map_epoch != voxels.map_epoch:
        return f"the path is of map epoch {path.map_epoch}, the map of {voxels.map_epoch}"
    return "" if path.viewpoints else "the path has no view"


def _leads_on(path: ViewPath, entry: InitialState) -> bool:
    """Whether the path begins in about the direction of the present motion, or with a turn on the spot."""
    first = np.vstack([path.waypoints_world[0], path.viewpoints[0].position_world]) - entry.place[:3]
    away_m = np.linalg.norm(first, axis=1)
    if not (away_m > ON_THE_SPOT_M).any():
        return True
    way = first[int(np.argmax((away_m > ON_THE_SPOT_M) & (np.arange(len(first)) > 0)))]
    velocity = entry.velocity[:3]
    return bool(way @ velocity >= BACK * np.linalg.norm(way) * np.linalg.norm(velocity))


def _ahead(path: ViewPath, entry: InitialState, begin: FloatArray) -> list[FloatArray]:
    """The legs without their beginning, and without waypoints that are passed while the old motion dies away."""
    left = entry.rows[entry.left, :3]
    first, *others = path.waypoints_world
    coast_m = float(np.linalg.norm(begin[:3] - left))
    away_m = np.linalg.norm(first - left, axis=1)
    passed = int(np.argmax(away_m > coast_m)) if (away_m > coast_m).any() else len(first)
    return [first[passed:], *others]
