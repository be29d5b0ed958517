"""One flight of a sweep: its options, its record, and the flight in a process that may fail."""

from __future__ import annotations

import os
import tempfile
import traceback
from dataclasses import dataclass, replace
from pathlib import Path

ONE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Case:
    """The options of a flight.

    scene: as for `sim --scene`, None for the built-in room. views None: the default of `sim`. camera_errors: the factor of
    `sim --camera-errors`. range_up_deg: as for `sim --range-up`, None for no such sensor. flow: as `sim --flow`.
    """

    scene: str | None
    seed: int
    radius_m: float
    variant: str
    mount: str
    camera: str
    views: int | None
    autopilot: str = "px4"
    camera_errors: float = 0.0
    pose: str = "stream"
    range_up_deg: float | None = None
    flow: bool = False

    def command(self) -> str:
        """Return the command that repeats the flight, with a report."""
        scene = [] if self.scene is None else ["--scene", self.scene]
        range_up = [] if self.range_up_deg is None else ["--range-up", f"{self.range_up_deg:g}"]
        flow = ["--flow"] if self.flow else []
        views = [] if self.views is None else ["--views", str(self.views)]
        words = [
            "uav-recon", "sim", "--lockstep", "--mapper", "depth-only", *scene, "--seed", str(self.seed),
            "--radius", f"{self.radius_m:g}", "--variant", self.variant, "--mount", self.mount, "--camera", self.camera,
            "--autopilot", self.autopilot, "--camera-errors", f"{self.camera_errors:g}", "--pose", self.pose, *range_up,
            *flow, *views,
        ]  # fmt: skip
        return " ".join(words)


@dataclass(frozen=True)
class Record:
    """The result of a case. Unknown numbers are None.

    error: the first line of an exception, "" without one.
    times_real: simulated time divided by wall time of the flight alone; times_real_processor: by its processor time.
    odometry_ate_cm: error of the odometry's path after rigid alignment. recall_90_s: time at which the surface first recalled
    90 % of the truth; recall: at the end. commit: of the flight, see host_info.commit(). ended_early: what ended the
    survey before everything was seen, "" if nothing did.
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
    odometry_ate_cm: float | None = None
    times_real: float | None = None
    times_real_processor: float | None = None
    commit: str = ""
    error: str = ""
    trace: str = ""
    recall: float | None = None
    ended_early: str = ""

    @property
    def bad(self) -> bool:
        """True for a contact or an error."""
        return bool(self.error) or bool(self.contacts)


def fly_case(case: Case, truth: bool) -> Record:
    """Fly a case in this process; an exception becomes the error of the record.

    truth: also measure exploration and recall.
    """
    try:
        with tempfile.TemporaryDirectory(prefix="uav_recon-") as folder:
            return _fly(case, Path(folder), truth)
    except Exception as error:  # the sweep continues; the record has the error and the command that repeats it
        return Record(case, error=f"{type(error).__name__}: {error}".splitlines()[0], trace=traceback.format_exc())


def _fly(case: Case, folder: Path, truth: bool) -> Record:
    from rich.console import Console

    from sitl.apps.flight_config import fitted_mount, flight_config
    from sitl.apps.flight_folder import make_folder
    from sitl.apps.flight_judge import add_truth_metrics, flight_report, visible_truth
    from sitl.apps.lockstep import fly_in_lockstep
    from sitl.apps.sim_options import SimOptions
    from sitl.scene.scene import load_scene
    from uav_recon import config as product_config

    options = SimOptions(
        scene=case.scene, seed=case.seed, radius_m=case.radius_m, variant=case.variant, mount=case.mount, camera=case.camera,
        views=case.views, autopilot=case.autopilot, mapper="depth-only", lockstep=True, out=folder / "flight",
        camera_errors=str(case.camera_errors), pose=case.pose, range_up_deg=case.range_up_deg,
        flow=case.flow,
    )  # fmt: skip
    scene = load_scene(options.scene, None, None, options.radius_m, fine=options.textured)
    options = replace(options, mount=fitted_mount(options, scene))
    make_folder(options.folder)
    config = flight_config(options, scene, folder)
    product_config.save(config, options.folder / "config.toml")
    flight = fly_in_lockstep(options, config, scene, Console(quiet=True), lambda: False, timelapse=truth)
    report = flight_report(options, scene, flight.wall_s, flight.fault)
    if truth:
        report = add_truth_metrics(report, options, scene, visible_truth(options, scene))
    safety, planning = report.safety, report.planning
    ate_cm = None if report.odometry is None else report.odometry.ate_cm
    return Record(
        case, report.outcome, report.stop_reason, report.flight_time_s, report.path_length_m, report.views,
        report.explored_fraction, report.time_to_recall_s.get("0.90"), safety.min_clearance_m, safety.contacts,
        safety.refusals, safety.failsafes, planning.hover_wait_s, planning.total_s, ate_cm,
        flight.simulated_s / flight.wall_s, flight.simulated_s / flight.processor_s,
        recall=report.recall_over_time[-1][2] if report.recall_over_time else None, ended_early=report.ended_early,
    )  # fmt: skip


def one_thread() -> None:
    """Limit each process that is started from here on to one core."""
    for name in ONE_THREAD:
        os.environ[name] = "1"
