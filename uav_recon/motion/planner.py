"""Paths to trajectories: smooth, under limits, from rest to rest in known-free space; braking; the check of what is left.

A polyline gets the fastest speed profile under its local limits (forward and backward pass over arc length), headings
turn meanwhile as trapezoids of rate, and the samples then pass two box filters. A filter is an average, so it keeps
every bound on speed, acceleration and turning, bounds the jerk, and rounds the corners; what the corners cost in
acceleration sets the speed through them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from uav_recon.config import MotionConfig
from uav_recon.motion.profile import CREEP_MPS, NODE_M, Line, Turn, along_at, pass_times
from uav_recon.motion.replay import STEP_S, braking, replayed, stretched
from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.maps import FREE, GridSpec, VoxelMap
from uav_recon.types.tasks import PlanMode, ViewPath, Viewpoint
from uav_recon.types.trajectory import Setpoint, Trajectory

ON_THE_SPOT_M = 0.05  # a leg shorter than this is a turn on the spot
OPEN_M = 0.3  # full speed where there is so much room beyond the clearance
TOLERANCE_M = 0.05  # half a voxel: what a lookup in the distance field is uncertain by
LEAVING_M = 0.3  # so much of the way is not checked: the body must be able to leave a tight spot ...
ESCAPE_M = 2.0  # ... and may fly so far through free space without the clearance, until it has it once
TRIES = 6
BRAKE_SHARE = 0.9  # of the limits: the rest covers the step of the integration


class MotionPlanner:
    """Pure: no clock, no state. Trajectories are in odom; world is taken as odom, as it is within a map epoch."""

    def __init__(self, config: MotionConfig, clearance_m: float) -> None:
        """clearance_m: from the body's centre to anything not known free; tight_speed_mps is flown where there is no more."""
        self._speed, self._tight_speed, self._clearance_m = config.speed_mps, config.tight_speed_mps, clearance_m
        self._acceleration = config.acceleration_mps2
        self._rate, self._spin = np.radians(config.yaw_rate_degps), np.radians(config.yaw_acceleration_degps2)
        self._box = max(int(config.smoothing_s / 2 / STEP_S) // 2 * 2 + 1, 1)

    def through(
        self, path: ViewPath, voxels: VoxelMap, start: Setpoint, start_s: float, views_at_spacing_m: float, identifier: int
    ) -> Trajectory | str:
        """From rest at ``start`` through every view of the path to rest at the last, or the reason why not, in words.

        Each view is captured where it is reached, and one every ``views_at_spacing_m`` (may be infinite) on the way to it.
        The flown curve is checked against the map; where a rounded corner comes too close, the corner is taken at a crawl.
        """
        if path.map_epoch != voxels.map_epoch:
            return f"the path is of map epoch {path.map_epoch}, the map of {voxels.map_epoch}"
        if not path.viewpoints:
            return "the path has no view"
        legs = [np.vstack([leg, view.position_world]) for leg, view in zip(path.waypoints_world, path.viewpoints, strict=True)]
        line = Line.through(start.position_m, legs)
        limit = self._limits(line, voxels)
        blocked = np.zeros(0, dtype=np.bool_)
        for attempt in range(3):
            trajectory = self._along(
                line, path.viewpoints, limit, start, start_s, views_at_spacing_m, path.map_epoch, identifier
            )
            blocked = self._blocked(trajectory.position_m, voxels)
            if not blocked.any():
                return trajectory
            if attempt == 0 and len(line.corners):
                reach_m = line.position_m[line.corners][:, None] - trajectory.position_m[blocked][None]
                limit[line.corners[np.argmin(np.linalg.norm(reach_m, axis=2), axis=0)]] = CREEP_MPS
            else:
                limit[line.corners] = CREEP_MPS
        where = ", ".join(f"{value:.2f}" for value in trajectory.position_m[np.argmax(blocked)])
        return f"the way is not clear by {self._clearance_m - TOLERANCE_M:.2f} m at ({where})"

    def onward(
        self, path: ViewPath, voxels: VoxelMap, flying: Trajectory, leave_s: float, views_at_spacing_m: float, identifier: int
    ) -> Trajectory | str:
        """Leave a trajectory in motion, or the reason why not."""
        return "a trajectory is left at rest only"

    def turn(self, start: Setpoint, start_s: float, total_yaw_rad: float, views: int, identifier: int) -> Trajectory:
        """Look round on the spot; ``views`` captures, equally spread over the angle, the last at its end."""
        turn = Turn(total_yaw_rad, self._rate, self._spin)
        samples = self._standing(start, turn.duration_s)
        samples[:, 3] += turn.at(np.arange(len(samples)) * np.float64(STEP_S))
        trajectory = self._smoothed(samples, start_s, np.zeros(0), 0, identifier)
        turned = np.abs(trajectory.yaw_rad - start.yaw_rad)
        wanted = abs(total_yaw_rad) * np.arange(1, views + 1) / max(views, 1) - 1e-6
        return dataclasses.replace(trajectory, views_s=np.minimum(np.searchsorted(turned, wanted), len(turned) - 1) * STEP_S)

    def line(self, start: Setpoint, goal_m: FloatArray, yaw_rad: float, start_s: float, identifier: int) -> Trajectory:
        """Straight, rest to rest, at the tight speed and without a look at the map: take-off and descent."""
        line = Line.through(start.position_m, [np.asarray(goal_m, dtype=np.float64)[None]])
        limit = np.full(len(line.along_m), self._tight_speed)
        view = Viewpoint(goal_m, yaw_rad, start.camera_pitch_down_rad)
        flown = self._along(line, (view,), limit, start, start_s, np.inf, 0, identifier)
        return dataclasses.replace(flown, views_s=np.zeros(0))

    def stop(self, trajectory: Trajectory, now_s: float, identifier: int) -> Trajectory:
        """Brake along the same path, as fast as the limits allow, to rest; captures nothing."""
        into_s = now_s - trajectory.start_s
        if into_s <= 0.0 or into_s >= trajectory.duration_s:
            still = np.zeros(2)
            return replayed(trajectory, min(max(into_s, 0.0), trajectory.duration_s), (still, still, still), now_s, identifier)
        pace = braking(trajectory, into_s, BRAKE_SHARE * self._acceleration, BRAKE_SHARE * self._spin)
        return replayed(trajectory, into_s, pace, now_s, identifier)

    def still_clear(self, trajectory: Trajectory, now_s: float, voxels: VoxelMap) -> bool:
        """Whether what is left of the trajectory is clear in a newer map; False for a map of another epoch."""
        if trajectory.map_epoch != voxels.map_epoch:
            return False
        first = int(np.clip((now_s - trajectory.start_s) / trajectory.step_s, 0, len(trajectory.yaw_rad) - 1))
        return not self._blocked(trajectory.position_m[first:], voxels).any()

    def warm_up(self) -> None:
        """Compile the kernels."""
        grid = GridSpec(np.zeros(3), 1.0, (3, 3, 3))
        voxels = VoxelMap.whole(grid, np.full(grid.shape, FREE, dtype=np.uint8), np.full(grid.shape, 81, dtype=np.uint8), 0)
        goal = Viewpoint(np.array([2.0, 1.0, 1.0]), 0.5, 0.0)
        path = ViewPath((goal,), (goal.position_world[None],), PlanMode.EXPLORE, 0, 0, (), 0.0, 0.0)
        flown = self.through(path, voxels, Setpoint.hold(np.ones(3), 0.0), 0.0, 0.5, 0)
        if isinstance(flown, Trajectory):
            self.stop(flown, 1.0, 1)

    def _limits(self, line: Line, voxels: VoxelMap) -> FloatArray:
        """Speed limit at each node: by the clearance all around it, and by what its corner costs in acceleration."""
        room_m, _ = _lookup(line.position_m, voxels)
        share = np.clip((room_m - self._clearance_m) / OPEN_M, 0.0, 1.0)
        limit = self._tight_speed + share * max(self._speed - self._tight_speed, 0.0)
        limit = minimum_filter1d(np.minimum(limit, self._speed), 2 * int(self._speed * self._box * STEP_S / NODE_M) + 1)
        into = line.position_m[line.corners] - line.position_m[line.corners - 1]
        out = line.position_m[line.corners + 1] - line.position_m[line.corners]
        cosine = np.sum(into * out, axis=1) / (np.linalg.norm(into, axis=1) * np.linalg.norm(out, axis=1))
        change = np.sqrt(np.maximum(2.0 - 2.0 * cosine, 1e-12))  # of velocity over speed; the filters peak at 1 / box
        corner = np.maximum(self._acceleration * self._box * STEP_S / change, CREEP_MPS)
        limit[line.corners] = np.minimum(limit[line.corners], corner)
        return np.asarray(limit, dtype=np.float64)

    def _along(
        self, line: Line, views: Sequence[Viewpoint], limit: FloatArray, start: Setpoint, start_s: float, spacing_m: float,
        map_epoch: int, identifier: int,
    ) -> Trajectory:  # fmt: skip
        """Fly the line under its limits; where the filtered acceleration is too high, slower there, then all over."""
        limit, turns = limit.copy(), self._turns(start, views)
        begins = np.concatenate(([0], line.ends[:-1]))
        for (yaw, pitch), begin, end in zip(turns, begins, line.ends, strict=True):
            length_m, needed_s = line.along_m[end] - line.along_m[begin], max(yaw.duration_s, pitch.duration_s)
            if length_m < ON_THE_SPOT_M and needed_s > 0:
                limit[end] = CREEP_MPS
            elif needed_s > 0:
                limit[begin : end + 1] = np.minimum(limit[begin : end + 1], max(length_m / needed_s, CREEP_MPS))
        for _ in range(TRIES):
            trajectory, node_s, speed = self._flown(line, limit, turns, start, start_s, spacing_m, map_epoch, identifier)
            excess = np.linalg.norm(trajectory.acceleration_mps2, axis=1) / self._acceleration
            around = maximum_filter1d(excess, 2 * self._box + 1)
            factor = around[np.minimum((node_s / STEP_S).astype(np.int64), len(around) - 1)]
            if factor.max() <= 1.02:
                return trajectory
            limit = np.where(factor > 1.0, np.minimum(limit, np.maximum(speed / np.maximum(factor, 1.0), CREEP_MPS)), limit)
        return stretched(trajectory, float(np.sqrt(max(excess.max(), 1.0))))

    def _turns(self, start: Setpoint, views: Sequence[Viewpoint]) -> list[tuple[Turn, Turn]]:
        """Yaw (the short way round) and camera pitch to turn on each leg."""
        turns, yaw_rad, pitch_rad = [], start.yaw_rad, start.camera_pitch_down_rad
        for view in views:
            turned_rad = float((view.yaw_rad - yaw_rad + np.pi) % (2 * np.pi) - np.pi)
            turns.append(
                (Turn(turned_rad, self._rate, self._spin), Turn(view.pitch_down_rad - pitch_rad, self._rate, self._spin))
            )
            yaw_rad, pitch_rad = yaw_rad + turned_rad, view.pitch_down_rad
        return turns

    def _flown(
        self, line: Line, limit: FloatArray, turns: list[tuple[Turn, Turn]], start: Setpoint, start_s: float,
        spacing_m: float, map_epoch: int, identifier: int,
    ) -> tuple[Trajectory, FloatArray, FloatArray]:  # fmt: skip
        """The trajectory under given limits, and for each node its instant in it and its speed."""
        speed, times = np.empty(len(limit)), np.empty(len(limit))
        pass_times(limit, line.along_m, self._acceleration, speed, times)
        arrive_s, leave_s = times.copy(), times.copy()
        begin_s, starts_s, reached_s = 0.0, [], []
        for (yaw, pitch), end in zip(turns, line.ends, strict=True):
            wait_s = max(begin_s + max(yaw.duration_s, pitch.duration_s) - float(leave_s[end]), 0.0)
            leave_s[end:] += wait_s
            arrive_s[end + 1 :] += wait_s
            starts_s.append(begin_s)
            begin_s = float(leave_s[end])
            reached_s.append(begin_s)
        samples = self._standing(start, float(leave_s[-1]))
        now_s = np.arange(len(samples)) * np.float64(STEP_S)
        along_m = np.empty(len(samples))
        along_at(STEP_S, line.along_m, speed, arrive_s, leave_s, along_m)
        for axis in range(3):
            samples[:, axis] = np.interp(along_m, line.along_m, line.position_m[:, axis])
        for (yaw, pitch), since_s in zip(turns, starts_s, strict=True):
            samples[:, 3] += yaw.at(now_s - since_s) if yaw.angle_rad else 0.0
            samples[:, 4] += pitch.at(now_s - since_s) if pitch.angle_rad else 0.0
        lead_s = self._box * STEP_S
        on_the_way_m, begin_m = [], 0.0
        for end_m in line.along_m[line.ends]:
            on_the_way_m += list(np.arange(begin_m + spacing_m, end_m - spacing_m / 2, spacing_m)) if spacing_m < np.inf else []
            begin_m = float(end_m)
        views_s = np.sort(np.concatenate((np.interp(on_the_way_m, line.along_m, arrive_s), reached_s))) + lead_s
        return self._smoothed(samples, start_s, views_s, map_epoch, identifier), arrive_s + lead_s, speed

    def _standing(self, start: Setpoint, duration_s: float) -> FloatArray:
        """Samples (N, 5) of x, y, z, yaw, pitch that stay at the start."""
        here = np.array([*start.position_m, start.yaw_rad, start.camera_pitch_down_rad])
        return np.tile(here, (int(np.ceil(duration_s / STEP_S)) + 1, 1))

    def _smoothed(
        self, samples: FloatArray, start_s: float, views_s: FloatArray, map_epoch: int, identifier: int
    ) -> Trajectory:
        """Two box filters over samples that rest before and after; the result leads by one box, and rests at both ends."""
        padded = np.pad(samples, ((2 * self._box - 1, 2 * self._box - 1), (0, 0)), mode="edge")
        origin = padded[0].copy()
        padded -= origin
        for _ in range(2):
            total = np.cumsum(np.vstack([np.zeros((1, 5)), padded]), axis=0)
            padded = (total[self._box :] - total[: -self._box]) / self._box
        padded += origin
        rate, change = np.zeros_like(padded), np.zeros((len(padded), 3))
        rate[1:-1] = (padded[2:] - padded[:-2]) / (2 * STEP_S)
        change[1:-1] = (padded[2:, :3] - 2 * padded[1:-1, :3] + padded[:-2, :3]) / STEP_S**2
        return Trajectory(
            start_s, STEP_S, padded[:, :3], rate[:, :3], change, padded[:, 3], rate[:, 3], padded[:, 4], views_s, map_epoch,
            identifier,
        )  # fmt: skip

    def _blocked(self, positions_m: FloatArray, voxels: VoxelMap) -> BoolArray:
        """Which samples (N,) are in space not known free, or too near to it once the clearance has been reached."""
        room_m, free = _lookup(positions_m, voxels)
        travelled_m = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(positions_m, axis=0), axis=1))))
        enough = room_m >= self._clearance_m - TOLERANCE_M
        escaped = np.logical_or.accumulate(enough) | (travelled_m > ESCAPE_M)
        return np.asarray((travelled_m > LEAVING_M) & (~free | (escaped & ~enough)))


def _lookup(positions_m: FloatArray, voxels: VoxelMap) -> tuple[FloatArray, BoolArray]:
    """Distance (N,) to what is not free, and whether it is free (N,); outside the grid nothing is."""
    index = voxels.grid.index(positions_m)
    inside = voxels.grid.contains(index)
    i, j, k = np.where(inside[:, None], index, 0).T
    free = inside & (voxels.state[i, j, k] == FREE)
    return np.where(free, voxels.distance_m(index), 0.0), np.asarray(free, dtype=np.bool_)
