"""A tracking engine beside the camera stream: frames in, poses of the body out."""

from __future__ import annotations

import logging
import math
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.interfaces import Clock
from uav_recon.sensors.stream_format import CameraSpec, RawFrame, StreamError, StreamPoseWriter, StreamReader
from uav_recon.trackers.engine import RgbdView, TrackedPose, TrackingEngine
from uav_recon.trackers.registered_depth import DepthRegistration
from uav_recon.types.camera import Intrinsics
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

LOG = logging.getLogger(__name__)

_REST_S = 0.5  #: refuse: no pose before the inertial samples were at rest for this time: they tell where down is
_REST_RADPS = 0.1  #: refuse: at rest, the turn rates stay below this
_REST_MPS2 = 0.5  #: refuse: at rest, the specific force differs from its mean by less
_NO_IMU_S = 3.0  #: warn: after this time without inertial samples the body is taken as level
_SILENT_S = 1.0  #: internal: after this time without a frame the stream is opened again
VARIANCE = np.repeat((0.03**2, math.radians(1.0) ** 2), 3)  # m², rad²: the engines tell none


class TrackerProcess:
    """Tracks a camera stream with an engine, and writes the poses into the same stream.

    body_from_depth: pose of the depth imager. odom begins at the body's first pose: level by the inertial samples at rest, with
    heading 0. Another world of the engine continues at the last pose, with another reset counter. ``poses`` counts the written
    ones. The constructor raises StreamError.
    """

    def __init__(self, path: Path, engine: TrackingEngine, body_from_depth: Pose, clock: Clock) -> None:
        self._path = path
        self._engine = engine
        self._clock = clock
        self._depth_from_body = body_from_depth.inverse()
        self._stream = _OpenStream(path)
        self._begun_s = self._newest_s = clock.now_s()
        self._rest: deque[tuple[float, FloatArray, FloatArray]] = deque()
        self._heard_imu = False
        self._level: Pose | None = None
        self._odom_from_world: Pose | None = None
        self._last = Pose.identity()
        self._world = self._resets = 0
        self.poses = 0

    def step(self) -> bool:
        """Track the newest frame, if there is one.

        Return True if poses were written. Blocks while the engine computes.
        """
        self._find_level()
        raw = self._stream.frame()
        now_s = self._clock.now_s()
        if raw is None:
            self._reopen(now_s)
            return False
        self._newest_s = now_s
        if self._level is None:
            return False
        depth_m = self._stream.registration.registered(raw.depth_mm * np.float32(1e-3))
        tracked = self._engine.track(RgbdView(raw.stamp_s, raw.rgb, depth_m, self._stream.rgb))
        for pose in tracked:
            self._write(pose, self._level)
        return bool(tracked)

    def _write(self, tracked: TrackedPose, level: Pose) -> None:
        world_from_body = tracked.world_from_rgb @ self._stream.rgb_from_depth @ self._depth_from_body
        if self._odom_from_world is None or tracked.world != self._world:
            self._resets += self._odom_from_world is not None
            start = level if self._odom_from_world is None else self._last
            self._odom_from_world, self._world = start @ world_from_body.inverse(), tracked.world
        self._last = self._odom_from_world @ world_from_body
        self._stream.writer.write_pose(
            tracked.stamp_s, self._last.translation_m, self._last.quat_wxyz, VARIANCE, tracked.quality, self._resets % 256
        )
        self.poses += 1

    def _find_level(self) -> None:
        """Find the attitude of the body at rest, once."""
        if self._level is not None:
            return
        for sample in self._stream.imu():
            self._heard_imu = True
            self._rest.append(
                (float(sample["stamp_s"]), np.array(sample["gyro_radps"]), np.array(sample["specific_force_mps2"]))
            )
        while self._rest and self._rest[-1][0] - self._rest[0][0] > _REST_S:
            self._rest.popleft()
        if not self._heard_imu and self._clock.now_s() - self._begun_s > _NO_IMU_S:
            LOG.warning("no inertial samples: the body is taken as level")
            self._level = Pose.identity()
        if self._rest and self._rest[-1][0] - self._rest[0][0] > 0.9 * _REST_S:
            forces = np.array([force for _, _, force in self._rest])
            fastest_radps = max(float(np.linalg.norm(gyro)) for _, gyro, _ in self._rest)
            mean = forces.mean(axis=0)
            if fastest_radps < _REST_RADPS and np.linalg.norm(forces - mean, axis=1).max() < _REST_MPS2:
                self._level = level_attitude(mean)

    def _reopen(self, now_s: float) -> None:
        """Open the stream of a restarted camera; the old one is used until then."""
        if now_s - self._newest_s < _SILENT_S:
            return
        self._newest_s = now_s
        try:
            if self._path.stat().st_ino != self._stream.inode:
                self._stream = _OpenStream(self._path)
        except (OSError, StreamError):
            return


class _OpenStream:
    """A stream as one camera process made it.

    Raises StreamError or OSError.
    """

    def __init__(self, path: Path) -> None:
        self._reader, self.writer = StreamReader(path), StreamPoseWriter(path)
        self.inode = path.stat().st_ino
        self._frames_read = self._imu_read = 0
        header, numbers = self._reader.header, np.array(self._reader.header.rgb_from_depth)
        self.rgb, self.rgb_from_depth = _intrinsics(header.rgb), Pose(numbers[:4], numbers[4:])
        self.registration = DepthRegistration(_intrinsics(header.depth), self.rgb, self.rgb_from_depth)

    def frame(self) -> RawFrame | None:
        """Return the newest frame that was not returned before, or None."""
        raw = self._reader.frame(self._frames_read)
        if raw is not None:
            self._frames_read = raw.sequence
        return raw

    def imu(self) -> np.ndarray[Any, Any]:
        """Return the inertial samples since the last call."""
        self._imu_read, samples = self._reader.imu(self._imu_read)
        return samples


def level_attitude(force_mps2: FloatArray) -> Pose:
    """Return odom_from_body at the origin of a body that rests with a specific force (3,).

    Its heading is 0.
    """
    up = force_mps2 / np.linalg.norm(force_mps2)
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead /= np.linalg.norm(ahead)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([ahead, np.cross(up, ahead), up])
    return Pose.from_matrix(matrix)


def _intrinsics(spec: CameraSpec) -> Intrinsics:
    return Intrinsics(spec.fx, spec.fy, spec.cx, spec.cy, spec.width, spec.height)
