from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest

from sitl.apps import sequence_faults
from sitl.apps.rgbd_sequences import RgbdSequence, SequenceOptions
from sitl.apps.sequence_faults import FAULTS, FaultWindow, altered, windows_of
from sitl.camera.d435i import MOUNT_M, stream_header
from sitl.geometry.transform import body_from_camera
from uav_recon.cli.choices import SEQUENCE_FAULTS

STAMPS_S = 10.0 + np.arange(600) / 15.0
COUNT = 24


def sequence(turn_radps: float = 0.0, speed_mps: float = 0.0) -> RgbdSequence:
    """Return COUNT noisy frames, 15 a second; the body turns about z and flies to the left at a constant rate."""
    rng = np.random.default_rng(0)
    header = stream_header("small")
    depth, rgb = header.depth, header.rgb
    stamp_s = STAMPS_S[:COUNT]
    texture = cv2.GaussianBlur(rng.integers(0, 255, (rgb.height, rgb.width, 3), np.uint8), (0, 0), 1.0)
    truth_s = np.arange(stamp_s[0] - 1.0, stamp_s[-1] + 1.0, 0.005)
    angle = 0.5 * turn_radps * (truth_s - stamp_s[0])
    zero = np.zeros(len(truth_s))
    return RgbdSequence(
        "noise", header,
        rng.integers(500, 3500, (COUNT, depth.height, depth.width)).astype(np.uint16),
        np.repeat(texture[None], COUNT, axis=0) + np.arange(COUNT, dtype=np.uint8)[:, None, None, None] // 8,
        stamp_s, stamp_s, np.zeros((0, 7)), np.tile(body_from_camera(MOUNT_M, 0.0), (COUNT, 1, 1)),
        np.tile(np.eye(4), (COUNT, 1, 1)), truth_s,
        np.stack([zero, speed_mps * (truth_s - stamp_s[0]), zero], axis=1),
        np.stack([np.cos(angle), zero, zero, np.sin(angle)], axis=1),
    )  # fmt: skip


@pytest.fixture(autouse=True)
def early(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sequence_faults, "FIRST_S", 0.5)
    monkeypatch.setattr(sequence_faults, "FOR_S", 0.4)
    monkeypatch.setattr(sequence_faults, "EVERY_S", 100.0)
    monkeypatch.setattr(sequence_faults, "AFTER_S", 0.1)


def inside(shown: RgbdSequence, window: FaultWindow) -> list[bool]:
    return [window.begin_s <= stamp_s < window.end_s for stamp_s in shown.stamp_s.tolist()]


def test_windows_come_regularly_and_leave_time_to_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    windows = windows_of(STAMPS_S)
    assert [round(window.begin_s - STAMPS_S[0], 1) for window in windows] == [12.0, 22.0, 32.0]
    assert all(window.end_s - window.begin_s == pytest.approx(1.0, abs=0.07) for window in windows)
    assert windows_of(STAMPS_S[:180]) == []


@pytest.mark.parametrize("name", ["covered", "frozen", "false-wall"])
def test_a_windowed_fault_alters_its_frames_and_no_others(name: str) -> None:
    plain = sequence()
    shown, (window,) = altered(plain, name, 0)
    changed = [
        not (np.array_equal(shown.depth_mm[n], plain.depth_mm[n]) and np.array_equal(shown.rgb[n], plain.rgb[n]))
        for n in range(COUNT)
    ]
    assert changed == inside(plain, window)
    assert sum(changed) == 6
    assert shown.stamp_s is plain.stamp_s, "new stamps, as a camera that hangs sends"
    assert plain.rgb.any(axis=(1, 2, 3)).all(), "the recording itself stays as it is"


def test_a_covered_camera_is_black_and_has_no_returns() -> None:
    shown, (window,) = altered(sequence(), "covered", 0)
    frames = inside(shown, window)
    assert not shown.rgb[frames].any()
    assert not shown.depth_mm[frames].any()


def test_a_frozen_camera_repeats_the_last_frame() -> None:
    shown, (window,) = altered(sequence(), "frozen", 0)
    first = int(np.argmax(inside(shown, window)))
    for n in np.flatnonzero(inside(shown, window)):
        assert np.array_equal(shown.depth_mm[n], shown.depth_mm[first - 1])
        assert np.array_equal(shown.rgb[n], shown.rgb[first - 1])


def test_a_false_wall_hides_what_is_behind_it() -> None:
    plain = sequence()
    shown, (window,) = altered(plain, "false-wall", 0)
    frames = inside(shown, window)
    assert shown.depth_mm[frames].max() == 800
    near = plain.depth_mm[frames] < 800
    assert near.any()
    assert np.array_equal(shown.depth_mm[frames][near], plain.depth_mm[frames][near])


def test_dark_and_low_contrast_images_keep_little_of_the_light() -> None:
    plain = sequence()
    dark, no_windows = altered(plain, "dark", 0)
    assert no_windows == []
    assert dark.rgb.mean() == pytest.approx(0.06 * plain.rgb.mean(), abs=0.5)
    flat, _ = altered(plain, "low-contrast", 0)
    assert flat.rgb.std() == pytest.approx(math.hypot(0.15 * plain.rgb.std(), 2.0), rel=0.05)
    assert 100 < flat.rgb.mean() < 150
    noise = (dark.rgb[0].astype(int) - dark.rgb[1].astype(int)).std()
    assert noise == pytest.approx(math.sqrt(2.0) * 1.5, rel=0.2)
    assert dark.depth_mm is flat.depth_mm is plain.depth_mm
    assert np.array_equal(altered(plain, "dark", 0)[0].rgb, dark.rgb)
    assert not np.array_equal(altered(plain, "dark", 1)[0].rgb, dark.rgb)


def detail(rgb: np.ndarray, axis: int) -> float:
    return float(np.abs(np.diff(rgb.astype(float), axis=axis)).mean())


def test_blur_follows_the_motion() -> None:
    still, _ = altered(sequence(), "blur", 0)
    plain = sequence()
    assert np.abs(still.rgb.astype(int) - plain.rgb).max() <= 1, "no motion, no blur"
    turning, _ = altered(sequence(turn_radps=math.radians(90.0)), "blur", 0)
    before = detail(plain.rgb[5], 1), detail(plain.rgb[5], 0)
    after = detail(turning.rgb[5], 1), detail(turning.rgb[5], 0)
    assert after[0] < 0.5 * before[0], "along the rows"
    assert after[0] < 0.7 * after[1], "less across them"
    sideways, _ = altered(sequence(speed_mps=2.0), "blur", 0)
    assert detail(sideways.rgb[5], 1) < 0.6 * before[0]


def test_faults_of_the_recording_change_its_options_only() -> None:
    plain = SequenceOptions()
    assert FAULTS["glass"].record(plain) == dataclasses.replace(plain, glass=True)
    assert FAULTS["fast-yaw"].record(plain).yaw_radps == pytest.approx(math.radians(120.0))
    assert all(fault.record(plain) == plain for name, fault in FAULTS.items() if name not in ("glass", "fast-yaw"))
    shown = sequence()
    assert altered(shown, "glass", 0) == (shown, [])


def test_the_command_line_offers_every_fault() -> None:
    assert tuple(FAULTS) == SEQUENCE_FAULTS
    assert [name for name, fault in FAULTS.items() if fault.windowed] == list(SEQUENCE_FAULTS[-3:])
