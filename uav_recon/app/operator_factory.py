"""Composition root of the operator's desk: where it stands, and what reaches the mission from it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from uav_recon.app.flight_channels import Wires
from uav_recon.channels import FileChannel
from uav_recon.clock import MonotonicClock
from uav_recon.config import Config
from uav_recon.errors import EXIT_CONFIG, Failure
from uav_recon.interfaces import Channel, Clock
from uav_recon.operator.command_handler import Clerk
from uav_recon.operator.command_socket import Desk, DeskError
from uav_recon.operator.status import Status
from uav_recon.operator.status_watch import Page, watch
from uav_recon.types.operator_command import GivenOrder

if TYPE_CHECKING:  # the mission and the command line need no pilot
    from uav_recon.autopilot.pilot.pilot import Pilot


def operator_orders(folder: Path) -> Channel[GivenOrder]:
    """From the pilot, which hears the operator, to the mission. Raises Failure as file_wires does."""
    try:
        return FileChannel(folder / "operator.channel", GivenOrder)
    except OSError as error:
        raise Failure(f"runtime.folder {folder}: cannot be written ({error.strerror})", EXIT_CONFIG) from None


def operator_socket(config: Config) -> Path:
    """Where the pilot hears the operator."""
    return config.runtime.folder / config.runtime.operator


def make_clerk(wires: Wires, pilot: Pilot, orders: Channel[GivenOrder], clock: Clock) -> Clerk:
    """Who answers the operator."""
    return Clerk(pilot, wires.vehicle, wires.intent, wires.progress, wires.odom, orders, clock)


def make_desk(config: Config, wires: Wires, pilot: Pilot, clock: Clock) -> Desk:
    """Where the pilot hears the operator. Raises Failure if the socket cannot be opened."""
    clerk = make_clerk(wires, pilot, operator_orders(config.runtime.folder), clock)
    try:
        return Desk(operator_socket(config), clerk.serve, clock)
    except DeskError as error:
        raise Failure(f"runtime.operator: {error}", EXIT_CONFIG) from None


def watch_status(ask: Callable[[], Status], page: Page) -> None:
    """Once a second by the clock of this machine. Raises CallError once nobody answers any more, whatever else ask raises."""
    watch(ask, page, MonotonicClock())
