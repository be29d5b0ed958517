"""Factory of the recorder: flight.rrd, or the growth of the surface alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uav_recon.app.flight_channels import FlightChannels
from uav_recon.config import Config
from uav_recon.interfaces import Clock

if TYPE_CHECKING:  # each process imports only the stages that it runs
    from uav_recon.recording.rerun_recorder import RerunRecorder
    from uav_recon.recording.timelapse import Timelapse


def make_recorder(config: Config, channels: FlightChannels, flight: Path, clock: Clock) -> RerunRecorder | Timelapse:
    """Return the recorder that writes flight.rrd and the growth of the surface.

    If recording.rerun is off, only the latter is written.
    """
    from uav_recon.recording.timelapse import Timelapse

    if not config.recording.rerun:
        return Timelapse(flight, channels.surface, clock)
    from uav_recon.recording.rerun_recorder import RerunRecorder

    fence = np.array([config.safety.fence_min_m, config.safety.fence_max_m])
    return RerunRecorder(flight, channels, clock, fence, live=config.recording.live)
