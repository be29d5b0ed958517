"""A sequence without rendering: noise images along a known path, for tests of what does not look at them."""

from __future__ import annotations

import numpy as np

from sitl.apps.rgbd_sequences import RgbdSequence
from sitl.camera.d435i import MOUNT_M, stream_header
from sitl.geometry.transform import body_from_camera


def sequence_of_noise(frames: int = 300, speed_mps: float = 0.6) -> RgbdSequence:
    """Return frames, 15 a second, of a body that flies a circle of 1 m radius at a constant height."""
    header = stream_header("small")
    stamp_s = 10.0 + np.arange(frames) / 15.0
    truth_s = np.arange(9.9, stamp_s[-1] + 0.1, 0.005)
    angle = speed_mps * (truth_s - 10.0)
    zero = np.zeros(len(truth_s))
    rgb = np.random.default_rng(0).integers(0, 255, (frames, header.rgb.height, header.rgb.width, 3), np.uint8)
    depth_mm = np.full((frames, header.depth.height, header.depth.width), 2000, np.uint16)
    made = RgbdSequence(
        "noise", header, depth_mm, rgb, stamp_s, stamp_s + 0.02, np.zeros((0, 7)),
        np.tile(body_from_camera(MOUNT_M, 0.26), (frames, 1, 1)), np.zeros((frames, 4, 4)), truth_s,
        np.stack([np.sin(angle), 1.0 - np.cos(angle), zero + 1.0], axis=1),
        np.stack([np.cos(0.5 * angle), zero, zero, np.sin(0.5 * angle)], axis=1),
    )  # fmt: skip
    made.shown_body[:] = made.true_body
    return made
