"""`uav-recon faults` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uav_recon.cli.exit_codes import exit_with


def faults(
    only: Annotated[
        str | None, typer.Option(metavar="A1,B4,...", help="Rows to fly, with commas between. Default: all.")
    ] = None,
    autopilot: Annotated[str, typer.Option(help="Firmware personality: px4, ardupilot or both.")] = "both",
    seeds: Annotated[
        int,
        typer.Option(
            min=1,
            max=1000,
            help="Flights a row, in lockstep three times as many of A1, B1, B4, E1 and F1; its cases take turns.",
        ),
    ] = 3,
    seed0: Annotated[
        int, typer.Option("--seed0", min=0, help="First seed; one that missed is flown again with --seeds 1.")
    ] = 0,
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Processes; one core each.")] = 2,
    json: Annotated[Path | None, typer.Option("--json", metavar="FILE", readable=False, help="Write every figure.")] = None,
    out: Annotated[
        Path | None, typer.Option(readable=False, help="Folder for the report faults.html and the flights. Default: keep none.")
    ] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="Rows of real processes and signals, one flight at a time, a minute each.")
    ] = False,
    firmware: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            readable=False,
            help="A real firmware's simulation binary as `sim` has it, in real time; say which with --autopilot. Flies the "
            "rows whose trouble can be had there.",
        ),
    ] = None,
) -> None:
    """Fly with one thing going wrong at a time; a line a row of the hazards' table, the measured figure beside its bar.

    Judged by the simulator's truth and by what was on the wire. Exit code 1 if any row failed.
    """
    from sitl.faults.flights.campaign import FaultOptions
    from sitl.faults.flights.campaign import faults as fly_all

    exit_with(
        lambda: fly_all(
            FaultOptions.parse(
                only=only, autopilot=autopilot, seeds=seeds, jobs=jobs, json=json, out=out, live=real_time, firmware=firmware,
                seed0=seed0,
            )
        )
    )  # fmt: skip
