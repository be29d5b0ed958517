"""`uav-recon bench ...`: measurements of this software on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sitl.apps import sim_options
from uav_recon.cli import choices
from uav_recon.cli.command_options import CameraErrorsOption
from uav_recon.cli.commands import add, new_group
from uav_recon.cli.exit_codes import exit_with
from uav_recon.cli.recording_options import DepthUnitOption
from uav_recon.cli.services import FlightArgument

JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", readable=False, help="Write all measured values to FILE.")
]
SceneOption = Annotated[
    str | None,
    typer.Option(metavar="PATH|random:SEED|flat:SEED|small:SEED", help="Scene as for `sim`. Default: the built-in room."),
]
PoseNoiseOption = Annotated[
    str, typer.Option(metavar="CM,DEG", help="Standard deviation of the error of the given poses, per axis.")
]
BenchCameraOption = Annotated[
    str,
    typer.Option(
        metavar="d435i|wide", autocompletion=choices.one_of(("d435i", "wide")),
        help="d435i: colour narrower than depth. wide: one registered RGB-D camera.",
    ),
]  # fmt: skip
DepthNoiseOption = Annotated[
    str,
    typer.Option(
        metavar=choices.listed(sim_options.NOISES), autocompletion=choices.one_of(sim_options.NOISES),
        help="Noise model of the depth images.",
    ),
]  # fmt: skip
MountOption = Annotated[
    str,
    typer.Option(
        metavar="fixed:DEG|gimbal", autocompletion=choices.one_of(sim_options.MOUNTS),
        help="Camera mount. With a gimbal the views have random tilts.",
    ),
]  # fmt: skip
StepsOption = Annotated[int, typer.Option(metavar="N", help="Training steps after each view, 1 to 200.")]


def bench_planner(
    stream: Annotated[
        Path | None,
        typer.Option(
            readable=False, metavar="FOLDER",
            help="Recorded stream: a folder with meta.json, poses.npy and depth_WxH.npz. Default: a built-in building.",
        ),
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Image size of the stream; needs --stream. Default: 640x480.")
    ] = None,
    stride: Annotated[
        int | None,
        typer.Option(metavar="N", help="Use every Nth pixel of a row and every Nth row, 1 to 8; needs --stream. Default: 2."),
    ] = None,
    scale: Annotated[
        bool, typer.Option("--scale", help="Measure growth: the same building at 1, 10 and 100 times its size.")
    ] = False,
    json: JsonOption = None,
) -> None:  # fmt: skip
    """Benchmark the planner: time per depth frame from fusion to tour, and quality of the plans.

    Computing time is measured on one thread.
    """
    from uav_recon.bench.planner import planner_bench as bench_of_planner

    exit_with(lambda: bench_of_planner.bench_planner(stream, size, stride, scale, json))


def bench_tasks(flight: FlightArgument, json: JsonOption = None) -> None:
    """Benchmark the search for views of the learned surface, along a recorded flight.

    Computing time is measured on one thread.
    """
    from uav_recon.bench.planner import task_bench

    exit_with(lambda: task_bench.bench_tasks(flight, json))


def bench_mapper(
    scene: SceneOption = None,
    views: Annotated[
        int, typer.Option(metavar="N", help="Number of views, 4 to 2000, at random positions that the vehicle can reach.")
    ] = 80,
    camera: BenchCameraOption = "d435i",
    depth_noise: DepthNoiseOption = "d435i",
    camera_errors: CameraErrorsOption = None,
    mount: MountOption = "fixed:15",
    pose_noise: PoseNoiseOption = "0,0",
    exposure: Annotated[
        float, typer.Option(metavar="EV", help="Random exposure of each image, uniform within ±EV stops, 0 to 2.")
    ] = 0.0,
    steps_per_view: StepsOption = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of positions, noise and training; one seed, one result.")] = 0,
    device: Annotated[str, typer.Option(metavar="cpu", help="Only cpu is implemented.")] = "cpu",
    json: JsonOption = None,
) -> None:
    """Benchmark the neural mapper on one scene: accuracy, speed, and calibration.

    Calibration: how well the uncertainty predicts the error. The reference is a 2 cm TSDF of the same frames. The first run
    adds one view at a time, as in flight, with training steps after each. The second run adds all views at once and measures
    the time to reach a recall. With --pose-noise or --exposure, a run without the correction of poses or exposure is added.
    Recall, completion and images count only observed surface. Times are processor time on one thread.
    """
    from sitl.bench.mapper import mapper_bench as bench_of_mapper

    exit_with(
        lambda: bench_of_mapper.bench_mapper(
            bench_of_mapper.MapperBench(
                scene,
                views,
                camera,
                depth_noise,
                mount,
                pose_noise,
                steps_per_view,
                seed,
                device,
                json,
                exposure,
                camera_errors,
            )
        )
    )


def bench_endurance(
    scene: SceneOption = None,
    hours: Annotated[
        float,
        typer.Option(metavar="H", help="Simulated hours of keyframes; they are processed as fast as the mapper takes them."),
    ] = 2.0,
    period_s: Annotated[
        float, typer.Option("--period-s", metavar="S", help="Simulated seconds between keyframes, 0.1 to 60.")
    ] = 1.5,
    views: Annotated[
        int, typer.Option(metavar="N", help="Number of different views, 4 to 2000; they are repeated.")
    ] = 160,
    camera: BenchCameraOption = "d435i",
    depth_noise: DepthNoiseOption = "d435i",
    camera_errors: CameraErrorsOption = None,
    steps_per_view: StepsOption = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of positions, noise, order and training.")] = 0,
    json: JsonOption = None,
) -> None:  # fmt: skip
    """Check that the mapper's costs and accuracy stay constant over hours of keyframes.

    Costs are memory, disk and time per view.
    """
    from sitl.bench.mapper import endurance as bench_of_endurance
    from sitl.bench.mapper import mapper_bench as bench_of_mapper

    wanted = bench_of_mapper.MapperBench(
        scene, views, camera, depth_noise, "fixed:15", "0,0", steps_per_view, seed, "cpu", json, camera_errors=camera_errors
    )
    exit_with(lambda: bench_of_endurance.bench_endurance(wanted, hours, period_s))


def bench_setpoints(
    minutes: Annotated[float, typer.Option(metavar="MIN", help="Duration of the hover, 0.1 to 120 minutes.")] = 10.0,
    negative: Annotated[
        bool, typer.Option("--negative", help="Negative control: run the pilot in a thread of the load; it must miss limits.")
    ] = False,
    autopilot: Annotated[
        str,
        typer.Option(
            metavar=choices.listed(choices.AUTOPILOTS), autocompletion=choices.one_of(choices.AUTOPILOTS),
            help="Simulated autopilot.",
        ),
    ] = "px4",
    json: JsonOption = None,
) -> None:  # fmt: skip
    """Benchmark setpoint timing under load, during a simulated hover.

    The load is training, four busy threads, disk writes and the recorder. Setpoints are time-stamped by the kernel at a
    simulated autopilot. Limits for the gap between two: p99 50 ms, p99.9 75 ms, maximum 250 ms.
    """
    from sitl.bench.setpoints import setpoint_bench

    exit_with(lambda: setpoint_bench.bench_setpoints(minutes, negative, autopilot, json))


def bench_uncertainty(
    scene: SceneOption = None,
    after: Annotated[
        str, typer.Option(metavar="N,N,...", help="Numbers of views after which the unfinished map is evaluated.")
    ] = "20,30",
    camera: BenchCameraOption = "d435i",
    depth_noise: DepthNoiseOption = "d435i",
    camera_errors: CameraErrorsOption = None,
    mount: MountOption = "fixed:15",
    pose_noise: PoseNoiseOption = "0,0",
    steps_per_view: StepsOption = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of positions, noise and training.")] = 0,
    json: JsonOption = None,
) -> None:
    """Compare uncertainty measures by how well they rank true errors.

    Scores: AUSE (area under the sparsification error curve) and Spearman correlation, on unfinished maps.

    Measures: the paper's colour sigma, evaluated by the network at surface points; colour sigma kept in a grid; the
    information that depth images gave to a lattice; the product of these two; number and agreement of measurements. `All`
    is every vertex of the field's surface in the room's box, observed or not; `observed` is what the planner gets.
    """
    from sitl.bench.mapper import mapper_bench as bench_of_mapper
    from sitl.bench.mapper import uncertainty_bench as bench_of_uncertainty

    def measure() -> int:
        views = bench_of_uncertainty.views_of(after)
        wanted = bench_of_mapper.MapperBench(
            scene,
            max(*views, 4),
            camera,
            depth_noise,
            mount,
            pose_noise,
            steps_per_view,
            seed,
            "cpu",
            json,
            camera_errors=camera_errors,
        )
        return bench_of_uncertainty.bench_uncertainty(wanted, views)

    exit_with(measure)


def bench_slam(
    scene: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH|random:SEED|flat:SEED|small:SEED|built-in",
            help="Scene as for `sim`; repeat the option for several. Default: built-in."
        ),
    ] = None,
    seeds: Annotated[int, typer.Option(metavar="N", help="Seeds of camera errors and noise, 1 to 100: 0 to N-1.")] = 1,
    paths: Annotated[int, typer.Option(metavar="N", help="Random paths through each scene, 1 to 100.")] = 1,
    length: Annotated[float, typer.Option(metavar="M", help="Length of a path, 2 to 200 m, flown at 0.6 m/s.")] = 20.0,
    camera_errors: CameraErrorsOption = None,
    mount: Annotated[
        str,
        typer.Option(
            metavar=choices.listed(sim_options.MOUNTS), autocompletion=choices.one_of(sim_options.MOUNTS), help="Camera mount."
        ),
    ] = "fixed:15",
    fault: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", autocompletion=choices.one_of(choices.SEQUENCE_FAULTS),
            help=f"Fault of the images: {', '.join(choices.SEQUENCE_FAULTS)}. black: no colour. "
            "The last three come for 1 s, every 10 s.",
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            metavar=choices.listed(choices.TRACKERS), autocompletion=choices.one_of(choices.TRACKERS),
            help="Tracker: the product's, or Open3D's RGB-D odometry as a baseline. Default: both.",
        ),
    ] = None,
    cache: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", readable=False, help="Keep recorded sequences there (0.4 GB each) and reuse them."),
    ] = None,
    recording: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FOLDER", readable=False,
            help="A recording as for `replay`: TUM RGB-D, 7-Scenes, bag; repeat the option for several.",
        ),
    ] = None,
    intrinsics: Annotated[
        str | None, typer.Option(metavar="FX,FY,CX,CY", help="Of recordings that have none, in pixels.")
    ] = None,
    depth_unit: DepthUnitOption = None,
    gyro: Annotated[
        str,
        typer.Option(
            metavar="none|reference",
            help="reference: make a gyro with noise and bias from a recording's reference poses. The result names it.",
        ),
    ] = "none",
    json: JsonOption = None,
) -> None:  # fmt: skip
    """Benchmark the embedded SLAM on rendered sequences, or on recordings.

    The poses are compared with the true ones, or with the reference of the recording. With --recording: absolute trajectory
    error (ATE) and relative pose error over 1 s (RPE) by the conventions of evo, time without a pose, and processor time of a
    frame. Without it, a simulated vehicle rests for 2 s, climbs and flies a random path; its camera has the errors of a real
    one. Reported: ATE after rigid alignment, drift over 2 m of path, rotation error, processor time of a frame, share of lost
    frames, and share of frames that are reported good with an error above 0.3 m. With a fault that comes in windows: the times
    until it is reported and until the pose is back. Recording takes half a minute a sequence.
    """
    from sitl.bench.slam import slam_bench

    exit_with(
        lambda: slam_bench.bench_slam(
            slam_bench.SlamBench(
                tuple(scene or ()), seeds, paths, length, camera_errors, mount, fault,
                tuple(method or choices.TRACKERS), cache, json, tuple(recording or ()), intrinsics, gyro, depth_unit,
            )
        )
    )  # fmt: skip


bench = new_group("Benchmark this software on this machine.")
add(
    bench, bench_planner, "planner",
    examples=(
        "uav-recon bench planner", "uav-recon bench planner --scale", "uav-recon bench planner --stream FOLDER --size 320x240",
    ),
)  # fmt: skip
add(bench, bench_tasks, "tasks", examples=("uav-recon bench tasks flights/room-20260101-120000",))
add(
    bench, bench_mapper, "mapper",
    examples=(
        "uav-recon bench mapper --views 20",
        "uav-recon bench mapper --scene ../shared/scenes/meeting_room --camera wide --depth-noise kinect",
    ),
)  # fmt: skip
add(
    bench, bench_endurance, "endurance",
    examples=("uav-recon bench endurance --hours 0.5 --scene random:3 --steps-per-view 5",),
)  # fmt: skip
add(
    bench,
    bench_setpoints,
    "setpoints",
    examples=("uav-recon bench setpoints --minutes 1", "uav-recon bench setpoints --negative"),
)
add(
    bench,
    bench_uncertainty,
    "uncertainty",
    examples=("uav-recon bench uncertainty --scene ../shared/scenes/two_rooms --after 20,30",),
)
add(
    bench, bench_slam, "slam",
    examples=(
        "uav-recon bench slam",
        "uav-recon bench slam --scene ../shared/scenes/meeting_room --scene built-in --seeds 2 --paths 3 --method joint",
        "uav-recon bench slam --recording rgbd_dataset_freiburg1_xyz --method joint",
        "uav-recon bench slam --fault covered --cache /var/tmp/sequences --json slam.json",
    ),
)  # fmt: skip
