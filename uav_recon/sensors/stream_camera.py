"""External camera through the memory-mapped stream: frames, inertial samples and poses.

stream_format.py describes the stream.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from uav_recon.interfaces import Clock
from uav_recon.sensors.stream_format import CameraSpec, RawFrame, StreamError, StreamReader
from uav_recon.types.camera import Frame, ImuSample, Intrinsics
from uav_recon.types.frames import Float32Array
from uav_recon.types.pose import Pose, StampedPose

__all__ = ["StreamCamera", "StreamError", "StreamPoses", "depth_lookup_table", "open_stream", "read_intrinsics"]

_log = logging.getLogger(__name__)
_REPEAT_S = 15.0  # between two messages of the same wait
_POLL_S = 0.05
_EMPTY_POLLS = 8  # consecutive empty polls before the file is checked: 0.1 s at 100 Hz


def open_stream(path: Path, clock: Clock, timeout_s: float, stopped: Callable[[], bool] = lambda: False) -> StreamReader:
    """Wait until a stream exists at ``path`` and open it; the reason for waiting is logged.

    Raises StreamError (one line) after timeout_s, or once stopped() returns True.
    """
    start_s, said, said_s = clock.now_s(), "", 0.0
    attempts = max(1, math.ceil(timeout_s / _POLL_S))
    for attempt in range(attempts):  # counted, so that it ends on any clock
        try:
            return StreamReader(path)
        except StreamError as error:
            if attempt + 1 == attempts:
                break
            waited_s = clock.now_s() - start_s
            if str(error) != said:
                said, said_s = str(error), waited_s
                _log.warning("waiting for a camera stream: %s", said)
            elif waited_s - said_s >= _REPEAT_S - 1e-9:
                said_s = waited_s
                _log.warning("waiting for a camera stream: %s; %.0f s", said, waited_s)
        if stopped():
            raise StreamError(f"{path}: ended while waiting for it")
        clock.sleep_until(start_s + (attempt + 1) * _POLL_S)
    try:
        return StreamReader(path)
    except StreamError as error:
        raise StreamError(f"{error}; waited {timeout_s:g} s") from None


def depth_lookup_table(depth_min_m: float, depth_max_m: float, metres_per_unit: float = 0.001) -> Float32Array:
    """Return the metres of every 16-bit depth, (65536,) float32.

    NaN for 0 and for depths outside [depth_min_m, depth_max_m].
    """
    metres = np.arange(65536) * metres_per_unit
    in_range = (metres >= depth_min_m - 1e-9) & (metres <= depth_max_m + 1e-9) & (metres > 0.0)
    return np.where(in_range, metres, np.nan).astype(np.float32)


class _Stream:
    """A reader that reopens the file when a restarted camera replaces it under the same name."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reader = StreamReader(path)
        self._inode = path.stat().st_ino
        self._read = 0
        self._empty = 0

    def _follow(self) -> bool:
        """Open the new file if there is one; called at every empty poll.

        The old file is used until the new one can be read. Returns True if a new file was opened.
        """
        self._empty += 1
        if self._empty < _EMPTY_POLLS:
            return False
        self._empty = 0
        try:
            inode = self._path.stat().st_ino
            if inode == self._inode:
                return False
            reader = StreamReader(self._path)
        except (OSError, StreamError):
            return False
        self._reader = reader
        self._inode = inode
        self._read = 0
        return True

    def close(self) -> None:
        """Do nothing: the mapping is released with the object."""


class StreamCamera(_Stream):
    """Camera protocol over a stream.

    Raises StreamError (one line) if the file is not a stream or its intrinsics are invalid. dropped_frames counts frames
    whose stamp is not finite or not newer than that of the previous frame, dropped or not: one wrong stamp, for example in
    the future, costs its own frame and one more.
    """

    def __init__(self, path: Path, depth_min_m: float = 0.3, depth_max_m: float = 6.0) -> None:
        super().__init__(path)
        self._table = depth_lookup_table(depth_min_m, depth_max_m)
        self._read_intrinsics = read_intrinsics(self._reader, path)
        self._imu_read = 0
        self._before_s = -math.inf
        self.dropped_frames = 0

    def poll(self) -> Frame | None:
        """Return the newest frame that was not returned yet, or None. About 1 ms for 424x240."""
        raw = self._reader.frame(self._read)
        if raw is None:
            if self._follow():
                self._imu_read = 0
                self._read_intrinsics = read_intrinsics(self._reader, self._path)
            return None
        self._read = raw.sequence
        self._empty = 0
        before_s = self._before_s
        self._before_s = raw.stamp_s if math.isfinite(raw.stamp_s) else self._before_s
        if not before_s < raw.stamp_s < math.inf:
            self.dropped_frames += 1
            return None
        return self._frame(raw)

    def imu(self) -> list[ImuSample]:
        """Return the inertial samples since the last call."""
        self._imu_read, samples = self._reader.imu(self._imu_read)
        if not len(samples):
            return []
        rows = zip(samples["stamp_s"].tolist(), samples["gyro_radps"], samples["specific_force_mps2"], strict=True)
        return [ImuSample(*row) for row in rows]

    def _frame(self, raw: RawFrame) -> Frame:
        depth, rgb, rgb_from_depth = self._read_intrinsics
        return Frame(raw.stamp_s, raw.sequence, self._table[raw.depth_mm], depth, raw.rgb, rgb, rgb_from_depth)


class StreamPoses(_Stream):
    """PoseSource protocol over a stream.

    refused: number of records with non-finite values, a negative variance, or a quaternion that is not a rotation.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.refused = 0

    def poses(self) -> list[StampedPose]:
        """Return the poses since the last call, in the order of their arrival."""
        self._read, records = self._reader.poses(self._read)
        if not len(records):
            self._follow()
            return []
        self._empty = 0
        out: list[StampedPose] = []
        columns = (
            records[name].tolist() for name in ("stamp_s", "position_m", "quat_wxyz", "variance", "quality", "reset_counter")
        )
        for stamp_s, position, quat, variance, quality, resets in zip(*columns, strict=True):
            finite = all(map(math.isfinite, (stamp_s, *position, *quat, *variance)))
            if not finite or abs(math.hypot(*quat) - 1.0) > 0.01 or min(variance) < 0.0:
                self.refused += 1
                continue
            pose = Pose(np.array(quat), np.array(position))
            out.append(StampedPose(stamp_s, pose, np.zeros(3), np.diag(variance), min(max(quality, 0), 100), resets % 256))
        return out


def read_intrinsics(reader: StreamReader, path: Path) -> tuple[Intrinsics, Intrinsics, Pose]:
    """Return the cameras of depth and colour, and rgb_from_depth. Raises StreamError."""
    header = reader.header
    for name, spec in (("depth", header.depth), ("rgb", header.rgb)):
        if not all(map(math.isfinite, (spec.fx, spec.fy, spec.cx, spec.cy))) or min(spec.fx, spec.fy) <= 0:
            raise StreamError(
                f"{path}: {name} intrinsics make no sense: fx {spec.fx}, fy {spec.fy}, cx {spec.cx}, cy {spec.cy}"
            )
    numbers = np.array(header.rgb_from_depth)
    try:
        rgb_from_depth = Pose(numbers[:4], numbers[4:])
    except ValueError as error:
        raise StreamError(f"{path}: rgb_from_depth: {error}") from None
    return _intrinsics(header.depth), _intrinsics(header.rgb), rgb_from_depth


def _intrinsics(spec: CameraSpec) -> Intrinsics:
    return Intrinsics(spec.fx, spec.fy, spec.cx, spec.cy, spec.width, spec.height)
