"""The simulator as one object: vehicle and autopilot, camera, delayed poses, ground truth."""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sitl.autopilots.base_autopilot import Autopilot, VehicleTruth
from sitl.camera.camera_errors import FILE_NAME, CameraErrors
from sitl.camera.camera_imu import CameraImu
from sitl.camera.camera_mount import CameraMount
from sitl.camera.d435i import EXACT, MOUNT_M, SimulatedD435i
from sitl.camera.frame_exposure import ExposureTimes, FrameExposure, MountPose
from sitl.camera.frame_timing import FrameLoss, FrameTiming
from sitl.geometry.quaternion import Quat
from sitl.geometry.transform import rigid, rotation_from_quat
from sitl.runtime import atomic_file
from sitl.truth.hull_clearance import HullClearance
from sitl.world.pose_history import PastPose, PoseHistory
from sitl.world.pose_tracker import SimulatedTracker
from sitl.world.step_sizes import FINE_STEPS, StepSizes

F64 = NDArray[np.float64]
# clearance is not measured below this height at the pad or in a landing
PAD_HEIGHT_M = 0.4
PAD_RADIUS_M = 0.6
BODY_ABOVE_FLOOR_M = 0.10


class Flyer(Protocol):
    """Vehicle with its autopilot: simulated, or a real firmware with its own physics."""

    @property
    def setpoint_arrivals_s(self) -> list[float]:
        """World-clock arrivals (s) of setpoints while armed and following them; empty if unknown."""
        ...

    @property
    def failsafes(self) -> list[str]:
        """Descriptions of the failsafes that acted, in order."""
        ...

    @property
    def texts(self) -> list[str]:
        """Every STATUSTEXT sent."""
        ...

    @property
    def version(self) -> str:
        """Version of a real firmware; '' for a simulated autopilot."""
        ...

    @property
    def battery_fraction(self) -> float:
        """State of charge, 0 to 1."""
        ...

    @property
    def boot_s(self) -> float:
        """Time of boot, s on the world clock."""
        ...

    def pilot_takes_over(self, mode: str) -> None:
        """Change the mode by a switch on the transmitter. Raises KeyError for an unknown mode."""
        ...

    def step(self, now_s: float) -> None:
        """Advance to now_s on the world clock."""
        ...

    def truth(self) -> VehicleTruth:
        """Return the true state of the vehicle at the last step."""
        ...


class PoseOutput(Protocol):
    """Output of the poses: the camera stream, or a tracker beside the autopilot."""

    def write_pose(
        self, stamp_s: float, position_m: F64, quat_wxyz: F64, variance: F64, quality: int, reset_counter: int
    ) -> None:
        """Write a pose odom_from_body at its delivery; arguments as PoseRecord."""
        ...


class CameraStreamOutput(PoseOutput, Protocol):
    """Output of the camera stream: the stream file's writer, or a fault injector before it."""

    def write_frame(self, stamp_s: float, depth_mm: NDArray[np.uint16], rgb: NDArray[np.uint8]) -> None:
        """Write a frame: depth_mm (H, W), rgb (h, w, 3)."""
        ...

    def write_imu(self, stamp_s: float, gyro_radps: F64, specific_force_mps2: F64) -> None:
        """Write an IMU sample: gyro (3,), rad/s; specific force (3,), m/s^2; FLU."""
        ...


@dataclass
class TruthLog:
    """Ground truth of a flight in the world frame, sampled at truth_hz.

    A row: stamp (s), position (3, m), attitude wxyz (4), and the flags clearance measured, armed, landing.
    """

    rows: list[tuple[float, ...]]

    def save(self, path: Path, world: OutsideWorld) -> None:
        """Write the rows, the setpoint arrivals and the failsafes to an npz file, atomically.

        The camera's errors go to FILE_NAME beside it.
        """
        world.camera_errors.save(path.with_name(FILE_NAME))
        table = np.array(self.rows, dtype=np.float64).reshape(-1, 11)
        hull_m, measured = np.full(len(table), np.nan), table[:, 8] > 0
        hull_m[measured] = world.clearance.batch(table[measured, 1:4])
        with atomic_file.writing(path) as file:
            np.savez_compressed(
                file,
                stamp_s=table[:, 0],
                position_m=table[:, 1:4],
                quat_wxyz=table[:, 4:8],
                hull_m=hull_m,
                armed=table[:, 9] > 0,
                landing=table[:, 10] > 0,
                setpoint_arrivals_s=np.array(world.flyer.setpoint_arrivals_s, dtype=np.float64),
                failsafes=np.array(world.flyer.failsafes, dtype=np.str_),
            )


