"""Hostile traffic on the link: `python tests/autopilot/link/hostile_traffic.py [BYTES [FORGED [SEED]]] [--json FILE]`.

Bursts of random bytes, rich in the bytes that frames begin with, and among them forged frames: of other vehicles and other
components, of MAVLink 1, and orders that no autopilot gives to a companion. After each burst the true autopilot speaks on, no
faster than it does in flight, and the time until it is heard is taken.
"""

from __future__ import annotations

import argparse
import dataclasses
import resource
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from px4_link import px4_link
from pymavlink.dialects.v20 import common as wire

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.measurement import result_file

BURST = 1 << 15  # bytes: a thirtieth of a second of a megabyte a second
_TAKEN_S = 0.010  # for a burst, so that a turn with a third of it in it leaves the stream its time
TELEMETRY_HZ = 60.0  # positions and attitudes in turn, thirty times a second each, as we ask for them
TRUE, STRANGERS = (1, 1), ((42, 1), (1, 77), (255, 190))

STATES = (
    wire.MAVLink_heartbeat_message(2, 12, 1, 3 << 16, 3, 3),
    wire.MAVLink_local_position_ned_message(7, 90.0, -80.0, 5.0, 3.0, 3.0, 3.0),
    wire.MAVLink_attitude_quaternion_message(7, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    wire.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0),
    wire.MAVLink_estimator_status_message(0, 0, *[9.0] * 8),
    wire.MAVLink_statustext_message(0, b"land at once"),
    wire.MAVLink_timesync_message(0, 1),  # a question: an answer would be ours
    wire.MAVLink_param_value_message(b"COM_OF_LOSS_T", 99.0, 9, 1, 0),
    wire.MAVLink_gps_global_origin_message(1, 2, 3),
)
ORDERS = (
    wire.MAVLink_command_long_message(233, 191, 400, 0, 0.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    wire.MAVLink_command_long_message(233, 191, 185, 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    wire.MAVLink_command_long_message(233, 191, 246, 0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    wire.MAVLink_set_mode_message(233, 1, 84148224),
    wire.MAVLink_param_set_message(233, 191, b"COM_OF_LOSS_T", 99.0, 9),
    wire.MAVLink_manual_control_message(233, 900, 900, 900, 900, 0),
    wire.MAVLink_set_position_target_local_ned_message(0, 233, 191, 1, 0, *[50.0] * 11),
)


@dataclass(frozen=True)
class HostileTrafficOutcome:
    """effects: what changed of what the link holds true, and what it said; heard_after_s of each burst, and taken_s, the
    processor's time for it; grown_bytes of the process, and what waited in the decoder at most.
    """

    effects: list[str]
    heard_after_s: list[float]
    taken_s: list[float]
    grown_bytes: int
    waited_bytes: int


class Wire:
    """A byte link whose other end is this file."""

    def __init__(self) -> None:
        self.inbox = b""
        self.sent = b""

    def read(self) -> bytes:
        data = self.inbox
        self.inbox = b""
        return data

    def write(self, data: bytes) -> None:
        self.sent += data

    def wait(self, timeout_s: float) -> None:
        pass

    def close(self) -> None:
        pass


def frame_of(message: wire.MAVLink_message, sender: tuple[int, int] = TRUE, mavlink1: bool = False, number: int = 0) -> bytes:
    voice = wire.MAVLink(None, *sender)
    voice.seq = number % 256
    return bytes(message.pack(voice, force_mavlink1=mavlink1))


def forgeries() -> list[bytes]:
    """Every state told by a stranger and in MAVLink 1, every order by anybody."""
    told = [frame_of(state, sender) for state in STATES for sender in STRANGERS]
    told += [frame_of(state, mavlink1=True) for state in STATES]
    return told + [frame_of(order, sender) for order in ORDERS for sender in (TRUE, *STRANGERS)]


def truth(count: int, turn: int) -> bytes:
    """What the autopilot itself says in turn: a position that tells one burst from the next, and an attitude."""
    place = wire.MAVLink_local_position_ned_message(count, float(count % 5000), 0.5, -1.0, 0.1, 0.0, 0.0)
    attitude = wire.MAVLink_attitude_quaternion_message(count, 0.8, 0.0, 0.0, 0.6, 0.0, 0.0, 0.0)
    return frame_of((place, attitude)[turn % 2], number=16 * count + turn)


def held_true(link: VehicleLink) -> dict[str, str]:
    """What the link knows, the autopilot's clock too, but for what the autopilot goes on saying."""
    known = {
        field.name: repr(getattr(value, field.name))
        for value in (link.telemetry, link.status)
        for field in dataclasses.fields(value)
        if field.name not in ("received_s", "estimate")
    }
    return {**known, "clock": str(link._clock.autopilot_ns(1.0))}


def flying() -> tuple[VehicleLink, Wire]:
    """A link whose autopilot has said that all is well, and whose clock is known."""
    far = Wire()
    link = px4_link(far)
    link.parameters.read(0.0, "COM_OF_LOSS_T")
    bit = wire.MAV_SYS_STATUS_PREARM_CHECK
    for well in (
        wire.MAVLink_heartbeat_message(2, 12, 0x80, 6 << 16, 4, 3),
        wire.MAVLink_sys_status_message(bit, bit, bit, 0, 0, 0, 80, 0, 0, 0, 0, 0, 0),
        wire.MAVLink_estimator_status_message(0, 0x3F, *[0.0] * 8),
    ):
        far.inbox += frame_of(well)
    for n in range(12):
        far.inbox += frame_of(wire.MAVLink_timesync_message(int(37e9 + n * 2e8), int(n * 2e8)), number=n)
        link.receive(n * 0.2 + 0.002)
    assert link.status.time_known
    far.sent = b""
    return link, far


def heard_after_s(link: VehicleLink, far: Wire, count: int, now_s: float) -> float:
    """Feed the true telemetry, frame by frame, until its position is taken; infinity if it never is."""
    for turn in range(600):
        far.inbox += truth(count, turn)
        link.receive(now_s + turn / TELEMETRY_HZ)
        if link.telemetry.estimate.position_m[1] == count % 5000:
            return turn / TELEMETRY_HZ
    return float("inf")


def bombard(size: int, forged: int, seed: int) -> HostileTrafficOutcome:
    """size: bytes in all; forged: frames among them."""
    rng, (link, far) = np.random.default_rng(seed), flying()
    before, after_s, taken_s, effects, waited = held_true(link), [], [], [], 0
    bursts, lies = max(size // BURST, 1), forgeries()
    started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for count in range(2, bursts + 2):
        noise = rng.integers(0, 256, BURST, dtype=np.uint8)
        noise[rng.random(BURST) < 0.02] = rng.choice([0xFD, 0xFE])
        pieces = np.split(noise, np.sort(rng.integers(0, BURST, -(-forged // bursts))))
        now_s = 3.0 + 0.1 * count
        for n, piece in enumerate(pieces):
            far.inbox += (lies[(count * len(pieces) + n) % len(lies)] if n else b"") + piece.tobytes()
        begun_s = time.process_time()
        link.receive(now_s)
        taken_s.append(time.process_time() - begun_s)
        waited = max(waited, len(link._frames._decoder._buffer))
        after_s.append(heard_after_s(link, far, count, now_s))
        now = held_true(link)
        effects += [f"{name}: {before[name]} became {now[name]}" for name in before if now[name] != before[name]]
        before = now
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - started) * 1024
    return HostileTrafficOutcome(effects + ["the link spoke"] * bool(far.sent), after_s, taken_s, grown, waited)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("bytes", type=int, nargs="?", default=10_000_000)
    parser.add_argument("forged", type=int, nargs="?", default=500)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = bombard(options.bytes, options.forged, options.seed)
    late_s, taken_s = np.array(found.heard_after_s), float(np.quantile(found.taken_s, 0.99))
    print(f"{len(late_s) * BURST} bytes, {options.forged} forged frames: {len(found.effects)} effects")
    print(f"heard again after {np.median(late_s) * 1e3:.0f} ms, {late_s.max() * 1e3:.0f} ms at most")
    print(f"{BURST} bytes, {BURST * 1e-3:.0f} ms of a megabyte a second, are taken in within {taken_s * 1e3:.1f} ms (99 %)")
    print(f"process grown by {found.grown_bytes / 1e6:.1f} MB, {found.waited_bytes} bytes waiting at most")
    print(*found.effects, sep="\n", end="")
    if options.json:
        measured = {
            "bytes": len(late_s) * BURST,
            "forged": options.forged,
            "effects": len(found.effects),
            "max_received_after_s": float(late_s.max()),
            "burst_p99_s": taken_s,
            "grown_mb": found.grown_bytes / 1e6,
        }
        result_file.save(options.json, measured)
    sys.exit(bool(found.effects) or late_s.max() > 0.05 or found.grown_bytes > 5e6 or taken_s > _TAKEN_S)
