"""Troubles of real processes, and their supervisor, with short programs in place of the product's."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from sitl.apps.launched_process import LaunchedProcess
from sitl.faults.flights.fault_flight_real_time import Supervised
from sitl.faults.injectors.base import InjectionContext
from sitl.faults.injectors.process_signals import ProcessKilled, ProcessStopped, ProcessTerminated
from sitl.faults.process_registry import Exit, ProcessRegistry, child_of
from uav_recon.errors import UserError

PATIENCE_S = 20.0
SLEEPER = "import signal, sys; signal.signal(signal.SIGTERM, lambda *_: sys.exit(7)); print(flush=True); signal.pause()"


def wait_for(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    pause = threading.Event()
    while not condition():
        assert time.monotonic() < deadline_s
        pause.wait(0.01)


def state_of(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


@pytest.fixture
def sleeper() -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, "-c", SLEEPER, "a-mark"], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def injection_context(registry: ProcessRegistry, armed: bool = True) -> InjectionContext:
    world: Any = SimpleNamespace(flyer=SimpleNamespace(truth=lambda: SimpleNamespace(armed=armed)))
    return InjectionContext(world, dice=None, registry=registry)  # type: ignore[arg-type]


def test_the_registry_is_empty_at_first_and_repeats_what_it_was_told(tmp_path: Path) -> None:
    registry = ProcessRegistry(tmp_path)
    assert registry.pid("pilot") is None
    assert registry.exits() == []
    assert registry.blocked_restarts() == frozenset()
    registry.tell({"pilot": 12}, [Exit("mission", -9, 3.5)])
    registry.block_restart(("mission",))
    assert ProcessRegistry(tmp_path).pid("pilot") == 12
    assert ProcessRegistry(tmp_path).exits() == [Exit("mission", -9, 3.5)]
    assert ProcessRegistry(tmp_path).blocked_restarts() == {"mission"}


def test_a_stopped_process_goes_on_after_its_time(tmp_path: Path, sleeper: subprocess.Popen[bytes]) -> None:
    registry = ProcessRegistry(tmp_path)
    registry.tell({"mission": sleeper.pid}, [])
    injector, at = ProcessStopped("mission", for_s=5.0), injection_context(registry)
    injector.begin(at)
    wait_for(lambda: state_of(sleeper.pid) == "T")
    injector.turn(at, 4.9)
    assert state_of(sleeper.pid) == "T"
    injector.turn(at, 5.0)
    wait_for(lambda: state_of(sleeper.pid) == "S")


def test_a_killed_process_is_kept_down_for_its_time(tmp_path: Path, sleeper: subprocess.Popen[bytes]) -> None:
    registry = ProcessRegistry(tmp_path)
    registry.tell({"mission": sleeper.pid}, [])
    injector, at = ProcessKilled("mission", "pilot", for_s=2.0), injection_context(registry)
    injector.begin(at)
    assert sleeper.wait(PATIENCE_S) == -signal.SIGKILL
    injector.turn(at, 1.9)
    assert registry.blocked_restarts() == {"mission", "pilot"}
    injector.turn(at, 2.0)
    assert registry.blocked_restarts() == frozenset()


def test_how_a_process_ends_that_was_asked_to_is_noted(tmp_path: Path, sleeper: subprocess.Popen[bytes]) -> None:
    registry = ProcessRegistry(tmp_path)
    registry.tell({"pilot": sleeper.pid}, [])
    injector, at = ProcessTerminated("pilot"), injection_context(registry)
    injector.begin(at)
    assert sleeper.wait(PATIENCE_S) == 7
    injector.turn(at, 0.1)
    assert at.notes == {}
    registry.tell({}, [Exit("pilot", 7, 1.0)])
    injector.turn(at, 0.2)
    assert at.notes == {"exit code": 7.0, "ended armed": 1.0}


def test_a_child_is_found_by_its_word(sleeper: subprocess.Popen[bytes]) -> None:
    assert child_of(os.getpid(), "a-mark") == sleeper.pid
    assert child_of(os.getpid(), "another-mark") is None
    assert child_of(None, "a-mark") is None


def test_what_ends_is_started_again_as_the_units_have_it(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()

    def note(name: str, code: int) -> list[str]:
        program = f"import sys; open({str(tmp_path / name)!r}, 'a').write('x'); sys.exit({code})"
        return [sys.executable, "-c", program]

    world = (
        "import json, pathlib, sys, time\n"
        f"runs = pathlib.Path({str(tmp_path / 'pilot')!r})\n"
        "while not (runs.exists() and len(runs.read_text()) >= 3): time.sleep(0.01)\n"
    )
    launched = [
        LaunchedProcess("world", [sys.executable, "-c", world], 0, 1.0),
        LaunchedProcess("pilot", note("pilot", 0), 0, 1.0),  # always again
        LaunchedProcess("perception", note("perception", 78), 0, 1.0),  # a config that is none stays none
        LaunchedProcess("mission", note("mission", 0), 0, 1.0),  # it has done its work
    ]
    Supervised(launched, tmp_path / "logs", tmp_path).watch()
    assert len((tmp_path / "pilot").read_text()) >= 3
    assert len((tmp_path / "perception").read_text()) == 1
    assert len((tmp_path / "mission").read_text()) == 1
    ended = ProcessRegistry(tmp_path).exits()
    assert {(e.name, e.code) for e in ended} == {("pilot", 0), ("perception", 78), ("mission", 0)}


def test_a_world_that_dies_is_told(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    world = LaunchedProcess("world", [sys.executable, "-c", "import sys; sys.exit('no such arena')"], 0, 1.0)
    with pytest.raises(UserError, match="world died: no such arena"):
        Supervised([world], tmp_path / "logs", tmp_path).watch()
