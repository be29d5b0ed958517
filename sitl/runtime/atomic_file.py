"""Atomic replacement of a file, also by several processes: the last one wins."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


def replace(path: Path, data: bytes) -> None:
    """Replace a file by these bytes; see writing()."""
    with writing(path) as file:
        file.write(data)


@contextmanager
def writing(path: Path) -> Iterator[BinaryIO]:
    """Give a binary file to write to, which replaces the file at the end. Raises OSError.

    If the body or the writing fails, the old content stays and nothing is left beside it.
    """
    aside = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with aside.open("wb") as file:
            yield file
        aside.replace(path)
    except BaseException:
        with suppress(OSError):  # the caller gets the first error
            aside.unlink(missing_ok=True)
        raise
