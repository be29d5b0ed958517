"""Checks of options, files and folders before the work starts.

Errors are one line with exit code 2.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uav_recon.errors import EXIT_USAGE, UserError

OUTPUTS = ("config.toml", "report.json", "timeline.jsonl", "mesh.ply", "keyframes")  # of a flight or replay, never overwritten


class UsageError(UserError):
    """An option with a value that cannot be used."""

    code = EXIT_USAGE


@contextmanager
def readable(name: str, code: int = EXIT_USAGE) -> Iterator[None]:
    """Turn an OSError of the block into a one-line UserError with this name and exit code."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{name}: cannot be read ({error.strerror or error})", code) from None


def require_writable_file(option: str, path: Path | None) -> None:
    """Check that a file can be written; an existing one is left unchanged.

    Raises UsageError.
    """
    if path is None:
        return
    with readable(f"{option} {path}"):
        if not path.parent.is_dir():
            raise UsageError(f"{option} {path}: no such folder {path.parent}")
        before = path.exists()
    try:
        path.open("ab").close()
        if not before:
            path.unlink()
    except OSError as error:
        raise UsageError(f"{option} {path}: cannot be written ({error.strerror})") from None


def require_writable_folder(option: str, path: Path | None) -> None:
    """Create the folder if needed and check that it can be written. Raises UsageError."""
    if path is None:
        return
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise UsageError(f"{option} {path}: cannot be written ({error.strerror})") from None


def remove_outputs(path: Path) -> None:
    """Remove what a run began in a folder that had no outputs before it. Raises OSError."""
    for name in OUTPUTS:
        if (path / name).is_dir():
            shutil.rmtree(path / name)
        else:
            (path / name).unlink(missing_ok=True)


def mount_pitch_deg(text: str) -> float | None:
    """Return the tilt of a fixed mount in degrees, None for a gimbal. Raises UsageError.

    Positive looks down.
    """
    if text == "gimbal":
        return None
    kind, _, degrees = text.partition(":")
    try:
        pitch = float(degrees)
    except ValueError:
        pitch = math.nan
    if kind != "fixed" or not -60.0 <= pitch <= 60.0:
        raise UsageError(f"--mount {text}: want gimbal, or fixed:DEG with DEG -60 to 60 (positive looks down)")
    return pitch
