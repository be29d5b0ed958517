"""Composition root of the command socket: its path, and the channel to the mission."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from uav_recon.app.flight_channels import FlightChannels, made_writable
from uav_recon.channels import FileChannel, ReadOnlyFileChannel, create_file
from uav_recon.clock import MonotonicClock
from uav_recon.config import Config
from uav_recon.errors import EXIT_CONFIG, UserError
from uav_recon.interfaces import Channel, Clock
from uav_recon.operator.command_handler import CommandHandler
from uav_recon.operator.command_socket import CommandSocket, CommandSocketError
from uav_recon.operator.status import Status
from uav_recon.operator.status_watch import Page, watch
from uav_recon.types.operator_command import GivenCommand

if TYPE_CHECKING:  # the mission and the command line need no pilot
    from uav_recon.autopilot.pilot.pilot import Pilot


def operator_command_sender(folder: Path) -> Channel[GivenCommand]:
    """Return the channel of commands to the mission, for the pilot.

    The pilot receives them from operators. Raises UserError like file_channels.
    """
    return _operator_channel(folder, FileChannel)


def operator_command_receiver(folder: Path) -> Channel[GivenCommand]:
    """Return the channel of commands to the mission, for the mission.

    Raises UserError like file_channels.
    """
    return _operator_channel(folder, ReadOnlyFileChannel)


def _operator_channel(
    folder: Path, variant: type[FileChannel[GivenCommand] | ReadOnlyFileChannel[GivenCommand]]
) -> Channel[GivenCommand]:
    path = folder / "operator.channel"
    with made_writable(folder):
        create_file(path)
        return variant(path, GivenCommand)


def operator_socket(config: Config) -> Path:
    """Return the path of the command socket at the pilot."""
    return config.runtime.folder / config.runtime.operator


def make_command_handler(
    channels: FlightChannels, pilot: Pilot, commands: Channel[GivenCommand], clock: Clock
) -> CommandHandler:
    """Return the handler of the operator's commands."""
    return CommandHandler(pilot, channels, commands, clock)


def make_command_socket(config: Config, channels: FlightChannels, pilot: Pilot, clock: Clock) -> CommandSocket:
    """Open the command socket at the pilot. Raises UserError if it cannot be opened."""
    handler = make_command_handler(channels, pilot, operator_command_sender(config.runtime.folder), clock)
    try:
        return CommandSocket(operator_socket(config), handler.serve, clock)
    except CommandSocketError as error:
        raise UserError(f"runtime.operator: {error}", EXIT_CONFIG) from None


def watch_status(ask: Callable[[], Status], page: Page) -> None:
    """Ask once a second by this machine's clock.

    Raises CallError when answers no longer come, and any other exception of ask.
    """
    watch(ask, page, MonotonicClock())
