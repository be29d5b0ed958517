"""Depth of CompressedImage messages, against an encoder that the test writes from the format's description."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin
from test_ros_bag import T, bag, head, said_of, usual, without

from uav_recon.sensors.recordings.compressed_depth import decoded_depth
from uav_recon.sensors.recordings.detection import ReadOptions, open_recording
from uav_recon.sensors.recordings.recording import RecordingError

QUANTIZATION, MAX_M = 100.0, 10.0  # the defaults of image_transport


def png(pixels: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", pixels)[1].tobytes())


def inverse(depth_m: np.ndarray) -> tuple[bytes, np.ndarray]:
    """Return the 12 bytes before the image, and the pixels, for depth in metres; NaN is no return."""
    a = QUANTIZATION * (QUANTIZATION + 1.0)
    b = 1.0 - a / MAX_M
    near = depth_m < MAX_M
    pixels = np.where(near, a / np.where(near, depth_m, 1.0) + b, 0.0).astype(np.uint16)
    return struct.pack("<iff", 0, a, b), pixels


def rvl(pixels: np.ndarray) -> bytes:
    """Encode by RVL, pixel by pixel."""
    nibbles: list[int] = []

    def put(number: int) -> None:
        while True:
            digit, number = number & 7, number >> 3
            nibbles.append(digit | (8 if number else 0))
            if not number:
                return

    flat, at, before = pixels.reshape(-1).astype(int).tolist(), 0, 0
    while at < len(flat):
        zeros = next((k for k, value in enumerate(flat[at:]) if value), len(flat) - at)
        depths = next((k for k, value in enumerate(flat[at + zeros :]) if not value), len(flat) - at - zeros)
        put(zeros)
        put(depths)
        for value in flat[at + zeros : at + zeros + depths]:
            step, before = value - before, value
            put(2 * step if step >= 0 else -2 * step - 1)
        at += zeros + depths
    nibbles += [0] * (-len(nibbles) % 8)
    words = [sum(nibble << (28 - 4 * k) for k, nibble in enumerate(nibbles[n : n + 8])) for n in range(0, len(nibbles), 8)]
    return struct.pack("<II", pixels.shape[1], pixels.shape[0]) + struct.pack(f"<{len(words)}I", *words)


def compressed(stamp_s: float, text: str, data: bytes) -> object:
    pixels = np.frombuffer(data, np.uint8)
    return T["sensor_msgs/msg/CompressedImage"](header=head(stamp_s, "optical"), format=text, data=pixels)


def depth_bag(folder: Path, text: str, data: bytes) -> Path:
    images = [("/d/image_raw/compressedDepth", 2.0 + k / 30, compressed(2.0 + k / 30, text, data)) for k in range(3)]
    return bag(folder, StoragePlugin.MCAP, [*without(usual(), "/d/image_raw"), *images])


@pytest.fixture
def depth_m() -> np.ndarray:
    """Return depth from 0.5 to 5 m with holes."""
    depth = np.linspace(0.5, 5.0, 48 * 64).reshape(48, 64)
    depth[10:14, 5:50] = np.nan
    depth[-1, -3:] = np.nan
    return depth


@pytest.mark.parametrize("codec", ["png", "rvl"])
def test_inverse_depth_is_metres(tmp_path: Path, depth_m: np.ndarray, codec: str) -> None:
    """image_transport_plugins 44: it was read as millimetres, 2.0 m as 4.04 m."""
    header, pixels = inverse(depth_m)
    data = header + (png(pixels) if codec == "png" else rvl(pixels))
    frame = next(open_recording(depth_bag(tmp_path / "b", f"32FC1; compressedDepth {codec}", data), ReadOptions()).frames())
    np.testing.assert_array_equal(np.isnan(frame.depth_m), np.isnan(depth_m))
    known = ~np.isnan(depth_m)
    np.testing.assert_allclose(frame.depth_m[known], depth_m[known], rtol=0.006)
    assert frame.depth_m[known][0] == pytest.approx(0.5, abs=0.001)


@pytest.mark.parametrize(
    "text", ["16UC1; compressedDepth png", "16UC1; compressedDepth", "16UC1; compressedDepth rvl", "16UC1"]
)
def test_millimetres_ignore_the_numbers_before_the_image(tmp_path: Path, depth_m: np.ndarray, text: str) -> None:
    millimetres = np.rint(np.nan_to_num(depth_m) * 1000).astype(np.uint16)
    data = struct.pack("<iff", 0, 123.0, -7.0) + (rvl(millimetres) if "rvl" in text else png(millimetres))
    frame = next(open_recording(depth_bag(tmp_path / "b", text, data), ReadOptions()).frames())
    np.testing.assert_allclose(frame.depth_m, depth_m, atol=0.0006)


def test_a_plain_png_of_16_bits_is_depth_whatever_its_format_says(tmp_path: Path, depth_m: np.ndarray) -> None:
    millimetres = np.rint(np.nan_to_num(depth_m) * 1000).astype(np.uint16)
    frame = next(open_recording(depth_bag(tmp_path / "b", "png", png(millimetres)), ReadOptions()).frames())
    np.testing.assert_allclose(frame.depth_m, depth_m, atol=0.0006)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from([0, 0, 0, 1, 7, 1000, 1001, 40000, 65535]), min_size=1, max_size=60), st.booleans())
def test_rvl_gives_the_pixels_that_were_encoded(values: list[int], tall: bool) -> None:
    pixels = np.array(values, np.uint16).reshape((-1, 1) if tall else (1, -1))
    np.testing.assert_array_equal(decoded_depth("16UC1; compressedDepth rvl", bytes(12) + rvl(pixels), "x"), pixels)


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=200), st.sampled_from(["16UC1; compressedDepth rvl", "32FC1; compressedDepth png", "16UC1"]))
def test_damaged_bytes_are_one_kind_of_error(data: bytes, text: str) -> None:
    """Or an image, if they happen to be one."""
    try:
        decoded_depth(text, data, "x")
    except RecordingError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize(("cut", "said"), [(12, "of 0 bytes"), (40, "that ends after")])
def test_a_cut_rvl_image_is_one_line(tmp_path: Path, depth_m: np.ndarray, cut: int, said: str) -> None:
    data = bytes(12) + rvl(np.rint(np.nan_to_num(depth_m) * 1000).astype(np.uint16))
    assert said in said_of(depth_bag(tmp_path / "b", "16UC1; compressedDepth rvl", data[:cut]))


def test_a_colour_jpeg_below_a_topic_named_depth_is_colour(tmp_path: Path) -> None:
    jpeg = bytes(cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes())
    images = [
        ("/c/depth_view/compressed", 2.0 + k / 30, compressed(2.0 + k / 30, "bgr8; jpeg compressed bgr8", jpeg))
        for k in range(3)
    ]
    folder = bag(tmp_path / "b", StoragePlugin.MCAP, [*without(usual(), "/c/image_raw"), *images])
    frame = next(open_recording(folder, ReadOptions()).frames())
    assert abs(int(frame.rgb[20, 20, 0]) - 90) < 3
    assert frame.depth_m[5, 5] == pytest.approx(1.055, abs=1e-3)


def test_depth_as_jpeg_is_named_and_not_used(tmp_path: Path) -> None:
    """realsense-ros 2361: 16UC1 as JPEG has 8 bits."""
    jpeg = bytes(cv2.imencode(".jpg", np.full((48, 64), 90, np.uint8))[1].tobytes())
    text = "16UC1; jpeg compressed "
    images = [("/d/image_raw/compressed", 2.0 + k / 30, compressed(2.0 + k / 30, text, jpeg)) for k in range(3)]
    folder = bag(tmp_path / "b", StoragePlugin.MCAP, [*without(usual(), "/d/image_raw"), *images])
    assert "has no depth image (16UC1 or 32FC1); it has /c/image_raw, /d/image_raw/compressed (" in said_of(folder)
    both = bag(tmp_path / "both", StoragePlugin.MCAP, [*usual(), *images])
    assert len(list(open_recording(both, ReadOptions()).frames())) == 3
