"""Decoding of image files: JPEG and PNG bytes as arrays.

Pillow decodes, because OpenCV prints the faults of a damaged image instead of raising them.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from uav_recon.sensors.recordings.recording import DamagedItemError
from uav_recon.types.frames import AnyArray

PNG_MAGIC = b"\x89PNG"
JPEG_MAGIC = b"\xff\xd8"
_DEPTH_BITS = 16
_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "PPM", "WEBP")


def is_depth_png(data: bytes) -> bool:
    """Return True for a PNG whose pixels are one number of 16 bits (its header, at byte 24.

    Bits, colour type).
    """
    return data.startswith(PNG_MAGIC) and data[24:26] == bytes((_DEPTH_BITS, 0))


def depth_of(data: bytes, where: str) -> AnyArray:
    """Return a 16-bit grey image (H, W) uint16. Raises DamagedItemError that names ``where``."""
    image = _opened(data, where)
    if not image.mode.startswith("I"):
        raise DamagedItemError(f"{where}: is an image of mode {image.mode}; want a 16-bit grey PNG")
    return _pixels(image, where).astype(np.uint16)


def rgb_of(data: bytes, where: str) -> AnyArray:
    """Return a colour or grey image of 8 bits (h, w, 3) uint8 as RGB.

    Raises DamagedItemError that names ``where``.
    """
    image = _opened(data, where)
    if image.mode.startswith(("I", "F")):
        raise DamagedItemError(f"{where}: is an image of mode {image.mode}; want colour or grey of 8 bits")
    return _pixels(image if image.mode == "RGB" else image.convert("RGB"), where)


def read_depth(path: Path) -> AnyArray:
    """Read a 16-bit grey image (H, W) uint16. Raises DamagedItemError that names the file."""
    return depth_of(_bytes(path), str(path))


def read_rgb(path: Path) -> AnyArray:
    """Read a colour image (h, w, 3) uint8 as RGB. Raises DamagedItemError that names the file."""
    return rgb_of(_bytes(path), str(path))


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise DamagedItemError(f"{path}: cannot be read ({error.strerror})") from None


def _opened(data: bytes, where: str) -> Image.Image:
    if not data:
        raise DamagedItemError(f"{where}: has no bytes")
    try:
        return Image.open(io.BytesIO(data), formats=_FORMATS)
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError):
        raise DamagedItemError(f"{where}: is no known image: {len(data)} bytes that begin with {data[:4]!r}") from None


def _pixels(image: Image.Image, where: str) -> AnyArray:
    try:
        return np.array(image)
    except (OSError, SyntaxError, ValueError) as error:
        raise DamagedItemError(f"{where}: damaged or cut ({error})") from None
