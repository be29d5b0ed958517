"""`uav-recon refine`: trains on the views of a flight again, for longer and on every GPU.

A composition root. With more than one GPU the command starts itself again under torchrun, one process for each.
"""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from uav_recon.app import config_file, mapper_factory
from uav_recon.app.option_validation import readable
from uav_recon.app.processes import Stop, claim_file
from uav_recon.app.step_display import Report, StepDisplay, no_report
from uav_recon.errors import EXIT_USAGE, UserError

if TYPE_CHECKING:
    from uav_recon.config import Config
    from uav_recon.mapping.neural.sdf_interface import SdfField
    from uav_recon.mapping.neural.sdf_torch.checkpoint import RefineCheckpoints, State
    from uav_recon.mapping.neural.sdf_torch.distributed import ProcessGroup
    from uav_recon.mapping.neural.sdf_torch.refiner import RefinePlan, Refiner
    from uav_recon.mapping.neural.training_data import TrainingData
    from uav_recon.mapping.neural.watertight.watertight_mesh import ClosedMesh

REFINED = "refined"
MESH_PLY = "mesh.ply"
MESH_GLB = "mesh.glb"
STOP_FILE = ".stop"
LOCK_FILE = ".lock"
STEPS = (1, 1_000_000)
VOXEL_M = (0.005, 0.05)
SAVE_EVERY_S = (1.0, 3600.0)
PROCESSES = (1, 64)
PROCESS_GB = 1.0  # memory that one process may use
RAYS = {"cpu": 1024, "cuda": 4096}  # rays per step and process
SLICE_STEPS = 20  # steps between two checks of the clock and of Ctrl-C
TEXEL_VOXELS = 0.5  # side of a texel
WORKER = "UAV_RECON_REFINE_WORKER"  # set for the processes that torchrun starts


@dataclass(frozen=True)
class RefineOptions:
    """Options of the command line."""

    flight: Path
    steps: int
    voxel_m: float
    device: str
    processes: int | None
    save_every_s: float

    def checked(self) -> RefineOptions:
        """Return the options if they are valid. Raises UserError in one line."""
        _in_range("--steps", self.steps, STEPS)
        _in_range("--voxel", self.voxel_m, VOXEL_M)
        _in_range("--save-every", self.save_every_s, SAVE_EVERY_S)
        if self.processes is not None:
            most = min(PROCESSES[1], max(2, int(memory_gb() / PROCESS_GB)))
            if not PROCESSES[0] <= self.processes <= most:
                why = "" if most == PROCESSES[1] else f"; each may use {PROCESS_GB:g} GB of memory"
                raise UserError(f"--processes {self.processes}: want {PROCESSES[0]} to {most}{why}", EXIT_USAGE)
        with readable(str(self.flight)):
            folder, views = self.flight.is_dir(), (self.flight / "keyframes" / "poses.json").is_file()
        if not folder:
            raise UserError(f"{self.flight}: no such flight folder", EXIT_USAGE)
        if not views:
            raise UserError(f"{self.flight}: has no keyframes (keyframes/poses.json)", EXIT_USAGE)
        return self


def refine(wanted: RefineOptions) -> int:
    """Train, mesh, and write FLIGHT/refined. Returns 0 also after Ctrl-C, which saves the state.

    Raises UserError in one line for bad input.
    """
    from uav_recon.mapping.neural.sdf_torch import distributed

    wanted.checked()
    try:
        kind = distributed.device_kind(wanted.device)
    except distributed.DeviceError as error:
        raise UserError(f"--device {error}", EXIT_USAGE) from None
    processes = wanted.processes or (distributed.gpus() if kind == "cuda" else 1)
    if kind == "cuda" and processes > distributed.gpus():
        raise UserError(f"--processes {processes}: torch sees {distributed.gpus()} GPUs", EXIT_USAGE)
    if processes > 1 and WORKER not in os.environ:
        _state(_checkpoints(wanted, kind)[2])  # errors are printed here, once
        return _under_torchrun(wanted, processes)
    return _Work(wanted, distributed.ProcessGroup(kind), kind).run()


