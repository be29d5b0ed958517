"""Composition root of the operator's desk: where it stands, and what reaches the mission from it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from uav_recon import run
from uav_recon.channels import FileChannel
from uav_recon.config import Config
from uav_recon.operator.clerk import Clerk
from uav_recon.operator.desk import Desk, DeskError
from uav_recon.protocols import Channel, Clock
from uav_recon.types.operator import GivenOrder

if TYPE_CHECKING:  # the mission and the command line need no pilot
    from uav_recon.autopilot.pilot import Pilot


def operator_orders(folder: Path) -> Channel[GivenOrder]:
    """From the pilot, which hears the operator, to the mission. Raises Failure as file_wires does."""
    try:
        return FileChannel(folder / "operator.channel", GivenOrder)
    except OSError as error:
        raise run.Failure(f"runtime.folder {folder}: cannot be written ({error.strerror})", run.EXIT_CONFIG) from None


def operator_socket(config: Config) -> Path:
    """Where the pilot hears the operator."""
    return config.runtime.folder / config.runtime.operator


def make_desk(config: Config, wires: run.Wires, pilot: Pilot, clock: Clock) -> Desk:
    """Where the pilot hears the operator. Raises Failure if the socket cannot be opened."""
    orders = operator_orders(config.runtime.folder)
    clerk = Clerk(pilot, wires.vehicle, wires.intent, wires.progress, wires.odom, orders, clock)
    try:
        return Desk(operator_socket(config), clerk.serve, clock)
    except DeskError as error:
        raise run.Failure(f"runtime.operator: {error}", run.EXIT_CONFIG) from None
