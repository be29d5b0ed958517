"""Flight folder as a recording: keyframes, and poses interpolated between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from uav_recon.clock import ManualClock
from uav_recon.sensors.recorded_camera import RecordedPoses, read_keyframes
from uav_recon.sensors.recordings.damaged_frames import DamagedFrames
from uav_recon.sensors.recordings.recording import LEVEL_MOUNT, MM, DepthUnit, RecordingInfo
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.pose import StampedPose


class FlightFolder:
    """Recording protocol over the keyframes of a flight folder. Raises RecordingError.

    metres_per_unit: of the depth images; None: millimetres.
    """

    def __init__(self, folder: Path, metres_per_unit: float | None) -> None:
        self._folder = folder
        self._keyframes = read_keyframes(folder)
        self._unit = DepthUnit(metres_per_unit or MM)
        self._damaged = DamagedFrames()

    @property
    def info(self) -> RecordingInfo:
        """Return the head of the recording."""
        first_s, last_s, unit = self._keyframes[0].stamp_s, self._keyframes[-1].stamp_s, self._unit.metres_per_unit
        skipped = self._damaged.counts()
        return RecordingInfo("flight folder", len(self._keyframes), first_s, last_s, LEVEL_MOUNT, True, unit, skipped)

    def frames(self, step: int = 1) -> Iterator[Frame]:
        """Yield every step-th keyframe that has its images. Raises RecordingError if none has."""
        numbered = list(enumerate(self._keyframes))[::step]
        return self._damaged.readable((number, partial(one.load, self._unit.table_m, one.stamp_s)) for number, one in numbered)

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
