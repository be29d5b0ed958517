"""Two autopilots under one name, and what one alone does that must not pass for two."""

from __future__ import annotations

import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as wire

from uav_recon.autopilot.link.duplicate_autopilot import DuplicateAutopilotDetector
from uav_recon.autopilot.mavlink.codec import Decoder

OURS, PILOTS = 6 << 16, 3 << 16


class Voice:
    """One autopilot: positions and attitudes thirty times a second, its mode ten times; booted at boot_s of our clock."""

    def __init__(self, boot_s: float, mode: int = OURS) -> None:
        self.boot_s = boot_s
        self.mode = mode
        self._voice = wire.MAVLink(None, 1, 1)

    def frames(self, turn: int) -> list[bytes]:
        """Of one of a hundred turns a second."""
        said: list[Any] = []
        boot_ms = int((turn / 100 - self.boot_s) * 1000) % (1 << 32)
        if turn % 3 == 0:
            said.append(wire.MAVLink_local_position_ned_message(boot_ms, 1.0, 2.0, -1.0, 0.0, 0.0, 0.0))
            said.append(wire.MAVLink_attitude_quaternion_message(boot_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        if turn % 10 == 0:
            said.append(wire.MAVLink_heartbeat_message(2, 12, 0x80, self.mode, 4, 3))
        return [self.frame(message) for message in said]

    def frame(self, message: Any) -> bytes:
        frame = bytes(message.pack(self._voice))
        self._voice.seq = (self._voice.seq + 1) % 256
        return frame


def noticed_s(arrivals: list[tuple[float, bytes]]) -> float | None:
    """When two are noticed, of frames by their arrival."""
    double, decoder = DuplicateAutopilotDetector(), Decoder()
    for now_s, frame in sorted(arrivals, key=lambda each: each[0]):
        for received in decoder.feed(frame):
            double.update(received, now_s)
        if double.detected(now_s):
            return now_s
    return None


def flight(voice: Voice, begin: int, end: int) -> list[tuple[float, bytes]]:
    return [(turn / 100, frame) for turn in range(begin, end) for frame in voice.frames(turn)]


@pytest.mark.parametrize("apart_s", [-800.0, -2.0, -1.0, 1.0, 3.0, 4_000_000.0])
def test_two_boot_clocks_are_noticed_within_a_second(apart_s: float) -> None:
    when_s = noticed_s(flight(Voice(-30.0), 0, 1000) + flight(Voice(-30.0 + apart_s), 500, 1000))
    assert when_s is not None
    assert 5.0 < when_s <= 5.8


def test_a_mode_that_goes_to_and_fro_is_noticed_where_the_clocks_are_one() -> None:
    when_s = noticed_s(flight(Voice(-30.0), 0, 1000) + flight(Voice(-30.0, PILOTS), 505, 1000))
    assert when_s is not None
    assert 5.0 < when_s <= 5.8


def test_a_clock_of_its_own_in_every_frame_is_noticed() -> None:
    dice = random.Random(1)
    forged = [frame for turn in range(500, 600) for frame in [(turn / 100, Voice(-dice.uniform(1e2, 1e6)).frames(30)[0])]]
    when_s = noticed_s(flight(Voice(-30.0), 0, 1000) + forged)
    assert when_s is not None
    assert when_s <= 5.1


def test_one_that_restarts_is_one() -> None:
    assert noticed_s(flight(Voice(-30.0), 0, 503) + flight(Voice(5.03), 503, 1500)) is None


@pytest.mark.parametrize("wall", ["late", "thrice", "held back", "one in a while"])
def test_a_bad_link_to_one_that_changes_its_mode_is_one(wall: str) -> None:
    dice, voice = random.Random(3), Voice(-30.0)
    sent = flight(voice, 0, 500)
    voice.mode = PILOTS
    sent += flight(voice, 500, 1000)
    voice.mode = OURS
    sent += flight(voice, 1000, 1500)
    arrivals = {
        "late": [(at_s + dice.uniform(0.0, 0.3), frame) for at_s, frame in sent],
        "thrice": [(at_s + late_s, frame) for at_s, frame in sent for late_s in (0.0, 0.15, 0.5)],
        "held back": [(7.0 if 4.0 < at_s < 7.0 else at_s, frame) for at_s, frame in sent],
        "one in a while": [each for each in sent if dice.random() < 0.05],
    }[wall]
    assert noticed_s(arrivals) is None


def test_it_is_over_two_seconds_after_the_other_fell_silent() -> None:
    double, decoder = DuplicateAutopilotDetector(), Decoder()
    spoken = []
    for now_s, frame in sorted(flight(Voice(-30.0), 0, 1000) + flight(Voice(-900.0), 200, 400), key=lambda each: each[0]):
        for received in decoder.feed(frame):
            double.update(received, now_s)
        spoken.append((now_s, double.detected(now_s)))
    over_s = max(now_s for now_s, two in spoken if two)
    assert 5.9 <= over_s <= 6.5
