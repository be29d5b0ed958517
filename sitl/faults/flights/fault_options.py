"""The options of `uav-recon faults`.

Imports nothing heavy: the help of `uav-recon` loads it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sitl.apps.command_option import CommandOption, check_fields
from sitl.apps.sim_options import AUTOPILOTS, CAMERA_ERRORS, camera_error_scale, check_jobs
from sitl.apps.sweep_options import BOTH, BOTH_AUTOPILOTS, JOBS
from uav_recon.app.option_validation import UsageError


@dataclass(frozen=True, kw_only=True)
class FaultOptions:
    """The options as typed; the command line is made of these fields.

    Raises UsageError with one line for a value that cannot be used.
    """

    show_list: Annotated[bool, CommandOption("List the scenarios with fault and limits, and exit.", flag="--list")] = False
    only: Annotated[str | None, CommandOption("Scenarios to fly, e.g. A1,B4. Default: all.", metavar="ID,ID,...")] = None
    autopilot: Annotated[str, BOTH_AUTOPILOTS] = BOTH
    seeds: Annotated[
        int,
        CommandOption(
            "Flights per scenario. In lockstep, A1, B1, B4, E1 and F1 get three times as many. A scenario with several "
            "variants takes them in turn.",
            whole=(1, 1000),
        ),
    ] = 3
    seed0: Annotated[int, CommandOption("First seed. Repeat a failed flight with its seed and --seeds 1.", whole=(0, None))] = 0
    jobs: Annotated[int, JOBS] = 2
    camera_errors: Annotated[str | None, CAMERA_ERRORS.unpanelled()] = None
    json: Annotated[Path | None, CommandOption("Write all measured values to FILE.", metavar="FILE")] = None
    out: Annotated[
        Path | None,
        CommandOption("Write the report faults.html and keep the flights. Default: keep nothing.", metavar="FOLDER"),
    ] = None
    real_time: Annotated[
        bool,
        CommandOption("Fly only the scenarios that have real processes: one flight at a time, about a minute each."),
    ] = False
    firmware: Annotated[
        Path | None,
        CommandOption(
            "Fly a real firmware instead of the simulated autopilot, as `sim --firmware`; needs --autopilot. Only the "
            "scenarios that can be injected there are flown, in real time.",
            metavar="PATH",
        ),
    ] = None

    def __post_init__(self) -> None:
        """Check each value, then values that do not go together. Raises UsageError with one line."""
        check_fields(self)
        camera_error_scale(self.camera_errors)
        if self.firmware is not None and self.autopilot == BOTH:
            raise UsageError(f"--autopilot {BOTH}: with --firmware want {' or '.join(AUTOPILOTS)}, the firmware's kind")
        if not self.live:
            check_jobs(self.jobs)

    @property
    def live(self) -> bool:
        """True for flights in real time, one after the other."""
        return self.real_time or self.firmware is not None

    @property
    def autopilots(self) -> tuple[str, ...]:
        """The simulated autopilots, or the kind of the real firmware."""
        return AUTOPILOTS if self.autopilot == BOTH else (self.autopilot,)
