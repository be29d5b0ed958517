"""`uav-recon start|hold|return|land|status` on the command line."""

from __future__ import annotations

import json as json_text
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from uav_recon.cli.exit_codes import exit_with
from uav_recon.errors import UserError

if TYPE_CHECKING:
    from uav_recon.operator.status import Status

T = TypeVar("T")

EXIT_NOBODY = 69
FLOWN = Path("/etc/uav_recon/config.toml")

ConfigOption = Annotated[
    Path, typer.Option("--config", metavar="FILE", readable=False, help="Config that names the pilot's socket.")
]
SocketOption = Annotated[
    Path | None,
    typer.Option("--socket", metavar="PATH", readable=False, help="The pilot's socket. Default: as in the config."),
]


def start(config: ConfigOption = FLOWN, socket: SocketOption = None) -> None:
    """Start the mission, or resume it after `hold`.

    The vehicle arms and takes off.

    Exit code 0: accepted; 1: refused (reason printed); 69: pilot not reachable.
    """
    exit_with(lambda: _order("start", config, socket))


def hold(config: ConfigOption = FLOWN, socket: SocketOption = None) -> None:
    """Hold position until start, return or land. Works without the mission process.

    Exit codes as for `start`.
    """
    exit_with(lambda: _order("hold", config, socket))


def go_home(config: ConfigOption = FLOWN, socket: SocketOption = None) -> None:
    """Fly home through known free space and land there. Needs the mission process.

    Exit codes as for `start`.
    """
    exit_with(lambda: _order("return", config, socket))


def land(config: ConfigOption = FLOWN, socket: SocketOption = None) -> None:
    """Land at the current position. Cannot be cancelled. Works without the mission process.

    Exit codes as for `start`.
    """
    exit_with(lambda: _order("land", config, socket))


def status(
    config: ConfigOption = FLOWN,
    socket: SocketOption = None,
    json: Annotated[bool, typer.Option("--json", help="Print one line of JSON.")] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Refresh every second until Ctrl-C. Also acts as the operator heartbeat.")
    ] = False,
) -> None:
    """Print the state of the flight, and why it waits.

    The state: pilot, mission, autopilot mode, battery, position and views. Each query counts as an operator heartbeat.

    Exit code 0: answered; 69: pilot not reachable.
    """
    exit_with(lambda: (_watch if watch else _status)(config, socket, json))


COMMANDS: dict[str, Callable[..., None]] = {"start": start, "hold": hold, "return": go_home, "land": land, "status": status}


def _order(word: str, config: Path, socket: Path | None) -> int:
    from uav_recon.operator.client import send_command

    answer = _reached(lambda: send_command(_path(config, socket), word))
    if not answer["ok"]:
        raise UserError(f"{word} refused: {answer['said']}")
    print(answer["said"])
    return 0


def _status(config: Path, socket: Path | None, as_json: bool) -> int:
    status = _reached(lambda: _asked(_path(config, socket)))
    print(_as_json(status) if as_json else "\n".join(status.lines()))
    return 0


def _watch(config: Path, socket: Path | None, as_json: bool) -> int:
    from uav_recon.app import operator_factory
    from uav_recon.operator.status_watch import LineOutput, TerminalOutput, in_a_line

    path, out = _path(config, socket), sys.stdout
    plain = as_json or not out.isatty()
    page = LineOutput(out, sys.stderr, _as_json if as_json else in_a_line) if plain else TerminalOutput(out)
    try:
        _reached(lambda: operator_factory.watch_status(lambda: _asked(path), page))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())  # otherwise the interpreter reports an error as it ends
    return 0


def _asked(path: Path) -> Status:
    """Return the pilot's status. Raises CallError, or UserError if the pilot refuses."""
    from uav_recon.operator.client import send_command
    from uav_recon.operator.status import Status

    answer = send_command(path, "status")
    if not answer["ok"]:
        raise UserError(f"status refused: {answer['said']}")
    return Status.from_json(answer["status"])


def _as_json(status: Status) -> str:
    return json_text.dumps(status.as_json())


def _path(config: Path, socket: Path | None) -> Path:
    from uav_recon.app import config_file, operator_factory

    return socket or operator_factory.operator_socket(config_file.load_config(config))


def _reached(work: Callable[[], T]) -> T:
    from uav_recon.operator.client import CallError

    try:
        return work()
    except CallError as error:
        raise UserError(str(error), EXIT_NOBODY) from None
