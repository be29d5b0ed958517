"""Compile the kernels of a simulated flight under a progress bar.

These are the simulator's and the product's kernels.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import cast

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from sitl.apps.flight_config import flight_config
from sitl.apps.sim_options import SimOptions
from sitl.camera import d435i, depth_surfels
from sitl.scene.scene import Scene, load_scene
from sitl.truth.hull_clearance import HullClearance
from uav_recon import config as product_config
from uav_recon.app import kernel_jobs
from uav_recon.app.kernel_cache import KernelJob, compile_kernels, log_failure, progress_text
from uav_recon.app.step_display import StepDisplay
from uav_recon.config import VariantName
from uav_recon.errors import UserError

LINE_EVERY_S = 5.0  # on a console that is no terminal
SIMULATOR = KernelJob("simulator", f"{__name__}:simulator", 25)
DEPTH_ONLY_MAPPER = KernelJob("depth-only mapper", f"{__name__}:depth_only_mapper", 3)


def simulator(_config_path: Path, _: str) -> None:
    """Compile the kernels of the scene, the camera and the collision check."""
    scene = load_scene(None, fine=False)
    d435i.warm_up()
    clearance = HullClearance(scene)
    clearance.hull_m(np.zeros(3))
    clearance.standing_m((0.0, 0.0, 0.0))


def depth_only_mapper(_config_path: Path, _: str) -> None:
    """Compile the kernels of the depth-only mapper."""
    depth_surfels.warm_up()


def flight_jobs(variants: Sequence[str] = ("adaptive",), neural: bool = True) -> list[KernelJob]:
    """Return the jobs of flights with these planner variants.

    neural: with the neural mapper, else with the depth-only one.
    """
    jobs = [job for variant in variants for job in kernel_jobs.mission_jobs(cast(VariantName, variant))]
    mission = dict.fromkeys(job for job in jobs if neural or job.name != kernel_jobs.MAPPER)
    last = [*kernel_jobs.perception_jobs(), *([] if neural else [DEPTH_ONLY_MAPPER])]
    return [SIMULATOR, *mission, *last]  # the scene is loaded after the first job, beside the others


def compile_ahead(jobs: Sequence[KernelJob], console: Console) -> None:
    """Compile what is not in the cache yet, and show the progress."""
    _compile(jobs, console, lambda: False, lambda _job: None)


def compile_all() -> None:
    """Compile the kernels of a flight with default options, and report the time.

    Raises UserError that names each job that failed, with its reason.
    """
    begun_s, console, failures = time.monotonic(), Console(), list[str]()

    def failed(job: KernelJob, reason: str) -> None:
        failures.append(f"{job.name} ({reason})")

    _compile(flight_jobs(), console, lambda: False, lambda _job: None, failed)
    if failures:
        raise UserError(f"kernels are not compiled: {', '.join(failures)}")
    console.print(f"all kernels are compiled: {time.monotonic() - begun_s:.0f} s", highlight=False)


def compile_and_load(jobs: Sequence[KernelJob], console: Console, load: Callable[[], Scene]) -> Scene:
    """Compile what is not in the cache yet, and load the scene meanwhile.

    It shows the progress of both. The scene needs the simulator's kernels: it is loaded as soon as these are compiled.
    Raises what load() raises, at once.
    """
    loading: Future[Scene] = Future()

    def start(job: KernelJob) -> None:
        if job is SIMULATOR:
            threading.Thread(target=_complete, args=(loading, load), name="scene", daemon=True).start()

    def failed() -> bool:
        return loading.done() and loading.exception() is not None

    _compile(jobs, console, failed, start)
    with StepDisplay(console).step("loading the scene"):
        return loading.result()


def _complete(future: Future[Scene], work: Callable[[], Scene]) -> None:
    try:
        future.set_result(work())
    except BaseException as error:  # raised again by the thread that asks for the result
        future.set_exception(error)


def _compile(
    jobs: Sequence[KernelJob],
    console: Console,
    stopped: Callable[[], bool],
    ended: Callable[[KernelJob], None],
    failed: Callable[[KernelJob, str], None] = log_failure,
) -> None:
    """Compile with a progress bar.

    A console that is no terminal gets a line every LINE_EVERY_S.
    """
    columns = (TextColumn("compiling kernels (first run only)"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    task, next_s = progress.add_task("", total=None), [-np.inf]

    def show(done: int, total: int) -> None:
        if console.is_terminal:
            progress.start()
            progress.update(task, completed=done, total=total)
        elif time.monotonic() >= next_s[0]:
            next_s[0] = time.monotonic() + LINE_EVERY_S
            console.print(progress_text(done, total), highlight=False)

    with tempfile.TemporaryDirectory(prefix="uav_recon-") as folder:
        try:
            compile_kernels(jobs, toy_config(Path(folder)), show, stopped, ended, failed)
        finally:
            progress.stop()


def toy_config(folder: Path) -> Path:
    """Write a config for the jobs into a folder, and return its path.

    It is the config of a flight with default options.
    """
    options, path = SimOptions(out=folder), folder / "config.toml"
    product_config.save(flight_config(options, _toy_scene(), folder), path)
    return path


def _toy_scene() -> Scene:
    """Return an empty scene with a fence, for a config."""
    low, high = np.full(3, -1.5), np.full(3, 1.5)
    return Scene(
        "toy", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8), 0.0, low, high, low
    )
