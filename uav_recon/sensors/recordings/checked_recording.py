"""Boundary around the readers: a damaged file becomes an error that names it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uav_recon.sensors.recordings.recording import Recording, RecordingError, RecordingInfo
from uav_recon.sensors.stream_format import StreamError
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.pose import StampedPose

_TEXT_CHARACTERS = 160  #: internal: of the message of a library


class CheckedRecording:
    """Recording protocol over another recording; every call raises RecordingError only.

    path: what the errors name.
    """

    def __init__(self, path: Path, recording: Recording) -> None:
        self._path, self._recording = path, recording

    @property
    def info(self) -> RecordingInfo:
        """Return the head of the recording."""
        return self._recording.info

    def frames(self, step: int = 1) -> Iterator[Frame]:
        """Yield every step-th frame. Raises RecordingError."""
        with faults_of(self._path):
            yield from self._recording.frames(step)

    def poses(self) -> list[StampedPose]:
        """Return all poses of the body. Raises RecordingError."""
        with faults_of(self._path):
            return self._recording.poses()

    def imu(self) -> list[ImuSample]:
        """Return all inertial samples. Raises RecordingError."""
        with faults_of(self._path):
            return self._recording.imu()


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
