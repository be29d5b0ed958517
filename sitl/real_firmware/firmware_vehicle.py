"""A vehicle that a real firmware flies, in its own physics: the world follows its true path and hears what it says."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.base_autopilot import VehicleTruth
from sitl.autopilots.byte_links import UdpPeer
from sitl.autopilots.mavlink_codec import MessageDecoder, MessageEncoder, ReceivedMessage
from sitl.real_firmware.process import FirmwareError, FirmwareProcess
from sitl.real_firmware.rc_transmitter import RcTransmitter
from sitl.real_firmware.request_queue import COMPONENT, SYSTEM, RequestQueue
from sitl.real_firmware.true_trajectory import Grain, TrueTrajectory

_OURS = (251, 1)  # neither the vehicle's nor the companion's: it is told nothing but what to send
_BOOT_S, _SILENT_S, _ASK_S, _POLL_S = 60.0, 5.0, 1.0, 0.02
_ARMED = 128
_STREAMS_HZ = (
    (mavlink.MAVLINK_MSG_ID_HEARTBEAT, 50.0),  # a referee wants to know at once who flies
    (mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, 5.0),
    (mavlink.MAVLINK_MSG_ID_SYS_STATUS, 1.0),
)
_WARNING = 4
_FAILSAFE_WORDS = ("failsafe", "breach", "crash")


class Binary(Protocol):
    """A kind of firmware: how it is started, and how it tells the truth."""

    @property
    def grain(self) -> Grain:
        """How coarse its places are."""
        ...

    @property
    def streams_hz(self) -> tuple[tuple[int, float], ...]:
        """The messages to ask for, and how often."""
        ...

    @property
    def set_late(self) -> Iterable[tuple[str, float, int]]:
        """Parameters that it is told once it runs: name, value on the wire, MAV_PARAM_TYPE."""
        ...

    @property
    def truth_port(self) -> int:
        """Where it sends the truth; 0 for wherever it is told."""
        ...

    @property
    def transmitter(self) -> RcTransmitter | None:
        """Its pilot's, None where its simulation has no sticks."""
        ...

    @property
    def asked_again(self) -> tuple[int, ...]:
        """Messages that it only sends as often when each is asked for."""
        ...

    def command(self, folder: Path, companion_port: int, truth_port: int) -> list[str]:
        """What starts it in a folder that is empty."""
        ...

    def environment(self) -> dict[str, str]:
        """What its environment has besides ours."""
        ...

    def follow(self, message: ReceivedMessage, stamp_s: float, path: TrueTrajectory) -> None:
        """Take the truth out of a message, if there is any in it."""
        ...

    def mode(self, custom_mode: int) -> str:
        """A mode of the heartbeat by its name; a number without one is its own."""
        ...


class FirmwareVehicle:
    """In the simulated autopilot's place. The companion speaks with the binary itself; this only listens, on a second link.

    setpoint_arrivals_s stays empty: they arrive elsewhere. failsafes: warnings in the firmware's own words; texts: every
    STATUSTEXT. version: as it says, '' until it did. battery_fraction: state of charge, NaN until it was told. boot_s: when it
    booted, on the world's clock, as near as its messages were quick; inf before the first.
    """

    def __init__(self, binary: Binary, companion_port: int, start_yaw_rad: float, folder: Path, log: Path) -> None:
        """Start it in folder and wait until it says where it is. Raises FirmwareError with one line."""
        folder.mkdir(parents=True, exist_ok=True)
        self._binary, self._path = binary, TrueTrajectory(binary.grain, start_yaw_rad)
        try:
            self._link = UdpPeer(local_port=binary.truth_port, remote=None)
        except OSError as error:
            raise FirmwareError(f"port {binary.truth_port}, where the firmware sends the truth: {error.strerror}") from None
        self._listener, self._speaker = MessageDecoder(), MessageEncoder(*_OURS)
        self._now_s = self._received_s = time.monotonic()
        self._asked_s = self._polled_s = 0.0
        self._wishes = RequestQueue()
        for kind, rate_hz in (*binary.streams_hz, *_STREAMS_HZ):
            self._wishes.stream(kind, rate_hz)
        self._wishes.message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        self._wishes.parameters(binary.set_late)
        self._armed, self._mode = False, ""
        self.setpoint_arrivals_s: list[float] = []
        self.failsafes: list[str] = []
        self.texts: list[str] = []
        self.version = ""
        self.battery_fraction, self.boot_s = math.nan, math.inf
        command = binary.command(folder, companion_port, self._link.local_port)
        self._process = FirmwareProcess(command, binary.environment(), folder, log)
        self._wait()

    def step(self, now_s: float) -> None:
        """Hear all that came by now_s. Raises FirmwareError once it is gone or silent."""
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
        if now_s - self._polled_s >= _POLL_S and self._wishes.due() is None:
            self._polled_s = now_s
            for kind in self._binary.asked_again:
                self._wishes.message(kind)
            self._ask()
        if self._path.begun and self._binary.transmitter is not None:
            self._binary.transmitter.hold(self.truth())
        if self._path.begun and now_s - self._received_s > _SILENT_S:
            self._process.check()
            raise FirmwareError(f"the firmware says no more where it is; it said last: {self._process.last_line()}")

    def truth(self) -> VehicleTruth:
        """The vehicle as it really is at the last step. The camera's mount is fixed."""
        m = self._path.at(self._now_s)
        return VehicleTruth(
            self._now_s, m.position, m.velocity, m.quat_wxyz, m.gyro, m.specific_force, 0.0, self._armed, self._mode
        )

    def pilot_takes_over(self, mode: str) -> None:
        """A switch on the transmitter; its sticks keep the vehicle where it is. Raises KeyError for a mode it does not have."""
        if self._binary.transmitter is None:
            raise KeyError(mode)
        self._binary.transmitter.take(mode, self.truth())

    def close(self) -> None:
        """End the firmware."""
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
                    raise FirmwareError(f"the firmware did not say where it is within {_BOOT_S:.0f} s; it said last: {last}")
        except FirmwareError:
            self.close()
            raise

    def _ask(self) -> None:
        if (wish := self._wishes.due()) is not None:
            self._link.write(self._speaker.frame(wish))

    def _take(self, message: ReceivedMessage, stamp_s: float) -> None:
        self._binary.follow(message, stamp_s, self._path)
        if self._wishes.answered(message):
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
    """Major, minor, patch and the commit, as AUTOPILOT_VERSION has them: ArduPilot has eight letters of it, PX4 five bytes, the
    last one first, behind three of its vendor's own version.
    """
    number, told = message.flight_sw_version, bytes(message.flight_custom_version)
    letters = told.rstrip(b"\0")
    commit = letters.decode("ascii") if letters.isalnum() else told[:2:-1].hex()
    return f"{number >> 24 & 0xFF}.{number >> 16 & 0xFF}.{number >> 8 & 0xFF}" + (f" ({commit})" if letters else "")
