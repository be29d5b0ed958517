"""The command line: it parses the options and runs a command.

Heavy imports are inside the commands, so that --help is quick.
"""

from __future__ import annotations

from typing import Annotated

import typer

from sitl.apps.sim_options import SimOptions
from sitl.apps.sweep_options import SweepOptions
from sitl.faults.flights.fault_options import FaultOptions
from uav_recon.app.kernel_cache import use_writable_cache
from uav_recon.cli import faults, operator, recordings, services, simulate
from uav_recon.cli.bench import bench
from uav_recon.cli.check import check
from uav_recon.cli.command_options import command_of
from uav_recon.cli.commands import HELP_NAMES, Commands, add
from uav_recon.cli.config import config
from uav_recon.cli.exit_codes import end
from uav_recon.cli.params import params

FLY = "Fly in simulation"
REVIEW = "Review a flight"
MEASURE = "Measure"
IN_FLIGHT = "Operate a flight"
VEHICLE = "On the vehicle"

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_markup_mode="rich",
    context_settings=HELP_NAMES,
    help="Autonomous indoor reconstruction drone: explores an unknown room and returns a coloured, metric model of it.\n\n"
    "Try `uav-recon sim` first: it flies a whole mission in a built-in room on this machine.",
    epilog="`uav-recon COMMAND --help` explains a command, with examples. `uav-recon --install-completion` adds completion of "
    "commands, options and values to your shell.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from uav_recon.cli.version import version_line

        print(version_line())
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print version and commit, and exit.")
    ] = False,
) -> None:
    """Take the options of every command."""


add(app, command_of(SimOptions, simulate.sim), "sim", FLY, simulate.SIM_EXAMPLES)
add(app, command_of(FaultOptions, faults.faults), "faults", FLY, faults.EXAMPLES)
add(app, command_of(SweepOptions, simulate.sweep), "sweep", FLY, simulate.SWEEP_EXAMPLES)
add(app, simulate.compile_kernels, "compile", FLY)
add(app, services.review, "review", REVIEW, services.REVIEW_EXAMPLES)
add(app, recordings.replay, "replay", REVIEW, recordings.REPLAY_EXAMPLES)
add(app, services.refine, "refine", REVIEW, services.REFINE_EXAMPLES)
app.add_typer(bench, name="bench", rich_help_panel=MEASURE)
for name, command in operator.COMMANDS.items():
    add(app, command, name, IN_FLIGHT)
add(app, services.pilot, "pilot", VEHICLE)
add(app, services.perception, "perception", VEHICLE)
add(app, services.mission, "mission", VEHICLE)
add(app, services.calibrate, "calibrate", VEHICLE, services.CALIBRATE_EXAMPLES)
add(app, services.track, "track", VEHICLE, services.TRACK_EXAMPLES)
add(app, recordings.record, "record", VEHICLE, recordings.RECORD_EXAMPLES)
add(app, services.recorder, "recorder", hidden=True)
app.add_typer(check, name="check", rich_help_panel=VEHICLE)
app.add_typer(params, name="params", rich_help_panel=VEHICLE)
app.add_typer(config, name="config", rich_help_panel=VEHICLE)


def main() -> None:
    """Run the command line."""
    use_writable_cache()
    end(app)


if __name__ == "__main__":
    main()
