"""The oldest depth in motion, at every rate of a camera: one missing frame passes, two do not."""

from __future__ import annotations

import math

import pytest

from uav_recon.safety.depth_age_limit import LONGEST_S, DepthInterval, depth_limit_s

TIMEOUT_S = 0.3


def measured(stamps_s: list[float], delay_s: float = 0.08) -> DepthInterval:
    interval = DepthInterval()
    for stamp_s in stamps_s:
        interval.add(stamp_s, stamp_s + delay_s)
    return interval


def regular(rate_hz: float, missing: frozenset[int] = frozenset(), frames: int = 12) -> list[float]:
    return [100.0 + n / rate_hz for n in range(frames) if n not in missing]


@pytest.mark.parametrize("rate_hz", [5.5, 6.0, 7.0, 10.0, 15.0, 30.0, 90.0])
def test_one_missing_frame_passes_and_two_do_not_at_any_rate(rate_hz: float) -> None:
    one_s = measured(regular(rate_hz)).one_missing_s
    assert 2.0 / rate_hz + 0.08 < one_s < 3.0 / rate_hz + 0.08 or rate_hz > 30.0
    limit_s = depth_limit_s(TIMEOUT_S, one_s)
    assert limit_s == pytest.approx(max(TIMEOUT_S, min(2.0 / rate_hz + 0.11, LONGEST_S)))


@pytest.mark.parametrize("rate_hz", [10.6, 15.0, 30.0])
def test_a_fast_camera_keeps_the_configured_limit(rate_hz: float) -> None:
    assert depth_limit_s(TIMEOUT_S, measured(regular(rate_hz)).one_missing_s) == TIMEOUT_S


@pytest.mark.parametrize("missing", [frozenset({4, 9}), frozenset({3, 7, 11}), frozenset({1, 4})])
def test_missing_frames_do_not_make_the_camera_slower(missing: frozenset[int]) -> None:
    assert measured(regular(6.0, missing, frames=14)).one_missing_s == pytest.approx(2.0 / 6.0 + 0.11)


def test_every_second_frame_missing_is_a_slower_camera_and_bounded() -> None:
    half = measured(regular(6.0, frozenset(range(1, 24, 2)), frames=24))
    assert depth_limit_s(TIMEOUT_S, half.one_missing_s) == LONGEST_S == 0.5


def test_the_rate_is_not_known_from_few_or_old_frames() -> None:
    assert DepthInterval().one_missing_s == 0.0
    assert measured(regular(6.0, frames=8)).one_missing_s == 0.0
    assert measured(regular(6.0, frames=9)).one_missing_s > 0.0
    assert measured(regular(1.5, frames=9)).one_missing_s == 0.0, "spread over more than five seconds"


def test_frames_tell_the_rate_within_five_seconds_exactly() -> None:
    assert measured([100.0 + 0.625 * n for n in range(9)]).one_missing_s == pytest.approx(1.36)
    assert measured([100.0 + 0.626 * n for n in range(9)]).one_missing_s == 0.0


@pytest.mark.parametrize(("long", "interval_s"), [(3, 0.125), (4, 0.125), (5, 0.25), (8, 0.25)])
def test_the_interval_is_that_of_half_the_frames(long: int, interval_s: float) -> None:
    stamps_s = [4.0 + 0.125 * n for n in range(9 - long)]
    stamps_s += [stamps_s[-1] + 0.25 * n for n in range(1, long + 1)]
    for offset_s in (-3.95, 0.0, 1000.0):
        one_s = measured([offset_s + stamp_s for stamp_s in stamps_s]).one_missing_s
        assert one_s == pytest.approx(2.0 * interval_s + 0.11)


def test_a_delay_counts_for_nine_frames() -> None:
    interval = DepthInterval()
    for n in range(20):
        interval.add(100.0 + n / 6.0, 100.0 + n / 6.0 + (0.2 if n == 10 else 0.08))
        if n >= 9:
            late = 10 <= n < 19
            assert interval.one_missing_s == pytest.approx(2.0 / 6.0 + (0.23 if late else 0.11)), n


def test_the_largest_delay_of_the_newest_frames_counts() -> None:
    interval = measured(regular(6.0))
    interval.add(102.1, 102.1 + 0.1)
    assert interval.one_missing_s == pytest.approx(2.0 / 6.0 + 0.1 + 0.03)


@pytest.mark.parametrize(
    ("one_missing_s", "limit_s"),
    [(0.0, 0.3), (-1.0, 0.3), (0.299, 0.3), (0.301, 0.301), (0.5, 0.5), (0.501, 0.5), (math.inf, 0.3), (math.nan, 0.3)],
)
def test_a_limit_is_never_below_the_configured_one_nor_above_the_longest(one_missing_s: float, limit_s: float) -> None:
    assert depth_limit_s(TIMEOUT_S, one_missing_s) == limit_s


def test_a_configured_limit_above_the_longest_stays() -> None:
    assert depth_limit_s(0.8, 0.45) == 0.8
    assert depth_limit_s(0.8, 9.0) == 0.8
