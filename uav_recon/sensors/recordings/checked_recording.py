"""Boundary around the readers: a damaged file becomes an error that names it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from uav_recon.sensors.recordings.recording import Recording, RecordingError, RecordingInfo
from uav_recon.sensors.stream_format import StreamError
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.pose import StampedPose

_TEXT_CHARACTERS = 160  #: internal: of the message of a library
_ROUNDING_M = 1e-6  #: internal: a depth may be outside the range by this
Stamped = TypeVar("Stamped", StampedPose, ImuSample)
_AROUND_S = 1.0  #: reject: poses and inertial samples that far from a part that is used, where the stamps jump


class CheckedRecording:
    """Recording protocol over the reader of a format; every call raises RecordingError only.

    path: what the errors name. depth_range_m: depths outside become no returns; None keeps all.
    """

    def __init__(self, path: Path, recording: Recording, depth_range_m: tuple[float, float] | None) -> None:
        self._path, self._recording, self._depth_range_m = path, recording, depth_range_m

    @property
    def info(self) -> RecordingInfo:
        """Return the head of the recording."""
        return self._recording.info

    @property
    def depth_range_m(self) -> tuple[float, float] | None:
        """The depths that are kept."""
        return self._depth_range_m

    def of_any_depth(self) -> CheckedRecording:
        """Return the same recording with all of its depth, also what the camera cannot measure."""
        return CheckedRecording(self._path, self._recording, None)

    def frames(self, step: int = 1) -> Iterator[Frame]:
        """Yield every step-th frame. Raises RecordingError."""
        with faults_of(self._path):
            for frame in self._recording.frames(step):
                yield frame if self._depth_range_m is None else _clipped(frame, *self._depth_range_m)

    def poses(self) -> list[StampedPose]:
        """Return all poses of the body. Raises RecordingError."""
        with faults_of(self._path):
            return self._beside_frames(self._recording.poses())

    def imu(self) -> list[ImuSample]:
        """Return all inertial samples. Raises RecordingError."""
        with faults_of(self._path):
            return self._beside_frames(self._recording.imu())

    def _beside_frames(self, values: list[Stamped]) -> list[Stamped]:
        """Leave out what is far from the frames, if only a part of them is used."""
        info = self._recording.info
        if not info.is_part:
            return values
        return [value for value in values if info.first_s - _AROUND_S <= value.stamp_s <= info.last_s + _AROUND_S]


def _clipped(frame: Frame, low_m: float, high_m: float) -> Frame:
    """Return the frame without depths outside a range."""
    inside = (frame.depth_m >= low_m - _ROUNDING_M) & (frame.depth_m <= high_m + _ROUNDING_M)
    return replace(frame, depth_m=np.where(inside, frame.depth_m, np.float32(np.nan)))


@contextmanager
def faults_of(named: Path | str) -> Iterator[None]:
    """Turn any exception of the block into a RecordingError of one line that names the file.

    named: the file, or the file and a part of it. The libraries that decode damaged bytes raise exceptions of their own, and of
    many built-in kinds.
    """
    try:
        yield
    except StreamError:
        raise
    except OSError as error:
        raise RecordingError(f"{error.filename or named}: cannot be read ({error.strerror or error})") from error
    except Exception as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())[:_TEXT_CHARACTERS]
        raise RecordingError(f"{named}: damaged or cut ({text})") from error
