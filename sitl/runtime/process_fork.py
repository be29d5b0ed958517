"""A process that goes on twice from one instant: what many flights have in common is flown once, and each then in a fork."""

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
    """Forks of this process, one after the other; it must have no other thread. The system gives each fork its own memory; the
    files below folder, mapped ones too, are put back when a fork has ended. No fork leaves the context that it was made in.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._way_back: Connection | None = None  # of a fork, to who made it
        self.answer: T | None = None

    def split(self) -> bool:
        """True in the fork, False here when it is over; answer then is what it gave, None where it died before."""
        receiver, sender = multiprocessing.Pipe(duplex=False)
        before = ForkSnapshot(self._folder)
        gc.freeze()  # a collection would touch, and so copy, all that is shared
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
        """In a fork: answer, and be over. Nothing where there is nobody to answer to."""
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
    """The files below a folder as they were; those that are open stay so."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._content = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    def put_back(self) -> None:
        """In place, so that whoever has one open or mapped sees it; later ones go."""
        for path in [path for path in self._folder.rglob("*") if path.is_file() and path not in self._content]:
            path.unlink()
        for path, content in self._content.items():
            with path.open("r+b") as file:
                file.write(content)
                file.truncate()
