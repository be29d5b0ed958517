"""The outside world as one object with a step(): vehicle and autopilot, camera, late poses, and the truth it keeps."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sitl.autopilots.base_autopilot import Autopilot, VehicleTruth
from sitl.camera.d435i import SimulatedD435i
from sitl.geometry.transform import rigid, rotation_from_quat
from sitl.truth.hull_clearance import HullClearance
from sitl.world.pose_tracker import SimulatedTracker
from sitl.world.step_sizes import REAL, StepSizes

F64 = NDArray[np.float64]
PAD_HEIGHT_M, PAD_RADIUS_M = 0.4, 0.6  # taking off and landing so low over the ground, nearness to it is no fault
BODY_ABOVE_FLOOR_M = 0.10


class Flyer(Protocol):
    """What flies the vehicle: a simulated autopilot with its physics, or a real firmware with its own."""

    @property
    def setpoint_arrivals_s(self) -> list[float]:
        """World-clock arrivals of setpoints while armed and flying by them, where they can be seen."""
        ...

    @property
    def failsafes(self) -> list[str]:
        """What went wrong and what was done about it, in order."""
        ...

    @property
    def texts(self) -> list[str]:
        """Every STATUSTEXT."""
        ...

    @property
    def version(self) -> str:
        """Of a real firmware; '' for none."""
        ...

    @property
    def battery_fraction(self) -> float:
        """State of charge now."""
        ...

    @property
    def boot_s(self) -> float:
        """When it booted, on the world's clock."""
        ...

    def pilot_takes_over(self, mode: str) -> None:
        """A switch on the transmitter. Raises KeyError for a mode that there is not."""
        ...

    def step(self, now_s: float) -> None:
        """Advance to now_s on the world's clock."""
        ...

    def truth(self) -> VehicleTruth:
        """The vehicle as it really is at the last step."""
        ...


class Outlet(Protocol):
    """Where the camera's stream goes: the wire format's writer, or whatever stands before it."""

    def write_frame(self, stamp_s: float, depth_mm: NDArray[np.uint16], rgb: NDArray[np.uint8]) -> None:
        """A frame."""
        ...

    def write_imu(self, stamp_s: float, gyro_radps: F64, specific_force_mps2: F64) -> None:
        """An inertial sample."""
        ...

    def write_pose(
        self, stamp_s: float, position_m: F64, quat_wxyz: F64, variance: F64, quality: int, reset_counter: int
    ) -> None:
        """A pose, on its arrival."""
        ...


@dataclass
class TruthLog:
    """What really happened, sampled at the pace's truth_hz, in the world frame.

    A row: stamp, position, attitude wxyz, whether clearance is to be measured there, armed, landing.
    """

    rows: list[tuple[float, ...]]

    def save(self, path: Path, world: OutsideWorld) -> None:
        """Write it with the setpoint arrivals and the failsafes; atomic."""
        table = np.array(self.rows, dtype=np.float64).reshape(-1, 11)
        hull_m, measured = np.full(len(table), np.nan), table[:, 8] > 0
        hull_m[measured] = world.clearance.batch(table[measured, 1:4])
        temporary = path.with_suffix(".new.npz")
        np.savez_compressed(
            temporary,
            stamp_s=table[:, 0],
            position_m=table[:, 1:4],
            quat_wxyz=table[:, 4:8],
            hull_m=hull_m,
            armed=table[:, 9] > 0,
            landing=table[:, 10] > 0,
            setpoint_arrivals_s=np.array(world.flyer.setpoint_arrivals_s, dtype=np.float64),
            failsafes=np.array(world.flyer.failsafes, dtype=np.str_),
        )
        temporary.replace(path)


class OutsideWorld:
    """Everything outside the product. step(now_s) is called every few milliseconds of its clock."""

    def __init__(
        self,
        flyer: Flyer,
        camera: SimulatedD435i,
        poses: SimulatedTracker,
        clearance: HullClearance,
        stream: Outlet,
        start_s: float,
        mount_pitch_down_rad: float | None,
        pace: StepSizes = REAL,
    ) -> None:
        """A mount_pitch_down_rad of None is a gimbal: its angle is the flyer's."""
        self._imu_hz, self._truth_hz = pace.imu_hz, pace.truth_hz
        self.flyer, self.camera, self._poses, self.clearance = flyer, camera, poses, clearance
        self.stream, self._start_s, self._mount_pitch_down_rad = stream, start_s, mount_pitch_down_rad
        self._imu_count = self._truth_count = self._frame_count = 0
        self.truth_log = TruthLog([])

    @property
    def autopilot(self) -> Autopilot:
        """The simulated autopilot, for those who meddle with it. Raises TypeError where a real firmware flies."""
        if not isinstance(self.flyer, Autopilot):
            raise TypeError("a real firmware flies")
        return self.flyer

    def step(self, now_s: float) -> None:
        """Fly to now_s, publish what the sensors saw on the way, keep the truth."""
        while (stamp_s := self._start_s + self._imu_count / self._imu_hz) <= now_s + 1e-9:
            self._publish_imu(stamp_s)
        self.flyer.step(now_s)
        self._publish_poses(now_s)
        self._keep_truth(now_s)

    def _publish_imu(self, stamp_s: float) -> None:
        """A sample of its own instant, however late this call comes: a computer that stalls does not stall gyros."""
        self.flyer.step(stamp_s)
        truth = self.flyer.truth()
        self.stream.write_imu(stamp_s, np.asarray(truth.gyro), np.asarray(truth.specific_force))
        self._imu_count += 1

    def _publish_poses(self, now_s: float) -> None:
        if not self._poses.due(now_s):
            return
        truth = self.flyer.truth()
        for record in self._poses.step(now_s, truth.position, truth.quat_wxyz):
            self.stream.write_pose(
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

    def _world_from_body(self) -> NDArray[np.float64]:
        truth = self.flyer.truth()
        return rigid(rotation_from_quat(truth.quat_wxyz), truth.position)

    def frame_due(self, now_s: float) -> bool:
        """Whether the shutter opens now; true once per camera period."""
        if self._start_s + self._frame_count * self.camera.period_s > now_s + 1e-9:
            return False
        self._frame_count = int((now_s - self._start_s) / self.camera.period_s + 1e-9) + 1
        return True

    def expose(self, now_s: float) -> PendingFrame:
        """What the shutter caught: take it in the stepping thread, develop it anywhere."""
        pitch_rad = self._mount_pitch_down_rad
        if pitch_rad is None:
            pitch_rad = self.flyer.truth().gimbal_pitch_down_rad
        return PendingFrame(now_s, self._world_from_body(), pitch_rad)

    def develop(self, exposure: PendingFrame) -> None:
        """Render an exposure and publish it."""
        depth_mm, rgb = self.camera.capture(exposure.world_from_body, exposure.pitch_down_rad)
        self.stream.write_frame(exposure.stamp_s, depth_mm, rgb)


@dataclass(frozen=True)
class PendingFrame:
    """Where the camera was when the shutter opened."""

    stamp_s: float
    world_from_body: NDArray[np.float64]
    pitch_down_rad: float


class Darkroom:
    """A thread that develops the newest exposure, so that rendering never delays the autopilot."""

    def __init__(self, world: OutsideWorld) -> None:
        self._world = world
        self._newest: PendingFrame | None = None
        self._wake = threading.Condition()
        self._open = True
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def submit(self, exposure: PendingFrame) -> None:
        """Hand over an exposure; an older one not begun yet is dropped, as a real camera would."""
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
                exposure, self._newest = self._newest, None
            if exposure is not None:
                self._world.develop(exposure)
