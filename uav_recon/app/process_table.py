"""The processes of a flight: command, priority, restart and stop of each.

The units of systemd/ repeat these numbers, and tests/systemd compares them. The simulator starts the processes by this table.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from uav_recon.errors import EXIT_CONFIG, EXIT_SECOND_COPY

NO_RESTART_EXIT_CODES = (EXIT_SECOND_COPY, EXIT_CONFIG)  # RestartPreventExitStatus= of all units: a restart solves neither


class Restart(Enum):
    """Rule for the restart of a service: Restart= of its unit."""

    ALWAYS = "always"
    ON_FAILURE = "on-failure"


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightProcess:
    """A process of a flight.

    name: its command of `uav-recon`. has_flight_option: that command takes --flight. niceness: added to that of the process
    that starts it. stop_timeout_s: from SIGTERM to SIGKILL.
    """

    name: str
    has_flight_option: bool
    niceness: int
    stop_timeout_s: float

    def arguments(self, config: Path, flight: Path | None = None) -> list[str]:
        """Return the arguments of `uav-recon` that start this process.

        flight: folder of the flight, None: a new one with the date in its name.
        """
        folder = ["--flight", str(flight)] if flight is not None and self.has_flight_option else []
        return [self.name, "--config", str(config), *folder]


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceProcess(FlightProcess):
    """A process with a systemd unit.

    restart_delay_s: from its end to its restart. watchdog_s: longest time between two steps of its loop. fifo_priority:
    real-time priority, None: none. Where it is not permitted, the niceness replaces it.
    """

    restart: Restart
    restart_delay_s: float
    watchdog_s: float
    fifo_priority: int | None = None

    def is_restarted(self, exit_code: int) -> bool:
        """Return True if the process is restarted after this exit code.

        A signal is its negative number.
        """
        return exit_code not in NO_RESTART_EXIT_CODES and (self.restart is Restart.ALWAYS or exit_code != 0)


PILOT = ServiceProcess(
    name="pilot",
    has_flight_option=True,
    niceness=-10,
    fifo_priority=50,
    restart=Restart.ALWAYS,
    restart_delay_s=0.2,
    watchdog_s=1.0,
    stop_timeout_s=90.0,
)
PERCEPTION = ServiceProcess(
    name="perception",
    has_flight_option=False,
    niceness=-10,
    restart=Restart.ON_FAILURE,
    restart_delay_s=0.5,
    watchdog_s=3.0,
    stop_timeout_s=5.0,
)
MISSION = ServiceProcess(
    name="mission",
    has_flight_option=True,
    niceness=10,
    restart=Restart.ON_FAILURE,
    restart_delay_s=1.0,
    watchdog_s=5.0,
    stop_timeout_s=300.0,
)
RECORDER = FlightProcess(name="recorder", has_flight_option=True, niceness=10, stop_timeout_s=20.0)  # child of the mission

SERVICES = (PILOT, PERCEPTION, MISSION)  # in the order of their start
STOP_ORDER = (MISSION, PILOT, PERCEPTION)  # the mission lands and saves; the pilot lands by the poses of perception
