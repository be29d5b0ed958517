"""`uav-recon start|hold|return|land|status` on the command line."""

from __future__ import annotations

import json as json_text
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from uav_recon.app import factory, operator_factory
from uav_recon.cli.exit_codes import exit_with
from uav_recon.errors import UserError
from uav_recon.operator.client import CallError, send_command
from uav_recon.operator.status import Status
from uav_recon.operator.status_watch import Block, Lines, in_a_line

T = TypeVar("T")

EXIT_NOBODY, FLOWN = 69, Path("/etc/uav_recon/config.toml")

ConfigOption = Annotated[Path, typer.Option("--config", readable=False, help="What says where the pilot listens.")]
SocketOption = Annotated[
    Path | None, typer.Option("--socket", readable=False, help="Where the pilot listens. Default: as the config says.")
]


def register(app: typer.Typer) -> None:
    """Add the five commands."""
    for name, command in (("start", start), ("hold", hold), ("return", go_home), ("land", land), ("status", status)):
        app.command(name, rich_help_panel="In flight")(command)


def start(config: ConfigOption = FLOWN, socket: SocketOption = None) -> None:
    """Take off and begin; held in the air, go on. Exit code 0: done so; 1: refused, with the reason; 69: no pilot."""
    exit_with(lambda: _order("start", config, socket))


def hold(config: ConfigOption = FLOWN, socket: SocketOption = None) -> None:
    """Stay where it is, until start, return or land. Works while the mission is dead."""
    exit_with(lambda: _order("hold", config, socket))


def go_home(config: ConfigOption = FLOWN, socket: SocketOption = None) -> None:
    """Fly home through known space and land there. Needs the mission."""
    exit_with(lambda: _order("return", config, socket))


def land(config: ConfigOption = FLOWN, socket: SocketOption = None) -> None:
    """Land here, now; not taken back. Works while the mission is dead."""
    exit_with(lambda: _order("land", config, socket))


def status(
    config: ConfigOption = FLOWN,
    socket: SocketOption = None,
    json: Annotated[bool, typer.Option("--json", help="One line of JSON.")] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Again every second until Ctrl-C: the operator attends.")] = False,
) -> None:
    """How the flight stands."""
    exit_with(lambda: (_watch if watch else _status)(config, socket, json))


def _order(word: str, config: Path, socket: Path | None) -> int:
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
    path, out = _path(config, socket), sys.stdout
    plain = as_json or not out.isatty()
    page = Lines(out, sys.stderr, _as_json if as_json else in_a_line) if plain else Block(out)
    try:
        _reached(lambda: operator_factory.watch_status(lambda: _asked(path), page))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())  # or the interpreter complains as it ends
    return 0


def _asked(path: Path) -> Status:
    """Raises CallError, or Failure where the answer is none."""
    answer = send_command(path, "status")
    if not answer["ok"]:
        raise UserError(f"status refused: {answer['said']}")
    return Status.told(answer["status"])


def _as_json(status: Status) -> str:
    return json_text.dumps(status.as_json())


def _path(config: Path, socket: Path | None) -> Path:
    return socket or operator_factory.operator_socket(factory.load_config(config))


def _reached(work: Callable[[], T]) -> T:
    try:
        return work()
    except CallError as error:
        raise UserError(str(error), EXIT_NOBODY) from None
