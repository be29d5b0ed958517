"""Remarks on a recording that its user should know, a line each."""

from __future__ import annotations

from rich.console import Console

from uav_recon.app.depth_unit_check import depth_unit_remarks
from uav_recon.sensors.recordings.checked_recording import CheckedRecording
from uav_recon.sensors.recordings.recording import RecordingInfo


def recording_remarks(recording: CheckedRecording) -> list[str]:
    """Return what is assumed, left out or wrong.

    Reads some frames and all poses, which takes seconds.

    Raises RecordingError.
    """
    depth = depth_unit_remarks(recording)
    return [*recording.info.remarks, *depth]


def skipped_remarks(info: RecordingInfo) -> list[str]:
    """Return what was not read, with the count, a line each.

    The damaged frames are known after they were read.
    """
    return [f"not read: {reason}: {count}" for reason, count in info.skipped]


def print_remarks(remarks: list[str], console: Console) -> None:
    """Print a line for each remark."""
    for remark in remarks:
        console.print(f"note: {remark}", highlight=False, markup=False, soft_wrap=True)
