"""`uav-recon bench mapper`: accuracy, speed and calibration of uncertainty on one scene."""

from __future__ import annotations

import math
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from sitl.bench.mapper import mapper_tables, seeded_views, training_run, tsdf_baseline
from uav_recon.app.option_validation import UsageError, require_writable_file
from uav_recon.evaluation.triangle_surface import TriangleSurface
from uav_recon.measurement import host_info, result_file
from uav_recon.measurement.machine_speed import measure_machine_speed

PRINTED_WIDTH = 100  # if the output is not a terminal
VIEWS = (4, 2000)
STEPS = (1, 200)
# max. standard deviation of the pose noise
CENTIMETRES = 10.0
DEGREES = 5.0
MAX_EV = 2.0
SIGMA_SEEDS = 3  # the median of the paper's sigma varies by a tenth between seeds

Result = dict[str, Any]


@dataclass(frozen=True)
class MapperBench:
    """The command-line options."""

    scene: str | None
    views: int
    camera: str
    depth_noise: str
    mount: str
    pose_noise: str
    steps_per_view: int
    seed: int
    device: str
    json: Path | None
    exposure: float = 0.0
    camera_errors: str | None = None

    @property
    def camera_error_scale(self) -> float:
        """Scale of the camera's errors. Raises UsageError."""
        from sitl.apps.sim_options import camera_error_scale

        return camera_error_scale(self.camera_errors)

    def checked(self) -> seeded_views.SceneOptions:
        """Return the scene options. Raises UserError with one line for bad input."""
        require_writable_file("--json", self.json)
        if not VIEWS[0] <= self.views <= VIEWS[1]:
            raise UsageError(f"--views {self.views}: want {VIEWS[0]} to {VIEWS[1]}")
        if not STEPS[0] <= self.steps_per_view <= STEPS[1]:
            raise UsageError(f"--steps-per-view {self.steps_per_view}: want {STEPS[0]} to {STEPS[1]}")
        if not 0.0 <= self.exposure <= MAX_EV:
            raise UsageError(f"--exposure {self.exposure:g}: want 0 to {MAX_EV:g}")
        if self.device != "cpu":
            raise UsageError(f"--device {self.device}: want cpu; the mapper has no other path yet")
        return seeded_views.SceneOptions(
            self.scene,
            self.views,
            self.camera,
            self.depth_noise,
            self.mount,
            _pose_sigma(self.pose_noise),
            self.seed,
            self.camera_errors,
        )


def bench_mapper(wanted: MapperBench) -> int:
    """Measure, print tables, write JSON. Raises UserError with one line for bad input."""
    options = wanted.checked()
    console = Console(stderr=True)
    with console.status("loading ...") as status:
        scene = seeded_views.load(options, lambda what: status.update(f"{what} ..."))
        status.update("compiling ...")
        began_s = time.perf_counter()
        training_run.warm_up(scene.keyframes[0])
        compile_s = time.perf_counter() - began_s
        machine_speed = measure_machine_speed()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as progress:
        ev = seeded_views.exposures(scene, wanted.exposure, wanted.seed)
        shown = seeded_views.exposed(scene, ev) if wanted.exposure else scene
        result = _measured(shown, wanted, machine_speed.cpu_slowdown, progress)
        result["about"] |= _compared(scene, shown, options, wanted, progress)
    result["about"] = _about(scene, wanted) | {"compile_s": compile_s} | result["about"]
    mapper_tables.show(Console(width=None if sys.stdout.isatty() else PRINTED_WIDTH), result)
    if wanted.json is not None:
        result_file.save(wanted.json, result)
    return 0


def ticking(progress: Progress, name: str, total: int) -> training_run.Tick:
    """Add a progress bar and return its tick function, which draws the bar.

    A thread that draws it would disturb the measured times.
    """
    task = progress.add_task(name, total=total)

    def tick() -> None:
        progress.advance(task)
        progress.refresh()

    return tick


