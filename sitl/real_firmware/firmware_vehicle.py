"""Vehicle controlled and simulated by a real firmware; the simulator receives its truth."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.base_autopilot import VehicleTruth
from sitl.autopilots.byte_links import UdpPeer
from sitl.autopilots.mavlink_codec import MessageDecoder, MessageEncoder, Packet, ReceivedMessage
from sitl.real_firmware.flow_feed import FlowFeed
from sitl.real_firmware.process import FirmwareError, FirmwareProcess
from sitl.real_firmware.rc_transmitter import RcTransmitter
from sitl.real_firmware.request_queue import COMPONENT, SYSTEM, RequestQueue
from sitl.real_firmware.true_trajectory import PositionResolution, TrueTrajectory
from sitl.world.flow_sensor import FlowMeasurement, SimulatedFlowModule

_SIMULATOR_IDS = (251, 1)  # of the simulator, which requests messages and sets parameters, and of its flow module
_BOOT_S = 60.0
_SILENT_S = 5.0
_ASK_S = 1.0
_POLL_S = 0.02
_ARMED = 128
_STREAMS_HZ = (
    (mavlink.MAVLINK_MSG_ID_HEARTBEAT, 50.0),  # so that mode changes are recorded without delay
    (mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, 5.0),
    (mavlink.MAVLINK_MSG_ID_SYS_STATUS, 1.0),
)
_WARNING = 4
_FAILSAFE_WORDS = ("failsafe", "breach", "crash")


class Binary(Protocol):
    """A kind of firmware: its start and its ground truth."""

    @property
    def grain(self) -> PositionResolution:
        """Resolution of its positions."""
        ...

    @property
    def streams_hz(self) -> tuple[tuple[int, float], ...]:
        """Messages to request: id and rate in Hz."""
        ...

    @property
    def parameters_after_start(self) -> Iterable[tuple[str, float, int]]:
        """Parameters to set after the start: name, value on the wire, MAV_PARAM_TYPE."""
        ...

    @property
    def truth_port(self) -> int:
        """UDP port to which it sends the truth; 0 if that can be chosen."""
        ...

    @property
    def transmitter(self) -> RcTransmitter | None:
        """Its RC transmitter; None if its simulation has none."""
        ...

    @property
    def polled_messages(self) -> tuple[int, ...]:
        """Messages that must be requested one by one, because their rate cannot be set."""
        ...

    def command(self, folder: Path, companion_port: int, truth_port: int) -> list[str]:
        """Return the command line that starts it in an empty folder."""
        ...

    def environment(self) -> dict[str, str]:
        """Return additional environment variables."""
        ...

    def follow(self, message: ReceivedMessage, stamp_s: float, path: TrueTrajectory) -> None:
        """Add the ground truth of a message to the path; other messages are ignored."""
        ...

    def mode(self, custom_mode: int) -> str:
        """Return the name of a heartbeat's custom_mode, or the number if it has no name."""
        ...

    def optical_flow(self, measured: FlowMeasurement) -> Packet:
        """Return a reading of a flow sensor as the message that it takes."""
        ...


