"""`uav-recon params ...` on the command line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from uav_recon.cli import choices
from uav_recon.cli.commands import add, new_group
from uav_recon.cli.exit_codes import exit_with

ConfigOption = Annotated[
    Path,
    typer.Option(
        "--config", metavar="FILE", readable=False, help="Config that gives autopilot, link and file where no option does."
    ),
]
AutopilotOption = Annotated[
    str | None,
    typer.Option(
        metavar=choices.listed(choices.AUTOPILOTS), autocompletion=choices.one_of(choices.AUTOPILOTS),
        help="Firmware of the vehicle. Default: as in the config.",
    ),
]  # fmt: skip
LinkOption = Annotated[
    str | None,
    typer.Option(
        metavar="URL", help="udp:HOST:PORT (listens there) or serial:DEVICE:BAUD. Default: as in the config."
    ),
]  # fmt: skip
FileOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", readable=False,
        help="Parameter file: .params (QGroundControl) or .param (Mission Planner). Default: the file in firmware_params/.",
    ),
]  # fmt: skip
OwnNavigationOption = Annotated[
    bool,
    typer.Option(
        "--own-navigation",
        help="The autopilot navigates by itself: leave out the parameters of the pose feed. Default: as in the config, "
        "localization.source.",
    ),
]
FlowOption = Annotated[
    bool,
    typer.Option(
        "--flow",
        help="The vehicle has an optical flow sensor and a range finder that look down: add their parameters. Default: as in "
        "the config, flow.enabled.",
    ),
]
FLOWN = Path("/etc/uav_recon/config.toml")


def check(
    autopilot: AutopilotOption = None,
    link: LinkOption = None,
    file: FileOption = None,
    config: ConfigOption = FLOWN,
    own_navigation: OwnNavigationOption = False,
    flow: FlowOption = False,
) -> None:
    """Show every required parameter beside the vehicle's value.

    Reads from the vehicle; writes nothing. Stop the pilot first: it uses the same link.

    Exit code 0: all equal; 1: some differ; 69: no answer; 78: bad input.
    """
    from uav_recon.app import parameter_tool as parameters

    exit_with(lambda: parameters.check(parameters.ParamsOptions.of(autopilot, link, file, config, own_navigation, flow), True))


def diff(
    autopilot: AutopilotOption = None,
    link: LinkOption = None,
    file: FileOption = None,
    config: ConfigOption = FLOWN,
    own_navigation: OwnNavigationOption = False,
    flow: FlowOption = False,
) -> None:
    """Show only differing parameters.

    Mark `!`: this difference blocks arming. Mark `~`: it does not. Exit codes as for `check`.
    """
    from uav_recon.app import parameter_tool as parameters

    exit_with(lambda: parameters.check(parameters.ParamsOptions.of(autopilot, link, file, config, own_navigation, flow), False))


def write(
    autopilot: AutopilotOption = None,
    link: LinkOption = None,
    file: FileOption = None,
    config: ConfigOption = FLOWN,
    own_navigation: OwnNavigationOption = False,
    flow: FlowOption = False,
    yes: Annotated[bool, typer.Option("--yes", help="Write without asking.")] = False,
) -> None:
    """Write the differing parameters after a confirmation, and read them back.

    Never writes while the motors are armed. Prints whether a reboot is needed. Exit codes as for `check`.
    """
    from uav_recon.app import parameter_tool as parameters

    def confirm(question: str) -> bool:
        if not yes and not sys.stdin.isatty():
            print("uav-recon: no terminal to confirm on: use --yes to write without confirmation", file=sys.stderr)
            return False
        return yes or typer.confirm(question)

    exit_with(
        lambda: parameters.write(parameters.ParamsOptions.of(autopilot, link, file, config, own_navigation, flow), confirm)
    )


params = new_group("Compare the vehicle's parameters with the required ones, and write them.")
_LINKED = "--autopilot px4 --link serial:/dev/ttyACM0:921600"
add(params, check, "check", examples=("uav-recon params check", f"uav-recon params check {_LINKED}"))
add(params, diff, "diff", examples=(f"uav-recon params diff {_LINKED}",))
add(params, write, "write", examples=(f"uav-recon params write {_LINKED}",))
