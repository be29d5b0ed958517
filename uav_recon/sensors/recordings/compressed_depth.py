"""Depth of a CompressedImage, as ROS's compressed_depth_image_transport writes it.

The format is "ENCODING; compressedDepth CODEC", or the encoding alone. Before the image come 12 bytes: a number of four bytes
and the floats A and B. With the encoding 32FC1 the pixels are inverse depth: z = A / (raw - B), 0 is no return. With 16UC1 they
are the depth, and A and B are ignored. The codec is png, or rvl: Wilson, Fast Lossless Depth Image Compression, ISS 2017.
"""

from __future__ import annotations

import struct

import numpy as np

from uav_recon.sensors.recordings.image_decoding import JPEG_MAGIC, PNG_MAGIC, depth_of, is_depth_png
from uav_recon.sensors.recordings.recording import DamagedItemError, RecordingError
from uav_recon.types.frames import AnyArray

DEPTH_ENCODINGS = ("16UC1", "mono16", "32FC1")
_INVERSE = "32FC1"
_HEADER_BYTES = 12
_RVL_HEAD_BYTES = 8  # width and height
_MAX_PIXELS = 1 << 26  #: reject: an RVL image that tells more pixels: its header is damaged
_NIBBLES_A_WORD = 8
_DIGIT_BITS, _DIGIT, _MORE = 3, 0x7, 0x8  # of a nibble: its bits of a number, their mask, and the flag that more follow
_MAX_DIGITS = 7  # of a number below 2**18, as a difference of 16 bits with its sign is


def encoding_of(text: str) -> str:
    """Return the encoding that the format of a CompressedImage begins with."""
    return text.partition(";")[0].strip()


def holds_depth(text: str, data: bytes) -> bool:
    """Return True if a CompressedImage of this format and these bytes holds depth.

    A JPEG has 8 bits a pixel: it is no depth, whatever the format says.
    """
    named = encoding_of(text) in DEPTH_ENCODINGS or "compressedDepth" in text
    return not data.startswith(JPEG_MAGIC) and (named or is_depth_png(data))


def decoded_depth(text: str, data: bytes, where: str) -> AnyArray:
    """Return the depth (H, W) of a CompressedImage.

    It is uint16 raw, or float32 in metres for the encoding 32FC1.

    Raises DamagedItemError, and RecordingError for a codec that is not known.
    """
    if not data:
        raise DamagedItemError(f"{where}: has no bytes")
    plain = data.startswith(PNG_MAGIC)  # without the 12 bytes: of another program than image_transport
    inverse = encoding_of(text) == _INVERSE
    if plain and inverse:
        raise RecordingError(f"{where}: format {text!r} without the 12 bytes before the PNG; want depth as 16UC1")
    body = data if plain else data[_HEADER_BYTES:]
    raw = _rvl(body, where) if text.strip().endswith("rvl") else depth_of(body, where)
    return _metres(raw, *struct.unpack_from("<ff", data, 4), where=where) if inverse else raw


def _metres(raw: AnyArray, a: float, b: float, *, where: str) -> AnyArray:
    """Return A / (raw - B) as float32 in metres.

    NaN for 0, and for a denominator that is not positive.
    """
    if not (np.isfinite((a, b)).all() and a > 0.0):
        raise DamagedItemError(f"{where}: inverse depth with A {a:g} and B {b:g}; want finite numbers and A positive")
    below = raw.astype(np.float32) - np.float32(b)
    valid = (raw > 0) & (below > 0.0)
    return np.where(valid, np.float32(a) / np.where(valid, below, 1.0), np.nan).astype(np.float32)


def _rvl(data: bytes, where: str) -> AnyArray:
    """Return an RVL image (H, W) uint16.

    Its numbers are runs: count of zeros, count of depths, and for each depth the difference from the depth before, as zigzag.
    """
    if len(data) < _RVL_HEAD_BYTES:
        raise DamagedItemError(f"{where}: an RVL image of {len(data)} bytes")
    width, height = struct.unpack_from("<II", data)
    size = width * height
    if not 0 < size <= _MAX_PIXELS:
        raise DamagedItemError(f"{where}: an RVL image of {width} x {height} pixels")
    numbers = _numbers(data[_RVL_HEAD_BYTES:])
    is_depth, zigzag, at, pixel = np.zeros(size, np.bool_), [], 0, 0
    while pixel < size and at + 1 < len(numbers):
        zeros, depths = int(numbers[at]), int(numbers[at + 1])
        is_depth[pixel + zeros : pixel + zeros + depths] = True
        zigzag.append(numbers[at + 2 : at + 2 + depths])
        at, pixel = at + 2 + depths, pixel + zeros + depths
    steps = np.concatenate([*zigzag, np.zeros(0, np.int64)])
    if pixel != size or len(steps) != int(is_depth.sum()):
        raise DamagedItemError(f"{where}: an RVL image of {width} x {height} pixels that ends after {min(pixel, size)}")
    out = np.zeros(size, np.uint16)
    out[is_depth] = np.cumsum((steps >> 1) ^ -(steps & 1)).astype(np.uint16)
    return out.reshape(height, width)


def _numbers(data: bytes) -> AnyArray:
    """Return the numbers (N,) int64 of an RVL stream.

    The stream is nibbles, the highest of each word of 32 bits first.

    A nibble holds three bits of a number, the lowest first; its highest bit tells that more follow.
    """
    words = np.frombuffer(data, "<u4", len(data) // 4)
    shifts = np.arange(4 * (_NIBBLES_A_WORD - 1), -1, -4, dtype=np.uint32)
    nibbles = ((words[:, None] >> shifts) & 0xF).reshape(-1).astype(np.int64)
    last = np.flatnonzero((nibbles & _MORE) == 0)
    if not len(last):
        return nibbles[:0]
    first = np.concatenate(([0], last[:-1] + 1))
    place = np.minimum(np.arange(last[-1] + 1) - np.repeat(first, last - first + 1), _MAX_DIGITS)
    return np.asarray(np.add.reduceat((nibbles[: last[-1] + 1] & _DIGIT) << (_DIGIT_BITS * place), first))
