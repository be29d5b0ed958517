"""The autopilot's end of the MAVLink 2 link: framing, streams, STATUSTEXT and parameters."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.byte_links import ByteEnd
from sitl.autopilots.mavlink_codec import Built, MessageDecoder, MessageEncoder, Packet, ReceivedMessage, packet
from sitl.autopilots.parameter_table import ParameterTable

_TEXT_BYTES = 50
_PARAMETERS_PER_STEP = 1  # 250 a second with time steps of 4 ms


class Stream:
    """One message that is sent periodically."""

    __slots__ = ("build", "default_s", "interval_s", "next_s")

    def __init__(self, build: Callable[[], Built], rate_hz: float) -> None:
        self.build = build
        self.default_s = 1.0 / rate_hz if rate_hz > 0.0 else math.inf
        self.interval_s = self.default_s
        self.next_s = 0.0


class MavlinkServer:
    """Reader and writer of one link; a closed link counts as silence, and flight continues."""

    def __init__(self, link: ByteEnd, parameters: ParameterTable, system: int = 1, component: int = 1) -> None:
        self._link = link
        self._parameters = parameters
        self._system = system
        self._component = component
        self._encoder = MessageEncoder(system, component)
        self._decoder = MessageDecoder()
        self._streams: dict[int, Stream] = {}
        self._due_s = 0.0
        self._out = bytearray()
        self._inbox: deque[tuple[float, bytes]] = deque()
        self._list_next = len(parameters)
        self._texts = 0
        self.texts: list[str] = []

    def restart(self) -> None:
        """Reset sequence numbers and message rates to those at boot."""
        self._encoder = MessageEncoder(self._system, self._component)
        for stream in self._streams.values():
            stream.interval_s, stream.next_s = stream.default_s, 0.0
        self._due_s = 0.0

    # -- sending --------------------------------------------------------------------------------------------------

    def send(self, message: Packet) -> None:
        """Queue a message; flush() sends it."""
        self._out += self._encoder.frame(message)

    def say(self, severity: int, text: str) -> None:
        """Send a STATUSTEXT, in chunks of 50 bytes if it is longer."""
        self.texts.append(text)
        raw = text.encode("ascii", "replace")
        self._texts = self._texts % 65535 + 1
        identifier = self._texts if len(raw) > _TEXT_BYTES else 0
        for piece in range(0, max(len(raw), 1), _TEXT_BYTES):
            part = raw[piece : piece + _TEXT_BYTES]
            self.send(packet(mavlink.MAVLink_statustext_message, severity, part, identifier, piece // _TEXT_BYTES))

    def acknowledge(self, command: int, result: int, sender: tuple[int, int]) -> None:
        """Send a COMMAND_ACK to the sender of the command."""
        self.send(packet(mavlink.MAVLink_command_ack_message, command, result, 0, 0, sender[0], sender[1]))

    def add_stream(self, message_id: int, build: Callable[[], Built], rate_hz: float) -> None:
        """Send build() at a rate (0: only on request); it may return None to skip a period."""
        self._streams[message_id] = Stream(build, rate_hz)

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> bool:
        """Set a message interval (µs; 0: default, -1: off). Return False for an unknown message."""
        stream = self._streams.get(message_id)
        if stream is None or not math.isfinite(interval_us):
            return False
        if interval_us == 0.0:
            stream.interval_s = stream.default_s
        else:
            stream.interval_s = math.inf if interval_us < 0.0 else max(interval_us * 1e-6, 0.004)
        stream.next_s = now_s
        self._due_s = now_s
        return True

    def request(self, message_id: int) -> bool:
        """Send a message once. Return False if it is unknown or not available yet."""
        stream = self._streams.get(message_id)
        return stream is not None and self._send_built(stream)

    def _send_built(self, stream: Stream) -> bool:
        """Build and send the messages of a stream; return False if there is none."""
        built = stream.build()
        messages = [built] if isinstance(built, Packet) else built or []
        for message in messages:
            self.send(message)
        return bool(messages)

    def stream_out(self, now_s: float) -> None:
        """Queue the messages that are due, and the next parameter of a requested list."""
        if self._list_next < len(self._parameters):
            for _ in range(_PARAMETERS_PER_STEP):
                self.send_parameter(self._parameters.name(self._list_next))
                self._list_next += 1
        if now_s < self._due_s:
            return
        for stream in self._streams.values():
            if stream.next_s <= now_s and stream.interval_s < math.inf:
                self._send_built(stream)
                stream.next_s = max(stream.next_s + stream.interval_s, now_s - stream.interval_s)
        self._due_s = min([s.next_s for s in self._streams.values() if s.interval_s < math.inf], default=math.inf)

    def flush(self) -> None:
        """Send all queued messages."""
        if not self._out:
            return
        data = bytes(self._out)
        self._out.clear()
        try:
            self._link.write(data)
        except OSError:
            return  # the companion is gone; the commander's failsafe reacts to its silence

    # -- receiving ------------------------------------------------------------------------------------------------

    def drain(self, now_s: float) -> None:
        """Read all waiting bytes; now_s is their arrival time if the link has none."""
        while True:
            try:
                data = self._link.read()
            except OSError:
                return
            if not data:
                return
            arrival = self._link.arrival_s
            self._inbox.append((now_s if arrival is None else arrival, data))

    def messages(self, now_s: float) -> Iterator[tuple[float, ReceivedMessage]]:
        """Yield arrival time and message of all frames arrived by now_s, in order.

        Invalid frames and messages for another system are skipped.
        """
        while self._inbox and self._inbox[0][0] <= now_s:
            arrival, data = self._inbox.popleft()
            for message in self._decoder.feed(data):
                if getattr(message, "target_system", 0) in (0, self._system):
                    yield arrival, message

    # -- parameters -----------------------------------------------------------------------------------------------

    def take_parameter_message(self, message: ReceivedMessage) -> bool:
        """Handle PARAM_REQUEST_LIST, PARAM_REQUEST_READ or PARAM_SET; return False for others."""
        kind = message.kind
        if kind == mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST:
            self._list_next = 0
        elif kind == mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
            if message.param_index >= 0:
                if message.param_index < len(self._parameters):
                    self.send_parameter(self._parameters.name(message.param_index))
            elif message.param_id in self._parameters:
                self.send_parameter(message.param_id)
        elif kind == mavlink.MAVLINK_MSG_ID_PARAM_SET:
            self._set_parameter(message)
        else:
            return False
        return True

    def _set_parameter(self, message: ReceivedMessage) -> None:
        name = message.param_id
        if name not in self._parameters:
            self.say(mavlink.MAV_SEVERITY_ERROR, f"unknown param: {name}")
            return
        if message.param_type != self._parameters.kind(name):
            self.say(mavlink.MAV_SEVERITY_ERROR, f"param types mismatch param: {name}")
            return
        try:
            self._parameters.set(name, self._parameters.from_wire(name, message.param_value))
        except ValueError:
            self.say(mavlink.MAV_SEVERITY_ERROR, f"param not set: {name}")
        self.send_parameter(name)

    def send_parameter(self, name: str) -> None:
        """Send the PARAM_VALUE of a parameter."""
        p = self._parameters
        self.send(
            packet(mavlink.MAVLink_param_value_message, name.encode(), p.on_wire(name), p.kind(name), len(p), p.index(name))
        )
