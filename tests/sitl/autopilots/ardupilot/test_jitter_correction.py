from __future__ import annotations

import random

from sitl.autopilots.ardupilot.jitter_correction import JitterCorrection

OFFSET_US = 5_000_000


def test_jitter_is_removed_and_the_least_lag_remains() -> None:
    source, correction = random.Random(1), JitterCorrection()
    errors = []
    for i in range(400):
        sent = 20_000 * i
        lag = 30_000 + source.randrange(40_000)
        errors.append(correction.local_us(sent, sent + OFFSET_US + lag) - (sent + OFFSET_US))
    settled = errors[120:]
    assert max(settled) - min(settled) < 5_000
    assert 30_000 <= min(settled) < 35_000


def test_a_clock_that_was_set_back_is_followed_within_half_a_second() -> None:
    correction = JitterCorrection()
    assert correction.local_us(10_000_000, 20_000_000) == 20_000_000
    assert correction.local_us(2_000_000, 21_000_000) == 20_500_000


def test_a_slowly_drifting_clock_is_followed() -> None:
    correction = JitterCorrection()
    last = 0
    for i in range(1000):
        now = 20_000 * i
        last = now - correction.local_us(now - 2 * i, now)  # our clock gains 100 us per second
    assert last < 500
