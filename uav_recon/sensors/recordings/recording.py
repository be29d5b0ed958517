"""Interface of a recording, and its playback as a camera and a pose source."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from uav_recon.interfaces import Clock
from uav_recon.sensors.stream_format import StreamError
from uav_recon.types.camera import BODY_FROM_OPTICAL, Frame, ImuSample, Intrinsics
from uav_recon.types.frames import AnyArray, Float32Array
from uav_recon.types.pose import Pose, StampedPose

Pinhole = tuple[float, float, float, float]  # fx, fy, cx, cy in pixels
LEVEL_MOUNT = Pose.from_matrix(BODY_FROM_OPTICAL)  # body_from_depth where the recording is of a camera without a body
MM = 0.001  # metres a unit of 16-bit depth, where a format says nothing else


class RecordingError(StreamError):
    """Raised for a recording that cannot be read; the text is one line."""


class DamagedItemError(RecordingError):
    """Raised for an image or message that cannot be read; those beside it may be good."""


@dataclass(frozen=True)
class RecordingInfo:
    """Head of a recording.

    kind: its format in words. frames: number of depth frames. first_s, last_s: stamps of the first and the last of them, in the
    recording's time. body_from_depth: mount of the depth imager. up_is_z: True if z of the poses' frame is up. metres_per_unit:
    of the depth images as they are read. skipped: what cannot be used: (reason, count) each. remarks: what else the user should
    know, a line each. is_part: True if frames before first_s or after last_s are left out, at a jump of the stamps.
    """

    kind: str
    frames: int
    first_s: float
    last_s: float
    body_from_depth: Pose
    up_is_z: bool
    metres_per_unit: float = MM
    skipped: tuple[tuple[str, int], ...] = ()
    remarks: tuple[str, ...] = ()
    is_part: bool = False


class Recording(Protocol):
    """A recording that is read from begin to end.

    Each call reads files and may block for seconds.
    """

    @property
    def info(self) -> RecordingInfo:
        """Return the head of the recording."""
        ...

    def frames(self, step: int = 1) -> Iterator[Frame]:
        """Yield every step-th frame, with increasing stamps.

        A frame whose images are damaged is left out and counted. Raises RecordingError if none can be read.
        """
        ...

    def poses(self) -> list[StampedPose]:
        """Return all poses of the body, oldest first; empty if the recording has none."""
        ...

    def imu(self) -> list[ImuSample]:
        """Return all inertial samples, oldest first; empty if the recording has none."""
        ...


class DepthUnit:
    """Metres of raw depth.

    metres_per_unit: of the images. table_m: (65536,) metres of 16-bit depth; NaN, no return, for 0 and 65535.
    """

    def __init__(self, metres_per_unit: float) -> None:
        self.metres_per_unit = metres_per_unit
        table = np.arange(65536) * metres_per_unit
        table[[0, 65535]] = np.nan
        self.table_m: Float32Array = table.astype(np.float32)

    def metres(self, raw: AnyArray) -> Float32Array:
        """Return the depth in metres of an image (H, W) of uint16 or float; NaN is no return."""
        if raw.dtype == np.uint16:
            return self.table_m[raw]
        measured = np.isfinite(raw) & (raw > 0.0)
        return np.where(measured, raw * self.metres_per_unit, np.nan).astype(np.float32)


class PlaybackCamera:
    """DepthCamera protocol over a recording.

    Stamps are shifted: the first frame is due when this object is made.

    ``finished`` is True after the last frame. ``read`` counts the frames that were given on.
    """

    def __init__(self, recording: Recording, clock: Clock) -> None:
        self._clock = clock
        self.shift_s = clock.now_s() - recording.info.first_s
        self._frames = recording.frames()
        self._imu = recording.imu()
        self._next_imu = 0
        self._ahead = next(self._frames, None)
        self.read = 0

    @property
    def finished(self) -> bool:
        """True if no frame is left."""
        return self._ahead is None

    def poll(self) -> Frame | None:
        """Return the next frame if it is due; reads the one after it from disk (about 5 ms)."""
        frame = self._ahead
        if frame is None or frame.stamp_s + self.shift_s > self._clock.now_s() + 1e-9:
            return None
        self._ahead = next(self._frames, None)
        self.read += 1
        return replace(frame, stamp_s=frame.stamp_s + self.shift_s)

    def imu(self) -> list[ImuSample]:
        """Return the inertial samples that became due since the last call."""
        now_s, out = self._clock.now_s() - self.shift_s, []
        while self._next_imu < len(self._imu) and self._imu[self._next_imu].stamp_s <= now_s + 1e-9:
            sample = self._imu[self._next_imu]
            out.append(replace(sample, stamp_s=sample.stamp_s + self.shift_s))
            self._next_imu += 1
        return out

    def close(self) -> None:
        """Do nothing: files are open only while they are read."""


class PlaybackPoses:
    """PoseSource protocol over a recording.

    target_from_source: moves the poses, for example to a level frame at the start.
    """

    def __init__(self, recording: Recording, clock: Clock, shift_s: float, target_from_source: Pose) -> None:
        self._clock = clock
        self._poses = [
            replace(pose, stamp_s=pose.stamp_s + shift_s, odom_from_body=target_from_source @ pose.odom_from_body)
            for pose in recording.poses()
        ]
        self._next = 0

    def poses(self) -> list[StampedPose]:
        """Return the poses that became due since the last call."""
        begin, now_s = self._next, self._clock.now_s()
        while self._next < len(self._poses) and self._poses[self._next].stamp_s <= now_s + 1e-9:
            self._next += 1
        return self._poses[begin : self._next]


def pinhole(numbers: Pinhole, shape: tuple[int, ...]) -> Intrinsics:
    """Return the intrinsics fx, fy, cx, cy of an image of this shape (H, W, ...)."""
    return Intrinsics(*numbers, width=shape[1], height=shape[0])


def undistorted(image: AnyArray, k: Pinhole, distortion: tuple[float, ...]) -> AnyArray:
    """Return an image without lens distortion, with the same intrinsics.

    Zero where it shows nothing. distortion: k1, k2, p1, p2, k3 of OpenCV. A depth is that of the nearest pixel: the mean of two
    surfaces is none.
    """
    import cv2

    height, width = image.shape[:2]
    maps = _undistortion(k, distortion, width, height)
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_NEAREST if image.dtype == np.uint16 else cv2.INTER_LINEAR))


@functools.lru_cache(maxsize=4)
def _undistortion(k: Pinhole, distortion: tuple[float, ...], width: int, height: int) -> tuple[AnyArray, AnyArray]:
    import cv2

    matrix = np.array([[k[0], 0.0, k[2]], [0.0, k[1], k[3]], [0.0, 0.0, 1.0]])
    maps = cv2.initUndistortRectifyMap(matrix, np.array(distortion), None, matrix, (width, height), cv2.CV_32FC1)
    return maps[0], maps[1]
