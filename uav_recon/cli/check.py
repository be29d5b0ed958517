"""`uav-recon check ...` on the command line."""

from __future__ import annotations

from typing import Annotated

import typer

from uav_recon.cli.commands import add, new_group
from uav_recon.cli.exit_codes import exit_with


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


check = new_group("Check what is connected to the companion.")
add(check, realsense, "realsense", examples=("uav-recon check realsense", "uav-recon check realsense --serial 146322070000"))
