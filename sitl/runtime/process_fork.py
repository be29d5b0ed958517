"""Forks of a running simulation: the common start of many flights is flown once."""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Generic, NoReturn, TypeVar

T = TypeVar("T")


class FlightFork(Generic[T]):
    """Forks of this process, one after the other. The process must have no other thread.

    Each fork has its own copy of the memory. The files below folder, including mapped ones, are restored when a fork has
    ended. Used as a context manager; a fork exits at the end of the `with` block at the latest.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._way_back: Connection | None = None  # in a fork: the pipe to the parent
        self.answer: T | None = None

    def split(self) -> bool:
        """Fork. Return True in the fork, and False in the parent when the fork has ended.

        `answer` is then the fork's result, or None if the fork ended without give(). Blocks the parent meanwhile.
        """
        receiver, sender = multiprocessing.Pipe(duplex=False)
        before = ForkSnapshot(self._folder)
        gc.freeze()  # a collection in the fork would write to, and so copy, all shared pages
        sys.stdout.flush()
        sys.stderr.flush()
        process = os.fork()
        if process == 0:
            receiver.close()
            self._way_back = sender
            return True
        sender.close()
        try:
            self.answer = receiver.recv()
        except EOFError:
            self.answer = None
        receiver.close()
        os.waitpid(process, 0)
        gc.unfreeze()
        before.put_back()
        return False

    def give(self, answer: T) -> None:
        """Send the result to the parent and exit, if this is a fork; no effect in the parent."""
        if self._way_back is not None:
            self._way_back.send(answer)
            self._end(0)

    def __enter__(self) -> FlightFork[T]:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._way_back is not None:
            self._end(1)

    def _end(self, code: int) -> NoReturn:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


class ForkSnapshot:
    """Content of the files below a folder at one time, to be restored while they may be open."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._content = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    def put_back(self) -> None:
        """Restore the files in place, so that open and mapped ones change too; delete newer files."""
        for path in [path for path in self._folder.rglob("*") if path.is_file() and path not in self._content]:
            path.unlink()
        for path, content in self._content.items():
            with path.open("r+b") as file:
                file.write(content)
                file.truncate()
