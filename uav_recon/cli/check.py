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


def realsense(
    serial: Annotated[
        str | None, typer.Option(metavar="NUMBER", help="Serial number of the camera. Default: the first one found.")
    ] = None,
) -> None:
    """Show what a connected RealSense camera is, offers and does, and what is wrong with it.

    It prints device, firmware, USB, profiles, chosen streams, frames, stamp clocks and IMU, then one line `!` with the remedy
    for each thing that is wrong. It listens for four seconds. Stop perception first: it uses the same camera.

    Exit code 0: nothing wrong; 1: something wrong, or no camera.
    """
    from uav_recon.app.realsense_check import check_realsense

    exit_with(lambda: check_realsense(serial=serial))


CAMERA_EXAMPLES = ("uav-recon check camera", "uav-recon check camera /run/uav_recon/camera.stream --seconds 10")
REALSENSE_EXAMPLES = ("uav-recon check realsense", "uav-recon check realsense --serial 146322070000")
check = new_group("Check a camera before a flight.")
add(check, camera, "camera", examples=CAMERA_EXAMPLES)
add(check, realsense, "realsense", examples=REALSENSE_EXAMPLES)