class FirmwareVehicle:
    """Vehicle of a real firmware, in place of the simulated autopilot.

    The companion communicates with the binary directly; this object receives the truth on a second link.
    setpoint_arrivals_s: empty, because setpoints do not pass this object.
    failsafes: STATUSTEXT warnings about failsafes. texts: every STATUSTEXT.
    version: '' until reported. battery_fraction: state of charge, NaN until reported.
    boot_s: time of boot on the world clock, late by the smallest message delay; inf before the first message.
    """

    def __init__(self, binary: Binary, companion_port: int, start_yaw_rad: float, folder: Path, log: Path) -> None:
        """Start it in folder and wait for its first true position. Raises FirmwareError."""
        folder.mkdir(parents=True, exist_ok=True)
        self._binary = binary
        self._path = TrueTrajectory(binary.grain, start_yaw_rad)
        try:
            self._link = UdpPeer(local_port=binary.truth_port, remote=None)
        except OSError as error:
            raise FirmwareError(f"port {binary.truth_port}, where the firmware sends the truth: {error.strerror}") from None
        self._listener = MessageDecoder()
        self._speaker = MessageEncoder(*_SIMULATOR_IDS)
        self._now_s = self._received_s = time.monotonic()
        self._asked_s = self._polled_s = 0.0
        self._requests = RequestQueue()
        for kind, rate_hz in (*binary.streams_hz, *_STREAMS_HZ):
            self._requests.stream(kind, rate_hz)
        self._requests.message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        self._requests.parameters(binary.parameters_after_start)
        self._flow: FlowFeed | None = None
        self._armed = False
        self._mode = ""
        self.setpoint_arrivals_s: list[float] = []
        self.failsafes: list[str] = []
        self.texts: list[str] = []
        self.version = ""
        self.battery_fraction = math.nan
        self.boot_s = math.inf
        command = binary.command(folder, companion_port, self._link.local_port)
        self._process = FirmwareProcess(command, binary.environment(), folder, log)
        self._wait()

    def mount_flow_module(self, module: SimulatedFlowModule) -> None:
        """Connect an optical flow sensor and a range finder that look down."""
        self._flow = FlowFeed(module, self._binary.optical_flow)

    def step(self, now_s: float) -> None:
        """Process all messages received by now_s. Raises FirmwareError if it has ended or is silent."""
        self._now_s = now_s
        while data := self._link.read():
            stamp_s = self._link.arrival_s or now_s
            for message in self._listener.feed(data):
                if message.sender == (SYSTEM, COMPONENT):
                    self._take(message, stamp_s)
        if now_s - self._asked_s >= _ASK_S:
            self._asked_s = now_s
            self._process.check()
            self._ask()
        if now_s - self._polled_s >= _POLL_S and self._requests.due() is None:
            self._polled_s = now_s
            for kind in self._binary.polled_messages:
                self._requests.message(kind)
            self._ask()
        if self._path.begun:
            self._move_instruments(self.truth())
        if self._path.begun and now_s - self._received_s > _SILENT_S:
            self._process.check()
            raise FirmwareError(f"the firmware sends no position any more; its last output: {self._process.last_line()}")

    def truth(self) -> VehicleTruth:
        """Return the true state of the vehicle at the last step. The camera's mount is fixed."""
        m = self._path.at(self._now_s)
        return VehicleTruth(
            self._now_s, m.position, m.velocity, m.quat_wxyz, m.gyro, m.specific_force, 0.0, self._armed, self._mode
        )

    def pilot_takes_over(self, mode: str) -> None:
        """Change the mode by a switch on the transmitter, whose sticks then hold the position.

        Raises KeyError for a mode that the switch does not have.
        """
        if self._binary.transmitter is None:
            raise KeyError(mode)
        self._binary.transmitter.take(mode, self.truth())

    def close(self) -> None:
        """End the firmware and close the link."""
        self._process.close()
        self._link.close()
        if self._binary.transmitter is not None:
            self._binary.transmitter.close()

    def _wait(self) -> None:
        end_s = time.monotonic() + _BOOT_S
        try:
            while not self._path.begun:
                self._link.wait(0.1)
                self.step(time.monotonic())
                if self._now_s > end_s:
                    last = self._process.last_line()
                    raise FirmwareError(f"the firmware sent no position within {_BOOT_S:.0f} s; its last output: {last}")
        except FirmwareError:
            self.close()
            raise

    def _move_instruments(self, truth: VehicleTruth) -> None:
        """Let the transmitter and the flow module send for this state."""
        if self._binary.transmitter is not None:
            self._binary.transmitter.hold(truth)
        if self._flow is not None:
            for message in self._flow.step(truth):
                self._link.write(self._speaker.frame(message))

    def _ask(self) -> None:
        if (wish := self._requests.due()) is not None:
            self._link.write(self._speaker.frame(wish))

    def _take(self, message: ReceivedMessage, stamp_s: float) -> None:
        self._binary.follow(message, stamp_s, self._path)
        if self._requests.answered(message):
            self._ask()
        if message.kind in (mavlink.MAVLINK_MSG_ID_SIM_STATE, mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION):
            self._received_s = stamp_s
        elif message.kind == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            self._armed = bool(message.base_mode & _ARMED)
            self._mode = self._binary.mode(message.custom_mode)
        elif message.kind == mavlink.MAVLINK_MSG_ID_SYSTEM_TIME:
            self.boot_s = min(self.boot_s, stamp_s - message.time_boot_ms * 1e-3)
        elif message.kind == mavlink.MAVLINK_MSG_ID_SYS_STATUS:
            self.battery_fraction = message.battery_remaining * 1e-2 if message.battery_remaining >= 0 else math.nan
        elif message.kind == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            self.version = _version(message)
            print(f"firmware {self.version}", flush=True)
        elif message.kind == mavlink.MAVLINK_MSG_ID_STATUSTEXT:
            self._hear(message.severity, message.text)

    def _hear(self, severity: int, text: str) -> None:
        said = text.lower()
        self.texts.append(text)
        print(f"{self._now_s:.3f} {text}", flush=True)
        if severity <= _WARNING and any(word in said for word in _FAILSAFE_WORDS) and "clear" not in said:
            self.failsafes.append(text)


def _version(message: ReceivedMessage) -> str:
    """Return major, minor, patch and commit of an AUTOPILOT_VERSION.

    In flight_custom_version ArduPilot has eight letters of the commit. PX4 has three bytes of a vendor version, followed by
    five bytes of the commit in reverse order.
    """
    number, custom = message.flight_sw_version, bytes(message.flight_custom_version)
    letters = custom.rstrip(b"\0")
    commit = letters.decode("ascii") if letters.isalnum() else custom[:2:-1].hex()
    return f"{number >> 24 & 0xFF}.{number >> 16 & 0xFF}.{number >> 8 & 0xFF}" + (f" ({commit})" if letters else "")
