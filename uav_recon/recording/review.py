"""Review of a recorded flight: open it in the viewer, or check that it can be read."""

from __future__ import annotations

import logging
import struct
import subprocess
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

from uav_recon.recording.blueprint import RECORDING
from uav_recon.recording.viewer import viewer_command

_LOG = logging.getLogger(__name__)
_MAGIC = b"RRF2"
_FILE_HEADER_BYTES = 12
_MESSAGE_HEADER = struct.Struct("<QQ")  # kind, and length of the payload that follows


class ReviewError(Exception):
    """Raised for a flight that cannot be shown; the text is one line."""


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """Content of a recording: entity names and number of chunks.

    cut_bytes: bytes of a last message that is not whole; 0 if nothing is missing, or if the file ends between two messages.
    """

    entities: tuple[str, ...]
    chunks: int
    cut_bytes: int = 0


def review(folder: Path) -> None:
    """Open the viewer on a flight folder with its stored blueprint; blocks until it is closed.

    A recording that was cut short is shown up to the cut, and reported in one line. Raises ReviewError if there is no
    recording, or if the viewer ends with an error.
    """
    path = recording_path(folder)
    if (cut_bytes := bytes_after_last_message(path)) > 0:
        _LOG.warning("%s: is cut, the last %d bytes are not a whole message; shown up to there", path, cut_bytes)
    try:
        result = subprocess.run(viewer_command(str(path)), stderr=subprocess.PIPE, text=True, check=False)  # noqa: S603
    except OSError as error:
        raise ReviewError(f"{path}: the viewer cannot be started ({error.strerror})") from None
    if result.returncode != 0:
        lines = [line for line in result.stderr.splitlines() if line.strip()]
        reason = lines[-1].strip() if lines else f"status {result.returncode}"
        raise ReviewError(f"{path}: the viewer ended with an error: {reason}")


def recording_path(folder: Path) -> Path:
    """Return the recording of a flight folder. Raises ReviewError if it is missing or empty."""
    if not folder.is_dir():
        raise ReviewError(f"{folder}: no such flight folder")
    path = folder / RECORDING
    if not path.is_file():
        raise ReviewError(f"{folder}: holds no {RECORDING} (was recording.rerun off?)")
    if path.stat().st_size == 0:
        raise ReviewError(f"{path}: is empty")
    return path


def bytes_after_last_message(path: Path) -> int:
    """Return the number of bytes after the last whole message of a recording.

    It returns 0 for a file of another format.
    """
    size, at = path.stat().st_size, _FILE_HEADER_BYTES
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            return 0
        while at + _MESSAGE_HEADER.size <= size:
            file.seek(at)
            _, length = _MESSAGE_HEADER.unpack(file.read(_MESSAGE_HEADER.size))
            if at + _MESSAGE_HEADER.size + length > size:
                break
            at += _MESSAGE_HEADER.size + length
    return max(size - at, 0)


def check_recording(folder: Path) -> RecordingSummary:
    """Read a recording completely.

    One that was cut short by a crash is valid up to its last whole message. Raises ReviewError if nothing can be read.
    """
    path = recording_path(folder)
    cut_bytes = bytes_after_last_message(path)
    if cut_bytes == 0:
        return _read(path, path)
    with tempfile.TemporaryDirectory() as temporary:
        whole = Path(temporary) / RECORDING
        with path.open("rb") as file:
            whole.write_bytes(file.read(path.stat().st_size - cut_bytes))
        return replace(_read(whole, path), cut_bytes=cut_bytes)


def _read(path: Path, named: Path) -> RecordingSummary:
    """Read a recording without a cut message.

    Raises ReviewError with the name ``named`` if there is nothing in it.
    """
    from rerun.chunk import RrdReader

    entities: set[str] = set()
    chunks = 0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a killed recorder writes no footer, which is expected
            for chunk in RrdReader(path).stream().to_chunks():
                entities.add(str(chunk.entity_path))
                chunks += 1
    except (RuntimeError, ValueError, OSError) as error:
        if chunks == 0:
            raise ReviewError(f"{named}: not a recording ({str(error).splitlines()[0]})") from None
    if chunks == 0:
        raise ReviewError(f"{named}: not a recording")
    return RecordingSummary(tuple(sorted(entities)), chunks)
