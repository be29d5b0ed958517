"""Review of a recorded flight: open it in the viewer, or check that it can be read."""

from __future__ import annotations

import subprocess
import warnings
from dataclasses import dataclass
from pathlib import Path

from uav_recon.recording.blueprint import RECORDING
from uav_recon.recording.viewer import viewer_command


class ReviewError(Exception):
    """Raised for a flight that cannot be shown; the text is one line."""


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """Content of a recording: entity names and number of chunks."""

    entities: tuple[str, ...]
    chunks: int


def review(folder: Path) -> None:
    """Open the viewer on a flight folder with its stored blueprint; blocks until it is closed.

    Raises ReviewError if there is no recording, or if the viewer ends with an error.
    """
    path = recording_path(folder)
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


def check_recording(folder: Path) -> RecordingSummary:
    """Read a recording completely; one that was cut short by a crash is valid up to the cut.

    Raises ReviewError if nothing can be read.
    """
    path = recording_path(folder)
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
            raise ReviewError(f"{path}: not a recording ({str(error).splitlines()[0]})") from None
    if chunks == 0:
        raise ReviewError(f"{path}: not a recording")
    return RecordingSummary(tuple(sorted(entities)), chunks)
