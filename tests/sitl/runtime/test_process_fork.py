"""Process fork: a common part is flown once, then each fork continues.

A fork has its own memory, its result comes back, and none of its files remain on disk.
"""

from __future__ import annotations

import mmap
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from sitl.runtime.process_fork import FlightFork


@pytest.fixture(scope="module")
def elsewhere() -> Iterator[ProcessPoolExecutor]:
    """Yield a process without threads: pytest may have threads, which a fork would lose."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield pool


def counted(folder: Path) -> list[list[str] | None]:
    """Fork three times; each fork appends to the common list and returns it."""
    story, answers = ["once"], list[list[str] | None]()
    with FlightFork[list[str]](folder) as fork:
        for name in ("a", "b", "c"):
            if fork.split():
                story.append(name)
                fork.give(story)
            answers.append(fork.answer)
        story.append("over")
        fork.give(story)  # outside a fork, this does nothing
    return [*answers, story]


def test_each_fork_continues_separately_and_returns_a_result(elsewhere: ProcessPoolExecutor, tmp_path: Path) -> None:
    told = elsewhere.submit(counted, tmp_path).result(60)
    assert told == [["once", "a"], ["once", "b"], ["once", "c"], ["once", "over"]]


def written(folder: Path) -> tuple[bytes, bytes, bytes, list[str]]:
    """Let a fork write into a mapped file, a log and a new file.

    Returns the content of the mapping, the two files, and all names.
    """
    (folder / "ring").write_bytes(b"....")
    with (folder / "ring").open("r+b") as file, (folder / "log").open("a", buffering=1) as log:
        ring = mmap.mmap(file.fileno(), 4)
        ring[0:2] = b"ab"
        log.write("before\n")
        with FlightFork[int](folder) as fork:
            if fork.split():
                ring[1:4] = b"XYZ"
                log.write("in the fork\n")
                (folder / "new").write_bytes(b"new")
                fork.give(0)
        log.write("after\n")
        seen = bytes(ring[:])
        ring.close()
    names = sorted(path.name for path in folder.iterdir())
    return seen, (folder / "ring").read_bytes(), (folder / "log").read_bytes(), names


def test_files_are_restored_even_while_they_are_open(elsewhere: ProcessPoolExecutor, tmp_path: Path) -> None:
    seen, ring, log, names = elsewhere.submit(written, tmp_path).result(60)
    assert seen == ring == b"ab.."
    assert log == b"before\nafter\n"
    assert names == ["log", "ring"]


def died(folder: Path, way: str) -> tuple[object, int]:
    ours = os.getpid()
    with FlightFork[str](folder) as fork:
        if fork.split():
            if way == "raises":
                raise SystemExit("of the fork alone")
            os.abort()
    return fork.answer, os.getpid() - ours


@pytest.mark.parametrize("way", ["raises", "aborts"])
def test_a_fork_that_dies_has_no_result_and_does_not_continue(elsewhere: ProcessPoolExecutor, tmp_path: Path, way: str) -> None:
    assert elsewhere.submit(died, tmp_path, way).result(60) == (None, 0)
