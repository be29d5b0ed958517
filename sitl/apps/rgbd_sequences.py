"""RGB-D-inertial sequences that a vehicle records on a path, with its true poses.

The frames and samples are those of a flight: the same simulator renders and stamps them, with the camera errors of the seed.
Only the vehicle is another one, which follows a path exactly and needs no autopilot.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sitl.autopilots.base_autopilot import VehicleTruth
from sitl.camera import d435i
from sitl.camera.camera_errors import CameraErrors
from sitl.camera.camera_mount import CameraMount
from sitl.camera.camera_view import CameraView
from sitl.camera.frame_exposure import MountPose
from sitl.geometry.transform import body_from_camera, rigid, rotation_from_quat
from sitl.outside_world import OutsideWorld
from sitl.runtime import atomic_file
from sitl.runtime.array_cache import key
from sitl.scene.glass import GlassView
from sitl.scene.rasterizer import Renderer
from sitl.scene.scene import Scene
from sitl.truth.hull_clearance import HullClearance
from sitl.truth.random_route import LOOK_RAD, random_route
from sitl.world.pose_tracker import SimulatedTracker
from sitl.world.spline_trajectory import Rates, SplineTrajectory, TrajectoryStates
from uav_recon.sensors.stream_format import CameraSpec, StreamHeader

VERSION = 1
FRAME_HZ = 15.0
IMU_HZ = 200.0
START_S = 10.0  # stamp of the start
LENGTH_M = 20.0
_ROUTE_SHARE = 1.1  # corners that are rounded shorten the route
_TICKS_HZ = 600.0  # every frame and every sample lies on a tick
FIXED_PITCH_RAD = math.radians(15.0)
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class SequenceOptions:
    """Options of a sequence; equal options give equal sequences.

    scene: as for `sim`. seed: of camera errors and noise. path: number of the route. camera_errors: scale. gimbal: else the
    camera is fixed, 15 degrees down. length_m: of the path. yaw_radps: largest turn rate. look_rad: largest angle between
    heading and direction of travel. glass: two walls are of glass (sitl/scene/glass.py). depth_noise: model of the noise.
    """

    scene: str | None = None
    seed: int = 0
    path: int = 0
    camera_errors: float = 1.0
    gimbal: bool = False
    length_m: float = LENGTH_M
    camera: d435i.Model = "d435i"
    yaw_radps: float = Rates.yaw_radps
    look_rad: float = LOOK_RAD
    glass: bool = False
    depth_noise: d435i.Noise = "d435i"

    @property
    def errors(self) -> CameraErrors:
        """Errors of this sequence's camera."""
        return CameraErrors.drawn(self.seed, self.camera_errors, gimbal=self.gimbal)


@dataclass(frozen=True, eq=False)
class RgbdSequence:
    """N frames and M inertial samples as the product gets them, and the true poses.

    depth_mm (N, H, W): 0 = no return. rgb (N, h, w, 3). stamp_s (N,): of the frames, ascending. arrival_s (N,): when the
    product gets them.
    imu (M, 7): stamp, s; gyro, rad/s; specific force, m/s^2; body FLU.
    body_from_depth (N, 4, 4): nominal. shown_body (N, 4, 4): true world_from_body when the depth image was exposed.
    truth_s (T,), truth_position_m (T, 3), truth_quat_wxyz (T, 4): true world_from_body, 200 times a second.
    """

    name: str
    header: StreamHeader
    depth_mm: U16
    rgb: U8
    stamp_s: F64
    arrival_s: F64
    imu: F64
    body_from_depth: F64
    shown_body: F64
    truth_s: F64
    truth_position_m: F64
    truth_quat_wxyz: F64

    @property
    def true_body(self) -> F64:
        """True world_from_body (N, 4, 4) at the stamps."""
        return self.true_body_at(self.stamp_s)

    def true_body_at(self, stamp_s: F64) -> F64:
        """Return the true world_from_body (K, 4, 4) at times (K,), s.

        Outside the recording it is the first or the last one. Interpolated along the chord between truths 5 ms apart.
        """
        t = np.clip(np.asarray(stamp_s, np.float64), self.truth_s[0], self.truth_s[-1])
        after = np.clip(np.searchsorted(self.truth_s, t), 1, len(self.truth_s) - 1)
        before = after - 1
        share = ((t - self.truth_s[before]) / (self.truth_s[after] - self.truth_s[before]))[:, None]
        position = (1.0 - share) * self.truth_position_m[before] + share * self.truth_position_m[after]
        quat = (1.0 - share) * self.truth_quat_wxyz[before] + share * self.truth_quat_wxyz[after]
        return _poses(position, quat)


