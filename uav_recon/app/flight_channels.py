"""Channels between the stages of a flight, in one process or between several."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from uav_recon.channels import FileChannel, MemoryChannel
from uav_recon.errors import EXIT_CONFIG, UserError
from uav_recon.interfaces import Channel
from uav_recon.types.camera import PosedFrame
from uav_recon.types.maps import FreeSpace, SurfaceElements, VoxelMap
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import MapCorrection, StampedPose
from uav_recon.types.tasks import ViewPath
from uav_recon.types.trajectory import Intent
from uav_recon.types.vehicle import MissionProgress, VehicleState


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


def memory_channels() -> FlightChannels:
    """Return channels within one process."""
    return FlightChannels(
        MemoryChannel(StampedPose), MemoryChannel(PosedFrame), MemoryChannel(VehicleState), MemoryChannel(Intent),
        MemoryChannel(MissionProgress), MemoryChannel(VoxelMap), MemoryChannel(SurfaceElements), MemoryChannel(ViewPath),
        MemoryChannel(MapCorrection), MemoryChannel(FreeSpace), MemoryChannel(MinRangeGrid),
    )  # fmt: skip


def file_channels(folder: Path) -> FlightChannels:
    """Return channels between processes: memory-mapped files in the runtime folder.

    Raises UserError if it cannot be written.
    """
    megabyte = 1 << 20
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return FlightChannels(
            odom=FileChannel(folder / "odom.channel", StampedPose),
            frames=FileChannel(folder / "frames.channel", PosedFrame, 16 * megabyte),
            vehicle=FileChannel(folder / "vehicle.channel", VehicleState),
            intent=FileChannel(folder / "intent.channel", Intent, 4 * megabyte),
            progress=FileChannel(folder / "progress.channel", MissionProgress),
            voxels=FileChannel(folder / "voxels.channel", VoxelMap, 64 * megabyte),
            surface=FileChannel(folder / "surface.channel", SurfaceElements, 32 * megabyte),
            plan=FileChannel(folder / "plan.channel", ViewPath, megabyte),
            correction=FileChannel(folder / "correction.channel", MapCorrection, megabyte),
            free=FileChannel(folder / "free.channel", FreeSpace, 4 * megabyte),
            nearby=FileChannel(folder / "nearby.channel", MinRangeGrid),
        )
    except OSError as error:
        raise UserError(f"runtime.folder {folder}: cannot be written ({error.strerror})", EXIT_CONFIG) from None
