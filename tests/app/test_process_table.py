"""Processes of a flight: their command lines and restarts. tests/systemd compares the table with the units."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from uav_recon.app.process_table import MISSION, PERCEPTION, PILOT, RECORDER, FlightProcess, ServiceProcess
from uav_recon.errors import EXIT_CONFIG, EXIT_FAILURE, EXIT_SECOND_COPY

CONFIG, FLIGHT = Path("/c.toml"), Path("/flight")


@pytest.mark.parametrize("process", [PILOT, MISSION, RECORDER], ids=lambda process: process.name)
def test_the_folder_of_the_flight_is_given_to_a_process_that_writes_there(process: FlightProcess) -> None:
    assert process.arguments(CONFIG, FLIGHT) == [process.name, "--config", "/c.toml", "--flight", "/flight"]
    assert process.arguments(CONFIG) == [process.name, "--config", "/c.toml"]


def test_perception_has_no_folder_of_a_flight() -> None:
    assert PERCEPTION.arguments(CONFIG, FLIGHT) == ["perception", "--config", "/c.toml"]


@pytest.mark.parametrize(
    ("service", "exit_code", "restarted"),
    [
        (PILOT, 0, True),
        (PILOT, EXIT_CONFIG, False),
        (PILOT, EXIT_SECOND_COPY, False),
        (PERCEPTION, 0, False),
        (PERCEPTION, EXIT_FAILURE, True),
        (MISSION, -signal.SIGKILL, True),
        (MISSION, EXIT_CONFIG, False),
    ],
)
def test_a_service_is_restarted_by_its_rule(service: ServiceProcess, exit_code: int, restarted: bool) -> None:
    assert service.is_restarted(exit_code) is restarted