_ARRAYS = tuple(f.name for f in fields(RgbdSequence) if f.name not in ("name", "header"))


class RecordedOutput:
    """Camera stream output that keeps frames and samples in lists."""

    def __init__(self) -> None:
        self.stamps_s: list[float] = []
        self.depth_mm: list[U16] = []
        self.rgb: list[U8] = []
        self.imu: list[tuple[float, ...]] = []

    def write_frame(self, stamp_s: float, depth_mm: U16, rgb: U8) -> None:
        """Keep a frame."""
        self.stamps_s.append(stamp_s)
        self.depth_mm.append(depth_mm)
        self.rgb.append(rgb)

    def write_imu(self, stamp_s: float, gyro_radps: F64, specific_force_mps2: F64) -> None:
        """Keep a sample."""
        self.imu.append((stamp_s, *gyro_radps.tolist(), *specific_force_mps2.tolist()))

    def write_pose(
        self, stamp_s: float, position_m: F64, quat_wxyz: F64, variance: F64, quality: int, reset_counter: int
    ) -> None:
        """Ignore a pose: a sequence has no pose source."""


class PathFollower:
    """Vehicle that follows a trajectory exactly.

    It takes the place of vehicle and autopilot in the simulator.
    """

    setpoint_arrivals_s: list[float] = []  # noqa: RUF012
    failsafes: list[str] = []  # noqa: RUF012
    texts: list[str] = []  # noqa: RUF012
    version = ""
    battery_fraction = 1.0
    boot_s = START_S

    def __init__(self, trajectory: SplineTrajectory) -> None:
        ticks = math.ceil(trajectory.duration_s * _TICKS_HZ) + 1
        self._states = trajectory.states(np.arange(ticks) / _TICKS_HZ)
        self._rows = _vehicle_truths(self._states)
        self._row = 0

    def pilot_takes_over(self, mode: str) -> None:
        """Do nothing: no modes."""

    def step(self, now_s: float) -> None:
        """Go to now_s, rounded to a tick."""
        self._row = min(max(round((now_s - START_S) * _TICKS_HZ), 0), len(self._rows) - 1)

    def truth(self) -> VehicleTruth:
        """Return the state at the last step."""
        return self._rows[self._row]

    def every(self, ticks: int) -> TrajectoryStates:
        """Return every ticks-th state, stamped on the world clock."""
        s = self._states
        taken = TrajectoryStates(*(getattr(s, f.name)[::ticks] for f in fields(TrajectoryStates)))
        taken.stamp_s[:] += START_S
        return taken


def record(options: SequenceOptions, scene: Scene, report: Progress = lambda done, total: None) -> RgbdSequence:
    """Fly and record a sequence; takes about 30 ms a frame.

    scene: loaded from options.scene. report(done, total) is called for each frame. Raises NoRouteError.
    """
    route = random_route(scene, options.path, _ROUTE_SHARE * options.length_m, options.look_rad)
    trajectory = SplineTrajectory(scene.start_yaw_rad, route, Rates(yaw_radps=options.yaw_radps))
    return record_along(trajectory, options, scene, report)


