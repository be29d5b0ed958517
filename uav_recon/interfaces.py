"""The interfaces between stages. Each says whether it blocks, how stale its answer may be, and what it raises."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

from uav_recon.types.camera import Frame, ImuSample, PosedFrame
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import SurfaceElements, VoxelMap
from uav_recon.types.pose import MapCorrection, Pose, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.tasks import NothingLeft, PlanRequest, ViewPath, Viewpoint
from uav_recon.types.trajectory import Setpoint, Trajectory
from uav_recon.types.vehicle import MissionProgress

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


class Clock(Protocol):
    """The only source of time. now_s() never blocks and never goes back."""

    def now_s(self) -> float:
        """Seconds of the companion's monotonic clock."""
        ...

    def sleep_until(self, instant_s: float) -> None:
        """Block until the instant (a manual clock returns at once: its owner moves it)."""
        ...


class Channel(Protocol[T]):
    """A last-value channel: a reader sees the newest value, never a queue. Neither side ever blocks."""

    def publish(self, value: T) -> None:
        """Replace the value. Raises ValueError if it does not fit."""
        ...

    def latest(self) -> T | None:
        """The newest value, or None before the first. A reader's None is also the answer to a torn or corrupt record."""
        ...

    def sequence(self) -> int:
        """How many values were published so far; tells whether latest() is new."""
        ...


class Pending(Protocol[T_co]):
    """Work handed to an Executor."""

    def done(self) -> bool:
        """Whether result() would return at once."""
        ...

    def result(self) -> T_co:
        """The result; raises what the work raised. Blocks only if not done."""
        ...


class Executor(Protocol):
    """Runs work beside the loop: a thread in real time, inline with a fixed simulated cost in lockstep."""

    def submit(self, work: Callable[[], T], cost_s: float) -> Pending[T]:
        """Start work; cost_s is its declared cost on a simulated clock and ignored in real time. Does not block."""
        ...

    def close(self) -> None:
        """Wait for running work, for a while, and end."""
        ...


class DepthCamera(Protocol):
    """A depth camera. poll() never blocks; a frame is handed out once, newest first, older ones dropped."""

    def poll(self) -> Frame | None:
        """The newest frame that was not handed out yet."""
        ...

    def imu(self) -> list[ImuSample]:
        """Inertial samples since the last call, oldest first (empty for a camera without an IMU)."""
        ...

    def close(self) -> None:
        """Release the device."""
        ...


class PoseSource(Protocol):
    """Absolute poses in odom, late and at its own rate; each is stamped at capture."""

    def poses(self) -> list[StampedPose]:
        """Poses since the last call, oldest first. Never blocks."""
        ...


@runtime_checkable
class ByteLink(Protocol):
    """A byte pipe to an autopilot: UDP, serial, or memory."""

    def read(self) -> bytes:
        """Whatever arrived; b'' if nothing. Never blocks. Raises OSError if the link is gone."""
        ...

    def write(self, data: bytes) -> None:
        """Send. Never blocks for long. Raises OSError if the link is gone."""
        ...

    def wait(self, timeout_s: float) -> None:
        """Block until bytes are there or the time is over (memory links return at once)."""
        ...

    def close(self) -> None:
        """Release it."""
        ...


class ViewBudget(Protocol):
    """Decides which frames, beside the tasks' own views, become keyframes. Nothing blocks."""

    def worth(self, posed: PosedFrame, views_left: int) -> bool:
        """Whether a frame should be one of the views that are left."""
        ...

    def keep(self, posed: PosedFrame) -> None:
        """Note that a frame became a keyframe."""
        ...


class Mapper(Protocol):
    """Learns the surface from keyframes, in its own process or inline. No call blocks except finish()."""

    def add(self, keyframe: PosedFrame) -> bool:
        """Hand over a view. False if it was refused (not finite, empty, outside the box) or the mapper is down."""
        ...

    def repose(self, correction: MapCorrection) -> None:
        """The map has another frame: learn it anew from the views, each where it now is. Those without a place are dropped."""
        ...

    def surface(self) -> SurfaceElements | None:
        """The newest surface; may be a few views behind. None before the first of a map epoch."""
        ...

    def refused(self) -> Mapping[str, int]:
        """How many views were not taken so far, by reason in words."""
        ...

    def alive(self) -> bool:
        """False while the mapper is dead or restarting."""
        ...

    def finish(self, folder: Path) -> None:
        """Polish, write mesh.ply (and its uncertainty) into the folder, and end. Blocks, bounded by its polish budget."""
        ...


