"""The clock of the link: stamps on our clock, answers in the autopilot's, and the delay of messages."""

from __future__ import annotations

import pytest

from uav_recon.autopilot.link.link_clock import LinkClock
from uav_recon.autopilot.link.own_heartbeat import OwnHeartbeat
from uav_recon.autopilot.mavlink.messages import TimesyncMessage
from uav_recon.types.reason_code import ReasonCode

AHEAD_NS = 37_000_000_000  # lead of the autopilot's clock


def exchange(clock: LinkClock, sent_s: float, trip_s: float = 0.002, ahead_ns: int = AHEAD_NS) -> bool:
    sent_ns, half_ns = int(sent_s * 1e9), int(trip_s * 5e8)
    return clock.observe(TimesyncMessage(sent_ns + half_ns + ahead_ns, sent_ns), sent_s + trip_s)


@pytest.fixture
def clock() -> LinkClock:
    clock = LinkClock(0.0)
    for n in range(12):
        exchange(clock, 0.1 * n)
    clock.update(1.2)
    assert clock.known
    return clock


def test_stamps_are_on_our_clock_once_it_is_known(clock: LinkClock) -> None:
    assert LinkClock(0.0).stamp_s(1000, 5.0) is None
    assert clock.stamp_s(-1, 5.0) is None
    assert clock.stamp_s(41_500, 5.0) == pytest.approx(4.5, abs=1e-6)
    assert clock.stamp_of_us_s(41_500_000, 5.0) == pytest.approx(4.5, abs=1e-6)


def test_a_measurement_is_never_in_the_future_and_a_long_past_one_has_no_time(clock: LinkClock) -> None:
    assert clock.measured_s(42_300, 5.0) == 5.0
    assert clock.measured_s(41_100, 5.0) == pytest.approx(4.1, abs=1e-6)
    assert clock.measured_s(40_900, 5.0) is None


def test_requests_are_answered_in_its_clock_and_prompt_ones_count(clock: LinkClock) -> None:
    asked_ns = AHEAD_NS + 5_000_000_000
    assert LinkClock(0.0).answer_ns(TimesyncMessage(0, asked_ns), 5.0) is None
    assert clock.answer_ns(TimesyncMessage(0, asked_ns), 5.01) == pytest.approx(asked_ns + 10_000_000, abs=1000)
    assert clock.answers == 1
    clock.answer_ns(TimesyncMessage(0, asked_ns), 5.05)
    assert clock.answers == 1, "a late copy teaches the autopilot nothing"


def test_a_clock_that_went_back_is_a_restart(clock: LinkClock) -> None:
    restarted = [exchange(clock, 2.0 + 0.1 * n, ahead_ns=0) for n in range(5)]
    assert restarted == [False] * 4 + [True]
    assert clock.restarts == 1


def test_requests_are_more_frequent_while_the_clock_is_lost(clock: LinkClock) -> None:
    usual = sum(clock.request_due(2.0 + 0.01 * n) for n in range(100))
    exchange(clock, 3.0, ahead_ns=0)
    assert clock.lost
    assert (usual, sum(clock.request_due(4.0 + 0.01 * n) for n in range(100))) == (10, 50)


def test_a_slow_link_counts_as_slow_for_ten_seconds_more(clock: LinkClock) -> None:
    for n in range(20):
        exchange(clock, 2.0 + n, trip_s=0.3)
    alert = clock.update(22.0)
    assert alert is not None and alert.code is ReasonCode.LINK_SLOW and clock.slow == alert
    for n in range(20):
        exchange(clock, 22.0 + 0.1 * n)
    assert clock.update(31.9) is None and clock.slow == alert
    assert clock.update(32.1) is None and clock.slow is None


def test_heartbeats_end_after_a_silence_of_the_autopilot_or_for_good() -> None:
    heartbeat = OwnHeartbeat(0.0)
    assert heartbeat.due(0.0, -float("inf")), "before it was received, it may be waiting for ours"
    assert not heartbeat.due(0.1, 0.0), "five a second"
    assert heartbeat.due(1.6, 0.0)
    assert not heartbeat.due(1.8, 0.0)
    assert heartbeat.due(2.0, 1.9)
    heartbeat.stop()
    assert not heartbeat.due(3.0, 3.0)
