"""Interfaces between stages. Each states blocking, staleness of the result and errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

from uav_recon.types.camera import Frame, ImuSample, PosedFrame
from uav_recon.types.frames import FloatArray
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.maps import SurfaceElements, VoxelMap
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import MapCorrection, Pose, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.recent_views import RecentViews
from uav_recon.types.tasks import NothingLeft, PlanRequest, ViewPath, Viewpoint
from uav_recon.types.trajectory import Setpoint, Trajectory
from uav_recon.types.vehicle import MissionProgress

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


class Clock(Protocol):
    """The only source of time. now_s() never blocks and never decreases."""

    def now_s(self) -> float:
        """Return the companion's monotonic time in seconds."""
        ...

    def sleep_until(self, instant_s: float) -> None:
        """Block until the instant. A manual clock returns at once, because its owner advances it."""
        ...


class Channel(Protocol[T]):
    """A last-value channel: a reader gets the newest value, never a queue. No call blocks."""

    def publish(self, value: T) -> None:
        """Replace the value. Raises ValueError if it exceeds the channel's capacity."""
        ...

    def latest(self) -> T | None:
        """Return the newest value, or None before the first publish.

        A reader without an earlier value also returns None for a torn or corrupt record.
        """
        ...

    def sequence(self) -> int:
        """Return the number of values published. A change means that latest() is new."""
        ...


class Pending(Protocol[T_co]):
    """The handle of work submitted to an Executor."""

    def done(self) -> bool:
        """Return True if result() would return at once."""
        ...

    def result(self) -> T_co:
        """Return the result, or raise the exception of the work. Blocks only while not done."""
        ...


class Executor(Protocol):
    """Runs work beside the control loop.

    In real time the work runs on a thread. In lockstep it runs inline and takes a fixed simulated time.
    """

    def submit(self, work: Callable[[], T], cost_s: float) -> Pending[T]:
        """Start the work and return its handle. Does not block.

        cost_s: declared duration of the work on a simulated clock, in seconds; ignored in real time.
        """
        ...

    def close(self) -> None:
        """Wait, for a limited time, for running work, and then shut down."""
        ...


class DepthCamera(Protocol):
    """A depth camera.

    poll() never blocks and returns each frame at most once; older unread frames are dropped.
    """

    def poll(self) -> Frame | None:
        """Return the newest frame that was not returned before, or None."""
        ...

    def imu(self) -> list[ImuSample]:
        """Return the inertial samples since the last call, oldest first. Empty without an IMU."""
        ...

    def close(self) -> None:
        """Release the device."""
        ...


@runtime_checkable
class CameraRemarks(Protocol):
    """A camera that can say what an operator should know of it."""

    def remarks(self) -> tuple[Reason, ...]:
        """Return its streams, and what is wrong with it. Never blocks."""
        ...


@runtime_checkable
class ExposureLocking(Protocol):
    """A camera whose exposure can be locked for a flight."""

    def lock_exposure(self, near_flight: Callable[[], bool]) -> None:
        """Lock exposure and white balance while near_flight() is True. Never blocks."""
        ...


class PoseSource(Protocol):
    """A source of absolute poses in odom.

    Poses arrive late and at the source's own rate, stamped at capture.
    """

    def poses(self) -> list[StampedPose]:
        """Return the poses since the last call, oldest first. Never blocks."""
        ...


@runtime_checkable
class ByteLink(Protocol):
    """A byte pipe to an autopilot: UDP, serial or memory."""

    def read(self) -> bytes:
        """Return the received bytes, b'' if there are none. Never blocks.

        Raises OSError if the link is gone.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send the bytes. May block briefly. Raises OSError if the link is gone."""
        ...

    def wait(self, timeout_s: float) -> None:
        """Block until bytes are available or the timeout ends. Memory links return at once."""
        ...

    def close(self) -> None:
        """Release the link."""
        ...


