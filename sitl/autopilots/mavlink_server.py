"""The autopilot's end of the MAVLink 2 link: framing, sequence numbers, stream rates, texts and the parameter protocol."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.byte_links import ByteEnd
from sitl.autopilots.mavlink_codec import MessageDecoder, MessageEncoder, Packet, ReceivedMessage, packet
from sitl.autopilots.parameter_table import ParameterTable

_TEXT_BYTES = 50
_PARAMETERS_PER_STEP = 1  # 250 a second


class Stream:
    """One message sent at a rate."""

    __slots__ = ("build", "default_s", "interval_s", "next_s")

    def __init__(self, build: Callable[[], Packet | None], rate_hz: float) -> None:
        self.build = build
        self.default_s = 1.0 / rate_hz if rate_hz > 0.0 else math.inf
        self.interval_s = self.default_s
        self.next_s = 0.0


class MavlinkServer:
    """Reads and writes one link. A link that fails is treated as silence: the world goes on without its companion."""

    def __init__(self, link: ByteEnd, parameters: ParameterTable, system: int = 1, component: int = 1) -> None:
        self._link = link
        self._parameters = parameters
        self._system, self._component = system, component
        self._speaker, self._listener = MessageEncoder(system, component), MessageDecoder()
        self._streams: dict[int, Stream] = {}
        self._due_s = 0.0
        self._out = bytearray()
        self._inbox: deque[tuple[float, bytes]] = deque()
        self._list_next = len(parameters)
        self._texts = 0
        self.texts: list[str] = []

    def restart(self) -> None:
        """Sequence numbers and message rates are those of the boot again."""
        self._speaker = MessageEncoder(self._system, self._component)
        for stream in self._streams.values():
            stream.interval_s, stream.next_s = stream.default_s, 0.0
        self._due_s = 0.0

    # -- sending --------------------------------------------------------------------------------------------------

    def send(self, message: Packet) -> None:
        """Queue a message; flush() puts it on the wire."""
        self._out += self._speaker.frame(message)

    def say(self, severity: int, text: str) -> None:
        """STATUSTEXT, in pieces of 50 bytes when it is longer."""
        self.texts.append(text)
        raw = text.encode("ascii", "replace")
        self._texts = self._texts % 65535 + 1
        identifier = self._texts if len(raw) > _TEXT_BYTES else 0
        for piece in range(0, max(len(raw), 1), _TEXT_BYTES):
            part = raw[piece : piece + _TEXT_BYTES]
            self.send(packet(mavlink.MAVLink_statustext_message, severity, part, identifier, piece // _TEXT_BYTES))

    def acknowledge(self, command: int, result: int, sender: tuple[int, int]) -> None:
        """COMMAND_ACK to whoever asked."""
        self.send(packet(mavlink.MAVLink_command_ack_message, command, result, 0, 0, sender[0], sender[1]))

    def add_stream(self, message_id: int, build: Callable[[], Packet | None], rate_hz: float) -> None:
        """Send build() at a rate (0: only on request); build may return None to skip a turn."""
        self._streams[message_id] = Stream(build, rate_hz)

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> bool:
        """SET_MESSAGE_INTERVAL: 0 the default, -1 off. False for a message that is not offered."""
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
        """REQUEST_MESSAGE: send it once. False for a message that is not offered or not known yet."""
        stream = self._streams.get(message_id)
        message = stream.build() if stream is not None else None
        if message is None:
            return False
        self.send(message)
        return True

    def stream_out(self, now_s: float) -> None:
        """Queue what is due, and the next parameter of a list under way."""
        if self._list_next < len(self._parameters):
            for _ in range(_PARAMETERS_PER_STEP):
                self.send_parameter(self._parameters.name(self._list_next))
                self._list_next += 1
        if now_s < self._due_s:
            return
        for stream in self._streams.values():
            if stream.next_s <= now_s and stream.interval_s < math.inf:
                message = stream.build()
                if message is not None:
                    self.send(message)
                stream.next_s = max(stream.next_s + stream.interval_s, now_s - stream.interval_s)
        self._due_s = min([s.next_s for s in self._streams.values() if s.interval_s < math.inf], default=math.inf)

    def flush(self) -> None:
        """Put everything queued on the wire."""
        if not self._out:
            return
        data = bytes(self._out)
        self._out.clear()
        try:
            self._link.write(data)
        except OSError:
            return  # the companion is gone; its failsafe is our business elsewhere

    # -- receiving ------------------------------------------------------------------------------------------------

    def drain(self, now_s: float) -> None:
        """Take in what the link has; now_s stands in for the arrival where the transport knows none."""
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
        """Arrival and message of all that had arrived by now_s, in order; garbage and frames for others left out."""
        while self._inbox and self._inbox[0][0] <= now_s:
            arrival, data = self._inbox.popleft()
            for message in self._listener.feed(data):
                if getattr(message, "target_system", 0) in (0, self._system):
                    yield arrival, message

    # -- parameters -----------------------------------------------------------------------------------------------

    def take_parameter_message(self, message: ReceivedMessage) -> bool:
        """Answer PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET; False for any other message."""
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
        """PARAM_VALUE."""
        p = self._parameters
        self.send(
            packet(mavlink.MAVLink_param_value_message, name.encode(), p.on_wire(name), p.kind(name), len(p), p.index(name))
        )
