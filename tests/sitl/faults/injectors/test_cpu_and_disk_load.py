"""Troubles of a computer that has too much to do: who toils, what a process is seen to take, and a disk that takes no more."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from sitl.faults.injectors.base import InjectionContext
from sitl.faults.injectors.cpu_and_disk_load import (
    BusyProcesses,
    FileSizeLimitOfProcesses,
    ProcessUsageMonitor,
    resident_bytes,
    writes_of,
)
from sitl.faults.process_registry import ProcessRegistry

PATIENCE_S = 20.0
WRITER = """
import sys
for line in sys.stdin:
    try:
        with open(sys.argv[1], "ab", buffering=0) as file:
            file.write(bytes(int(line)))
        print("done", flush=True)
    except OSError as error:
        print(error.strerror, flush=True)
"""


def wait_for(condition: Callable[[], bool]) -> None:
    deadline_s, pause = time.monotonic() + PATIENCE_S, threading.Event()
    while not condition():
        assert time.monotonic() < deadline_s
        pause.wait(0.01)


def injection_context(folder: Path) -> InjectionContext:
    world: Any = None
    return InjectionContext(world, dice=None, registry=ProcessRegistry(folder), config=folder / "config.toml")  # type: ignore[arg-type]


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-c", WRITER, str(tmp_path / "written")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        ProcessRegistry(tmp_path).tell({"mission": process.pid, "pilot": process.pid}, [])
        yield process
        process.kill()


def written(writer: subprocess.Popen[str], count: int) -> str:
    assert writer.stdin is not None
    assert writer.stdout is not None
    writer.stdin.write(f"{count}\n")
    writer.stdin.flush()
    return writer.stdout.readline().strip()


def test_who_toils_is_gone_with_its_file_when_the_time_is_over(tmp_path: Path) -> None:
    at = injection_context(tmp_path)
    toil = BusyProcesses("import sys, time; open(sys.argv[1], 'w').close(); time.sleep(60)", 2, for_s=5.0)
    toil.begin(at)
    wait_for(lambda: {p.name for p in tmp_path.iterdir()} == {"toil-0", "toil-1"})
    toil.turn(at, 4.9)
    assert (tmp_path / "toil-0").exists()
    toil.turn(at, 5.0)
    assert list(tmp_path.iterdir()) == []
    toil.end(at)


def test_no_file_of_the_product_grows_beyond_the_limit(tmp_path: Path, writer: subprocess.Popen[str]) -> None:
    assert written(writer, 5000) == "done"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    FileSizeLimitOfProcesses(4096).begin(injection_context(tmp_path))
    assert written(writer, 1) == "File too large"
    assert (tmp_path / "written").stat().st_size == 5000
    assert resource.getrlimit(resource.RLIMIT_FSIZE) == before, "of the referee, who must write too"


def test_what_a_process_takes_is_noted(tmp_path: Path, writer: subprocess.Popen[str]) -> None:
    at, weighed = injection_context(tmp_path), ProcessUsageMonitor("pilot")
    assert written(writer, 10) == "done"
    weighed.begin(at)
    weighed.turn(at, 0.0)
    assert at.notes["writes"] == 0.0
    assert written(writer, 10) == "done"
    weighed.turn(at, 0.05)  # not yet
    assert at.notes["writes"] == 0.0
    weighed.turn(at, 0.1)
    assert at.notes["writes"] >= 2.0, "the file's, and its answer"
    assert 1.0 < at.notes["memory"] < 500.0


def test_a_process_that_is_gone_takes_nothing() -> None:
    assert resident_bytes(os.getpid()) > 0
    assert (resident_bytes(1 << 30), writes_of(1 << 30)) == (0, 0)
