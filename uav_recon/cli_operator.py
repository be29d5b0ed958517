"""`uav-recon start|hold|return|land|status` on the command line."""

from __future__ import annotations

import json as text
from pathlib import Path
from typing import Annotated, Any

import typer

from uav_recon import run, run_desk
from uav_recon.cli_exit import exit_with

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
) -> None:
    """How the flight stands."""
    exit_with(lambda: _status(config, socket, json))


def _order(word: str, config: Path, socket: Path | None) -> int:
    answer = _call(word, config, socket)
    if not answer["ok"]:
        raise run.Failure(f"{word} refused: {answer['said']}")
    print(answer["said"])
    return 0


def _status(config: Path, socket: Path | None, as_json: bool) -> int:
    from uav_recon.operator.status import Status

    answer = _call("status", config, socket)
    if not answer["ok"]:
        raise run.Failure(f"status refused: {answer['said']}")
    print(text.dumps(answer["status"]) if as_json else "\n".join(Status.told(answer["status"]).lines()))
    return 0


def _call(word: str, config: Path, socket: Path | None) -> dict[str, Any]:
    from uav_recon.operator.call import CallError, call

    path = socket or run_desk.operator_socket(run.load_config(config))
    try:
        return call(path, word)
    except CallError as error:
        raise run.Failure(str(error), EXIT_NOBODY) from None
