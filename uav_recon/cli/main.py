"""The command line: parses, calls run. Heavy imports are lazy, so that --help is quick."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uav_recon.app import processes
from uav_recon.app.kernel_cache import use_writable_cache
from uav_recon.cli.exit_codes import end, exit_with
from uav_recon.cli.faults import faults
from uav_recon.cli.operator import register
from uav_recon.cli.params import params

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    help="Put a drone on the floor of an unknown room; get back a coloured, metric model of it.\n\n"
    "Try `uav-recon sim` first: it flies a whole mission in a built-in room on this machine.",
)

bench = typer.Typer(no_args_is_help=True, help="Measure this software on this machine.")
app.add_typer(bench, name="bench")
app.add_typer(params, name="params")
register(app)

# who opens a path judges it, in one line and with the exit code that it has: readable=False
ConfigOption = Annotated[Path, typer.Option("--config", readable=False, help="TOML config; uav_recon/config.py has every key.")]
FlightOption = Annotated[
    Path | None, typer.Option("--flight", readable=False, help="Flight folder; default: a dated one below recording.folder.")
]
FlightArgument = Annotated[Path, typer.Argument(metavar="FLIGHT", readable=False, help="A flight folder.")]
JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", readable=False, help="Write everything that was measured.")
]
SceneOption = Annotated[
    str | None, typer.Option(help="Scene as `sim` has it: a folder, a mesh, random:SEED. Default: the built-in room.")
]
PoseNoiseOption = Annotated[
    str, typer.Option(metavar="CM,DEG", help="Standard deviation, each axis, of the poses that the mapper is told.")
]


@app.command()
def sim(
    scene: Annotated[
        str | None,
        typer.Option(
            help="Folder with scene.json, .ply/.obj/.glb/.stl mesh in metres, z up, or random:SEED. Default: the built-in room."
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(metavar="X,Y,Z,YAW", help="Start in the mesh's frame, metres and degrees; needed for a bare mesh file."),
    ] = None,
    fence: Annotated[
        str | None,
        typer.Option(metavar="X0,Y0,Z0,X1,Y1,Z1", help="Fence box in the mesh's frame; needed where the scene is open."),
    ] = None,
    views: Annotated[
        int | None,
        typer.Option(
            min=4, max=5000, help="View budget: keyframes given to the mapper, at most. Default: 60, or 120 with --scene."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of wind, noise and learning; one seed, one lockstep flight.")] = 0,
    out: Annotated[Path | None, typer.Option(readable=False, help="Flight folder. Default: flights/SCENE-DATE.")] = None,
    autopilot: Annotated[str, typer.Option(help="Firmware personality: px4 or ardupilot.")] = "px4",
    variant: Annotated[
        str,
        typer.Option(
            help="The paper's adaptive (V5), merged (V4), reconstruct (V3), explore (V2), explore-yaw (V1); "
            "the baselines explore-then-refine, evpp, vpp."
        ),
    ] = "adaptive",
    mount: Annotated[
        str, typer.Option(metavar="fixed:DEG|gimbal", help="Camera mount; DEG is the tilt, down is plus.")
    ] = "fixed:15",
    depth_noise: Annotated[str, typer.Option(help="d435i, paper, kinect or none.")] = "d435i",
    camera: Annotated[
        str | None,
        typer.Option(
            help="d435i (colour narrower than depth), wide (one registered RGB-D camera), fast (a d435i at a quarter of its "
            "pixels, 6 Hz, no colour) or small (the same in colour). Default: d435i, or fast where the mapper is a stand-in."
        ),
    ] = None,
    mapper: Annotated[
        str, typer.Option(help="neural, or stand-in: surface straight from depth, no model, no recording; needs --lockstep.")
    ] = "neural",
    uncertainty: Annotated[
        str,
        typer.Option(
            help="What says how badly surface is known, to the planner: agreement, paper, colour, information, product."
        ),
    ] = "agreement",
    radius: Annotated[
        float, typer.Option(help="Radius of the vehicle in metres, 0.05 to 0.6; distances to obstacles and fence follow.")
    ] = 0.20,
    blind_speed: Annotated[
        float,
        typer.Option(
            help="Greatest speed where the camera does not look, 0.1 to 1.2 m/s. Below 1.2 long ways are flown nose ahead; "
            "1.2 does not ask for it, and a flight takes two thirds of the time."
        ),
    ] = 0.3,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="One process on a simulated clock: repeatable and fast.")
    ] = False,
    live: Annotated[bool, typer.Option("--live", help="Open the rerun viewer and watch while it flies.")] = False,
    port: Annotated[int, typer.Option(min=1024, max=65535, help="Loopback UDP port of the MAVLink link.")] = 14540,
    firmware: Annotated[
        Path | None,
        typer.Option(
            readable=False,
            help="A real firmware's simulation binary in the simulated autopilot's place: ArduCopter SITL, or bin/px4 of a "
            "build with SIH. Its vehicle flies in its own physics, and the camera follows.",
        ),
    ] = None,
) -> None:
    """Fly a whole mission in simulation and write a flight folder with model, report and recording.

    The outside world (scene, camera, autopilot) is simulated; the pilot, perception and mission processes are the very
    programs that fly a real drone. Ctrl-C lands and still writes the report; a second Ctrl-C ends everything at once.
    """
    from sitl.apps.sim import SimOptions, simulate

    exit_with(
        lambda: simulate(
            SimOptions.parse(
                scene=scene, start=start, fence=fence, views=views, seed=seed, out=out, autopilot=autopilot, variant=variant,
                mount=mount, depth_noise=depth_noise, camera=camera, mapper=mapper, uncertainty=uncertainty, radius=radius,
                lockstep=lockstep, live=live, port=port, firmware=firmware, blind_speed=blind_speed,
            )
        )
    )  # fmt: skip


@app.command()
def sweep(
    flights: Annotated[int, typer.Option(min=1, max=100000, help="How many.")] = 500,
    seed0: Annotated[int, typer.Option(min=0, help="First seed.")] = 0,
    scenes: Annotated[
        str, typer.Option(help="Scenes with commas between: random (a new flat with each seed), built-in, folders, meshes.")
    ] = "random",
    radii: Annotated[str, typer.Option(help="Radii of the vehicle in metres, with commas between.")] = "0.20",
    variants: Annotated[str, typer.Option(help="Planner variants as `sim` has them, with commas between.")] = "adaptive",
    mount: Annotated[str, typer.Option(metavar="fixed:DEG|gimbal", help="Camera mount.")] = "fixed:15",
    camera: Annotated[str, typer.Option(help="d435i, wide, fast or small.")] = "fast",
    views: Annotated[int | None, typer.Option(min=4, max=5000, help="View budget. Default: as `sim`.")] = None,
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Processes; one core each.")] = 2,
    json: Annotated[
        Path | None, typer.Option(readable=False, help="Account to write, and to go on with: what it holds is not flown again.")
    ] = None,
    truth: Annotated[
        bool, typer.Option("--truth", help="Measure explored fraction and recall too: up to a minute for each new scene.")
    ] = False,
) -> None:
    """Fly many missions in quick lockstep with a stand-in for the mapper; a line each, a table, and what went wrong.

    Flights go through scenes, radii and variants, then the same again with the next seed. Exit code 1 if any flight
    touched something or broke; such a flight is repeated by the command that is printed.
    """
    from sitl.apps.sweep import SweepOptions
    from sitl.apps.sweep import sweep as fly_all

    exit_with(
        lambda: fly_all(
            SweepOptions.parse(
                flights=flights, seed0=seed0, scenes=scenes, radii=radii, variants=variants, mount=mount, camera=camera,
                views=views, jobs=jobs, json=json, truth=truth,
            )
        )
    )  # fmt: skip


app.command()(faults)


@app.command()
def pilot(config: ConfigOption = Path("/etc/uav_recon/config.toml"), flight: FlightOption = None) -> None:
    """The process next to the autopilot: the only MAVLink link, the guard, the setpoint stream."""
    exit_with(lambda: processes.pilot(config, flight))


@app.command()
def perception(config: ConfigOption = Path("/etc/uav_recon/config.toml")) -> None:
    """The process next to the camera: frames, poses, steady odometry."""
    exit_with(lambda: processes.perception(config))


@app.command()
def mission(config: ConfigOption = Path("/etc/uav_recon/config.toml"), flight: FlightOption = None) -> None:
    """The process that decides: voxels, planner, state machine, with the mapper and the recorder as children."""
    exit_with(lambda: processes.mission(config, flight))


@app.command(hidden=True)
def record(config: ConfigOption = Path("/etc/uav_recon/config.toml"), flight: FlightOption = None) -> None:
    """The recorder, started by the mission: reads the channels, writes flight.rrd."""
    exit_with(lambda: processes.record(config, flight))


@app.command()
def review(flight: FlightArgument) -> None:
    """Open a flight in the rerun viewer: map, path, model, camera and figures on one timeline."""
    exit_with(lambda: processes.review(flight))


@app.command()
def refine(
    flight: FlightArgument,
    steps: Annotated[int, typer.Option(help="Training steps, 1 to 1000000.")] = 8000,
    voxel: Annotated[float, typer.Option(help="Edge of the mesh's triangles in metres, 0.005 to 0.05.")] = 0.01,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda; auto takes every GPU there is.")] = "auto",
    processes: Annotated[
        int | None,
        typer.Option(help="Learn with so many processes (torchrun), 1 to 64, 1 GB of memory each. Default: one for each GPU."),
    ] = None,
    save_every: Annotated[float, typer.Option(metavar="S", help="Seconds between checkpoints, 1 to 3600.")] = 60.0,
) -> None:
    """Learn the final model of a flight at full quality: FLIGHT/refined/mesh.ply and mesh.glb.

    The mesh is watertight. Faces that close what nobody saw are marked (mesh.ply: property `observed`; mesh.glb: primitive
    `unseen`) and are part of no figure. Ctrl-C saves; the same command goes on, also after a kill.
    """
    from uav_recon.app import refine as refinement

    wanted = refinement.RefineOptions(flight, steps, voxel, device, processes, save_every)
    exit_with(lambda: refinement.refine(wanted))


@bench.command("planner")
def bench_planner(
    stream: Annotated[
        Path | None,
        typer.Option(
            readable=False,
            help="Folder of a recorded stream: meta.json, poses.npy, depth_WxH.npz. Default: a built-in building.",
        ),
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Which of the stream's image sizes. Default: 640x480.")
    ] = None,
    stride: Annotated[
        int | None, typer.Option(help="Every so many of the stream's pixels, across and down, 1 to 8. Default: 2.")
    ] = None,
    scale: Annotated[bool, typer.Option("--scale", help="Growth: the same building once, ten and a hundred times.")] = False,
    json: JsonOption = None,
) -> None:
    """What a frame costs from fusion to tour, and how good the answers are; all on one thread."""
    from uav_recon.bench.planner import planner_bench as bench_of_planner

    exit_with(lambda: bench_of_planner.bench_planner(stream, size, stride, scale, json))


@bench.command("tasks")
def bench_tasks(
    flight: FlightArgument,
    json: JsonOption = None,
) -> None:
    """What it costs to find views of the learned surface, along a flight that was flown; all on one thread."""
    from uav_recon.bench.planner import task_bench

    exit_with(lambda: task_bench.bench_tasks(flight, json))


@bench.command("mapper")
def bench_mapper(
    scene: SceneOption = None,
    views: Annotated[int, typer.Option(help="How many views, from random places that the vehicle can reach.")] = 80,
    camera: Annotated[
        str, typer.Option(help="d435i (colour narrower than depth) or wide (one registered RGB-D camera).")
    ] = "d435i",
    depth_noise: Annotated[str, typer.Option(help="d435i, paper, kinect or none.")] = "d435i",
    mount: Annotated[str, typer.Option(metavar="fixed:DEG|gimbal", help="Camera mount; a gimbal looks at random tilts.")] = (
        "fixed:15"
    ),
    pose_noise: PoseNoiseOption = "0,0",
    exposure: Annotated[
        float, typer.Option(metavar="EV", help="Random exposure of each picture, uniform in ± this, of linear light.")
    ] = 0.0,
    steps_per_view: Annotated[int, typer.Option(help="Training steps after each view.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of places, noise and learning; one seed, one result.")] = 0,
    device: Annotated[str, typer.Option(help="cpu; the mapper has no other path yet.")] = "cpu",
    json: JsonOption = None,
) -> None:
    """How well, how fast and how honestly the mapper learns a scene; a TSDF at 2 cm on the same frames beside it.

    Views are taken one by one as in flight, each followed by its training steps; then once more all at once, for the time
    to a recall. Where poses or exposures err, once more without corrections. Recall, completion and pictures count what
    some view saw. Times are the processor's, on one thread.

    Example: `uav-recon bench mapper --scene ../shared/scenes/meeting_room --camera wide --depth-noise kinect`
    """
    from uav_recon.bench.mapper import mapper_bench as bench_of_mapper

    exit_with(
        lambda: bench_of_mapper.bench_mapper(
            bench_of_mapper.MapperBench(
                scene, views, camera, depth_noise, mount, pose_noise, steps_per_view, seed, device, json, exposure
            )
        )
    )


@bench.command("endurance")
def bench_endurance(
    scene: SceneOption = None,
    hours: Annotated[float, typer.Option(help="So long the mapper is given keyframes, as fast as it takes them.")] = 2.0,
    period_s: Annotated[float, typer.Option("--period-s", help="Seconds between two keyframes of that time.")] = 1.5,
    views: Annotated[int, typer.Option(help="How many different views there are; they come again and again.")] = 160,
    camera: Annotated[str, typer.Option(help="d435i or wide, as `bench mapper` has them.")] = "d435i",
    depth_noise: Annotated[str, typer.Option(help="d435i, paper, kinect or none.")] = "d435i",
    steps_per_view: Annotated[int, typer.Option(help="Training steps after each view.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of places, noise, order and learning.")] = 0,
    json: JsonOption = None,
) -> None:
    """Whether memory, disk and time per view stay what they are over hours of keyframes, and accuracy what it was.

    Example: `uav-recon bench endurance --scene ../shared/scenes/meeting_room --steps-per-view 5`
    """
    from uav_recon.bench.mapper import endurance as bench_of_endurance
    from uav_recon.bench.mapper import mapper_bench as bench_of_mapper

    wanted = bench_of_mapper.MapperBench(
        scene, views, camera, depth_noise, "fixed:15", "0,0", steps_per_view, seed, "cpu", json
    )
    exit_with(lambda: bench_of_endurance.bench_endurance(wanted, hours, period_s))


@bench.command("setpoints")
def bench_setpoints(
    minutes: Annotated[float, typer.Option(help="So long the vehicle hovers, 0.1 to 120.")] = 10.0,
    negative: Annotated[
        bool, typer.Option("--negative", help="The control: the pilot as a thread of the load. It must miss the bars.")
    ] = False,
    autopilot: Annotated[str, typer.Option(help="px4 or ardupilot.")] = "px4",
    json: JsonOption = None,
) -> None:
    """How steadily setpoints arrive beside training, four busy threads, a disk that is written, and the recorder.

    Stamped by the kernel at a simulated autopilot. Bars: p99 50 ms, p99.9 75 ms, max 250 ms between two.
    """
    from uav_recon.bench.setpoints import setpoint_bench

    exit_with(lambda: setpoint_bench.bench_setpoints(minutes, negative, autopilot, json))


@bench.command("uncertainty")
def bench_uncertainty(
    scene: SceneOption = None,
    after: Annotated[
        str, typer.Option(metavar="N,N,...", help="Views after which the unfinished map is asked, with commas between.")
    ] = "20,30",
    camera: Annotated[str, typer.Option(help="d435i or wide, as `bench mapper` has them.")] = "d435i",
    depth_noise: Annotated[str, typer.Option(help="d435i, paper, kinect or none.")] = "d435i",
    mount: Annotated[str, typer.Option(metavar="fixed:DEG|gimbal", help="Camera mount.")] = "fixed:15",
    pose_noise: PoseNoiseOption = "0,0",
    steps_per_view: Annotated[int, typer.Option(help="Training steps after each view.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of places, noise and learning.")] = 0,
    json: JsonOption = None,
) -> None:
    """Which measure of uncertainty ranks true errors: AUSE and Spearman of each, on unfinished maps.

    Measures: the paper's colour sigma asked of the network at surface points; colour sigma kept in a grid; the information
    that depth images gave to a lattice; the product of these two; how many measurements there are and whether they agree.
    `All` is every vertex of the field's surface in the room's box, also where nobody looked; `observed` is what the planner
    is given.

    Example: `uav-recon bench uncertainty --scene ../shared/scenes/two_rooms --after 20,30`
    """
    from uav_recon.bench.mapper import mapper_bench as bench_of_mapper
    from uav_recon.bench.mapper import uncertainty_bench as bench_of_uncertainty

    def measure() -> int:
        views = bench_of_uncertainty.views_of(after)
        wanted = bench_of_mapper.MapperBench(
            scene, max(*views, 4), camera, depth_noise, mount, pose_noise, steps_per_view, seed, "cpu", json
        )
        return bench_of_uncertainty.bench_uncertainty(wanted, views)

    exit_with(measure)


def main() -> None:
    """Entry point."""
    use_writable_cache()
    end(app)


if __name__ == "__main__":
    main()