def memory_gb() -> float:
    """Return the memory of this machine in GB."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9


def _in_range(name: str, value: float, allowed: tuple[float, float]) -> None:
    if not allowed[0] <= value <= allowed[1]:
        raise UserError(f"{name} {value:g}: want {allowed[0]:g} to {allowed[1]:.7g}", EXIT_USAGE)


def _under_torchrun(wanted: RefineOptions, processes: int) -> int:
    """Run the same command once for each GPU.

    Ctrl-C is handled by this process: it creates a file, which the others check.
    """
    stop_file = wanted.flight / REFINED / STOP_FILE
    stop_file.parent.mkdir(parents=True, exist_ok=True)
    stop_file.unlink(missing_ok=True)
    threads = str(max(1, (os.cpu_count() or 1) // processes))
    worker = [
        *("refine", str(wanted.flight), "--steps", str(wanted.steps), "--voxel", str(wanted.voxel_m)),
        *("--device", wanted.device, "--processes", str(processes), "--save-every", str(wanted.save_every_s)),
    ]
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]
    child = subprocess.Popen(  # noqa: S603 - this very command
        [*torchrun, "-m", "uav_recon", *worker],
        env={"OMP_NUM_THREADS": threads} | os.environ | {WORKER: "1"},
        start_new_session=True,
    )
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop_file.touch())
    return child.wait()


class _Work:
    """One process of a run."""

    def __init__(self, wanted: RefineOptions, process_group: ProcessGroup, kind: str) -> None:
        self._wanted = wanted
        self._process_group = process_group
        self._kind = kind
        self._folder = wanted.flight / REFINED
        self._console = Console(stderr=True, quiet=not process_group.is_main)
        self._display = StepDisplay(self._console)
        self._stop = Stop()

    def run(self) -> int:
        """Run all of it; return 0, or raise UserError."""
        from uav_recon.mapping.neural.sdf_torch.distributed import FullDeviceError
        from uav_recon.mapping.neural.sdf_torch.feature_grid import GridError
        from uav_recon.mapping.neural.watertight.watertight_mesh import MeshResolutionError

        lock = self._claim() if self._process_group.is_main else None
        try:
            self._run()
        except (GridError, MeshResolutionError) as error:
            raise UserError(f"--voxel {self._wanted.voxel_m:g}: {error}", EXIT_USAGE) from None
        except FullDeviceError:
            raise UserError(f"--voxel {self._wanted.voxel_m:g}: the GPU's memory is full; use a larger value") from None
        except OSError as error:
            raise UserError(f"{self._folder}: cannot be written ({error.strerror})") from None
        finally:
            if lock is not None:
                os.close(lock)
        return 0

    def _run(self) -> None:
        from uav_recon.mapping.neural.surface.colour_fusion import ColourFusedField
        from uav_recon.mapping.neural.watertight.watertight_mesh import closed_mesh

        gathered, refiner, checkpoints = self._prepare()
        done = self._learn(refiner, checkpoints)
        self._process_group.shutdown()
        self._stop.restore_default()
        if not done:
            self._say(f"stopped after {refiner.steps} of {self._wanted.steps} steps; the same command continues from there")
        elif self._process_group.is_main:
            with self._display.step("extracting and closing the surface"):
                painted = ColourFusedField(refiner.field, gathered.replay, gathered.low_m, gathered.high_m)
                mesh = closed_mesh(painted, gathered, self._wanted.voxel_m)
            self._write(mesh, painted, gathered)

    def _claim(self) -> int:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"{self._folder}: cannot be made ({error.strerror})") from None
        return claim_file(self._folder / LOCK_FILE, f"another refinement of {self._wanted.flight} is running")

    def _prepare(self) -> tuple[TrainingData, Refiner, RefineCheckpoints]:
        from uav_recon.mapping.neural.sdf_torch.refiner import Refiner
        from uav_recon.mapping.neural.watertight.watertight_mesh import check_size

        config, plan, checkpoints = _checkpoints(self._wanted, self._kind)
        state, said = _state(checkpoints)
        for line in said:
            self._say(line)
        with self._display.step("loading the keyframes") as progress:
            gathered = _gathered(self._wanted.flight, config, self._say, progress)
            check_size(gathered, self._wanted.voxel_m)  # now, not after the training
            refiner = Refiner(gathered, plan, self._process_group)
        if state is not None:
            refiner.restore(state)
            self._say(f"continuing after {refiner.steps} of {plan.steps} steps")
        elif said:
            self._say("starting from the beginning")
        return gathered, refiner, checkpoints

    def _learn(self, refiner: Refiner, checkpoints: RefineCheckpoints) -> bool:
        """Train and save. Return True if the plan is completed."""
        start, began_s = refiner.steps, time.monotonic()
        saved_s, saved_at = began_s, refiner.steps
        columns = (TextColumn("training"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"))
        lines = nullcontext(no_report) if self._console.is_terminal else self._display.step("training")
        with (
            Progress(*columns, TimeRemainingColumn(), console=self._console, disable=not self._console.is_terminal) as progress,
            lines as report,
        ):
            task = progress.add_task("training", total=self._wanted.steps, completed=start, rate="")
            while not refiner.done and not self._process_group.any(self._asked()):
                loss = refiner.advance(SLICE_STEPS)
                now_s = time.monotonic()
                rate = f"{(refiner.steps - start) / (now_s - began_s):.1f} steps/s, loss {loss:.3f}"
                progress.update(task, completed=refiner.steps, rate=rate)
                report(refiner.steps, self._wanted.steps)
                if self._process_group.is_main and now_s - saved_s > self._wanted.save_every_s:
                    checkpoints.save(refiner.state())
                    saved_s, saved_at = time.monotonic(), refiner.steps
        if self._process_group.is_main and saved_at != refiner.steps:
            checkpoints.save(refiner.state())
        return refiner.done

    def _asked(self) -> bool:
        return self._stop.asked or (WORKER in os.environ and (self._folder / STOP_FILE).exists())

    def _write(self, mesh: ClosedMesh, field: SdfField, gathered: TrainingData) -> None:
        from uav_recon.mapping.neural.watertight.mesh_export import write_closed_ply, write_textured_glb
        from uav_recon.recording.mesh_renders import render_mesh_images

        write_closed_ply(self._folder / MESH_PLY, mesh)
        with self._display.step("baking the texture and drawing images"):
            write_textured_glb(self._folder / MESH_GLB, mesh, field, TEXEL_VOXELS * self._wanted.voxel_m)
            render_mesh_images(self._folder, mesh.seen(), gathered.replay.views.position[0].astype(np.float64))
        self._say(f"{self._folder / MESH_PLY}, {MESH_GLB}: {len(mesh.faces)} faces, {100 * mesh.seen_share():.0f} % of the "
                  "area observed, the rest closes the surface")  # fmt: skip

    def _say(self, line: str) -> None:
        self._console.print(line, highlight=False, soft_wrap=True, markup=False)


def _checkpoints(wanted: RefineOptions, kind: str) -> tuple[Config, RefinePlan, RefineCheckpoints]:
    """Return the flight's config, the plan, and its checkpoints."""
    from uav_recon.mapping.neural.sdf_torch.checkpoint import RefineCheckpoints
    from uav_recon.mapping.neural.sdf_torch.refiner import RefinePlan

    config = config_file.load_config(wanted.flight / "config.toml")
    plan = RefinePlan(wanted.steps, wanted.voxel_m, RAYS[kind], config.mapper.seed)
    return config, plan, RefineCheckpoints(wanted.flight / REFINED, plan.identity(_digest(wanted.flight, config)))


