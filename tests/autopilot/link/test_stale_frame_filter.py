"""Which frames of a sender are news, whatever the link repeats, reorders or loses."""

from __future__ import annotations

import random

import pytest
from pymavlink.dialects.v20 import common as wire

from uav_recon.autopilot.link.stale_frame_filter import StaleFrameFilter

HEARTBEAT = wire.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
SYNC = wire.MAVLink_timesync_message(0, 1)


def frame(number: int, message: wire.MAVLink_message = HEARTBEAT) -> bytes:
    voice = wire.MAVLink(None, 1, 1)
    voice.seq = number % 256
    return bytes(message.pack(voice))


def test_a_clean_stream_is_all_news_however_long() -> None:
    succession = StaleFrameFilter()
    assert all(succession.is_newest(frame(number), 0.01 * number) for number in range(1000))


def test_of_three_copies_late_and_among_others_the_first_counts() -> None:
    succession, arrivals = StaleFrameFilter(), []
    for number in range(400):
        arrivals += [(0.01 * number + late, number) for late in (0.0, 0.15, 0.45)]
    taken = [number for at_s, number in sorted(arrivals) if succession.is_newest(frame(number), at_s)]
    assert taken == list(range(400))


def test_on_a_busy_link_numbers_come_round_before_the_last_copy_does() -> None:
    """512 frames a second: what is half a second late has the number of what is sent now."""
    succession, arrivals = StaleFrameFilter(), []
    for number in range(2048):
        arrivals += [(number / 512 + late, number) for late in (0.0, 0.25, 0.4, 0.5)]
    told = {number: wire.MAVLink_heartbeat_message(2, 12, 0, number, 4, 3) for number in range(2048)}
    taken = [n for at_s, n in sorted(arrivals) if at_s < 4.0 and succession.is_newest(frame(n, told[n]), at_s)]
    assert taken == list(range(2048))


@pytest.mark.parametrize("seed", range(5))
def test_what_is_taken_never_goes_back(seed: int) -> None:
    dice, succession = random.Random(seed), StaleFrameFilter()
    arrivals = sorted((0.01 * number + dice.uniform(0.0, 0.4), number) for number in range(600))
    taken = [number for at_s, number in arrivals if succession.is_newest(frame(number), at_s)]
    assert taken == sorted(taken)
    assert len(taken) > 60


def test_kinds_do_not_wait_for_each_other() -> None:
    succession = StaleFrameFilter()
    assert succession.is_newest(frame(9, SYNC), 0.0)
    assert succession.is_newest(frame(7), 0.01)
    assert not succession.is_newest(frame(6), 0.02)


@pytest.mark.parametrize("lost", [1, 127, 128, 200, 255])
def test_after_a_gap_or_a_new_beginning_it_is_heard_within_half_a_second(lost: int) -> None:
    succession, number = StaleFrameFilter(), 40
    for number in range(40, 90):
        assert succession.is_newest(frame(number), 0.01 * number)
    at_s = 0.01 * number
    heard = [succession.is_newest(frame(number + lost + n), at_s + 0.01 * n) for n in range(1, 100)]
    assert all(heard[51:])
