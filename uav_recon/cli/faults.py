"""`uav-recon faults`: the fault-injection campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uav_recon.cli import choices
from uav_recon.cli.exit_codes import exit_with
from uav_recon.cli.simulate import CameraErrorsOption

EXAMPLES = (
    "uav-recon faults --list                                  # every scenario with its limits",
    "uav-recon faults --only A1,B4 --seeds 3 --out faults/    # two scenarios, with an HTML report",
    "uav-recon faults --real-time --autopilot px4             # scenarios that need real processes and signals",
    "uav-recon faults --only B1 --autopilot ardupilot --firmware ./arducopter",
)
_AUTOPILOTS = (*choices.AUTOPILOTS, "both")


def faults(
    show_list: Annotated[
        bool, typer.Option("--list", help="List the scenarios with fault and limits, and exit.")
    ] = False,
    only: Annotated[
        str | None, typer.Option(metavar="ID,ID,...", help="Scenarios to fly, e.g. A1,B4. Default: all.")
    ] = None,
    autopilot: Annotated[
        str,
        typer.Option(
            metavar=choices.listed(_AUTOPILOTS), autocompletion=choices.one_of(_AUTOPILOTS), help="Simulated autopilot."
        ),
    ] = "both",
    seeds: Annotated[
        int,
        typer.Option(
            min=1, max=1000,
            help="Flights per scenario. In lockstep, A1, B1, B4, E1 and F1 get three times as many. A scenario with several "
            "variants takes them in turn.",
        ),
    ] = 3,
    seed0: Annotated[
        int, typer.Option("--seed0", min=0, help="First seed. Repeat a failed flight with its seed and --seeds 1.")
    ] = 0,
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Parallel processes; each uses one core.")] = 2,
    camera_errors: CameraErrorsOption = None,
    json: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", readable=False, help="Write all measured values to FILE.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            readable=False, metavar="FOLDER", help="Write the report faults.html and keep the flights. Default: keep nothing."
        ),
    ] = None,
    real_time: Annotated[
        bool,
        typer.Option(
            "--real-time", help="Fly only the scenarios that have real processes: one flight at a time, about a minute each."
        ),
    ] = False,
    firmware: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH", readable=False,
            help="Fly a real firmware instead of the simulated autopilot, as `sim --firmware`; needs --autopilot. Only the "
            "scenarios that can be injected there are flown, in real time.",
        ),
    ] = None,
) -> None:  # fmt: skip
    """Run the fault-injection campaign, one fault per flight.

    Flies on a simulated clock (lockstep) unless --real-time or --firmware is given. Prints one line per scenario: measured
    value and limit. Results are computed from the simulator's ground truth and the captured MAVLink traffic. docs/hazards.md
    describes the scenarios. Exit code 1 if any scenario failed.
    """
    if show_list:
        from sitl.faults.flights.scenario_list import print_scenarios

        exit_with(lambda: print_scenarios(only))
    from sitl.faults.flights.campaign import FaultOptions
    from sitl.faults.flights.campaign import faults as fly_all

    exit_with(
        lambda: fly_all(
            FaultOptions.parse(
                only=only, autopilot=autopilot, seeds=seeds, jobs=jobs, json=json, out=out, live=real_time, firmware=firmware,
                seed0=seed0, camera_errors=camera_errors,
            )
        )
    )  # fmt: skip