class ViewBudget(Protocol):
    """Decides which frames become keyframes, in addition to the views of the tasks.

    No call blocks.
    """

    def selects(self, posed: PosedFrame, views_left: int, *, explored: bool) -> bool:
        """Return True if the frame should use one of the remaining views.

        explored: the newest plan leads to no opening into unknown space.
        """
        ...

    def keep(self, posed: PosedFrame) -> None:
        """Record that the frame became a keyframe."""
        ...


class Mapper(Protocol):
    """Learns the surface from keyframes, in its own process or inline. Only finish() blocks."""

    def add(self, keyframe: PosedFrame) -> bool:
        """Hand over a keyframe. Return False if it was rejected or the mapper is down.

        A keyframe is rejected if it is not finite, is empty, or lies outside the mapped box.
        """
        ...

    def repose(self, correction: MapCorrection) -> None:
        """Relearn the surface in a new map frame, with the corrected pose of each view.

        Views without a corrected pose are dropped.
        """
        ...

    def surface(self) -> SurfaceElements | None:
        """Return the newest surface, or None before the first of a map epoch.

        It may lag by a few views.
        """
        ...

    def refused(self) -> Mapping[str, int]:
        """Return the number of rejected views by reason, as text."""
        ...

    def alive(self) -> bool:
        """Return False while the mapper is dead or restarting."""
        ...

    def finish(self, folder: Path) -> None:
        """Run the final training, write mesh.ply and its uncertainty to the folder, and end.

        Blocks for at most the budget of the final training.
        """
        ...


class Planner(Protocol):
    """Chooses views and paths.

    The same requests and accepted paths, in the same order, give the same results. The results do not depend on the load of
    the machine.
    """

    def plan(self, request: PlanRequest) -> ViewPath | NothingLeft:
        """Choose the next views and the path to them."""
        ...

    def route(self, request: PlanRequest, goal: Viewpoint) -> ViewPath | NothingLeft:
        """Return the shortest clear path to one view, for example home. The path has only that view."""
        ...

    def accept(self, path: ViewPath) -> None:
        """Record that this path is flown, or could not be flown. A later plan evaluates the outcome."""
        ...

    @property
    def fine_places(self) -> tuple[FloatArray, ...]:
        """Positions (3,) around which the planner needs fine maps."""
        ...

    def next_view_has_gain(self, voxels: VoxelMap, position_world: FloatArray, yaw_rad: float) -> bool:
        """Return True if the next view of the last plan still has a gain in a newer map.

        Takes microseconds.
        """
        ...


class RecentViewMemoryInterface(Protocol):
    """The views of the last seconds. No call blocks."""

    def add(self, posed: PosedFrame) -> RecentViews | None:
        """Store a frame; return all stored views, or None if it adds nothing."""
        ...


class LocalizabilityInterface(Protocol):
    """Surface as the camera uses it to tell where it is.

    No call blocks; each costs a few milliseconds.
    """

    @property
    def cells(self) -> SurfaceCells:
        """All surface."""
        ...

    def add(self, posed: PosedFrame) -> bool:
        """Take a frame; return False if it adds nothing."""
        ...

    def sigma_m(self, world_from_body: Pose, pitch_down_rad: float) -> float:
        """Return how well the view of a level body shows its place.

        Standard deviation in the worst direction, m.
        """
        ...

    def seeing_yaw_rad(self, world_from_body: Pose, pitch_down_rad: float) -> float | None:
        """Return the nearest heading in which the view shows the place well.

        None if there is none.
        """
        ...


class OccupancyMapInterface(Protocol):
    """The occupancy map. No call blocks; each costs a few milliseconds."""

    @property
    def shows_motion(self) -> bool:
        """True if the newest frame shows something where free space was known a moment ago."""
        ...

    def integrate(self, posed: PosedFrame) -> int:
        """Fuse a frame and return the number of changed voxels."""
        ...

    def integrate_cone(self, cone: FreeCone) -> int:
        """Fuse what a range finder found empty and return the number of voxels that became free."""
        ...

    def refine(self, places_world: Sequence[FloatArray]) -> None:
        """Keep fine maps around positions (3,) from now on."""
        ...

    def reset(self, map_epoch: int) -> None:
        """Clear the map: poses of a new map epoch do not fit the old map."""
        ...

    def declare_free(self, centre_world: FloatArray, radius_m: float, z_min_m: float, z_max_m: float) -> None:
        """Mark an upright cylinder as free, as declared by the operator."""
        ...

    def snapshot(self) -> VoxelMap:
        """Return a frozen copy of the map with its distance field."""
        ...

    def explored_m3(self) -> float:
        """Return the known volume (free or occupied), in cubic metres."""
        ...


