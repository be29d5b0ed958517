"""The composition root: the only file that picks implementations, and the loops of the processes."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np

from uav_recon import config as configuration
from uav_recon import notify
from uav_recon.channels import FileChannel, MemoryChannel
from uav_recon.clock import MonotonicClock
from uav_recon.config import Config
from uav_recon.protocols import ByteLink, Channel, Clock, Executor, Mapper
from uav_recon.types.camera import Intrinsics, PosedFrame, body_from_camera
from uav_recon.types.maps import GridSpec, SurfaceElements, VoxelMap
from uav_recon.types.pose import StampedPose
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Intent
from uav_recon.types.vehicle import MissionProgress, VehicleState

EXIT_FAILURE, EXIT_USAGE, EXIT_CONFIG = 1, 2, 78
PERCEPTION_RATE_HZ = PILOT_RATE_HZ = 100.0
MISSION_RATE_HZ = 30.0
RECORDER_RATE_HZ = 10.0
CAMERA_WAIT_S = 240.0


class Failure(Exception):
    """Something a person can mend, in one line; code is the exit code."""

    code = EXIT_FAILURE

    def __init__(self, message: str, code: int | None = None) -> None:
        super().__init__(message)
        self.code = self.code if code is None else code


# -- wires --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Wires:
    """Every last-value channel of a flight."""

    odom: Channel[StampedPose]
    frames: Channel[PosedFrame]
    vehicle: Channel[VehicleState]
    intent: Channel[Intent]
    progress: Channel[MissionProgress]
    voxels: Channel[VoxelMap]
    surface: Channel[SurfaceElements]
    plan: Channel[ViewPath]


def memory_wires() -> Wires:
    """All in one process."""
    return Wires(
        MemoryChannel(StampedPose), MemoryChannel(PosedFrame), MemoryChannel(VehicleState), MemoryChannel(Intent),
        MemoryChannel(MissionProgress), MemoryChannel(VoxelMap), MemoryChannel(SurfaceElements), MemoryChannel(ViewPath),
    )  # fmt: skip


def file_wires(folder: Path) -> Wires:
    """Between processes: memory-mapped files in the runtime folder. Raises Failure if it cannot be written."""
    megabyte = 1 << 20
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return Wires(
            odom=FileChannel(folder / "odom.channel", StampedPose),
            frames=FileChannel(folder / "frames.channel", PosedFrame, 16 * megabyte),
            vehicle=FileChannel(folder / "vehicle.channel", VehicleState),
            intent=FileChannel(folder / "intent.channel", Intent, 4 * megabyte),
            progress=FileChannel(folder / "progress.channel", MissionProgress),
            voxels=FileChannel(folder / "voxels.channel", VoxelMap, 64 * megabyte),
            surface=FileChannel(folder / "surface.channel", SurfaceElements, 32 * megabyte),
            plan=FileChannel(folder / "plan.channel", ViewPath, megabyte),
        )
    except OSError as error:
        raise Failure(f"runtime.folder {folder}: cannot be written ({error.strerror})", EXIT_CONFIG) from None


def load_config(path: Path) -> Config:
    """Read a config. Raises Failure with exit code 78."""
    try:
        return configuration.load(path)
    except configuration.ConfigError as error:
        raise Failure(str(error), EXIT_CONFIG) from None
