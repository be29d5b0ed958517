"""Atomic replacement of a file: a reader sees the whole old or the whole new content."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

_ASIDE = ".part"  # appended to the name of the file while it is written, in the same folder


def replace(path: Path, data: bytes | memoryview, *, durable: bool) -> None:
    """Replace a file by these bytes; see writing()."""
    with writing(path, durable=durable) as file:
        file.write(data)


@contextmanager
def writing(path: Path, *, durable: bool, previous: Path | None = None) -> Iterator[BinaryIO]:
    """Give a binary file to write to, which replaces the file at the end.

    A replaced file keeps its mode. One writer of a file at a time. Blocks; raises OSError. If the body or the writing fails,
    the old content stays and nothing is left beside it.

    durable: when this returns, the new content survives a loss of power: file and folder are synced, which can take as long
    as the disk likes. previous: where to keep the old file.
    """
    aside = path.with_name(path.name + _ASIDE)
    try:
        with aside.open("wb") as file:
            yield file
            _keep_mode(path, file)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        if previous is not None:
            with suppress(FileNotFoundError):
                path.replace(previous)
        aside.replace(path)
    except BaseException:
        with suppress(OSError):  # the caller gets the first error
            aside.unlink(missing_ok=True)
        raise
    if durable:
        _sync_folder(path.parent)


def _keep_mode(path: Path, file: BinaryIO) -> None:
    with suppress(FileNotFoundError):
        mode = stat.S_IMODE(path.stat().st_mode)
        if mode != stat.S_IMODE(os.fstat(file.fileno()).st_mode):
            os.fchmod(file.fileno(), mode)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
