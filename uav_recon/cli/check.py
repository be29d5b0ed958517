"""`uav-recon check ...`: check what surrounds the product before a flight."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uav_recon.cli.commands import add, new_group
from uav_recon.cli.exit_codes import exit_with
from uav_recon.cli.services import CONFIG, ConfigOption


def camera(
    stream: Annotated[
        Path | None,
        typer.Argument(metavar="[STREAM]", readable=False, help="Stream file. Default: camera.stream of the config."),
    ] = None,
    seconds: Annotated[float, typer.Option(help="Time to watch, 1 to 600 s.")] = 5.0,
    config: ConfigOption = CONFIG,
) -> None:
    """Check a running camera stream: header, rates, stamps, units, axes, poses.

    Hold the camera level and still. Prints one line per finding, with its value and the allowed range.

    Exit code 0: all findings are good; 1: one is wrong, or there is no stream; 78: bad config.
    """
    from uav_recon.app import camera_check

    exit_with(lambda: camera_check.check(stream, config, seconds))


check = new_group("Check a camera before a flight.")
EXAMPLES = ("uav-recon check camera", "uav-recon check camera /run/uav_recon/camera.stream --seconds 10")
add(check, camera, "camera", examples=EXAMPLES)
