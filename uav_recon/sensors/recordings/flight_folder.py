"""Flight folder as a recording: keyframes, and poses interpolated between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from uav_recon.clock import ManualClock
from uav_recon.sensors.recorded_camera import RecordedPoses, read_keyframes
from uav_recon.sensors.recordings.recording import LEVEL_MOUNT, RecordingError, RecordingInfo
from uav_recon.sensors.stream_camera import depth_lookup_table
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.pose import StampedPose


class FlightFolder:
    """Recording protocol over the keyframes of a flight folder. Raises RecordingError."""

    def __init__(self, folder: Path, depth_min_m: float, depth_max_m: float) -> None:
        self._folder = folder
        self._keyframes = read_keyframes(folder)
        self._table = depth_lookup_table(depth_min_m, depth_max_m)

    @property
    def info(self) -> RecordingInfo:
        """Return the head of the recording."""
        first_s, last_s = self._keyframes[0].stamp_s, self._keyframes[-1].stamp_s
        return RecordingInfo("flight folder", len(self._keyframes), first_s, last_s, LEVEL_MOUNT, up_is_z=True)

    def frames(self, step: int = 1) -> Iterator[Frame]:
        """Yield every step-th keyframe. Raises RecordingError for one without its images."""
        for keyframe in self._keyframes[::step]:
            frame = keyframe.load(self._table, keyframe.stamp_s)
            if frame is None:
                raise RecordingError(f"{keyframe.depth}: image or its colour image is missing or has another size")
            yield frame

    def poses(self) -> list[StampedPose]:
        """Return the poses of a body that carries the camera level, at 15 Hz between the keyframes."""
        clock, first_s = ManualClock(), self._keyframes[0].stamp_s
        source = RecordedPoses(self._folder, clock, LEVEL_MOUNT)
        clock.advance_to(self._keyframes[-1].stamp_s - first_s)
        return [replace(pose, stamp_s=pose.stamp_s + first_s) for pose in source.poses()]

    def imu(self) -> list[ImuSample]:
        """Return an empty list: keyframes have no inertial samples."""
        return []


def is_flight_folder(path: Path) -> bool:
    """Return True if the folder has a list of keyframes."""
    return (path / "keyframes" / "poses.json").is_file() or (path / "poses.json").is_file()
