"""Choice of the streams of a camera from those that it offers.

A camera offers other sizes and rates at USB 2 than at USB 3, with another firmware, and from model to model. So nothing is
assumed: the offers are ranked by how this project uses them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from uav_recon.sensors.stream_format import StreamError

# Depth costs processor time per pixel, and voxels of 5 cm need no more than 424 columns; below, thin objects are lost.
_DEPTH_SIZES = ((424, 240), (480, 270), (640, 360), (640, 480), (848, 480))  # the first one offered is taken
_VIDEO_RATES_HZ = (30, 15)  # the same; fewer than 15 frames a second are too late for an obstacle
_COLOUR_BYTES = 3  # rgb8
_DEPTH_BYTES = 2  # z16
_USB2_BYTES_PER_S = 30e6  # what is left of 480 Mbit/s, in practice (librealsense doc, USB 2 mode)
_GYRO_HZ = (200, 400, 100)
_ACCEL_HZ = (100, 200, 63, 250)


class StreamKind(Enum):
    """A stream of a depth camera."""

    DEPTH = "depth"
    COLOUR = "colour"
    GYRO = "gyro"
    ACCEL = "accel"


@dataclass(frozen=True, slots=True)
class StreamProfile:
    """A stream that a camera offers.

    rate_hz: frames or samples a second. width, height: pixels; 0 for inertial streams. index: its place among the offers, by
    which the driver finds it again. sensor: number of the sensor that sends it.
    """

    kind: StreamKind
    rate_hz: int
    width: int = 0
    height: int = 0
    index: int = 0
    sensor: int = 0

    def text(self) -> str:
        """Return '424x240 at 30 Hz' or '200 Hz'."""
        return f"{self.width}x{self.height} at {self.rate_hz} Hz" if self.width else f"{self.rate_hz} Hz"


@dataclass(frozen=True, slots=True)
class StreamChoice:
    """The chosen streams; gyro and accel are None without an IMU. reason: one line for people."""

    depth: StreamProfile
    colour: StreamProfile
    gyro: StreamProfile | None
    accel: StreamProfile | None
    reason: str


class NoProfileError(StreamError):
    """Raised if no offer fits; the text is one line and names the offers."""


def choose_streams(offers: Iterable[StreamProfile], usb2: bool = False) -> StreamChoice:
    """Choose depth, colour and, if there are both, gyro and accelerometer.

    Depth: the first of 424x240, 480x270 up to 848x480 that is offered at 30 Hz together with a colour stream of the same rate,
    then at 15 Hz. Colour: the size nearest to that of depth. usb2: leave out pairs that exceed the bandwidth of USB 2.
    Raises NoProfileError (one line with the offers) if there is no such pair.
    """
    known = list(offers)
    pair = _video_pair(known, usb2)
    if pair is None:
        raise NoProfileError(_nothing_fits(known, usb2))
    depth, colour = pair
    gyro, accel = _by_rate(known, StreamKind.GYRO, _GYRO_HZ), _by_rate(known, StreamKind.ACCEL, _ACCEL_HZ)
    if gyro is None or accel is None:
        gyro = accel = None
    return StreamChoice(depth, colour, gyro, accel, _reason(known, depth, colour, gyro, accel))


def _video_pair(known: list[StreamProfile], usb2: bool) -> tuple[StreamProfile, StreamProfile] | None:
    for rate_hz in _VIDEO_RATES_HZ:
        for size in _DEPTH_SIZES:
            depth = next((p for p in _of(known, StreamKind.DEPTH, rate_hz) if (p.width, p.height) == size), None)
            colours = [
                p
                for p in _of(known, StreamKind.COLOUR, rate_hz)
                if depth is not None and not (usb2 and _bytes_per_s(depth, p) > _USB2_BYTES_PER_S)
            ]
            if depth is not None and colours:
                return depth, min(colours, key=lambda p: (_unlike(p, size), p.width * p.height))
    return None


def _of(known: list[StreamProfile], kind: StreamKind, rate_hz: int) -> list[StreamProfile]:
    return [p for p in known if p.kind is kind and p.rate_hz == rate_hz]


def _bytes_per_s(depth: StreamProfile, colour: StreamProfile) -> float:
    pixels = _DEPTH_BYTES * depth.width * depth.height + _COLOUR_BYTES * colour.width * colour.height
    return float(pixels * depth.rate_hz)


def _unlike(profile: StreamProfile, size: tuple[int, int]) -> float:
    """Return how far the number of columns and rows is from a size, as a ratio."""
    return abs(math.log(profile.width / size[0])) + abs(math.log(profile.height / size[1]))


def _by_rate(known: list[StreamProfile], kind: StreamKind, wanted_hz: tuple[int, ...]) -> StreamProfile | None:
    """Return the profile at the first wanted rate, otherwise the one nearest to it.

    None if there is none.
    """
    offered = [p for p in known if p.kind is kind]
    for rate_hz in wanted_hz:
        for profile in offered:
            if profile.rate_hz == rate_hz:
                return profile
    return min(offered, key=lambda p: abs(p.rate_hz - wanted_hz[0]), default=None)


def _reason(
    known: list[StreamProfile],
    depth: StreamProfile,
    colour: StreamProfile,
    gyro: StreamProfile | None,
    accel: StreamProfile | None,
) -> str:
    imu = f"gyro {gyro.text()}, accelerometer {accel.text()}" if gyro and accel else "no IMU offered"
    count = sum(p.kind is StreamKind.DEPTH for p in known)
    why = "the first choice" if (depth.width, depth.height, depth.rate_hz) == (*_DEPTH_SIZES[0], _VIDEO_RATES_HZ[0]) else (
        f"the first of the preferred ones among {count} depth profiles"
    )  # fmt: skip
    return f"depth {depth.text()} ({why}), colour {colour.text()} (nearest), {imu}"


def _nothing_fits(known: list[StreamProfile], usb2: bool) -> str:
    def listed(kind: StreamKind) -> str:
        return ", ".join(sorted({p.text() for p in known if p.kind is kind})) or "none"

    sizes = " to ".join(f"{w}x{h}" for w, h in (_DEPTH_SIZES[0], _DEPTH_SIZES[-1]))
    bus = ", within the bandwidth of USB 2" if usb2 else ""
    return (
        f"no camera profile fits: want depth (z16) of {sizes} at 30 or 15 Hz and colour (rgb8) of the same rate{bus}; "
        f"offered depth {listed(StreamKind.DEPTH)}; colour {listed(StreamKind.COLOUR)}"
    )