def record_along(
    trajectory: SplineTrajectory,
    options: SequenceOptions,
    scene: Scene,
    report: Progress = lambda done, total: None,
) -> RgbdSequence:
    """Record a sequence along a trajectory; arguments as for record()."""
    vehicle, output, errors = PathFollower(trajectory), RecordedOutput(), options.errors
    painted = scene.paint or scene
    view: CameraView = Renderer(painted.vertices, painted.faces, painted.rgb)
    if options.glass:
        view = GlassView(scene, view)
    camera = d435i.SimulatedD435i(view, options.camera, options.depth_noise, options.seed, errors)
    camera.period_s = 1.0 / FRAME_HZ
    pitch_rad = None if options.gimbal else FIXED_PITCH_RAD
    world = OutsideWorld(
        vehicle, camera, SimulatedTracker(options.seed), HullClearance(scene), output, START_S, pitch_rad, errors=errors
    )
    shown, arrivals_s, total = [], [], int(trajectory.duration_s * FRAME_HZ)
    for now_s in _steps(trajectory.duration_s):
        world.step(now_s)
        while world.frame_due(now_s):
            exposure = world.begin_frame()
            shown.append(exposure.depth.world_from_body)
            arrivals_s.append(now_s)
            world.develop(exposure)
            report(len(shown), total)
    truth = vehicle.every(round(_TICKS_HZ / IMU_HZ))
    stamp_s = np.array(output.stamps_s)
    tilt = np.full(len(stamp_s), FIXED_PITCH_RAD)
    if options.gimbal:
        tilt = np.interp(stamp_s, truth.stamp_s, truth.pitch_down_rad)
    nominal = np.array([body_from_camera(d435i.MOUNT_M, float(p)) for p in tilt])
    return RgbdSequence(
        scene.name, camera.header, np.array(output.depth_mm), np.array(output.rgb), stamp_s, np.array(arrivals_s),
        np.array(output.imu), nominal, np.array(shown), truth.stamp_s, truth.position_m, truth.quat_wxyz,
    )  # fmt: skip


def recorded(
    options: SequenceOptions, scene: Scene, folder: Path | None, report: Progress = lambda done, total: None
) -> RgbdSequence:
    """Return the sequence stored in a folder, or record it and store it there; None: no folder.

    A sequence takes 0.5 MB a frame. A file that cannot be read is recorded again. Raises OSError if one cannot be written.
    """
    if folder is None:
        return record(options, scene, report)
    digest = key(scene.vertices, scene.faces, scene.rgb, repr((VERSION, options)))
    path = folder / f"{scene.name}-{options.seed}-{options.path}-{digest}.npz"
    try:
        return load(path)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        sequence = record(options, scene, report)
        save(sequence, path)
        return sequence


def save(sequence: RgbdSequence, path: Path) -> None:
    """Write a sequence as an uncompressed npz file, atomically."""
    header = sequence.header
    lenses = [[*astuple(spec)] for spec in (header.depth, header.rgb)]
    arrays = {name: getattr(sequence, name) for name in _ARRAYS}
    with atomic_file.writing(path) as file:
        np.savez(file, name=sequence.name, lenses=lenses, rgb_from_depth=header.rgb_from_depth, **arrays)


def load(path: Path) -> RgbdSequence:
    """Read a file of save(). Raises OSError, ValueError, KeyError, EOFError or BadZipFile."""
    with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
        depth, rgb = (CameraSpec(int(row[0]), int(row[1]), *row[2:].tolist()) for row in stored["lenses"])
        header = StreamHeader(depth, rgb, tuple(stored["rgb_from_depth"].tolist()))
        return RgbdSequence(str(stored["name"]), header, **{name: stored[name] for name in _ARRAYS})


def true_world_from_depth(sequence: RgbdSequence, options: SequenceOptions) -> F64:
    """Return the true poses (N, 4, 4) of a fixed depth imager when each frame was exposed."""
    mount = CameraMount(d435i.MOUNT_M, options.errors.mount)
    return np.array([mount.world_from_depth(MountPose(body, FIXED_PITCH_RAD)) for body in sequence.shown_body])


def _steps(duration_s: float) -> list[float]:
    """Return the times of all samples and frames, s, ascending."""
    imu, frame = round(_TICKS_HZ / IMU_HZ), round(_TICKS_HZ / FRAME_HZ)
    ticks = range(math.floor(duration_s * _TICKS_HZ) + 1)
    return [START_S + tick / _TICKS_HZ for tick in ticks if tick % imu == 0 or tick % frame == 0]


def _vehicle_truths(s: TrajectoryStates) -> list[VehicleTruth]:
    columns = (
        START_S + s.stamp_s, s.position_m, s.velocity_mps, s.quat_wxyz, s.gyro_radps, s.specific_force_mps2, s.pitch_down_rad,
        s.motors_on,
    )  # fmt: skip
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return [
        VehicleTruth(stamp_s, tuple(at), tuple(velocity), tuple(quat), tuple(gyro), tuple(force), pitch_rad, on, "PATH")
        for stamp_s, at, velocity, quat, gyro, force, pitch_rad, on in rows
    ]


def _poses(position_m: F64, quat_wxyz: F64) -> F64:
    return np.array([rigid(rotation_from_quat(q), p) for q, p in zip(quat_wxyz, position_m, strict=True)])
