"""Faults of the MAVLink link: loss, delay, duplication, reordering, garbage and forgery."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from sitl.faults.injectors.base import Capabilities, InjectionContext, Injector
from sitl.faults.mavlink_proxy import DelayedItems, MavlinkProxy, frames, message_id

_COMMAND_LONG = 76
SYS_STATUS = 1
COMPANION = (233, 191)  # the product's ids
QUADROTOR, GCS, ONBOARD_CONTROLLER = 2, 6, 18  # MAV_TYPE
GENERIC, INVALID = 0, 8  # MAV_AUTOPILOT


class PacketLoss(Injector):
    """Frames that are lost for a while, all or a share.

    way: "up" (to the autopilot), "down" or "both".
    """

    def __init__(self, way: str, for_s: float = 1e9, share: float = 1.0, seed: int = 0, only: tuple[int, ...] = ()) -> None:
        self._way = way
        self._for_s = for_s
        self._share = share
        self._only = only
        self._dice = random.Random(seed)

    def _fate(self, way: str, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        hit = self._way in (way, "both") and since_s < self._for_s
        hit = hit and (not self._only or message_id(frame) in self._only)
        return [] if hit and self._dice.random() < self._share else [(0.0, frame)]

    def to_autopilot(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Drop the frame with probability share."""
        return self._fate("up", since_s, frame)

    def to_product(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Drop the frame with probability share."""
        return self._fate("down", since_s, frame)


class Unplugged(Injector):
    """A serial line that is unplugged for a while."""

    needs = Capabilities.SERIAL_LINE

    def __init__(self, for_s: float) -> None:
        self._for_s = for_s
        self._out = False

    def begin(self, at: InjectionContext) -> None:
        """Unplug the line."""
        assert at.line is not None
        at.line.unplug()
        self._out = True

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Plug the line in again, once."""
        assert at.line is not None
        if self._out and since_s >= self._for_s:
            at.line.plug()
            self._out = False


class DroppedCommand(Injector):
    """One kind of command that the autopilot never carries out: it is lost on the link."""

    def __init__(self, command: int) -> None:
        self._command = command

    def to_autopilot(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Drop the command.

        COMMAND_LONG carries the command number after seven floats.
        """
        hit = message_id(frame) == _COMMAND_LONG and int.from_bytes(frame[38:40], "little") == self._command
        return [] if hit else [(0.0, frame)]


class Jitter(Injector):
    """A random delay of every frame for a while, so that some overtake others."""

    def __init__(self, max_s: float, for_s: float = 1e9, seed: int = 0) -> None:
        self._max_s = max_s
        self._for_s = for_s
        self._dice = random.Random(seed)

    def to_autopilot(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Delay the frame by a uniform random time."""
        return [(self._dice.uniform(0.0, self._max_s) if since_s < self._for_s else 0.0, frame)]

    to_product = to_autopilot


class DuplicatedFrames(Injector):
    """Every frame three times; the copies arrive late, among later frames."""

    def __init__(self, late_s: float = 0.5) -> None:
        self._late_s = late_s

    def to_product(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Return the frame now and twice later."""
        return [(0.0, frame), (0.3 * self._late_s, frame), (self._late_s, frame)]

    to_autopilot = to_product


class Corrupted(Injector):
    """One wrong byte in a share of the frames."""

    def __init__(self, share: float, seed: int = 0) -> None:
        self._share = share
        self._dice = random.Random(seed)

    def to_product(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Change one byte at any position, the start byte included."""
        if self._dice.random() >= self._share:
            return [(0.0, frame)]
        spoilt = bytearray(frame)
        spoilt[self._dice.randrange(len(spoilt))] ^= self._dice.randrange(1, 256)
        return [(0.0, bytes(spoilt))]

    to_autopilot = to_product


class Garbage(Injector):
    """Random bytes inserted into what the product reads."""

    def __init__(self, bytes_per_s: int, for_s: float) -> None:
        self._per_s = bytes_per_s
        self._for_s = for_s
        self._before_s = 0.0

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Insert the bytes of this turn."""
        if since_s < self._for_s:
            count = int(self._per_s * (since_s - self._before_s))
            proxy_of(at).inject_to_product(at.dice.randbytes(count))
        self._before_s = since_s


class SpoofedSystem(Injector):
    """A sender on the link that pretends to be a system.

    It sends heartbeats in other modes and disarmed, false poses, and commands to the product.
    """

    def __init__(self, system: int, component: int = 1, for_s: float = 10.0, version_1: bool = False) -> None:
        self._for_s = for_s
        self._voice = mavlink.MAVLink(None, system, component)
        self._version_1 = version_1

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Send a message of every kind in each turn."""
        if since_s >= self._for_s:
            return
        boot_ms = int(since_s * 1000)
        for message in (
            mavlink.MAVLink_heartbeat_message(2, 12, 1, 3 << 16, 3, 3),
            mavlink.MAVLink_heartbeat_message(2, 12, 1, 84148224, 4, 3),
            mavlink.MAVLink_local_position_ned_message(boot_ms, 90.0, -80.0, 5.0, 3.0, 3.0, 3.0),
            mavlink.MAVLink_command_long_message(*COMPANION, 400, 0, 0.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            mavlink.MAVLink_command_long_message(*COMPANION, 176, 0, 1.0, 4.0, 6.0, 0.0, 0.0, 0.0, 0.0),
            mavlink.MAVLink_command_long_message(*COMPANION, 185, 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0),
        ):
            proxy_of(at).inject_to_product(bytes(message.pack(self._voice, force_mavlink1=self._version_1)))


class ProgramHeartbeats(Injector):
    """Heartbeats of other programs on the network, once a second each.

    programs: system id, component id, MAV_TYPE and MAV_AUTOPILOT of each. They reach the autopilot (to_autopilot) or the
    product. states: after each heartbeat, a program sends two messages as an autopilot would, of an empty battery and of a
    position elsewhere.
    """

    def __init__(self, *programs: tuple[int, int, int, int], to_autopilot: bool = False, states: bool = False) -> None:
        self._programs = [
            (mavlink.MAVLink(None, system, component), kind, family) for system, component, kind, family in programs
        ]
        for number, (voice, _, _) in enumerate(self._programs):
            voice.seq = 50 * number
        self._to_autopilot = to_autopilot
        self._states = states
        self._next_s = 0.0

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Send what is due."""
        if since_s < self._next_s:
            return
        self._next_s += 1.0
        send = proxy_of(at).inject_to_autopilot if self._to_autopilot else proxy_of(at).inject_to_product
        for voice, kind, family in self._programs:
            beat = mavlink.MAVLink_heartbeat_message(kind, family, 0, 0, 4, 3)
            empty = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0)
            place = mavlink.MAVLink_local_position_ned_message(int(since_s * 1000), 90.0, -80.0, 5.0, 3.0, 3.0, 3.0)
            for message in (beat, empty, place) if self._states else (beat,):
                send(bytes(message.pack(voice)))
                voice.seq = (voice.seq + 1) % 256


class SecondAutopilot(Injector):
    """Another autopilot on the link with the vehicle's own system id.

    It has its own sequence numbers and boot time, is elsewhere, and reports a mode ten times a second. briefly: it only sends
    one heartbeat per turn for 0.1 s, with sequence numbers that follow the vehicle's. modes: mode numbers of its HEARTBEAT on
    PX4 and on ArduPilot.
    """

    OURS, PILOTS, LANDING = (6 << 16, 4), (3 << 16, 5), (6 << 24 | 4 << 16, 9)

    def __init__(self, modes: tuple[int, int], armed: bool = True, for_s: float = 10.0, briefly: bool = False) -> None:
        self._modes = modes
        self._armed = armed
        self._for_s = for_s
        self._briefly = briefly
        self._voice = mavlink.MAVLink(None, 1, 1)
        self._turns = 0
        self._heartbeat: mavlink.MAVLink_message | None = None

    def begin(self, at: InjectionContext) -> None:
        """Build a heartbeat of the vehicle's firmware."""
        px4 = at.world.flyer.truth().mode == "OFFBOARD"
        family, mode, base = 12 if px4 else 3, self._modes[0 if px4 else 1], 1 | 128 * self._armed
        self._heartbeat = mavlink.MAVLink_heartbeat_message(2, family, base, mode, 4, 3)

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Send its messages; it booted a quarter of an hour before the fault."""
        if self._briefly and since_s < 0.1:
            self._voice.seq = (frames(proxy_of(at).heard[-1][1])[-1][4] + 16) % 256
            self._say(at, self._heartbeat)
        if self._briefly or since_s >= self._for_s:
            return
        boot_ms = int((900.0 + since_s) * 1000)
        if self._turns % 10 == 0:
            self._say(at, self._heartbeat)
        if self._turns % 3 == 0:
            self._say(at, mavlink.MAVLink_local_position_ned_message(boot_ms, 3.0, -2.0, -1.5, 0.3, 0.0, 0.0))
            self._say(at, mavlink.MAVLink_attitude_quaternion_message(boot_ms, 0.6, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0))
        self._turns += 1

    def _say(self, at: InjectionContext, message: mavlink.MAVLink_message | None) -> None:
        assert message is not None
        proxy_of(at).inject_to_product(bytes(message.pack(self._voice)))
        self._voice.seq = (self._voice.seq + 1) % 256


class RewrittenFrames(Injector):
    """Frames of one kind from the autopilot that a function rewrites."""

    def __init__(self, kind: int, change: Callable[[bytes], bytes]) -> None:
        self._kind = kind
        self._change = change

    def to_product(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Rewrite frames of this kind; return the others unchanged."""
        return [(0.0, self._change(frame) if message_id(frame) == self._kind else frame)]


class FalseBatteryCharge(Injector):
    """False battery charge in SYS_STATUS during some intervals.

    spells: from and until (s) and the charge, 0 to 1; NaN for unknown.
    """

    def __init__(self, *spells: tuple[float, float, float]) -> None:
        self._spells = spells

    def to_product(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Change the charge, and keep the sequence number of the frame.

        With another number, the frame would be taken for a late one.
        """
        shares = [share for from_s, until_s, share in self._spells if from_s <= since_s < until_s]
        if not shares or message_id(frame) != SYS_STATUS:
            return [(0.0, frame)]
        message, voice = mavlink.MAVLink(None).decode(bytearray(frame)), mavlink.MAVLink(None, 1, 1)
        message.battery_remaining, voice.seq = -1 if math.isnan(shares[0]) else round(shares[0] * 100), frame[4]
        return [(0.0, bytes(message.pack(voice)))]


def version(major: int, minor: int, patch: int) -> Callable[[bytes], bytes]:
    """Return a change of AUTOPILOT_VERSION to another firmware version."""
    voice = mavlink.MAVLink(None, 1, 1)

    def change(frame: bytes) -> bytes:
        message = mavlink.MAVLink(None).decode(bytearray(frame))
        message.flight_sw_version = major << 24 | minor << 16 | patch << 8 | 255
        return bytes(message.pack(voice))

    return change


def proxy_of(at: InjectionContext) -> MavlinkProxy:
    """Return the link's proxy, which the fault director keeps in the injection context."""
    assert at.proxy is not None
    return at.proxy