class MotionPlannerInterface(Protocol):
    """Pure functions from paths to trajectories within limits.

    A returned Reason says why there is no trajectory.
    """

    def plan_from_rest(
        self, path: ViewPath, voxels: VoxelMap, start: Setpoint, start_s: float, views_at_spacing_m: float, identifier: int
    ) -> Trajectory | Reason:
        """Plan from rest at ``start`` through every view of the path to rest at the last one."""
        ...

    def plan_from_motion(
        self, path: ViewPath, voxels: VoxelMap, flying: Trajectory, leave_s: float, views_at_spacing_m: float, identifier: int
    ) -> Trajectory | Reason:
        """Follow ``flying`` until ``leave_s``, then fly every view of the path without stopping.

        The trajectory ends at rest at the last view.
        """
        ...

    def plan_turn(self, start: Setpoint, start_s: float, total_yaw_rad: float, views: int, identifier: int) -> Trajectory:
        """Turn on the spot through ``total_yaw_rad`` and capture ``views`` views."""
        ...

    def plan_line(self, start: Setpoint, goal_m: FloatArray, yaw_rad: float, start_s: float, identifier: int) -> Trajectory:
        """Fly a straight line from rest to rest."""
        ...

    def plan_stop(self, trajectory: Trajectory, now_s: float, identifier: int) -> Trajectory:
        """Brake to rest along the same path."""
        ...

    def is_still_clear(self, trajectory: Trajectory, now_s: float, voxels: VoxelMap) -> bool:
        """Return True if the rest of the trajectory is clear in a newer map."""
        ...


class SpeedLimitedMotion(MotionPlannerInterface, Protocol):
    """A motion planner whose speed limit can be changed at run time."""

    def set_max_speed(self, max_speed_mps: float) -> None:
        """Set the speed limit in m/s of all trajectories planned from now on."""
        ...

    def set_recent_views(self, views: RecentViews) -> None:
        """Set the views of the last seconds for all trajectories planned from now on."""
        ...

    def set_surface(self, cells: SurfaceCells) -> None:
        """Set the surface by which the camera tells where it is, for the next trajectories."""
        ...


class Journal(Protocol):
    """The flight log: one line per event, crash-safe. May block briefly; never raises in flight."""

    def progress(self, now: MissionProgress) -> None:
        """Log a sample of the mission's progress."""
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
        """Log a plan, its computation times, and the time the vehicle hovered while waiting for it."""
        ...

    def view(self, stamp_s: float, index: int, world_from_depth: Pose) -> None:
        """Log a keyframe."""
        ...

    def phase(self, stamp_s: float, phase: str, note: Reason | None) -> None:
        """Log a change of phase."""
        ...

    def refusal(self, stamp_s: float, reason: Reason) -> None:
        """Log a rejected command, trajectory or setpoint with its reason."""
        ...

    def speed_limit(self, stamp_s: float, max_speed_mps: float, reason: Reason | None) -> None:
        """Log a change of the reason for a reduced speed.

        None, with an infinite speed: it is no longer reduced.
        """
        ...

    def refused_views(self, stamp_s: float, counts: Mapping[str, int]) -> None:
        """Log the number of keyframes rejected by the mapper, by reason as text."""
        ...

    def perception(self, status: PerceptionStatus) -> None:
        """Log the counts of what perception has rejected."""
        ...

    def outcome(self, stamp_s: float, aborted: Reason | None, stop_reason: Reason | None) -> None:
        """Log the outcome of the flight, as the last line."""
        ...
