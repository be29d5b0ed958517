"""What is common is flown once: a fork has memory of its own, its answer comes back, and nothing of it stays on disk."""

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
    """A process without threads: pytest may have some, and a fork would lack them."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield pool


def counted(folder: Path) -> list[list[str] | None]:
    """Three forks of one story, each of which adds to what was told before it."""
    story, answers = ["once"], list[list[str] | None]()
    with FlightFork[list[str]](folder) as fork:
        for name in ("a", "b", "c"):
            if fork.split():
                story.append(name)
                fork.give(story)
            answers.append(fork.answer)
        story.append("over")
        fork.give(story)  # to nobody
    return [*answers, story]


def test_each_fork_goes_on_by_itself_and_answers(elsewhere: ProcessPoolExecutor, tmp_path: Path) -> None:
    told = elsewhere.submit(counted, tmp_path).result(60)
    assert told == [["once", "a"], ["once", "b"], ["once", "c"], ["once", "over"]]


def written(folder: Path) -> tuple[bytes, bytes, bytes, list[str]]:
    """A fork writes into a mapped file, a log and a new file: the mapping as it is seen, the two files, and all names."""
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


def test_files_are_put_back_under_whoever_has_them_open(elsewhere: ProcessPoolExecutor, tmp_path: Path) -> None:
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
def test_a_fork_that_dies_has_no_answer_and_goes_nowhere(elsewhere: ProcessPoolExecutor, tmp_path: Path, way: str) -> None:
    assert elsewhere.submit(died, tmp_path, way).result(60) == (None, 0)
