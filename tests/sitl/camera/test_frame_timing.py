"""Instants of exposure, and bursts of lost frames."""

from __future__ import annotations

import numpy as np
import pytest

from sitl.camera.camera_errors import CameraErrors, LossErrors, TimingErrors
from sitl.camera.frame_timing import FrameLoss, FrameTiming


def test_an_exact_frame_is_exposed_and_complete_at_its_stamp() -> None:
    times = FrameTiming(CameraErrors(3)).exposure(1000.1)
    assert {times.stamp_s, times.depth_s, times.colour_first_s, times.colour_last_s, times.complete_s} == {1000.1}


def test_frames_are_older_than_their_stamps_by_a_constant_and_a_bounded_jitter() -> None:
    timing = FrameTiming(CameraErrors(2, timing=TimingErrors(age_s=0.03, jitter_s=0.005)))
    ages = np.array([100.0 - timing.exposure(100.0).depth_s for _ in range(4000)])
    assert ages.mean() == pytest.approx(0.03, abs=3e-4)
    assert ages.std() == pytest.approx(0.005, rel=0.04)
    assert np.abs(ages - 0.03).max() == pytest.approx(0.015, abs=1e-9)


def test_the_middle_colour_row_is_exposed_after_depth_and_the_frame_is_complete_after_the_last() -> None:
    times = FrameTiming(CameraErrors(timing=TimingErrors(age_s=0.004, colour_delay_s=0.012, readout_s=0.02))).exposure(5.0)
    assert 0.5 * (times.colour_first_s + times.colour_last_s) - times.depth_s == pytest.approx(0.012)
    assert times.colour_last_s - times.colour_first_s == pytest.approx(0.02)
    assert times.complete_s == times.colour_last_s > times.stamp_s


def test_bursts_of_one_to_five_frames_are_lost_every_twenty_to_sixty_seconds() -> None:
    stamps = np.arange(0.0, 7200.0, 0.1)
    loss = FrameLoss(CameraErrors.drawn(1))
    lost = np.array([loss.lost(float(stamp_s)) for stamp_s in stamps])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]])))
    starts, lengths = edges[::2], edges[1::2] - edges[::2]
    assert set(lengths) == {1, 2, 3, 4, 5}
    gaps_s = np.diff(stamps[starts], prepend=0.0)
    assert gaps_s.min() >= 20.0 - 1e-6
    assert gaps_s.max() <= 60.1
    assert np.ptp(gaps_s) > 30.0


def test_no_frame_is_lost_without_errors() -> None:
    loss = FrameLoss(CameraErrors(1, loss=LossErrors()))
    assert not any(loss.lost(0.1 * n) for n in range(10_000))
