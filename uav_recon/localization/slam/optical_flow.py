"""Pyramidal Lucas-Kanade optical flow (OpenCV), and the brightness that it follows."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from uav_recon.types.frames import AnyArray, BoolArray, ByteArray, FloatArray

# ends after this many rounds, or a step of this many pixels
_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 10, 0.03)


def brightness(rgb: ByteArray, widest_px: int) -> tuple[ByteArray, FloatArray]:
    """Return the brightness (h, w) of an image, and the scale of its width and height (2,).

    An image that is wider than widest_px is made smaller by a whole number.
    """
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    stride = -(-grey.shape[1] // widest_px)
    if stride > 1:
        grey = cv2.resize(grey, (grey.shape[1] // stride, grey.shape[0] // stride), interpolation=cv2.INTER_AREA)
    return np.asarray(grey, dtype=np.uint8), np.array([grey.shape[1] / rgb.shape[1], grey.shape[0] / rgb.shape[0]])


def inside(at_px: AnyArray, grey: ByteArray, window_px: int) -> BoolArray:
    """Return a mask of the pixels (N, 2) with half a window around them; not of NaN."""
    room_px, (height, width) = window_px // 2, grey.shape
    within = (at_px >= room_px).all(axis=1) & (at_px[:, 0] <= width - 1 - room_px) & (at_px[:, 1] <= height - 1 - room_px)
    return np.asarray(within, dtype=np.bool_)


def followed(
    before: ByteArray,
    now: ByteArray,
    was_px: AnyArray,
    guess_px: AnyArray,
    *,
    window_px: int,
    levels: int,
    back_levels: int,
    returns_px: float,
) -> tuple[AnyArray, BoolArray]:
    """Return the new positions of points (N, 2), and a mask of those found.

    A point is found if tracking it back leads to within returns_px of where it was. levels, back_levels: of the pyramids in
    which it is tracked there and back.
    """
    follow = functools.partial(
        cv2.calcOpticalFlowPyrLK, winSize=(window_px, window_px), flags=cv2.OPTFLOW_USE_INITIAL_FLOW, criteria=_STOP
    )
    at_px, there, _ = follow(before, now, was_px, guess_px.copy(), maxLevel=levels)
    back_px, back, _ = follow(now, before, at_px, was_px.copy(), maxLevel=back_levels)
    returns = np.linalg.norm(back_px - was_px, axis=1) <= returns_px
    return at_px, np.asarray(returns & (there[:, 0] == 1) & (back[:, 0] == 1) & inside(at_px, now, window_px), dtype=np.bool_)
