"""The processes of a vehicle, and the commands for a flight folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uav_recon.cli import choices
from uav_recon.cli.exit_codes import exit_with
from uav_recon.cli.recording_options import DepthUnitOption

CONFIG = Path("/etc/uav_recon/config.toml")
# readable=False: the code that opens a path checks it, and reports one line with its own exit code
ConfigOption = Annotated[
    Path,
    typer.Option("--config", metavar="FILE", readable=False, help="TOML config; `uav-recon config write` lists every key."),
]
FlightOption = Annotated[
    Path | None,
    typer.Option(
        "--flight", metavar="FOLDER", readable=False, help="Flight folder. Default: a dated folder in recording.folder."
    ),
]
FlightArgument = Annotated[Path, typer.Argument(metavar="FLIGHT", readable=False, help="A flight folder.")]
TRACK_EXAMPLES = (
    "uav-recon track orbslam3 --weights ORBvoc.txt",
    "PYTHONPATH=DROID-SLAM/droid_slam uav-recon track droid --weights droid.pth",
)
REVIEW_EXAMPLES = ("uav-recon review flights/room-20260101-120000",)
CALIBRATE_EXAMPLES = (
    "uav-recon calibrate --live                               # move the vehicle by hand until all is known",
    "uav-recon calibrate --live --seconds 60 --write new.toml # the config with the calibrated camera",
    "uav-recon calibrate hand.mcap --config config.toml --out residuals/     # after `uav-recon record hand.mcap`",
)
REFINE_EXAMPLES = (
    "uav-recon refine flights/room-20260101-120000                 # 8000 steps, 1 cm triangles",
    "uav-recon refine flights/room-20260101-120000 --steps 500 --voxel 0.02     # a quick look",
    "uav-recon refine flights/room-20260101-120000 --device cuda --processes 2",
)


def pilot(config: ConfigOption = CONFIG, flight: FlightOption = None) -> None:
    """Run the pilot process: the only MAVLink link, the guard and the setpoint stream."""
    from uav_recon.app import processes

    exit_with(lambda: processes.pilot(config, flight))


def perception(config: ConfigOption = CONFIG) -> None:
    """Run the perception process: camera frames, poses and odometry."""
    from uav_recon.app import processes

    exit_with(lambda: processes.perception(config))


def mission(config: ConfigOption = CONFIG, flight: FlightOption = None) -> None:
    """Run the mission process: voxel map, planner and state machine.

    Mapper and recorder are its child processes.
    """
    from uav_recon.app import processes

    exit_with(lambda: processes.mission(config, flight))


def recorder(config: ConfigOption = CONFIG, flight: FlightOption = None) -> None:
    """Run the recorder, which writes the channels to flight.rrd.

    The mission starts it.
    """
    from uav_recon.app import processes

    exit_with(lambda: processes.recorder(config, flight))


def calibrate(
    recording: Annotated[
        Path | None,
        typer.Argument(
            metavar="RECORDING", readable=False, help="An .npz file, or a ROS 2 bag such as `uav-recon record` writes."
        ),
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="Read the running camera stream while you move the vehicle.")] = False,
    config: ConfigOption = CONFIG,
    seconds: Annotated[float, typer.Option(metavar="S", help="With --live: longest time, 5 to 600.")] = 120.0,
    out: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", readable=False, help="Folder of calibration.png, the residuals.")
    ] = Path("calibration"),
    depth_unit: DepthUnitOption = None,
    write: Annotated[
        Path | None, typer.Option("--write", metavar="FILE", readable=False, help="Write the calibrated config to FILE.")
    ] = None,
) -> None:
    """Calibrate the camera from a motion by hand, with the motors off.

    Adjusts views of the whole walk together, which takes about a minute. Prints each error of the camera with its uncertainty,
    draws the distances between views before and after, and prints the keys of the config that remove the errors. A fixed mount
    only. Exit code 0: all is known; 1: some motion is missing, or the poses come from the depth images.
    """
    from uav_recon.app import calibrate_command

    exit_with(
        lambda: calibrate_command.calibrate(
            calibrate_command.CalibrateOptions.of(recording, live, config, seconds, out, write, depth_unit)
        )
    )


def track(
    engine: Annotated[str, typer.Argument(metavar="orbslam3|cuvslam|droid", help="The tracking engine.")],
    weights: Annotated[
        Path | None,
        typer.Option("--weights", metavar="FILE", readable=False, help="orbslam3: ORBvoc.txt. droid: droid.pth."),
    ] = None,
    config: ConfigOption = CONFIG,
) -> None:
    """Track the camera stream with a SLAM engine of others, which is installed by you.

    It reads frames of the camera stream and writes poses into it, in this process and outside the flight. The config has
    camera.source and localization.source stream. docs/pose-sources/engines.md has the installation of each engine.
    """
    from uav_recon.app import processes
    from uav_recon.app import track as tracking

    def work() -> int:
        stop = processes.Stop()
        return tracking.track(tracking.TrackOptions(engine, config, weights), lambda: stop.asked)

    exit_with(work)


def review(flight: FlightArgument) -> None:
    """Open a flight in the rerun viewer.

    It shows map, path, model, camera images and values on one timeline.
    """
    from uav_recon.app import processes

    exit_with(lambda: processes.review(flight))


def refine(
    flight: FlightArgument,
    steps: Annotated[int, typer.Option(help="Training steps, 1 to 1000000.")] = 8000,
    voxel: Annotated[float, typer.Option(metavar="M", help="Edge length of the triangles in metres, 0.005 to 0.05.")] = 0.01,
    device: Annotated[
        str,
        typer.Option(
            metavar=choices.listed(choices.DEVICES), autocompletion=choices.one_of(choices.DEVICES),
            help="auto uses every GPU that is found, otherwise the CPU.",
        ),
    ] = "auto",
    processes: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Train in N processes (torchrun), 1 to 64; each needs 1 GB of memory. Default: one per GPU."
        ),
    ] = None,
    save_every: Annotated[float, typer.Option(metavar="S", help="Seconds between checkpoints, 1 to 3600.")] = 60.0,
) -> None:  # fmt: skip
    """Train the final model of a flight at full quality.

    It writes FLIGHT/refined/mesh.ply and mesh.glb. The mesh is watertight. Faces that no view observed are marked
    (mesh.ply: property `observed`; mesh.glb: primitive `unseen`) and are not part of any measured value. Ctrl-C saves a
    checkpoint; the same command continues from it, also after a kill.
    """
    from uav_recon.app import refine as refinement

    wanted = refinement.RefineOptions(flight, steps, voxel, device, processes, save_every)
    exit_with(lambda: refinement.refine(wanted))