def _state(checkpoints: RefineCheckpoints) -> tuple[State | None, list[str]]:
    """Return the newest state, and messages about it. Raises UserError if it is of another run."""
    from uav_recon.mapping.neural.sdf_torch.checkpoint import CheckpointMismatchError

    try:
        return checkpoints.load()
    except CheckpointMismatchError as error:
        raise UserError(str(error), EXIT_USAGE) from None


def _gathered(flight: Path, config: Config, say: Callable[[str], None], progress: Report) -> TrainingData:
    """Load every readable view. Raises UserError if there is none."""
    from uav_recon.mapping.keyframe_store import KeyframeError, KeyframeFolder

    trainer = mapper_factory.make_neural_mapper(config)
    try:
        folder = KeyframeFolder(flight / "keyframes")
    except KeyframeError as error:
        raise UserError(str(error)) from None
    if not len(folder):
        raise UserError(f"{flight}: has no keyframes (keyframes/poses.json lists none)")
    for number in range(len(folder)):
        progress(number, len(folder))
        try:
            trainer.add(folder.load(number))
        except KeyframeError as error:
            say(str(error))  # one view less
    if trainer.views == 0:
        raise UserError(f"{flight}: none of its {len(folder)} keyframes can be used")
    return trainer.training_data()


def _digest(flight: Path, config: Config) -> str:
    """Return a digest of the training data: views, box and camera."""
    parts = (config.safety.fence_min_m, config.safety.fence_max_m, config.camera.depth_noise_px, config.camera.baseline_m)
    data = (flight / "keyframes" / "poses.json").read_bytes() + repr(parts).encode()
    return hashlib.sha256(data).hexdigest()[:12]
