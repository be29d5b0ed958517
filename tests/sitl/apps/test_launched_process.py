"""Processes of a flight in real time: command lines and order."""

from __future__ import annotations

import sys
from pathlib import Path

from sitl.apps.launched_process import flight_processes
from sitl.apps.sim_processes import STOP_ORDER


def test_simulator_and_product_are_started_in_order() -> None:
    launched = flight_processes(["sitl.apps.world_process", "/run/world.json"], Path("/f/config.toml"), Path("/f"))
    product, config, flight = [sys.executable, "-m", "uav_recon"], ["--config", "/f/config.toml"], ["--flight", "/f"]
    assert [(each.name, each.command) for each in launched] == [
        ("world", [sys.executable, "-m", "sitl.apps.world_process", "/run/world.json"]),
        ("pilot", [*product, "pilot", *config, *flight]),
        ("perception", [*product, "perception", *config]),
        ("mission", [*product, "mission", *config, *flight]),
    ]


def test_the_world_ends_last_and_perception_after_the_landing() -> None:
    assert STOP_ORDER == ("mission", "pilot", "perception", "world")
