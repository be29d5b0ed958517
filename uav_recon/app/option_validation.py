"""What a user asked for and cannot have, in one line and with exit code 2; files and folders are looked at before the work."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uav_recon.errors import EXIT_USAGE, UserError


class UsageError(UserError):
    """An option that makes no sense."""

    code = EXIT_USAGE


@contextmanager
def readable(name: str, code: int = EXIT_USAGE) -> Iterator[None]:
    """What the system refuses in here is told under this name. Raises Failure with this exit code."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{name}: cannot be read ({error.strerror or error})", code) from None


def require_writable_file(option: str, path: Path | None) -> None:
    """See that a file can be written there, and leave what is there as it is. Raises UsageError."""
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
    """Make the folder if needed, and see that it can be written into. Raises UsageError."""
    if path is None:
        return
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise UsageError(f"{option} {path}: cannot be written ({error.strerror})") from None