class Planner(Protocol):
    """The same requests, accepted paths and order give the same answers, whatever the machine's load."""

    def plan(self, request: PlanRequest) -> ViewPath | NothingLeft:
        """Choose the next views and the way to them."""
        ...

    def route(self, request: PlanRequest, goal: Viewpoint) -> ViewPath | NothingLeft:
        """The shortest clear way to one view (home), as a path with that single view."""
        ...

    def accept(self, path: ViewPath) -> None:
        """This path is flown, or was tried in vain; a later plan looks at what came of it."""
        ...

    def still_worth(self, voxels: VoxelMap, position_world: FloatArray, yaw_rad: float) -> bool:
        """Whether the next view of the last plan still promises anything in a newer map. Microseconds."""
        ...


class OccupancyMapInterface(Protocol):
    """The occupancy map. Nothing blocks; costs are a few milliseconds."""

    def integrate(self, posed: PosedFrame) -> int:
        """Fuse a frame; how many voxels changed."""
        ...

    def reset(self, map_epoch: int) -> None:
        """Forget everything: poses of a new epoch do not fit the old map."""
        ...

    def declare_free(self, centre_world: FloatArray, radius_m: float, z_min_m: float, z_max_m: float) -> None:
        """The operator's word: this upright cylinder is free."""
        ...

    def snapshot(self) -> VoxelMap:
        """A frozen copy with its distance field."""
        ...

    def explored_m3(self) -> float:
        """Volume known (free or occupied)."""
        ...


class MotionPlannerInterface(Protocol):
    """Pure: paths to trajectories under limits. A Reason says why there is none."""

    def through(
        self, path: ViewPath, voxels: VoxelMap, start: Setpoint, start_s: float, views_at_spacing_m: float, identifier: int
    ) -> Trajectory | Reason:
        """From rest at ``start`` through every view of the path to rest at the last."""
        ...

    def onward(
        self, path: ViewPath, voxels: VoxelMap, flying: Trajectory, leave_s: float, views_at_spacing_m: float, identifier: int
    ) -> Trajectory | Reason:
        """Follow ``flying`` until ``leave_s``, then go on, in motion, through every view of the path to rest at the last."""
        ...

    def turn(self, start: Setpoint, start_s: float, total_yaw_rad: float, views: int, identifier: int) -> Trajectory:
        """Look round on the spot."""
        ...

    def line(self, start: Setpoint, goal_m: FloatArray, yaw_rad: float, start_s: float, identifier: int) -> Trajectory:
        """Straight, rest to rest."""
        ...

    def stop(self, trajectory: Trajectory, now_s: float, identifier: int) -> Trajectory:
        """Brake along the same path."""
        ...

    def still_clear(self, trajectory: Trajectory, now_s: float, voxels: VoxelMap) -> bool:
        """Whether what is left of the trajectory is clear in a newer map."""
        ...


class SpeedLimitedMotion(MotionPlannerInterface, Protocol):
    """Motion that is told how fast it may be."""

    def allow(self, max_speed_mps: float) -> None:
        """What is planned from now on stays below this speed (m/s)."""
        ...


class Journal(Protocol):
    """The flight's own account: one line per event, crash-safe. Never blocks for long, never raises in flight."""

    def progress(self, now: MissionProgress) -> None:
        """A sample of the mission's life."""
        ...

    def plan(
        self,
        stamp_s: float,
        mode: str,
        task_s: float,
        step_s: float,
        frontiers: int,
        tasks: int,
        views: int,
        hover_wait_s: float,
    ) -> None:
        """A plan, what it cost, and how long the vehicle stood waiting for it."""
        ...

    def view(self, stamp_s: float, index: int, world_from_depth: Pose) -> None:
        """A keyframe."""
        ...

    def phase(self, stamp_s: float, phase: str, note: Reason | None) -> None:
        """A change of phase."""
        ...

    def refusal(self, stamp_s: float, reason: Reason) -> None:
        """Something that was turned down."""
        ...

    def refused_views(self, stamp_s: float, counts: Mapping[str, int]) -> None:
        """How many keyframes the mapper did not take, by reason in words."""
        ...

    def outcome(self, stamp_s: float, aborted: Reason | None, stop_reason: Reason | None) -> None:
        """The last line. aborted: None for a flight that was completed."""
        ...