class OutsideWorld:
    """Simulator of everything outside the product; call step(now_s) every few ms of its clock."""

    def __init__(
        self,
        flyer: Flyer,
        camera: SimulatedD435i,
        poses: SimulatedTracker,
        clearance: HullClearance,
        stream: CameraStreamOutput,
        start_s: float,
        mount_pitch_down_rad: float | None,
        pace: StepSizes = FINE_STEPS,
        errors: CameraErrors = EXACT,
        onboard: PoseOutput | None = None,
    ) -> None:
        """Set up the simulator at start_s.

        mount_pitch_down_rad: tilt of a fixed camera; None: a gimbal controlled by the flyer. errors: of the camera and its IMU.
        onboard: takes the poses in place of the stream.
        """
        self.camera_errors = errors
        self._imu = CameraImu(errors, pace.imu_hz)
        self._mount = CameraMount(MOUNT_M, errors.mount)
        self._timing = FrameTiming(errors)
        self._loss = FrameLoss(errors)
        self._history = PoseHistory()
        self._exposing: deque[ExposureTimes] = deque()
        self._imu_hz = pace.imu_hz
        self._truth_hz = pace.truth_hz
        self.flyer = flyer
        self.camera = camera
        self._poses = poses
        self.clearance = clearance
        self.stream = stream
        self.onboard = onboard
        self._start_s = start_s
        self._mount_pitch_down_rad = mount_pitch_down_rad
        self._imu_count = self._truth_count = self._frame_count = 0
        self.truth_log = TruthLog([])

    @property
    def autopilot(self) -> Autopilot:
        """The simulated autopilot, for fault injection. Raises TypeError for a real firmware."""
        if not isinstance(self.flyer, Autopilot):
            raise TypeError("a real firmware flies")
        return self.flyer

    def turn_camera(self, quat_wxyz: Quat) -> None:
        """Turn the camera, depth, colour and IMU, about the body's origin; the product is not told."""
        self._mount.turn(quat_wxyz)
        self.camera.turn(quat_wxyz)

    def step(self, now_s: float) -> None:
        """Advance to now_s; publish the IMU samples and poses due by then, and record the truth."""
        while (stamp_s := self._start_s + self._imu_count / self._imu_hz) <= now_s + 1e-9:
            self._publish_imu(stamp_s)
        self.flyer.step(now_s)
        self._keep_pose(self.flyer.truth())
        self._publish_poses(now_s)
        self._keep_truth(now_s)

    def _publish_imu(self, stamp_s: float) -> None:
        """Publish the sample of stamp_s, simulated for that time even if this call is late."""
        self.flyer.step(stamp_s)
        truth = self.flyer.truth()
        self._keep_pose(truth)
        axes = self._mount.imu_from_body(self._pitch_rad(truth.gimbal_pitch_down_rad))
        sample = self._imu.read(stamp_s, truth.gyro, truth.specific_force, axes, truth.armed)
        self.stream.write_imu(sample.stamp_s, sample.gyro_radps, sample.specific_force_mps2)
        self._imu_count += 1

    def _publish_poses(self, now_s: float) -> None:
        if not self._poses.due(now_s):
            return
        truth = self.flyer.truth()
        for record in self._poses.step(now_s, truth.position, truth.quat_wxyz):
            (self.onboard or self.stream).write_pose(
                record.stamp_s, record.position_m, record.quat_wxyz, record.variance, record.quality, record.reset_counter
            )

    def _keep_truth(self, now_s: float) -> None:
        if self._start_s + self._truth_count / self._truth_hz > now_s + 1e-9:
            return
        self._truth_count = int((now_s - self._start_s) * self._truth_hz + 1e-9) + 1
        truth = self.flyer.truth()
        x, y, z = truth.position
        landing = "LAND" in truth.mode
        over_pad = landing or math.hypot(x, y) < PAD_RADIUS_M
        measured = truth.armed and not (z + BODY_ABOVE_FLOOR_M < PAD_HEIGHT_M and over_pad)
        self.truth_log.rows.append((now_s, x, y, z, *truth.quat_wxyz, float(measured), float(truth.armed), float(landing)))

    def _keep_pose(self, truth: VehicleTruth) -> None:
        self._history.add(PastPose(truth.stamp_s, truth.position, truth.quat_wxyz, truth.gimbal_pitch_down_rad))

    def _pitch_rad(self, gimbal_pitch_down_rad: float) -> float:
        """Return the tilt of the camera as the product is told it."""
        return gimbal_pitch_down_rad if self._mount_pitch_down_rad is None else self._mount_pitch_down_rad

    def frame_due(self, now_s: float) -> bool:
        """Return True once per camera period, when a frame is complete.

        begin_frame() then returns it. An exact camera exposes a frame at its stamp, and delivers it then.
        """
        if self._start_s + self._frame_count * self.camera.period_s <= now_s + 1e-9:
            self._frame_count = int((now_s - self._start_s) / self.camera.period_s + 1e-9) + 1
            times = self._timing.exposure(now_s)
            if not self._loss.lost(now_s):
                self._exposing.append(times)
        return bool(self._exposing) and self._exposing[0].complete_s <= now_s + 1e-9

    def begin_frame(self) -> FrameExposure:
        """Return the poses of the frame that is due.

        Call it in the stepping thread; develop() in any.
        """
        t = self._exposing.popleft()
        depth, first, last = (self._mount_pose(stamp_s) for stamp_s in (t.depth_s, t.colour_first_s, t.colour_last_s))
        middle = self._mount_pose(0.5 * (t.colour_first_s + t.colour_last_s))
        return FrameExposure(t.stamp_s, depth, first, middle, last)

    def _mount_pose(self, stamp_s: float) -> MountPose:
        past = self._history.at(stamp_s)
        return MountPose(rigid(rotation_from_quat(past.quat_wxyz), past.position), self._pitch_rad(past.gimbal_pitch_down_rad))

    def develop(self, exposure: FrameExposure) -> None:
        """Render a frame and publish it."""
        depth_mm, rgb = self.camera.expose(exposure)
        self.stream.write_frame(exposure.stamp_s, depth_mm, rgb)


class RenderThread:
    """Thread that renders the newest frame, so that rendering never delays the autopilot."""

    def __init__(self, world: OutsideWorld) -> None:
        self._world = world
        self._newest: FrameExposure | None = None
        self._wake = threading.Condition()
        self._open = True
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def submit(self, exposure: FrameExposure) -> None:
        """Queue a frame; an older one not started yet is dropped, as in a real camera."""
        with self._wake:
            self._newest = exposure
            self._wake.notify()

    def close(self) -> None:
        """End the thread."""
        with self._wake:
            self._open = False
            self._wake.notify()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._newest is not None or not self._open)
                if not self._open:
                    return
                exposure = self._newest
                self._newest = None
            if exposure is not None:
                self._world.develop(exposure)
