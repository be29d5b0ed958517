"""A line on standard error while a process waits for another one.

Without it the terminal would be silent.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from uav_recon.app.flight_channels import FlightChannels
from uav_recon.interfaces import Channel
from uav_recon.types.pose import StampedPose
from uav_recon.types.vehicle import VehicleState

FIRST_S = 2.0  # from the start of the wait to the first line
PERIOD_S = 15.0  # between lines
SILENT_S = 2.0  # a value older than this counts as none


class WaitNotice:
    """Notice of what a process waits for: after 2 s, on a change, then every 15 s."""

    def __init__(self, name: str, now_s: float) -> None:
        self._name = name
        self._since_s = now_s
        self._next_s = now_s + FIRST_S
        self._printed: tuple[str, ...] = ()

    def update(self, now_s: float, missing: Sequence[str]) -> None:
        """Print a line if one is due. missing: what the process waits for; may be empty."""
        if not missing:
            self._since_s = now_s
            self._next_s = now_s + FIRST_S
            self._printed = ()
        elif now_s >= self._next_s or (self._printed and self._printed != tuple(missing)):
            line = f"uav-recon {self._name}: waiting for {' and '.join(missing)}: {now_s - self._since_s:.0f} s"
            print(line, file=sys.stderr, flush=True)
            self._next_s = now_s + PERIOD_S
            self._printed = tuple(missing)


def missing_processes(channels: FlightChannels, now_s: float) -> list[str]:
    """Return the processes of a flight that report nothing.

    Each is given with the command that starts it.
    """
    missing = []
    if is_silent(channels.vehicle, now_s):
        missing.append("the pilot (uav-recon pilot)")
    if is_silent(channels.odom, now_s):
        missing.append("perception (uav-recon perception)")
    return missing


def is_silent(channel: Channel[VehicleState] | Channel[StampedPose], now_s: float) -> bool:
    """Return True if the channel has no value of the last 2 s."""
    try:
        newest = channel.latest()
    except ValueError:
        return True
    return newest is None or not abs(now_s - newest.stamp_s) <= SILENT_S
