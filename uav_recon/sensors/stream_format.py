"""Camera-stream wire format: one memory-mapped file through which ANY camera is read.

Layout, little endian: a header page (magic, version, intrinsics, write counters), a ring of frame slots, a ring of IMU
samples, a ring of pose samples. One writer, any number of readers; a record is valid if its sequence word is the same before
and after the copy. A writer needs nothing else of the product, and this file imports no other module of it.

Frames: depth uint16 in millimetres (0 = no return), rgb uint8. Intrinsics put pixel (0, 0) at the CENTRE of the first pixel.
IMU: body FLU axes. Poses: odom_from_body (ENU-like z-up odom, FLU body), stamped at capture, written on arrival. All stamps
are CLOCK_MONOTONIC seconds of this machine.
"""

from __future__ import annotations

import mmap
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAGIC = b"UAVSTRM1"
FRAME_SLOTS = 4
IMU_SLOTS = 2048
POSE_SLOTS = 256
HEADER_BYTES = 4096

HEADER = np.dtype(
    [
        ("magic", "S8"),
        ("depth_size", "<i4", 2),  # width, height
        ("rgb_size", "<i4", 2),
        ("depth_k", "<f8", 4),  # fx, fy, cx, cy
        ("rgb_k", "<f8", 4),
        ("rgb_from_depth", "<f8", 7),  # qw qx qy qz tx ty tz
        ("frames", "<i8"),  # number of frames written
        ("imu", "<i8"),
        ("poses", "<i8"),
    ]
)
IMU = np.dtype([("stamp_s", "<f8"), ("gyro_radps", "<f8", 3), ("specific_force_mps2", "<f8", 3)])
POSE = np.dtype(
    [
        ("stamp_s", "<f8"),
        ("position_m", "<f8", 3),
        ("quat_wxyz", "<f8", 4),
        ("variance", "<f8", 6),  # position m², rotation rad²
        ("quality", "<i4"),
        ("reset_counter", "<i4"),
    ]
)


class StreamError(Exception):
    """Raised for a file that is not a camera stream, or not of this version."""


@dataclass(frozen=True)
class CameraSpec:
    """Pinhole camera of the stream."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True)
class StreamHeader:
    """Constants of a stream. rgb_from_depth: quaternion wxyz, then translation in metres."""

    depth: CameraSpec
    rgb: CameraSpec
    rgb_from_depth: tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True)
class RawFrame:
    """A frame as in the file: depth_mm (H, W) uint16, rgb (h, w, 3) uint8."""

    sequence: int
    stamp_s: float
    depth_mm: NDArray[np.uint16]
    rgb: NDArray[np.uint8]


def _frame_dtype(header: StreamHeader) -> np.dtype[Any]:
    return np.dtype(
        [
            ("sequence", "<i8"),
            ("stamp_s", "<f8"),
            ("depth_mm", "<u2", (header.depth.height, header.depth.width)),
            ("rgb", "u1", (header.rgb.height, header.rgb.width, 3)),
            ("sequence_end", "<i8"),
        ]
    )


class _Stream:
    """The mapped file and its four views."""

    def __init__(self, path: Path, header: StreamHeader, *, create: bool) -> None:
        frame = _frame_dtype(header)
        size = HEADER_BYTES + FRAME_SLOTS * frame.itemsize + IMU_SLOTS * IMU.itemsize + POSE_SLOTS * POSE.itemsize
        if create:
            temporary = path.with_suffix(path.suffix + ".new")
            with temporary.open("wb") as file:
                file.truncate(size)
            self._map(temporary, size)
        else:
            if path.stat().st_size < size:
                raise StreamError(f"{path}: truncated camera stream")
            self._map(path, size)
        buffer: Any = self._mmap
        self.header: Any = np.frombuffer(buffer, HEADER, 1)[0:1]
        offset = HEADER_BYTES
        self.frames: Any = np.frombuffer(buffer, frame, FRAME_SLOTS, offset)
        offset += FRAME_SLOTS * frame.itemsize
        self.imu: Any = np.frombuffer(buffer, IMU, IMU_SLOTS, offset)
        offset += IMU_SLOTS * IMU.itemsize
        self.poses: Any = np.frombuffer(buffer, POSE, POSE_SLOTS, offset)

    def append_pose(self, record: tuple[Any, ...]) -> None:
        """Write a record of dtype POSE, and count it. One process writes the poses."""
        count = int(self.header["poses"][0])
        self.poses[count % POSE_SLOTS] = record
        self.header["poses"][0] = count + 1

    def _map(self, path: Path, size: int) -> None:
        descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
        try:
            self._mmap = mmap.mmap(descriptor, size)
        finally:
            os.close(descriptor)


class _PoseWriting:
    """The poses of a stream, which the camera's program or another one writes."""

    _stream: _Stream

    def write_pose(
        self,
        stamp_s: float,
        position_m: NDArray[np.float64],
        quat_wxyz: NDArray[np.float64],
        variance: NDArray[np.float64],
        quality: int = 100,
        reset_counter: int = 0,
    ) -> None:
        """Publish odom_from_body captured at stamp_s; call it when the pose ARRIVES."""
        self._stream.append_pose((stamp_s, position_m, quat_wxyz, variance, quality, reset_counter))


