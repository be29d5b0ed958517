"""One flight of the fault campaign in real time.

The product's own processes run and are supervised as by their services.
"""

from __future__ import annotations

import pickle
import socket
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from sitl.apps.flight_config import flight_config, world_options
from sitl.apps.launched_process import WORLD, LaunchedProcess, flight_processes
from sitl.apps.sim_options import SimOptions
from sitl.apps.sim_processes import SimProcesses
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.flights.scenario_world_process import WorldProcessOptions
from sitl.faults.injectors.base import Capabilities
from sitl.faults.process_registry import Exit, ProcessRegistry
from sitl.faults.table.arenas import arena
from sitl.faults.table.scenario import Scenario
from uav_recon import config as product_config
from uav_recon.app.process_table import SERVICES
from uav_recon.errors import UserError

_LOOK_S = 0.02


class Supervised(SimProcesses):
    """World and product processes, until the world process ends.

    A process that ends earlier is restarted as its systemd unit restarts it.
    """

    def __init__(self, launched: Sequence[LaunchedProcess], logs: Path, runtime: Path) -> None:
        super().__init__(launched, logs, runtime, Console(quiet=True))
        self._services = {service.name: service for service in SERVICES}
        self._registry = ProcessRegistry(runtime)
        self._exits = list[Exit]()
        self._pids: dict[str, int] = {}
        self._due_s: dict[str, float] = {}  # when to restart a process that ended

    def watch(self) -> None:
        """Fly. Raises UserError if the world process fails."""
        try:
            for name in self._launched:
                self.start(name)
                self._pids[name] = self._child(name).process.pid
            self._registry.tell(self._pids, self._exits)
            while self._child(WORLD).runs:
                self._collect_exits()
                self._restart_due()
                time.sleep(_LOOK_S)
            world = self._child(WORLD)
            if world.process.returncode != 0:
                raise UserError(f"world died: {world.end_reason()}")
        finally:
            self._end_all()

    def _collect_exits(self) -> None:
        for child in [c for c in self._children if not c.runs and c.name != WORLD]:
            code = int(child.process.returncode)
            self._children.remove(child)
            self._exits.append(Exit(child.name, code, time.monotonic()))
            self._pids.pop(child.name, None)
            service = self._services[child.name]
            if service.is_restarted(code):
                self._due_s[child.name] = time.monotonic() + service.restart_delay_s
            self._registry.tell(self._pids, self._exits)

    def _restart_due(self) -> None:
        kept_down = self._registry.blocked_restarts() if self._due_s else frozenset[str]()
        for name, due_s in list(self._due_s.items()):
            if name not in kept_down and time.monotonic() >= due_s:
                del self._due_s[name]
                self.start(name)
                self._pids[name] = self._child(name).process.pid
                self._registry.tell(self._pids, self._exits)


def flight_in_real_time(
    scenario: Scenario, options: SimOptions, runtime: Path, number: int, firmware: Path | None = None
) -> FlightEvidence:
    """Fly the fault of a scenario with real processes.

    options: its folder exists. firmware: a real firmware in place of the simulated autopilot. Raises UserError.
    """
    config, line = flight_config(options, arena(scenario.arena, options.radius_m), runtime), None
    if Capabilities.SERIAL_LINE in scenario.needs(number, live=True):
        line = str(runtime / "autopilot")
        link = config.link.model_copy(update={"url": f"serial:{line}:921600"})
        config = config.model_copy(update={"link": link})
    product_config.save(config, options.folder / "config.toml")
    world_options(options, runtime).save(runtime / "world.json")
    order = runtime / "order.json"
    binary = None if firmware is None else str(firmware)
    WorldProcessOptions(
        str(runtime / "world.json"), scenario.id, number, str(options.folder / "config.toml"), binary, line
    ).save(order)
    world = ["sitl.faults.flights.scenario_world_process", str(order)]
    launched = flight_processes(world, options.folder / "config.toml", options.folder)
    Supervised(launched, options.folder / "logs", runtime).watch()
    evidence: FlightEvidence = pickle.loads(order.with_suffix(".evidence").read_bytes())  # noqa: S301 - our own world wrote it
    return evidence


def free_port() -> int:
    """Return a free UDP port of the loopback interface."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
