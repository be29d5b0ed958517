"""Faults of a recorded sequence: altered images; the vehicle's motion is not changed.

Some last for a second and come back, so that one sequence shows several onsets. The others last for the whole sequence; of
those, `glass` and `fast-yaw` belong to the recording itself.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sitl.apps.rgbd_sequences import RgbdSequence, SequenceOptions
from sitl.geometry.transform import inverse, rigid, rotation_from_quat

FIRST_S = 12.0  # after the start of the recording: some metres have been flown
EVERY_S = 10.0
FOR_S = 1.0
AFTER_S = 4.0  # of the sequence after the last onset's end
WALL_MM = 800
DARK = 0.06  # brightness
DARK_NOISE = 1.5  # levels
CONTRAST = 0.15
CONTRAST_NOISE = 2.0
EXPOSURE_S = 0.030
BLUR_STEPS = 7
FAST_YAW_RADPS = math.radians(120.0)
_STREAM = 0xFA17
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
Frames = NDArray[np.int64]


@dataclass(frozen=True)
class FaultWindow:
    """Altered frames: stamps of the first one and of the first unaltered one after it, s."""

    begin_s: float
    end_s: float


@dataclass(frozen=True)
class SequenceFault:
    """A kind of fault.

    record: options of the recording. alter: returns depth and colour of the sequence with these frames (K,) altered, None: as
    recorded. windowed: it comes in windows, else it lasts.
    """

    record: Callable[[SequenceOptions], SequenceOptions] = lambda options: options
    alter: Callable[[RgbdSequence, Frames, np.random.Generator], tuple[U16, U8]] | None = None
    windowed: bool = False


def windows_of(stamp_s: F64) -> list[FaultWindow]:
    """Return the windows of a windowed fault on frames with these stamps (N,)."""
    onsets = np.arange(stamp_s[0] + FIRST_S, stamp_s[-1] - FOR_S - AFTER_S, EVERY_S)
    first, after = np.searchsorted(stamp_s, onsets), np.searchsorted(stamp_s, onsets + FOR_S)
    return [FaultWindow(float(stamp_s[a]), float(stamp_s[b])) for a, b in zip(first, after, strict=True)]


def altered(sequence: RgbdSequence, name: str, seed: int) -> tuple[RgbdSequence, list[FaultWindow]]:
    """Return the sequence with a fault of FAULTS, and its windows, none if it lasts."""
    fault = FAULTS[name]
    windows = windows_of(sequence.stamp_s) if fault.windowed else []
    if fault.alter is None:
        return sequence, windows
    stamp_s = sequence.stamp_s
    inside = np.zeros(len(stamp_s), np.bool_)
    for window in windows:
        inside |= (stamp_s >= window.begin_s) & (stamp_s < window.end_s)
    frames = np.flatnonzero(inside) if fault.windowed else np.arange(len(stamp_s))
    depth_mm, rgb = fault.alter(sequence, frames, np.random.default_rng([seed, _STREAM]))
    return dataclasses.replace(sequence, depth_mm=depth_mm, rgb=rgb), windows


def _covered(sequence: RgbdSequence, frames: Frames, rng: np.random.Generator) -> tuple[U16, U8]:
    """Both images are empty: black, and without returns."""
    depth_mm, rgb = sequence.depth_mm.copy(), sequence.rgb.copy()
    depth_mm[frames], rgb[frames] = 0, 0
    return depth_mm, rgb


def _frozen(sequence: RgbdSequence, frames: Frames, rng: np.random.Generator) -> tuple[U16, U8]:
    """Both images repeat the last one before the window, under new stamps."""
    depth_mm, rgb = sequence.depth_mm.copy(), sequence.rgb.copy()
    for n in frames:
        depth_mm[n], rgb[n] = depth_mm[n - 1], rgb[n - 1]
    return depth_mm, rgb


def _false_wall(sequence: RgbdSequence, frames: Frames, rng: np.random.Generator) -> tuple[U16, U8]:
    """Depth shows a wall across the image at WALL_MM, with what is nearer before it."""
    depth_mm = sequence.depth_mm.copy()
    seen = depth_mm[frames]
    depth_mm[frames] = np.where((seen == 0) | (seen > WALL_MM), WALL_MM, seen)
    return depth_mm, sequence.rgb


def _black(sequence: RgbdSequence, frames: Frames, rng: np.random.Generator) -> tuple[U16, U8]:
    return sequence.depth_mm, np.zeros_like(sequence.rgb)


def _toned(sequence: RgbdSequence, gain: float, offset: float, noise: float, rng: np.random.Generator) -> tuple[U16, U8]:
    out = np.empty_like(sequence.rgb)
    for n, image in enumerate(sequence.rgb):
        shown = gain * image + offset + noise * rng.standard_normal(image.shape, np.float32)
        out[n] = np.clip(np.rint(shown), 0, 255).astype(np.uint8)
    return sequence.depth_mm, out


def _dark(sequence: RgbdSequence, frames: Frames, rng: np.random.Generator) -> tuple[U16, U8]:
    return _toned(sequence, DARK, 0.0, DARK_NOISE, rng)


def _low_contrast(sequence: RgbdSequence, frames: Frames, rng: np.random.Generator) -> tuple[U16, U8]:
    return _toned(sequence, CONTRAST, (1.0 - CONTRAST) * 128.0, CONTRAST_NOISE, rng)


def _blurred(sequence: RgbdSequence, frames: Frames, rng: np.random.Generator) -> tuple[U16, U8]:
    """Colour is exposed for EXPOSURE_S.

    It is the mean of images along the true motion, each moved as a plane at the median depth.
    """
    spec = sequence.header.rgb
    lens = np.array([[spec.fx, 0.0, spec.cx], [0.0, spec.fy, spec.cy], [0.0, 0.0, 1.0]])
    quat, (tx, ty, tz) = sequence.header.rgb_from_depth[:4], sequence.header.rgb_from_depth[4:]
    depth_from_rgb = inverse(rigid(rotation_from_quat(quat), (tx, ty, tz)))
    out = np.empty_like(sequence.rgb)
    for n in frames:
        depth = sequence.depth_mm[n]
        median_m = 1e-3 * float(np.median(depth[depth > 0])) if (depth > 0).any() else math.inf
        bodies = sequence.true_body_at(sequence.stamp_s[n] + EXPOSURE_S * np.linspace(-0.5, 0.5, BLUR_STEPS))
        eyes = bodies @ (sequence.body_from_depth[n] @ depth_from_rgb)
        middle, total = eyes[BLUR_STEPS // 2], np.zeros(out.shape[1:], np.float32)
        for eye in eyes:
            moved = inverse(eye) @ middle
            plane = moved[:3, :3] + np.outer(moved[:3, 3], [0.0, 0.0, 1.0 / median_m])
            homography = lens @ plane @ np.linalg.inv(lens)
            size = (spec.width, spec.height)
            total += cv2.warpPerspective(sequence.rgb[n], homography, size, borderMode=cv2.BORDER_REPLICATE)
        out[n] = np.rint(total / BLUR_STEPS).astype(np.uint8)
    return sequence.depth_mm, out


FAULTS: dict[str, SequenceFault] = {
    "black": SequenceFault(alter=_black),
    "dark": SequenceFault(alter=_dark),
    "low-contrast": SequenceFault(alter=_low_contrast),
    "blur": SequenceFault(alter=_blurred),
    "fast-yaw": SequenceFault(record=lambda options: dataclasses.replace(options, yaw_radps=FAST_YAW_RADPS, look_rad=math.pi)),
    "glass": SequenceFault(record=lambda options: dataclasses.replace(options, glass=True)),
    "covered": SequenceFault(alter=_covered, windowed=True),
    "frozen": SequenceFault(alter=_frozen, windowed=True),
    "false-wall": SequenceFault(alter=_false_wall, windowed=True),
}
