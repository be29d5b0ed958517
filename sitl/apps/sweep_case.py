"""One flight of a sweep: what is to be flown, what came of it, and flying it in a process that may fail."""

from __future__ import annotations

import dataclasses
import os
import tempfile
import traceback
from dataclasses import dataclass
from pathlib import Path

ONE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Case:
    """scene: as `sim --scene` has it, None for the built-in room. views None: as many as `sim` would take."""

    scene: str | None
    seed: int
    radius_m: float
    variant: str
    mount: str
    camera: str
    views: int | None
    autopilot: str = "px4"

    def command(self) -> str:
        """What flies it once more, with a report."""
        scene = [] if self.scene is None else ["--scene", self.scene]
        views = [] if self.views is None else ["--views", str(self.views)]
        words = [
            "uav-recon", "sim", "--lockstep", "--mapper", "stand-in", *scene, "--seed", str(self.seed),
            "--radius", f"{self.radius_m:g}", "--variant", self.variant, "--mount", self.mount, "--camera", self.camera,
            "--autopilot", self.autopilot, *views,
        ]  # fmt: skip
        return " ".join(words)


@dataclass(frozen=True)
class Record:
    """What came of a case; error is the last line of an exception, "" where there was none. Unknown numbers are None.

    times_real: simulated time over wall time of the flight alone; times_real_processor: over this process's own time.
    recall_90_s: when the surface first recalled 90 % of the truth. commit: that flew it, as host_info.commit() gives it.
    """

    case: Case
    outcome: str = ""
    stop_reason: str = ""
    flight_s: float | None = None
    path_m: float | None = None
    views: int | None = None
    explored: float | None = None
    recall_90_s: float | None = None
    min_clearance_m: float | None = None
    contacts: int | None = None
    refusals: int | None = None
    failsafes: int | None = None
    hover_wait_s: float | None = None
    planning_s: float | None = None
    times_real: float | None = None
    times_real_processor: float | None = None
    commit: str = ""
    error: str = ""
    trace: str = ""

    @property
    def bad(self) -> bool:
        """Touched something, or broke."""
        return bool(self.error) or bool(self.contacts)


def fly_case(case: Case, truth: bool) -> Record:
    """Fly it in this process; an exception becomes the record's error. truth: measure what was explored and recalled too."""
    try:
        with tempfile.TemporaryDirectory(prefix="uav_recon-") as folder:
            return _fly(case, Path(folder), truth)
    except Exception as error:  # a sweep goes on: what broke is in its record, with the command that shows it
        return Record(case, error=f"{type(error).__name__}: {error}".splitlines()[0], trace=traceback.format_exc())


def _fly(case: Case, folder: Path, truth: bool) -> Record:
    from rich.console import Console

    from sitl.apps.flight_judge import against_truth, flown, visible_truth
    from sitl.apps.lockstep import fly_in_lockstep
    from sitl.apps.sim_options import SimOptions
    from sitl.scene.scene import load_scene
    from uav_recon import config as product_config

    options = SimOptions.parse(
        scene=case.scene, seed=case.seed, radius=case.radius_m, variant=case.variant, mount=case.mount, camera=case.camera,
        views=case.views, autopilot=case.autopilot, mapper="stand-in", lockstep=True, out=folder / "flight",
    )  # fmt: skip
    scene = load_scene(options.scene, options.start, options.fence, options.radius_m, fine=False)
    options.make_folder()
    config = options.config(scene, folder)
    product_config.save(config, options.out / "config.toml")
    flight = fly_in_lockstep(options, config, scene, Console(quiet=True), lambda: False, timelapse=truth)
    report = flown(options, scene, flight.wall_s, flight.fault)
    if truth:
        report = against_truth(report, options, scene, visible_truth(options, scene))
    safety, planning = report.safety, report.planning
    return Record(
        case, report.outcome, report.stop_reason, report.flight_time_s, report.path_length_m, report.views,
        report.explored_fraction, report.time_to_recall_s.get("0.90"), safety.min_clearance_m, safety.contacts,
        safety.refusals, safety.failsafes, planning.hover_wait_s, planning.total_s,
        flight.simulated_s / flight.wall_s, flight.simulated_s / flight.processor_s,
    )  # fmt: skip


def one_thread() -> None:
    """Let each process of a sweep compute on one core; for the processes that are started from here on."""
    for name in ONE_THREAD:
        os.environ[name] = "1"


def as_tree(record: Record) -> dict[str, object]:
    """For JSON."""
    return dataclasses.asdict(record)


def from_tree(tree: dict[str, object]) -> Record:
    """The inverse. Raises TypeError for a tree of another shape."""
    case = tree["case"]
    if not isinstance(case, dict):
        raise TypeError("case")
    return Record(**{**tree, "case": Case(**case)})  # type: ignore[arg-type]
