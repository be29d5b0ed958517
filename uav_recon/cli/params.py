"""`uav-recon params ...` on the command line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from uav_recon.cli.exit_codes import exit_with

params = typer.Typer(no_args_is_help=True, help="The vehicle's parameters: read back, compared with a file, written.")

ConfigOption = Annotated[
    Path, typer.Option("--config", readable=False, help="What says autopilot, link and file, where they are not given here.")
]
AutopilotOption = Annotated[str | None, typer.Option(help="Firmware personality: px4 or ardupilot.")]
LinkOption = Annotated[str | None, typer.Option(help="udp:HOST:PORT (listens there) or serial:DEVICE:BAUD.")]
FileOption = Annotated[
    Path | None,
    typer.Option(
        readable=False, help=".params of QGroundControl, .param of Mission Planner. Default: that of firmware_params/."
    ),
]
FLOWN = Path("/etc/uav_recon/config.toml")


@params.command()
def check(
    autopilot: AutopilotOption = None, link: LinkOption = None, file: FileOption = None, config: ConfigOption = FLOWN
) -> None:
    """Every parameter beside the vehicle's. Exit code 0: all as wanted; 1: some differ; 69: no answer; 78: bad input."""
    from uav_recon.app import parameter_tool as parameters

    exit_with(lambda: parameters.check(parameters.ParamsOptions.of(autopilot, link, file, config), every_row=True))


@params.command()
def diff(
    autopilot: AutopilotOption = None, link: LinkOption = None, file: FileOption = None, config: ConfigOption = FLOWN
) -> None:
    """Only what differs; exit codes as of check. `!` keeps the vehicle from being armed, `~` does not."""
    from uav_recon.app import parameter_tool as parameters

    exit_with(lambda: parameters.check(parameters.ParamsOptions.of(autopilot, link, file, config), every_row=False))


@params.command()
def write(
    autopilot: AutopilotOption = None,
    link: LinkOption = None,
    file: FileOption = None,
    config: ConfigOption = FLOWN,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
) -> None:
    """Write what differs, after a question, and read it back; never while armed. Says whether a reboot is needed."""
    from uav_recon.app import parameter_tool as parameters

    def confirm(question: str) -> bool:
        if not yes and not sys.stdin.isatty():
            print("uav-recon: nobody can be asked here: --yes writes without a question", file=sys.stderr)
            return False
        return yes or typer.confirm(question)

    exit_with(lambda: parameters.write(parameters.ParamsOptions.of(autopilot, link, file, config), confirm))
