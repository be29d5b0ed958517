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


def room(
    size: Annotated[
        str, typer.Argument(metavar="LxWxH", help="Length, width and height of the room in metres, such as 4x3x2.5.")
    ],
    mount: Annotated[
        str | None,
        typer.Option(metavar="fixed:DEG|gimbal", help="Camera mount. Default: that of the config, else a tilt of 15° down."),
    ] = None,
    clearance: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            max=2.0,
            metavar="M",
            help="Distance of the body's centre from walls and ceiling. Default: planner.clearance_m.",
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", readable=False, help="Config with the camera and the clearance.")
    ] = None,
) -> None:
    """Check which share of a room the camera can see, and which tilt shows most.

    The room is an empty box, and the vehicle flies in it over furniture. Shares are of the surface that a gimbal would see.

    Exit code 0: the mount fits; 1: another tilt is recommended; 2: bad size or option.
    """
    from uav_recon.app import room_check

    exit_with(lambda: room_check.check_room(size, config, mount, clearance))


ROOM_EXAMPLES = ("uav-recon check room 3.5x2.5x2.4", "uav-recon check room 4x3x2.5 --config config.toml --mount fixed:0")
CAMERA_EXAMPLES = ("uav-recon check camera", "uav-recon check camera /run/uav_recon/camera.stream --seconds 10")
REALSENSE_EXAMPLES = ("uav-recon check realsense", "uav-recon check realsense --serial 146322070000")
check = new_group("Check a camera, or how well it fits a room, before a flight.")
add(check, camera, "camera", examples=CAMERA_EXAMPLES)
add(check, realsense, "realsense", examples=REALSENSE_EXAMPLES)
add(check, room, "room", examples=ROOM_EXAMPLES)
