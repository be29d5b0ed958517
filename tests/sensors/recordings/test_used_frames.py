"""Choice of the frames of a recording by their stamps: what people really have."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.sensors.recordings.frame_stamps import UsedFrames, used_frames
from uav_recon.sensors.recordings.recording import RecordingError

PERIOD_S = 1.0 / 30.0
EPOCH_S = 1.3e9


def steady(count: int, begin_s: float = EPOCH_S) -> list[float]:
    return [begin_s + k * PERIOD_S for k in range(count)]


def used(stamps_s: list[float]) -> UsedFrames:
    return used_frames(Path("walk"), stamps_s)


def said(stamps_s: list[float]) -> str:
    with pytest.raises(RecordingError) as error:
        used(stamps_s)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_steady_stamps_are_all_used() -> None:
    found = used(steady(300))
    assert (found.order, found.skipped, found.remarks, found.is_part) == (tuple(range(300)), {}, (), False)


@pytest.mark.parametrize("at", [1, 150, 298])
def test_a_repeated_stamp_costs_its_frame_and_a_swapped_pair_nothing(at: int) -> None:
    stamps_s = steady(300)
    stamps_s[at] = stamps_s[at - 1]
    found = used(stamps_s)
    assert found.order == tuple(k for k in range(300) if k != at)
    assert found.skipped == {"frames with the stamp of another": 1}
    stamps_s = steady(300)
    stamps_s[at], stamps_s[at - 1] = stamps_s[at - 1], stamps_s[at]
    found = used(stamps_s)
    assert (found.order[at - 1 : at + 1], found.skipped, found.remarks) == ((at, at - 1), {}, ())
    assert list(found.stamps_s) == sorted(stamps_s)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 10))
def test_a_few_late_frames_are_sorted(seed: int, late: int) -> None:
    """Frames that come late by up to 0.9 s are put where they belong."""
    rng = random.Random(seed)
    order = list(range(300))
    for number in rng.sample(range(30, 270), late):
        order.remove(number)
        order.insert(min(number + rng.randint(1, 26), 299), number)
    stamps_s = [EPOCH_S + k * PERIOD_S for k in order]
    found = used(stamps_s)
    assert list(found.stamps_s) == sorted(stamps_s)
    assert found.skipped == {}


@pytest.mark.parametrize("jump_s", [700.0, 1.7e9])
@pytest.mark.parametrize(("first", "second"), [(200, 100), (100, 200)])
def test_at_a_gap_the_longer_part_is_used_and_said(jump_s: float, first: int, second: int) -> None:
    stamps_s = [*steady(first, 100.0), *steady(second, 100.0 + first * PERIOD_S + jump_s)]
    found = used(stamps_s)
    assert found.order == tuple(range(200)) if first == 200 else tuple(range(100, 300))
    assert found.skipped == {"frames at a jump of the stamps": 100}
    (line,) = found.remarks
    assert line.startswith(f"gap of {jump_s + PERIOD_S:.4g} s after {stamps_s[first - 1]:.3f} s: used 200 of 300 frames, ")
    assert found.is_part


def test_a_clock_that_was_set_back_leaves_its_longer_part() -> None:
    found = used([*steady(30, 5000.0), *steady(200, 10.0)])
    assert found.order == tuple(range(30, 230))
    assert found.remarks[0].startswith("step back of 4991 s after 5000.967 s: used 200 of 230 frames, 10.000 to 16.633 s")


def test_a_recording_that_begins_again_is_one_line() -> None:
    """As a bag that was played in a loop while it was recorded: its poses cannot be told apart."""
    assert "several frames for the same time; cut the recording there" in said([*steady(300), *steady(300)])


@pytest.mark.parametrize("wrong_s", [0.0, 1e12, float("nan"), EPOCH_S + 200.0, EPOCH_S - 50.0])
@pytest.mark.parametrize("at", [0, 40, 299])
def test_a_single_wrong_stamp_costs_its_frame(wrong_s: float, at: int) -> None:
    stamps_s = steady(300)
    stamps_s[at] = wrong_s
    found = used(stamps_s)
    assert len(found.order) >= 299
    if at == 40:
        assert 40 not in found.order


@pytest.mark.parametrize(("unit", "name"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
@pytest.mark.parametrize("rate_hz", [1.1, 15.0, 30.0, 290.0])
def test_another_unit_is_named(unit: float, name: str, rate_hz: float) -> None:
    text = said([unit * (EPOCH_S + k / rate_hz) for k in range(300)])
    assert f"want stamps in seconds, 1 to 300 frames a second; they look like {name}, divide them by {unit:.0f}" in text


def test_durations_of_a_loop_are_one_line() -> None:
    """As Make-ORB-SLAM2-RGBD-dataset writes them: 191 frames in 0.03 s."""
    rng = np.random.default_rng(0)
    text = said([0.033 + float(rng.normal(0.0, 0.004)) for _ in range(191)])
    assert "stamps are out of order: " in text
    assert "want stamps of the capture in seconds, not durations, in the order of the frames" in text
    assert said(sorted(0.033 + float(rng.normal(0.0, 0.004)) for _ in range(191))).startswith("walk: 191 frames in 0.02")


def test_a_list_by_name_or_at_random_is_one_line() -> None:
    names = sorted(range(1000), key=str)
    assert "stamps are out of order: " in said([k * PERIOD_S for k in names])
    shuffled = list(range(300))
    random.Random(1).shuffle(shuffled)
    assert "stamps are out of order: " in said([k * PERIOD_S for k in shuffled])
    assert "stamps are out of order: 299 of 300" in said(steady(300)[::-1])


@pytest.mark.parametrize(
    ("stamps_s", "text"),
    [
        ([], "has no depth frame"),
        ([float("nan")], "has no depth frame"),
        ([7.0] * 20, "all 20 stamps are 7 s; want stamps that increase"),
        ([40.0 * k for k in range(20)], "are 0.025 a second by their stamps; want stamps in seconds, 1 to 300 frames a second"),
        ([k / 900.0 for k in range(20)], "are 900 a second by their stamps"),
    ],
)
def test_stamps_that_count_no_seconds_are_one_line(stamps_s: list[float], text: str) -> None:
    assert text in said(stamps_s)


def test_one_frame_has_no_rate() -> None:
    assert used([3.0]).order == (0,)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=40))
def test_any_list_gives_increasing_stamps_or_one_line(stamps_s: list[float]) -> None:
    try:
        found = used(stamps_s)
    except RecordingError as error:
        assert "\n" not in str(error)
        return
    assert all(a < b for a, b in zip(found.stamps_s, found.stamps_s[1:], strict=False))
    assert len(found.order) + sum(found.skipped.values()) == len(stamps_s)
    assert [stamps_s[k] for k in found.order] == list(found.stamps_s)
