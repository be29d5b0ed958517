"""Channels between the stages of a flight, in one process or between several."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uav_recon.channels import ChannelError, FileChannel, MemoryChannel, ReadOnlyFileChannel, create_file
from uav_recon.errors import EXIT_CONFIG, UserError
from uav_recon.interfaces import Channel
from uav_recon.types.camera import PosedFrame
from uav_recon.types.flow import FlowReadings
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.maps import FreeSpace, SurfaceElements, VoxelMap
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import MapCorrection, StampedPose
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Intent
from uav_recon.types.vehicle import MissionProgress, ReportedPoses, TurnRates, VehicleState


@dataclass(frozen=True)
class FlightChannels:
    """Every last-value channel of a flight."""

    odom: Channel[StampedPose]
    frames: Channel[PosedFrame]
    vehicle: Channel[VehicleState]
    intent: Channel[Intent]
    progress: Channel[MissionProgress]
    voxels: Channel[VoxelMap]
    surface: Channel[SurfaceElements]
    plan: Channel[ViewPath]
    correction: Channel[MapCorrection]
    free: Channel[FreeSpace]
    nearby: Channel[MinRangeGrid]
    perception: Channel[PerceptionStatus]
    rates: Channel[TurnRates]
    reported: Channel[ReportedPoses]
    cones: Channel[FreeCone]
    flow: Channel[FlowReadings]


PERCEPTION_WRITES = frozenset({"odom", "frames", "correction", "nearby", "perception"})
PILOT_WRITES = frozenset({"vehicle", "rates", "reported", "cones", "flow"})
MISSION_WRITES = frozenset({"intent", "progress", "voxels", "surface", "plan", "free"})
_KIBIBYTE = 1 << 10
_MEBIBYTE = 1 << 20
_FILES: dict[str, tuple[Any, int]] = {  # type of the value and capacity in bytes
    "odom": (StampedPose, 64 * _KIBIBYTE),
    "frames": (PosedFrame, 16 * _MEBIBYTE),
    "vehicle": (VehicleState, 64 * _KIBIBYTE),
    "intent": (Intent, 4 * _MEBIBYTE),
    "progress": (MissionProgress, 64 * _KIBIBYTE),
    "voxels": (VoxelMap, 64 * _MEBIBYTE),
    "surface": (SurfaceElements, 32 * _MEBIBYTE),
    "plan": (ViewPath, _MEBIBYTE),
    "correction": (MapCorrection, _MEBIBYTE),
    "free": (FreeSpace, 4 * _MEBIBYTE),
    "nearby": (MinRangeGrid, 64 * _KIBIBYTE),
    "perception": (PerceptionStatus, 64 * _KIBIBYTE),
    "rates": (TurnRates, 64 * _KIBIBYTE),
    "reported": (ReportedPoses, 64 * _KIBIBYTE),
    "cones": (FreeCone, 64 * _KIBIBYTE),
    "flow": (FlowReadings, 64 * _KIBIBYTE),
}


def memory_channels() -> FlightChannels:
    """Return channels within one process."""
    return FlightChannels(
        odom=MemoryChannel(StampedPose),
        frames=MemoryChannel(PosedFrame),
        vehicle=MemoryChannel(VehicleState),
        intent=MemoryChannel(Intent),
        progress=MemoryChannel(MissionProgress),
        voxels=MemoryChannel(VoxelMap),
        surface=MemoryChannel(SurfaceElements),
        plan=MemoryChannel(ViewPath),
        correction=MemoryChannel(MapCorrection),
        free=MemoryChannel(FreeSpace),
        nearby=MemoryChannel(MinRangeGrid),
        perception=MemoryChannel(PerceptionStatus),
        rates=MemoryChannel(TurnRates),
        reported=MemoryChannel(ReportedPoses),
        cones=MemoryChannel(FreeCone),
        flow=MemoryChannel(FlowReadings),
    )


def file_channels(folder: Path, writes: frozenset[str]) -> FlightChannels:
    """Return channels between the processes of a flight: files in the runtime folder.

    writes: names of the channels that this process publishes; the others are mapped read-only. All files are created, so none
    is opened in flight. A file of another build is not read and is logged, as its writer may start later.
    Raises UserError if the folder cannot be written.
    """
    kinds = {name: FileChannel if name in writes else ReadOnlyFileChannel for name in _FILES}
    with made_writable(folder):
        for name, (_, capacity_bytes) in _FILES.items():
            create_file(_path(folder, name), capacity_bytes)
        return FlightChannels(**{name: kinds[name](_path(folder, name), *of) for name, of in _FILES.items()})


@contextlib.contextmanager
def made_writable(folder: Path) -> Iterator[None]:
    """Create the runtime folder if needed; an OSError inside becomes a UserError that names it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise UserError(f"runtime.folder {folder}: cannot be written ({error.strerror})", EXIT_CONFIG) from None


def read_only_channels(folder: Path) -> FlightChannels:
    """Return the channels of a flight for a program that only reads.

    It may run as any user of the flight's group. Files that do not exist yet are opened later.

    Raises UserError if this user may not read them, or another build has written one.
    """
    try:
        channels = {name: ReadOnlyFileChannel(_path(folder, name), *of) for name, of in _FILES.items()}
        for channel in channels.values():
            channel.check()
    except PermissionError as error:
        raise UserError(
            f"{error.filename}: not allowed: be root, the user of the flight, or in its group", EXIT_CONFIG
        ) from None
    except OSError as error:
        raise UserError(f"runtime.folder {folder}: cannot be read ({error.strerror})", EXIT_CONFIG) from None
    except ChannelError as error:
        raise UserError(str(error), EXIT_CONFIG) from None
    return FlightChannels(**channels)


def _path(folder: Path, name: str) -> Path:
    return folder / f"{name}.channel"
