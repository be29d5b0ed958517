"""Launcher of a real-time flight, with short stub programs.

They replace world, pilot, perception and mission.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from uav_recon.app.flight_channels import PILOT_WRITES, file_channels
from uav_recon.types.pose import Pose
from uav_recon.types.vehicle import FlightPhase, VehicleState

PATIENCE_S = 30.0

# Reports its own and its child's process id, and ignores SIGTERM and SIGINT.
STUBBORN = """
    import os, signal, subprocess, sys
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    child = subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE)
    os.write(int(sys.argv[1]), f"{os.getpid()} {child.pid}\\n".encode())
    child.wait()
"""

# Like the mission, it ends in order on SIGTERM.
ORDERLY = """
    import os, signal, sys
    def end(number, frame):
        os.write(int(sys.argv[1]), b"landed\\n")
        sys.exit(0)
    signal.signal(signal.SIGTERM, end)
    os.write(int(sys.argv[1]), f"{os.getpid()}\\n".encode())
    while True:
        signal.pause()
"""

LAUNCHER = """
    import sys
    from pathlib import Path
    from rich.console import Console
    from sitl.apps.launched_process import LaunchedProcess
    from sitl.apps.sim_processes import SimProcesses
    from sitl.runtime.die_with_parent import die_with_parent_command
    from uav_recon.errors import UserError

    def through(command):  # the launcher keeps no pipe open but these programs tell us of themselves
        return ["/bin/sh", "-c", 'exec "$@" ' + sys.argv[2] + '> ' + sys.argv[3], "sh", *command, sys.argv[2]]

    folder, stubborn, orderly = Path(sys.argv[1]), sys.argv[4], sys.argv[5]
    rows = [(name, stubborn, 0.2) for name in ("world", "pilot", "perception")] + [("mission", orderly, 30.0)]
    launched = [LaunchedProcess(name, through([sys.executable, "-c", text]), 0, stop_s) for name, text, stop_s in rows]
    try:
        fault = SimProcesses(launched, folder, folder, Console()).fly()
    except UserError as failure:
        print(failure)
        sys.exit(failure.code)
    print(f"fault: {fault}")
"""


class Flight:
    """Launcher with its four children running."""

    def __init__(self, folder: Path) -> None:
        fifo = folder / "words"
        os.mkfifo(fifo)
        self._words = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
        sources = [textwrap.dedent(source) for source in (LAUNCHER, STUBBORN, ORDERLY)]
        self.process = subprocess.Popen(
            [sys.executable, "-c", sources[0], str(folder), "9", str(fifo), *sources[1:]], stdout=subprocess.PIPE, text=True
        )
        self._heard = ""
        self.pids = {int(pid) for line in self.lines(4) for pid in line.split()}
        assert len(self.pids) == 7

    def lines(self, count: int) -> list[str]:
        """Return the children's output, once it has count lines."""
        while self._heard.count("\n") < count:
            assert select.select([self._words], [], [], PATIENCE_S)[0], self._heard
            self._heard += os.read(self._words, 4096).decode()
        return self._heard.splitlines()

    def end(self) -> str:
        return self.process.communicate(timeout=PATIENCE_S)[0]

    def left(self) -> set[int]:
        """Return the children that do not end."""
        return {pid for pid in self.pids if not _ends(pid)}

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()
        for pid in filter(_alive, self.pids):
            os.kill(pid, signal.SIGKILL)
        os.close(self._words)


def _ends(pid: int) -> bool:
    try:
        process = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([process], [], [], PATIENCE_S)[0])
    finally:
        os.close(process)


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture()
def launch(tmp_path: Path) -> Iterator[Callable[[], Flight]]:
    flights: list[Flight] = []

    def start() -> Flight:
        flights.append(Flight(tmp_path))
        return flights[-1]

    yield start
    for flight in flights:
        flight.close()


def say(folder: Path, phase: FlightPhase) -> None:
    """Publish a vehicle state as the pilot does."""
    state = VehicleState(1.0, Pose.identity(), np.zeros(3), True, "OFFBOARD", phase, 0.9, False, float("nan"), -1, 0, None)
    file_channels(folder, PILOT_WRITES).vehicle.publish(state)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_before_the_take_off_a_signal_ends_everything(launch: Callable[[], Flight], number: signal.Signals) -> None:
    flight = launch()
    flight.process.send_signal(number)
    assert flight.end().splitlines()[-1] == "interrupted before take-off; nothing was flown"
    assert flight.process.returncode == 130
    assert flight.left() == set()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_in_flight_a_signal_lands_and_then_ends_everything(
    launch: Callable[[], Flight], tmp_path: Path, number: signal.Signals
) -> None:
    say(tmp_path, FlightPhase.FLYING)
    flight = launch()
    flight.process.send_signal(number)
    said = flight.end()
    assert "landing, then writing the report; press Ctrl-C again" in said
    assert said.splitlines()[-1] == "fault: None"
    assert flight.lines(5)[4] == "landed"
    assert flight.left() == set()


def test_a_killed_launcher_leaves_no_process(launch: Callable[[], Flight], tmp_path: Path) -> None:
    say(tmp_path, FlightPhase.FLYING)
    flight = launch()
    flight.process.kill()
    flight.end()
    assert flight.left() == set()


def test_a_program_without_its_parent_does_not_start() -> None:
    alone = subprocess.run(
        [sys.executable, "-m", "sitl.runtime.die_with_parent", "1", "echo", "here"], capture_output=True, check=False
    )
    assert (alone.returncode, alone.stdout) == (1, b"")
