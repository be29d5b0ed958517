"""Sources of a recording: a camera stream of another program, or a camera read directly."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from uav_recon.interfaces import DepthCamera, PoseSource
from uav_recon.sensors.recordings.mcap_writer import McapWriter
from uav_recon.sensors.stream_format import CameraSpec, StreamHeader, StreamReader
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.frames import AnyArray, Float32Array
from uav_recon.types.pose import Pose

_MAX_DEPTH_M = 65.0  # a larger one does not fit into 16 bits of millimetres


class RecordingSource(Protocol):
    """Frames, inertial samples and poses as they come.

    missed: number of frames that came and were not read.
    """

    missed: int

    def copy_to(self, writer: McapWriter) -> bool:
        """Write what is new, at most one frame. Returns whether anything was. Never blocks."""
        ...

    def close(self) -> None:
        """Release the source."""
        ...


class StreamSource:
    """The records of a camera stream, unchanged."""

    def __init__(self, reader: StreamReader) -> None:
        self._reader = reader
        self._frame = self._imu = self._pose = 0
        self.missed = 0

    def copy_to(self, writer: McapWriter) -> bool:
        """Write every new record; of the frames the newest, because the stream gives no other."""
        before = self._frame, self._imu, self._pose
        self._imu, samples = self._reader.imu(self._imu)
        for sample in samples:
            writer.write_imu(float(sample["stamp_s"]), sample["gyro_radps"], sample["specific_force_mps2"])
        self._pose, poses = self._reader.poses(self._pose)
        for pose in poses:
            _write_pose(pose, writer)
        raw = self._reader.frame(self._frame)
        if raw is not None:
            self.missed += raw.sequence - self._frame - 1 if self._frame else 0
            self._frame = raw.sequence
            writer.write_frame(raw.stamp_s, raw.depth_mm, raw.rgb)
        return (self._frame, self._imu, self._pose) != before

    def close(self) -> None:
        """Do nothing: the stream belongs to its writer."""


class CameraSource:
    """A camera that is read directly, and the poses of another source, None without one.

    first: the first frame of the camera, which is recorded, too.
    """

    def __init__(self, camera: DepthCamera, poses: PoseSource | None, first: Frame) -> None:
        self._camera, self._poses = camera, poses
        self._waiting: Frame | None = first
        self._frame = first.sequence
        self.missed = 0

    def copy_to(self, writer: McapWriter) -> bool:
        """Write the newest frame and every inertial sample and pose since the last call."""
        samples = self._camera.imu()
        for sample in samples:
            writer.write_imu(sample.stamp_s, sample.gyro_radps, sample.specific_force_mps2)
        poses = [] if self._poses is None else [pose for pose in self._poses.poses() if pose.quality > 0]
        for pose in poses:
            writer.write_pose(pose.stamp_s, pose.odom_from_body, np.diag(pose.covariance))
        frame = self._waiting or self._camera.poll()
        self._waiting = None
        if frame is not None:
            self.missed += max(frame.sequence - self._frame - 1, 0)
            self._frame = frame.sequence
            writer.write_frame(frame.stamp_s, _millimetres(frame.depth_m), frame.rgb)
        return bool(samples or poses or frame is not None)

    def close(self) -> None:
        """Release the camera."""
        self._camera.close()


def header_of(frame: Frame) -> StreamHeader:
    """Return the constants of a camera that gives such frames."""
    to_rgb = (*frame.rgb_from_depth.quat_wxyz.tolist(), *frame.rgb_from_depth.translation_m.tolist())
    return StreamHeader(_spec(frame.depth_intrinsics), _spec(frame.rgb_intrinsics), to_rgb)


def _spec(of: Intrinsics) -> CameraSpec:
    return CameraSpec(of.width, of.height, of.fx, of.fy, of.cx, of.cy)


def _millimetres(depth_m: Float32Array) -> AnyArray:
    """Return depth (H, W) uint16 in millimetres, 0 where there is no return."""
    known_m = np.where(np.isfinite(depth_m) & (depth_m < _MAX_DEPTH_M), depth_m, np.float32(0.0))
    return np.rint(1e3 * known_m).astype(np.uint16)


def _write_pose(pose: np.void, writer: McapWriter) -> None:
    """Write a pose of a stream, unless it is none."""
    numbers = np.concatenate([pose["quat_wxyz"], pose["position_m"], pose["variance"]])
    if int(pose["quality"]) > 0 and np.isfinite(numbers).all() and np.linalg.norm(pose["quat_wxyz"]) > 0.5:
        pose_of_body = Pose(np.array(pose["quat_wxyz"]), np.array(pose["position_m"]))
        writer.write_pose(float(pose["stamp_s"]), pose_of_body, pose["variance"])
