"""`uav-recon sim`, `uav-recon sweep` and `uav-recon compile`: flights in simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uav_recon.cli import choices
from uav_recon.cli.exit_codes import exit_with

SIM_EXAMPLES = (
    "uav-recon sim                                            # the built-in room, in real time",
    "uav-recon sim --lockstep --views 20 --seed 3             # repeatable; the same seed gives the same flight",
    "uav-recon sim --lockstep --mapper depth-only             # without the neural mapper: much faster",
    "uav-recon sim --scene random:7 --variant explore         # a generated flat",
    "uav-recon sim --scene small:3                            # a generated small room",
    "uav-recon sim --scene room.ply --start 1.5,2,0,90        # your own mesh: metres, z up",
    "uav-recon sim --autopilot ardupilot --firmware ./arducopter",
)
SWEEP_EXAMPLES = (
    "uav-recon sweep --flights 20",
    "uav-recon sweep --scenes built-in,random --radii 0.15,0.20 --json sweep.json",
)
SCENE = "Scene"
VEHICLE = "Vehicle and autopilot"
CAMERA = "Camera"
PLANNER = "Mapping and planning"
RUN = "Run"
CameraOption = Annotated[
    str,
    typer.Option(
        metavar=choices.listed(choices.CAMERAS),
        autocompletion=choices.one_of(choices.CAMERAS),
        help="Simulated camera; see `sim --help`.",
    ),
]

CameraErrorsOption = Annotated[
    str | None,
    typer.Option(
        metavar="default|none|FACTOR", autocompletion=choices.one_of(choices.CAMERA_ERRORS), help=choices.CAMERA_ERRORS_HELP
    ),
]


def sim(
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="PATH|random:SEED|small:SEED", rich_help_panel=SCENE,
            help="Folder with scene.json, mesh file (.ply .obj .glb .stl; metres, z up), random:SEED for a generated flat or "
            "small:SEED for a generated room of 6 to 14 m². Default: the built-in room.",
        ),
    ] = None,
    list_scenes: Annotated[
        bool, typer.Option("--list-scenes", rich_help_panel=SCENE, help="List the scenes that can be flown, and exit.")
    ] = False,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z,YAW", rich_help_panel=SCENE,
            help="Take-off position in metres and heading in degrees, in the mesh's frame. Required for a mesh file.",
        ),
    ] = None,
    fence: Annotated[
        str | None,
        typer.Option(
            metavar="X0,Y0,Z0,X1,Y1,Z1", rich_help_panel=SCENE,
            help="Fence: lower and upper corner in metres, in the mesh's frame. Required where the mesh is open.",
        ),
    ] = None,
    autopilot: Annotated[
        str,
        typer.Option(
            metavar=choices.listed(choices.AUTOPILOTS), autocompletion=choices.one_of(choices.AUTOPILOTS),
            rich_help_panel=VEHICLE, help="Simulated autopilot.",
        ),
    ] = "px4",
    firmware: Annotated[
        Path | None,
        typer.Option(
            readable=False, metavar="PATH", rich_help_panel=VEHICLE,
            help="Fly a real firmware instead of the simulated autopilot: the binary of ArduCopter SITL, or bin/px4 of a "
            "PX4 build with SIH. It has its own vehicle dynamics. Needs the matching --autopilot.",
        ),
    ] = None,
    port: Annotated[
        int, typer.Option(min=1024, max=65535, metavar="N", rich_help_panel=VEHICLE, help="UDP port of the MAVLink link.")
    ] = 14540,
    radius: Annotated[
        float,
        typer.Option(
            metavar="M", rich_help_panel=VEHICLE,
            help="Radius of the vehicle in metres, 0.05 to 0.6. Planning clearance and fence inset follow from it.",
        ),
    ] = 0.20,
    blind_speed: Annotated[
        float,
        typer.Option(
            metavar="M/S", rich_help_panel=VEHICLE,
            help="Speed limit outside the camera's field of view, 0.1 to 1.2 m/s. Below 1.2 the vehicle yaws into the "
            "direction of travel on long segments. 1.2 disables the limit; flights are then about a third shorter.",
        ),
    ] = 0.3,
    range_up: Annotated[
        float | None,
        typer.Option(
            metavar="DEG", rich_help_panel=VEHICLE,
            help="Add a range finder of 4 m that looks up. DEG is the whole angle of its cone, 5 to 60 degrees: 27 is that of "
            "a small time-of-flight sensor. What it finds empty becomes known free space.",
        ),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar=choices.listed(choices.CAMERAS), autocompletion=choices.one_of(choices.CAMERAS), rich_help_panel=CAMERA,
            help="d435i: colour narrower than depth. wide: one registered RGB-D camera. fast: a d435i at a quarter of its "
            "pixels, 6 Hz, no colour. small: the same with colour. Default: d435i; fast with --mapper depth-only.",
        ),
    ] = None,
    mount: Annotated[
        str,
        typer.Option(
            metavar="auto|fixed:DEG|gimbal", autocompletion=choices.one_of(choices.SIM_MOUNTS), rich_help_panel=CAMERA,
            help="Camera mount. DEG is the tilt in degrees, -60 to 60; positive looks down. auto: fixed:10, or less in a small "
            "room where that shows much more of it (`uav-recon check room`).",
        ),
    ] = "auto",
    pose: Annotated[
        str,
        typer.Option(
            metavar=choices.listed(choices.POSES), autocompletion=choices.one_of(choices.POSES), rich_help_panel=CAMERA,
            help="Source of the poses. stream: a simulated tracking system beside the camera. corrected: the same, "
            "its drift corrected by a tracker (localization.correct_drift). slam: the embedded RGB-D SLAM, "
            "which has nothing but the images and the IMU of the camera. autopilot: a tracking system of the autopilot.",
        ),
    ] = "stream",
    depth_noise: Annotated[
        str,
        typer.Option(
            metavar=choices.listed(choices.DEPTH_NOISES), autocompletion=choices.one_of(choices.DEPTH_NOISES),
            rich_help_panel=CAMERA, help="Noise model of the depth images; none: exact depth.",
        ),
    ] = "d435i",
    camera_errors: Annotated[
        str | None,
        typer.Option(
            metavar="default|none|FACTOR", autocompletion=choices.one_of(choices.CAMERA_ERRORS), rich_help_panel=CAMERA,
            help=choices.CAMERA_ERRORS_HELP,
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            readable=False, metavar="FILE", rich_help_panel=CAMERA,
            help="Begin from the camera errors that an earlier flight left in FILE, and write them there. Default: begin "
            "without, so that a seed gives one flight.",
        ),
    ] = None,
    mapper: Annotated[
        str,
        typer.Option(
            metavar=choices.listed(choices.MAPPERS), autocompletion=choices.one_of(choices.MAPPERS), rich_help_panel=PLANNER,
            help="neural: learn the surface. depth-only: surface directly from depth images; quick, without model and "
            "recording; needs --lockstep.",
        ),
    ] = "neural",
    variant: Annotated[
        str,
        typer.Option(
            metavar="NAME", autocompletion=choices.one_of(choices.VARIANTS), rich_help_panel=PLANNER,
            help="Planner. Of the paper (Zeng et al., ICRA 2024): adaptive (V5), merged (V4), reconstruct (V3), explore "
            "(V2), explore-yaw (V1; equals explore with a fixed mount). Its baselines: explore-then-refine, evpp, vpp.",
        ),
    ] = "adaptive",
    uncertainty: Annotated[
        str,
        typer.Option(
            metavar="NAME", autocompletion=choices.one_of(choices.UNCERTAINTIES), rich_help_panel=PLANNER,
            help="Measure of surface uncertainty for the planner: agreement, paper, colour, information or product.",
        ),
    ] = "agreement",
    views: Annotated[
        int | None,
        typer.Option(
            min=4, max=5000, metavar="N", rich_help_panel=PLANNER,
            help="View budget: maximum number of keyframes for the mapper. Default: 60; 120 with --scene.",
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(
            min=0, rich_help_panel=RUN, help="Seed of wind, noise and training. In lockstep, one seed gives one flight."
        ),
    ] = 0,
    out: Annotated[
        Path | None,
        typer.Option(readable=False, metavar="FOLDER", rich_help_panel=RUN, help="Flight folder. Default: flights/SCENE-DATE."),
    ] = None,
    lockstep: Annotated[
        bool,
        typer.Option("--lockstep", rich_help_panel=RUN, help="Run in one process on a simulated clock: repeatable and faster."),
    ] = False,
    live: Annotated[
        bool, typer.Option("--live", rich_help_panel=RUN, help="Open the rerun viewer and show the flight while it runs.")
    ] = False,
    json: Annotated[
        Path | None,
        typer.Option(metavar="FILE", readable=False, rich_help_panel=RUN, help="Write the report, commit and machine to FILE."),
    ] = None,
) -> None:  # fmt: skip
    """Fly a whole mission in simulation and write a flight folder.

    The folder holds model, report and recording. Scene, camera and autopilot are simulated. The pilot, perception and
    mission processes are the programs that run on a drone. Ctrl-C lands and still writes the report; a second Ctrl-C ends
    all processes at once.

    Exit code 0: mission completed; 1: not completed, or a process failed; 2: bad option; 130: interrupted before take-off.
    """
    if list_scenes:
        from sitl.apps.scene_list import print_scenes

        exit_with(print_scenes)
    from sitl.apps.sim import SimOptions, simulate

    exit_with(
        lambda: simulate(
            SimOptions.parse(
                scene=scene, start=start, fence=fence, views=views, seed=seed, out=out, autopilot=autopilot, variant=variant,
                mount=mount, depth_noise=depth_noise, camera=camera, mapper=mapper, uncertainty=uncertainty, radius=radius,
                lockstep=lockstep, live=live, port=port, firmware=firmware, blind_speed=blind_speed,
                camera_errors=camera_errors, pose=pose, calibration=calibration, range_up=range_up,
            ),
            json,
        )
    )  # fmt: skip


def sweep(
    flights: Annotated[int, typer.Option(min=1, max=100000, help="Number of flights.")] = 500,
    seed0: Annotated[int, typer.Option(min=0, help="First seed.")] = 0,
    scenes: Annotated[
        str,
        typer.Option(
            metavar="S,S,...",
            help="Scenes: random or small (a new flat or small room for each seed), random:SEED, small:SEED, built-in, "
            "folders, mesh files.",
        ),
    ] = "random",
    radii: Annotated[str, typer.Option(metavar="M,M,...", help="Radii of the vehicle in metres, 0.05 to 0.6.")] = "0.20",
    variants: Annotated[
        str,
        typer.Option(
            metavar="V,V,...", autocompletion=choices.one_of(choices.VARIANTS), help="Planner variants; see `sim --help`."
        ),
    ] = "adaptive",
    mount: Annotated[
        str,
        typer.Option(
            metavar="M,M,...",
            autocompletion=choices.one_of(choices.SIM_MOUNTS),
            help="Camera mounts: fixed:DEG, gimbal, or auto, as `sim` without one.",
        ),
    ] = "fixed:15",
    autopilot: Annotated[
        str,
        typer.Option(
            metavar=choices.listed((*choices.AUTOPILOTS, "both")),
            autocompletion=choices.one_of((*choices.AUTOPILOTS, "both")),
            help="Simulated autopilot.",
        ),
    ] = "px4",
    pose: Annotated[
        str,
        typer.Option(
            metavar=choices.listed(choices.POSES),
            autocompletion=choices.one_of(choices.POSES),
            help="Source of the poses; see `sim --help`.",
        ),
    ] = "stream",
    camera: CameraOption = "fast",
    camera_errors: CameraErrorsOption = None,
    range_up: Annotated[
        float | None, typer.Option(metavar="DEG", help="Add a range finder that looks up; see `sim --help`.")
    ] = None,
    views: Annotated[int | None, typer.Option(min=4, max=5000, help="View budget. Default: as `sim`.")] = None,
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Parallel processes; each uses one core.")] = 2,
    json: Annotated[
        Path | None,
        typer.Option(readable=False, metavar="FILE", help="Results file. Flights that it already contains are not repeated."),
    ] = None,
    truth: Annotated[
        bool,
        typer.Option("--truth", help="Also measure explored fraction and recall. Adds up to a minute for each new scene."),
    ] = False,
) -> None:
    """Fly many missions in lockstep with the depth-only mapper.

    Lockstep is a simulated clock: repeatable and faster than real time. Prints one line per flight and a summary table. The
    flights take all scenes, radii, variants, mounts and autopilots in turn, then again with the next seed. Exit code 1 if any
    flight had contact or failed with an error; the command that repeats such a flight is printed.
    """
    from sitl.apps.sweep import SweepOptions
    from sitl.apps.sweep import sweep as fly_all

    exit_with(
        lambda: fly_all(
            SweepOptions.parse(
                flights=flights, seed0=seed0, scenes=scenes, radii=radii, variants=variants, mount=mount, autopilot=autopilot,
                pose=pose, camera=camera, views=views, jobs=jobs, json=json, truth=truth,
                camera_errors=camera_errors, range_up=range_up,
            )
        )
    )  # fmt: skip


def compile_kernels() -> None:
    """Compile the numerical kernels now, so that the first flight does not wait for them.

    It takes about two minutes on two cores, and nothing if all are compiled. The kernels are kept in the package, or in
    NUMBA_CACHE_DIR if set: set it as the services do (/var/cache/uav_recon), and run as their user.
    """
    from sitl.apps.kernel_compilation import compile_all

    exit_with(compile_all)
