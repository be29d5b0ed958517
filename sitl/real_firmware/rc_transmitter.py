"""RC transmitter of a human pilot who sees the vehicle: mode switch and stabilising sticks."""

from __future__ import annotations

import math
import socket
import struct
from collections.abc import Mapping

from sitl.autopilots.base_autopilot import VehicleTruth
from sitl.geometry.quaternion import yaw_of

_PULSES = struct.Struct("<8H")  # pulses of channels 1 to 8, µs; 0 leaves a channel unchanged
_MIDDLE_US = 1500
_MAX_US = 300
_TILT_US_PER_MPS = 300.0
_THROTTLE_US_PER_M = 250.0
_THROTTLE_US_PER_MPS = 200.0
_PERIOD_S = 0.02


class RcTransmitter:
    """Transmitter for ArduPilot's simulated receiver.

    It sends nothing until the pilot takes over: before that the firmware uses default pulses.
    """

    def __init__(self, switch: Mapping[str, int]) -> None:
        """Choose a free port for the receiver (`port`). switch: pulse of channel 5 (µs) by mode."""
        self._switch = switch
        self._pulse_us = 0
        self._height_m = 0.0
        self._next_s = 0.0
        self._socket: socket.socket | None = None
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = int(probe.getsockname()[1])

    def take(self, mode: str, truth: VehicleTruth) -> None:
        """Set the mode switch and start to send. Raises KeyError for a mode without a position."""
        self._pulse_us = self._switch[mode]
        self._height_m = truth.position[2]
        if self._socket is None:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.setblocking(False)

    def hold(self, truth: VehicleTruth) -> None:
        """Send stick positions at 50 Hz that oppose the vehicle's motion and hold its height."""
        if self._socket is None or truth.stamp_s < self._next_s:
            return
        self._next_s = truth.stamp_s + _PERIOD_S
        yaw_rad, (east, north, up) = yaw_of(truth.quat_wxyz), truth.velocity
        forward = east * math.cos(yaw_rad) + north * math.sin(yaw_rad)
        left = north * math.cos(yaw_rad) - east * math.sin(yaw_rad)
        lift = _THROTTLE_US_PER_M * (self._height_m - truth.position[2]) - _THROTTLE_US_PER_MPS * up
        sticks = (_pulse(_TILT_US_PER_MPS * left), _pulse(_TILT_US_PER_MPS * forward), _pulse(lift), _MIDDLE_US)
        try:
            self._socket.sendto(_PULSES.pack(*sticks, self._pulse_us, 0, 0, 0), ("127.0.0.1", self.port))
        except (BlockingIOError, ConnectionRefusedError):
            return  # the next one follows in 20 ms

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()


def _pulse(off_middle_us: float) -> int:
    return _MIDDLE_US + round(min(max(off_middle_us, -_MAX_US), _MAX_US))