class StreamWriter(_PoseWriting):
    """Writer for the camera. The file appears under its name only when it is complete."""

    def __init__(self, path: Path, header: StreamHeader) -> None:
        self._stream = _Stream(path, header, create=True)
        head = self._stream.header
        for name in ("depth", "rgb"):
            spec: CameraSpec = getattr(header, name)
            head[f"{name}_size"][0] = (spec.width, spec.height)
            head[f"{name}_k"][0] = (spec.fx, spec.fy, spec.cx, spec.cy)
        head["rgb_from_depth"][0] = header.rgb_from_depth
        head["magic"][0] = MAGIC
        path.with_suffix(path.suffix + ".new").replace(path)

    def write_frame(self, stamp_s: float, depth_mm: NDArray[np.uint16], rgb: NDArray[np.uint8]) -> None:
        """Publish one frame: depth_mm (H, W), rgb (h, w, 3)."""
        sequence = int(self._stream.header["frames"][0]) + 1
        slot = self._stream.frames[sequence % FRAME_SLOTS]
        slot["sequence_end"] = -sequence
        slot["sequence"] = -sequence
        slot["stamp_s"] = stamp_s
        slot["depth_mm"][...] = depth_mm
        slot["rgb"][...] = rgb
        slot["sequence"] = sequence
        slot["sequence_end"] = sequence
        self._stream.header["frames"][0] = sequence

    def write_imu(self, stamp_s: float, gyro_radps: NDArray[np.float64], specific_force_mps2: NDArray[np.float64]) -> None:
        """Publish one inertial sample in body FLU axes."""
        count = int(self._stream.header["imu"][0])
        self._stream.imu[count % IMU_SLOTS] = (stamp_s, gyro_radps, specific_force_mps2)
        self._stream.header["imu"][0] = count + 1


class StreamPoseWriter(_PoseWriting):
    """Writer of the poses alone, for a tracker beside the camera.

    The process of the camera writes everything else. The constructor raises StreamError. A restarted camera makes a new file:
    open it again.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._stream = _Stream(path, StreamReader(path).header, create=False)
        except OSError as error:
            raise StreamError(f"{path}: cannot be mapped ({error.strerror})") from None


class StreamReader:
    """Reader for the product. No call blocks. The constructor raises StreamError."""

    def __init__(self, path: Path) -> None:
        try:
            with path.open("rb") as file:
                raw = file.read(HEADER_BYTES)
        except OSError as error:
            raise StreamError(f"{path}: cannot be read ({error.strerror})") from None
        if len(raw) < HEADER.itemsize or not raw.startswith(MAGIC):
            raise StreamError(f"{path}: not a camera stream (want {MAGIC.decode()} at its start)")
        head = np.frombuffer(raw, HEADER, 1)
        specs = []
        for name in ("depth", "rgb"):
            width, height = (int(n) for n in head[f"{name}_size"][0])
            fx, fy, cx, cy = (float(x) for x in head[f"{name}_k"][0])
            if not (0 < width <= 4096 and 0 < height <= 4096):
                raise StreamError(f"{path}: {name} size {width}x{height} is outside 1..4096")
            specs.append(CameraSpec(width, height, fx, fy, cx, cy))
        q = [float(x) for x in head["rgb_from_depth"][0]]
        self.header = StreamHeader(specs[0], specs[1], (q[0], q[1], q[2], q[3], q[4], q[5], q[6]))
        try:
            self._stream = _Stream(path, self.header, create=False)
        except OSError as error:
            raise StreamError(f"{path}: cannot be mapped ({error.strerror})") from None
        self._written = {name: self._stream.header[name] for name in ("frames", "imu", "poses")}  # read at every poll

    def frame(self, after: int = 0) -> RawFrame | None:
        """Return the newest frame if its sequence number is above ``after``, else None.

        Returns None also if the frame was overwritten while being copied.
        """
        sequence: int = self._written["frames"].item()
        if sequence <= after:
            return None
        slot = self._stream.frames[sequence % FRAME_SLOTS]
        stamp_s = float(slot["stamp_s"])
        depth, rgb = slot["depth_mm"].copy(), slot["rgb"].copy()
        if int(slot["sequence"]) != sequence or int(slot["sequence_end"]) != sequence:
            return None
        return RawFrame(sequence, stamp_s, depth, rgb)

    def imu(self, after: int = 0) -> tuple[int, NDArray[Any]]:
        """Return the number of samples written, and the samples (dtype IMU) after number ``after``.

        Oldest first; overwritten samples are lost.
        """
        return self._ring("imu", self._stream.imu, IMU_SLOTS, after)

    def poses(self, after: int = 0) -> tuple[int, NDArray[Any]]:
        """Return the number of poses written, and the poses (dtype POSE) after number ``after``.

        Oldest first; overwritten poses are lost.
        """
        return self._ring("poses", self._stream.poses, POSE_SLOTS, after)

    def _ring(self, name: str, ring: Any, slots: int, after: int) -> tuple[int, NDArray[Any]]:
        count: int = self._written[name].item()
        first = max(after, count - slots // 2, 0)
        if first >= count:  # most polls find nothing new
            return count, ring[:0]
        begin, end = first % slots, (count - 1) % slots + 1
        return count, ring[begin:end].copy() if begin < end else np.concatenate((ring[begin:], ring[:end]))