def _measured(scene: seeded_views.MapperScene, wanted: MapperBench, slowdown_before: float, progress: Progress) -> Result:
    """Return the fields of the result; times are processor milliseconds of this machine.

    The entry ``about`` has the same times calibrated and as wall-clock time, and the TSDF baseline. The speed of a shared
    machine varies, so the divisor is the geometric mean of one measurement before and one after.
    """
    views = len(scene.keyframes)
    run = training_run.online(scene, wanted.steps_per_view, wanted.seed, ticking(progress, "view by view", views))
    room = training_run.room_extraction(run.trainer)
    mesh = run.trainer.mesh(training_run.MESH_VOXEL_M)
    quality = training_run.against_truth(TriangleSurface(mesh.vertices_world, mesh.faces), scene)
    psnr_db = training_run.picture_psnr_db(run.trainer, run.trainer.painted(), scene.pictures)
    unpainted_db = training_run.picture_psnr_db(run.trainer, run.trainer.field, scene.pictures)
    looks = training_run.RECALL_STEPS // training_run.RECALL_EVERY
    recalls = training_run.time_to_recall(scene, wanted.seed, ticking(progress, "all views at once", looks))
    factor = math.sqrt(slowdown_before * measure_machine_speed().cpu_slowdown)
    baseline = training_run.against_truth(
        tsdf_baseline.tsdf_surface(scene.keyframes, ticking(progress, "TSDF beside it", views)), scene
    )
    times: Result = {
        "step_ms": run.step.median_ms,
        "view_update_ms": run.view_update.median_ms,
        "time_to_recall_s": recalls,
        "extraction_ms": {"room": room.median_ms, "view": run.extraction_view.median_ms},
    }
    return {
        **times,
        "accuracy_cm": quality.accuracy_cm,
        "completion_cm": quality.completion_cm,
        "recall_seen_5cm": quality.recall_seen_5cm,
        "psnr_db": psnr_db,
        "ause_all": run.ause_all,
        "ause_observed": run.ause_observed,
        "hallucinated_fraction": quality.hallucinated_fraction,
        "memory_mb": run.memory_mb,
        "about": {
            "calibrated": _divided(times, factor),
            "calibration_cpu": factor,
            "wall_ms": {"step": run.step_wall.median_ms, "view_update": run.view_update_wall.median_ms},
            "p95_ms": {
                "step": run.step.p95_ms,
                "view_update": run.view_update.p95_ms,
                "extraction_room": room.p95_ms,
                "extraction_view": run.extraction_view.p95_ms,
            },
            "psnr_unpainted_db": unpainted_db,
            "tsdf_2cm": asdict(baseline),
        },
    }


def _compared(
    plain: seeded_views.MapperScene,
    shown: seeded_views.MapperScene,
    options: seeded_views.SceneOptions,
    wanted: MapperBench,
    progress: Progress,
) -> Result:
    """Measure the benefit of pose and exposure corrections, if poses or exposures have errors.

    The same views are learned without corrections, and the colour sigmas with and without exposure errors.
    """
    result: Result = {}
    views, steps, seed = len(plain.keyframes), wanted.steps_per_view, wanted.seed
    if options.pose_sigma != (0.0, 0.0) or wanted.exposure:
        trainer = training_run.learned(shown, steps, seed, False, ticking(progress, "without corrections", views))
        mesh = trainer.mesh(training_run.MESH_VOXEL_M)
        quality = training_run.against_truth(TriangleSurface(mesh.vertices_world, mesh.faces), plain)
        result["uncorrected"] = asdict(quality) | {
            "psnr_db": training_run.picture_psnr_db(trainer, trainer.painted(), shown.pictures)
        }
    if wanted.exposure:
        sigmas = [
            training_run.colour_sigmas(
                scene, steps, range(seed, seed + SIGMA_SEEDS), ticking(progress, name, views * SIGMA_SEEDS)
            )
            for scene, name in ((plain, "one exposure"), (shown, "many exposures"))
        ]
        result["colour_sigma"] = {"one_exposure": sigmas[0], "many_exposures": sigmas[1]}
    return result


def _about(scene: seeded_views.MapperScene, wanted: MapperBench) -> Result:
    return {
        "scene": scene.name,
        "views": len(scene.keyframes),
        "camera": wanted.camera,
        "depth_noise": wanted.depth_noise,
        "mount": wanted.mount,
        "pose_noise": wanted.pose_noise,
        "exposure": wanted.exposure,
        "camera_errors": wanted.camera_error_scale,
        "steps_per_view": wanted.steps_per_view,
        "seed": wanted.seed,
        "device": wanted.device,
        "seen_points": len(scene.points),
        "held_out_pixels": len(scene.pictures.rgb),
        "machine": host_info.processor(),
        "commit": host_info.commit(),
    }


def _divided(tree: Result, factor: float) -> Result:
    """Divide every time in a tree by the slowdown of the machine."""
    return {
        name: _divided(value, factor) if isinstance(value, dict) else None if value is None else value / factor
        for name, value in tree.items()
    }


def _pose_sigma(words: str) -> tuple[float, float]:
    try:
        centimetres, degrees = (float(word) for word in words.split(","))
    except ValueError:
        centimetres = degrees = -1.0
    if not (0.0 <= centimetres <= CENTIMETRES and 0.0 <= degrees <= DEGREES):
        raise UsageError(f"--pose-noise {words}: want CM,DEG, 0 or more and at most {CENTIMETRES:g} and {DEGREES:g}")
    return centimetres * 0.01, math.radians(degrees)
