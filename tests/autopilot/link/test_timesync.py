"""The clock filter: shortest round trip wins, one bad answer changes nothing, a reboot starts it again."""

from __future__ import annotations

import random

import pytest

from uav_recon.autopilot.link.timesync import TimeSyncFilter

MS = 1_000_000
OFFSET_NS = 37_500 * MS


def exchange(sync: TimeSyncFilter, sent_ms: float, there_ms: float, back_ms: float, offset_ns: int = OFFSET_NS) -> None:
    sent = int(sent_ms * MS)
    sync.observe(sent, sent + int(there_ms * MS) + offset_ns, sent + int((there_ms + back_ms) * MS))


def test_the_offset_is_right_to_half_the_shortest_round_trip() -> None:
    sync, rng = TimeSyncFilter(), random.Random(1)
    for i in range(64):
        exchange(sync, 100.0 * i, rng.uniform(0.2, 8.0), rng.uniform(0.2, 8.0))
    assert sync.converged
    assert abs(sync.autopilot_ns(10.0) - (10_000 * MS + OFFSET_NS)) < 1.0 * MS


def test_ten_exchanges_converge_and_slow_ones_do_not_count() -> None:
    sync = TimeSyncFilter()
    for i in range(50):
        exchange(sync, 100.0 * i, 20.0, 20.0)
    exchange(sync, 5000.0, -2.0, 1.0)
    assert not sync.converged
    for i in range(10):
        assert not sync.converged
        exchange(sync, 6000.0 + 100.0 * i, 1.0, 1.0)
    assert sync.converged


def test_a_lie_is_ignored_and_a_reboot_is_not() -> None:
    sync = TimeSyncFilter()
    for i in range(10):
        exchange(sync, 100.0 * i, 1.0, 1.0)
    for i in range(4):
        exchange(sync, 2000.0 + i, 1.0, 1.0, offset_ns=0)
    assert abs(sync.autopilot_ns(1.0) - (1000 * MS + OFFSET_NS)) < MS
    exchange(sync, 2500.0, 1.0, 1.0)
    assert sync.restarts == 0
    for i in range(5):
        exchange(sync, 3000.0 + i, 1.0, 1.0, offset_ns=-2_000 * MS)
    assert sync.restarts == 1
    assert not sync.converged


def test_one_contradiction_makes_it_doubtful_and_one_agreement_clears_it() -> None:
    sync = TimeSyncFilter()
    for i in range(10):
        exchange(sync, 100.0 * i, 1.0, 1.0)
    exchange(sync, 2000.0, 1.0, 1.0, offset_ns=0)
    assert (sync.converged, sync.lost) == (False, True)
    exchange(sync, 2020.0, 1.0, 1.0)
    assert (sync.converged, sync.lost) == (True, False)


def test_lies_that_differ_are_never_believed() -> None:
    sync = TimeSyncFilter()
    for i in range(10):
        exchange(sync, 100.0 * i, 1.0, 1.0)
    for i in range(20):
        exchange(sync, 2000.0 + i, 1.0, 1.0, offset_ns=-2_000 * MS * (i % 2 + 2))
    assert sync.restarts == 0
    assert not sync.converged


def test_what_spoke_for_the_new_clock_is_kept() -> None:
    sync = TimeSyncFilter()
    for i in range(20):
        exchange(sync, 100.0 * i, 1.0, 1.0)
    for i in range(10):
        assert not (i and sync.converged)
        exchange(sync, 3000.0 + 20.0 * i, 1.0, 1.0, offset_ns=-2_500 * MS)
    assert sync.converged
    assert sync.autopilot_ns(3.2) == pytest.approx(700 * MS, abs=MS)


@pytest.mark.parametrize("stood_still_ms", [160, 900])
def test_a_clock_that_stood_still_for_a_while_is_no_reboot(stood_still_ms: int) -> None:
    """As that of a firmware in simulation does, where its computer stalls."""
    sync = TimeSyncFilter()
    for i in range(100):
        exchange(sync, 100.0 * i, 1.0, 1.0)
    for i in range(5):
        assert abs(sync.autopilot_ns(10.0) - (10_000 * MS + OFFSET_NS)) < MS
        exchange(sync, 12_000.0 + 100.0 * i, 1.0, 1.0, offset_ns=OFFSET_NS - stood_still_ms * MS)
    assert sync.converged
    assert sync.restarts == 0
    assert abs(sync.autopilot_ns(13.0) - (13_000 * MS + OFFSET_NS - stood_still_ms * MS)) < MS


def test_instants_before_the_autopilots_boot_are_its_zero() -> None:
    sync = TimeSyncFilter()
    exchange(sync, 9000.0, 0.0, 0.0, offset_ns=-8_000 * MS)
    assert sync.autopilot_ns(3.0) == 0


@pytest.mark.parametrize("told_ns", [2**63 - 1, 2**62])
def test_a_clock_that_no_autopilot_has_is_not_heard(told_ns: int) -> None:
    """It was believed after five times, and our answer to the next question did not fit its field."""
    sync = TimeSyncFilter()
    for i in range(10):
        exchange(sync, 100.0 * i, 1.0, 1.0)
    for i in range(8):
        sync.observe((2000 + i) * MS, told_ns, (2001 + i) * MS)
    assert sync.converged
    assert sync.restarts == 0
    assert abs(sync.autopilot_ns(3.0) - (3000 * MS + OFFSET_NS)) < MS


def test_the_usual_trip_is_the_median_of_the_last_twenty_whatever_they_took() -> None:
    """Copies of an answer, and answers to what was asked long ago, tell nothing."""
    sync = TimeSyncFilter()
    for i in range(19):
        exchange(sync, 100.0 * i, 100.0 + 10.0 * i, 50.0)
    assert sync.usual_trip_s == 0.0, "too few"
    exchange(sync, 1900.0, 290.0, 50.0)
    assert sync.usual_trip_s == pytest.approx(0.245)
    for _ in range(40):
        exchange(sync, 1900.0, 900.0, 50.0)
        exchange(sync, 2000.0, 9000.0, 50.0)
    assert sync.usual_trip_s == pytest.approx(0.245)
    for i in range(20):
        exchange(sync, 3000.0 + 100.0 * i, 1.0, 1.0)
    assert sync.usual_trip_s == pytest.approx(0.002)


@pytest.mark.parametrize("ahead_s", [0.0, 37.5, 4294960.0, 9.0e6])
@pytest.mark.parametrize("before_s", [0.0, 0.4, -0.1])
def test_a_boot_clock_of_32_bits_becomes_our_instant(ahead_s: float, before_s: float) -> None:
    """Also across a restart of the 32 bits, after 49.7 days."""
    sync = TimeSyncFilter(samples_needed=1)
    sync.observe(int(100.0e9), int((100.0 + ahead_s) * 1e9), int(100.0e9))
    boot_ms = round((110.0 - before_s + ahead_s) * 1000.0) % (1 << 32)
    assert sync.ours_s(boot_ms, 110.0) == pytest.approx(110.0 - before_s, abs=1e-3)
