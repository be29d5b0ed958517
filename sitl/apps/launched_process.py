"""Processes of a flight in real time: those of the product, and the world process."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from uav_recon.app.process_table import SERVICES, FlightProcess

WORLD = "world"
WORLD_NICENESS = -5  # simulator and receiver of setpoints
_WORLD_STOP_S = 20.0  # to save the truth


@dataclass(frozen=True, slots=True)
class LaunchedProcess:
    """A process and its command line.

    niceness: set at its start, if permitted. stop_timeout_s: from SIGTERM to SIGKILL.
    """

    name: str
    command: list[str]
    niceness: int
    stop_timeout_s: float


def flight_processes(world: list[str], config: Path, flight: Path) -> list[LaunchedProcess]:
    """Return simulator and unmodified product, in the order of their start.

    world: module of the world process, and its arguments. flight: folder of the flight.
    """
    started = LaunchedProcess(WORLD, [sys.executable, "-m", *world], WORLD_NICENESS, _WORLD_STOP_S)
    return [started, *(_launched(process, config, flight) for process in SERVICES)]


def _launched(process: FlightProcess, config: Path, flight: Path) -> LaunchedProcess:
    command = [sys.executable, "-m", "uav_recon", *process.arguments(config, flight)]
    return LaunchedProcess(process.name, command, process.niceness, process.stop_timeout_s)
