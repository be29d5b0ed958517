"""Evaluation of a flight against ground truth, written as report.json and report.html."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from sitl.apps.model_scale import at_true_size
from sitl.apps.odometry_alignment import OdometryAlignment, align_odometry
from sitl.apps.sim_options import SimOptions
from sitl.camera.d435i import Model
from sitl.runtime.array_cache import cache_folder
from sitl.scene.rasterizer import Renderer
from sitl.scene.scene import Scene
from sitl.truth.reference_times import REFERENCE_TIMES_S
from sitl.truth.visibility import VisibleTruth, load_visible_truth
from uav_recon.app import config_file
from uav_recon.app.step_display import Report as Progress
from uav_recon.app.step_display import StepDisplay, no_report
from uav_recon.app.unseen_space import with_unseen
from uav_recon.config import Config
from uav_recon.evaluation import metrics
from uav_recon.evaluation.path_visibility import PathVisibility, path_visibility
from uav_recon.evaluation.recall import ElementRecall, time_to
from uav_recon.evaluation.triangle_surface import TriangleSurface
from uav_recon.recording.blueprint import RECORDING
from uav_recon.recording.flight_log import read_timeline
from uav_recon.recording.flight_report import FlightInfo, build_report, publish
from uav_recon.recording.map_file import load_map
from uav_recon.recording.mesh_file import load_mesh
from uav_recon.recording.report import (
    TIMED_RECALLS,
    Report,
    ReportOdometry,
    ReportSafety,
)
from uav_recon.recording.timelapse import load_states
from uav_recon.types.flight_metrics import ModelQuality, StreamStatistics
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, TriangleMesh, VoxelMap
from uav_recon.types.pose import Pose

F64 = NDArray[np.float64]
CONTACT_M = 1e-3


@dataclass(frozen=True)
class FlightTruth:
    """Ground truth of a flight; hull_m is the clearance of the hull, NaN on ground and pad."""

    stamp_s: F64
    position_m: F64
    quat_wxyz: F64
    hull_m: F64
    armed: NDArray[np.bool_]
    setpoint_arrivals_s: F64
    failsafes: int

    @staticmethod
    def load(path: Path) -> FlightTruth | None:
        """Read the simulator's truth file; None if there is none."""
        if not path.exists():
            return None
        with np.load(path) as data:
            return FlightTruth(
                data["stamp_s"], data["position_m"], data["quat_wxyz"], data["hull_m"], data["armed"],
                data["setpoint_arrivals_s"], len(data["failsafes"]),
            )  # fmt: skip


def evaluate_flight(options: SimOptions, scene: Scene, wall_s: float, fault: str | None, console: Console) -> Report:
    """Evaluate the flight in options.folder against ground truth and write the report there."""
    steps = StepDisplay(console)
    with steps.step("computing the surface that the camera can see (kept for the next flight in this scene)") as progress:
        cut = visible_truth(options, scene, progress)
    with steps.step("evaluating path, clearance and setpoints"):
        report = flight_report(options, scene, wall_s, fault)
        truth_from_odom = _model_alignment(options, report)
    with steps.step("evaluating coverage, and recall over time") as progress:
        report = add_truth_metrics(report, options, scene, cut, progress, truth_from_odom)
    mesh = _aligned_mesh(load_mesh(options.folder), truth_from_odom)
    if mesh is not None and len(mesh.faces):
        with steps.step("rendering images of model and truth") as progress:
            psnr_db = metrics.psnr_db(*_held_out_pictures(mesh, scene, cut, progress))
        with steps.step("measuring the model against ground truth"):
            report = dataclasses.replace(report, quality=_quality(mesh, scene, cut, psnr_db))
            report = dataclasses.replace(report, odometry=_with_size(report.odometry, mesh, scene, cut))
    with steps.step("drawing the images of the report"):
        publish(report, options.folder)
    return report


def visible_truth(options: SimOptions, scene: Scene, progress: Progress = no_report) -> VisibleTruth:
    """Return what the camera of the options can see of the scene, from the cache or computed."""
    camera: Model = "wide" if options.camera_model == "wide" else "d435i"  # `fast` sees what the d435i sees
    return load_visible_truth(scene, options.mount, camera, cache_folder(), progress)


def flight_report(options: SimOptions, scene: Scene, wall_s: float, fault: str | None) -> Report:
    """Return the product's report of the flight, with figures from ground truth.

    These are path, flight time, setpoint stream and safety. Quick.
    """
    card = FlightInfo(scene.name, options.variant, options.autopilot, options.mount, options.seed, options.depth_noise)
    config = config_file.load_config(options.folder / "config.toml")
    report = with_unseen(build_report(options.folder, card, wall_s), config, options.folder)
    truth = FlightTruth.load(options.folder / "truth.npz")
    if fault:
        report = dataclasses.replace(report, outcome=f"aborted: {fault}")
    if truth is None:
        return report
    return dataclasses.replace(
        report,
        path_length_m=_path_length_m(truth),
        flight_time_s=_flight_time_s(truth),
        stream=_stream(truth),
        odometry=_odometry(options, truth),
        safety=_safety(truth, report.safety.refusals, scene, _lookahead(truth, config)),
    )


def add_truth_metrics(
    report: Report, options: SimOptions, scene: Scene, cut: VisibleTruth, progress: Progress = no_report,
    truth_from_odom: Pose | None = None,
) -> Report:  # fmt: skip
    """Add the explored fraction of the truth, and the recall of its surface over time.

    A recall that training reaches after the landing has no time.
    """
    voxels, curve = load_map(options.folder), recall_over_time(options.folder, cut, progress, truth_from_odom)
    flown = [point for point in curve or () if point[0] <= report.flight_time_s]
    return dataclasses.replace(
        report,
        explored_fraction=None if voxels is None else _explored_fraction(voxels, scene, cut, truth_from_odom),
        recall_over_time=curve,
        time_to_recall_s={recall: time_to(flown, float(recall)) for recall in TIMED_RECALLS},
        oracle_s=REFERENCE_TIMES_S.get(scene.name),
    )


def _alignment(options: SimOptions, truth: FlightTruth) -> OdometryAlignment | None:
    """Return the alignment of the odometry in flight with the true path."""
    stamp_s, position_m = read_timeline(options.folder).path_world()
    flown = truth.stamp_s[truth.armed]
    if not len(flown):
        return None
    within = (stamp_s >= flown[0]) & (stamp_s <= flown[-1])
    return align_odometry(stamp_s[within], position_m[within], truth.stamp_s, truth.position_m)


def _odometry(options: SimOptions, truth: FlightTruth) -> ReportOdometry | None:
    found = _alignment(options, truth)
    if found is None:
        return None
    return ReportOdometry(
        ate_cm=100.0 * found.ate_m,
        largest_cm=100.0 * float(found.error_m.max()),
        shift_cm=100.0 * float(np.linalg.norm(found.truth_from_odom.translation_m)),
        turn_deg=float(np.degrees(found.turn_rad)),
        model_aligned=options.pose == "slam",
    )


def _model_alignment(options: SimOptions, report: Report) -> Pose | None:
    """Return truth_from_odom for a model that has to be aligned, None for one that has not."""
    truth = FlightTruth.load(options.folder / "truth.npz")
    if truth is None or report.odometry is None or not report.odometry.model_aligned:
        return None
    found = _alignment(options, truth)
    return None if found is None else found.truth_from_odom


def _aligned_mesh(mesh: TriangleMesh | None, truth_from_odom: Pose | None) -> TriangleMesh | None:
    if mesh is None or truth_from_odom is None:
        return mesh
    return dataclasses.replace(mesh, vertices_world=truth_from_odom.apply(mesh.vertices_world))


def _with_size(odometry: ReportOdometry | None, mesh: TriangleMesh, scene: Scene, cut: VisibleTruth) -> ReportOdometry | None:
    """Add the size of an aligned model, and its accuracy at the true size."""
    if odometry is None or not odometry.model_aligned:
        return odometry
    vertices_world, size = at_true_size(mesh.vertices_world, scene)
    quality = _quality(dataclasses.replace(mesh, vertices_world=vertices_world), scene, cut, None)
    return dataclasses.replace(odometry, model_size=size, shape_accuracy_cm=quality.accuracy_cm)


def _quality(mesh: TriangleMesh, scene: Scene, cut: VisibleTruth, psnr_db: float | None) -> ModelQuality:
    truth = metrics.SurfaceTruth(
        surface=TriangleSurface(scene.vertices.astype(np.float64), scene.faces.astype(np.int64)),
        points_world=cut.points.astype(np.float64),
    )
    return metrics.measure(TriangleSurface(mesh.vertices_world, mesh.faces), truth, psnr_db)


def recall_over_time(
    folder: Path, cut: VisibleTruth, progress: Progress = no_report, truth_from_odom: Pose | None = None
) -> tuple[tuple[float, int, float], ...] | None:
    """Return (time, views, recall) of every stored state of the surface; None if unknown.

    time: seconds since the take-off command. views: number of views taken by then.
    """
    timeline, states = read_timeline(folder), load_states(folder)
    start_s = timeline.took_off_s()
    if start_s is None or not states or not len(cut.points):
        return None
    truth = ElementRecall(cut.points.astype(np.float64), config_file.load_config(folder / "config.toml").mapper.surface_voxel_m)
    taken_s = np.array([view.stamp_s for view in timeline.views])
    curve = []
    for number, state in enumerate(states):
        progress(number, len(states))
        position, normal = state.position_world, state.normal_world
        if truth_from_odom is not None:
            position, normal = truth_from_odom.apply(position), normal @ truth_from_odom.rotation().T
        recall = round(truth.of(position, normal), 5)
        curve.append((round(state.stamp_s - start_s, 3), int(np.count_nonzero(taken_s <= state.stamp_s)), recall))
    return tuple(curve)


def _held_out_pictures(
    mesh: TriangleMesh, scene: Scene, cut: VisibleTruth, progress: Progress
) -> tuple[list[NDArray[np.uint8]], list[NDArray[np.uint8]]]:
    model = Renderer(mesh.vertices_world.astype(np.float32), mesh.faces.astype(np.int32), mesh.rgb)
    truth = Renderer(scene.vertices, scene.faces, scene.rgb)
    of_model, of_truth = [], []
    for number, view in enumerate(cut.views):
        progress(number, len(cut.views))
        of_model.append(model.render(view, cut.view_spec).rgb)
        of_truth.append(truth.render(view, cut.view_spec).rgb)
    return of_model, of_truth


def _explored_fraction(voxels: VoxelMap, scene: Scene, cut: VisibleTruth, truth_from_odom: Pose | None) -> float | None:
    """Return the share of the truth's free cells that the map knows.

    A cell is known if the map has it as free, or as occupied with true surface within the voxel.
    """
    cells = np.argwhere(cut.free_seen)
    centres = cut.free_origin_m + (cells + 0.5) * cut.free_cell_m
    index = voxels.grid.index(centres if truth_from_odom is None else truth_from_odom.inverse().apply(centres))
    inside = voxels.grid.contains(index)
    state = np.full(len(cells), UNKNOWN, dtype=np.uint8)
    state[inside] = voxels.state[tuple(index[inside].T)]
    truth = TriangleSurface(scene.vertices.astype(np.float64), scene.faces.astype(np.int64))
    within_m = voxels.grid.resolution_m * np.sqrt(3.0)
    known = (state == FREE) | ((state == OCCUPIED) & (truth.distance_m(centres) <= within_m))
    return metrics.explored_fraction(known, np.ones(len(cells), dtype=bool))


def _path_length_m(truth: FlightTruth) -> float:
    flown = truth.position_m[truth.armed]
    return float(np.linalg.norm(np.diff(flown, axis=0), axis=1).sum()) if len(flown) > 1 else 0.0


def _flight_time_s(truth: FlightTruth) -> float:
    stamps = truth.stamp_s[truth.armed]
    return float(stamps[-1] - stamps[0]) if len(stamps) else 0.0


def _stream(truth: FlightTruth) -> StreamStatistics:
    return metrics.stream_statistics(truth.setpoint_arrivals_s)


def _lookahead(truth: FlightTruth, config: Config) -> PathVisibility:
    """Return the share of the path that the camera saw ahead.

    Unknown for a gimbal, whose angle is not in the truth.
    """
    camera = config.camera
    if camera.mount == "gimbal":
        return PathVisibility(None, None)
    down_rad, wide_rad, high_rad = np.radians([camera.pitch_down_deg, camera.horizontal_fov_deg, camera.vertical_fov_deg])
    armed = truth.armed
    return path_visibility(
        truth.stamp_s[armed], truth.position_m[armed], truth.quat_wxyz[armed], down_rad, (wide_rad, high_rad)
    )


def _safety(truth: FlightTruth, refusals: int, scene: Scene, looked: PathVisibility) -> ReportSafety:
    hull_m = truth.hull_m[np.isfinite(truth.hull_m)]
    touching = hull_m < CONTACT_M
    contacts = int(np.count_nonzero(touching[1:] & ~touching[:-1]) + (len(touching) > 0 and bool(touching[0])))
    flown = truth.position_m[truth.armed]
    outside = np.maximum(scene.fence_min - flown, flown - scene.fence_max) if len(flown) else np.zeros((1, 3))
    return ReportSafety(
        min_clearance_m=float(hull_m.min()) if len(hull_m) else None,
        fence_overshoot_m=float(max(outside.max(), 0.0)),
        contacts=contacts,
        way_in_sight=looked.seen,
        way_in_sight_nose_first=looked.nose_first,
        refusals=refusals,
        failsafes=truth.failsafes,
    )


def summary(report: Report, folder: Path) -> str:
    """Return the text that the launcher prints at the end."""
    quality, safety = report.quality, report.safety

    def figure(value: float | None, unit: str, digits: int = 2) -> str:
        return "not measured" if value is None else f"{value:.{digits}f}{unit}"

    lines = [
        *([report.headline] if report.unseen is not None and report.unseen.text else []),
        ": ".join(filter(None, (report.outcome, report.stop_reason))),  # the reason begins with what was left
        f"flight {report.flight_time_s:.0f} s, path {report.path_length_m:.1f} m, {report.views} views, "
        f"explored {figure(report.explored_fraction, '')}",
        f"min clearance {figure(safety.min_clearance_m, ' m')}, contacts {safety.contacts}, "
        f"trajectories rejected by the guard {safety.refusals}",
    ]
    if report.odometry is not None and report.odometry.model_aligned:
        found = report.odometry
        lines.append(
            f"poses of the embedded SLAM: off by {found.ate_cm:.1f} cm (ATE), {found.largest_cm:.1f} cm at most; the model is "
            f"compared after a shift of {found.shift_cm:.1f} cm and a turn of {found.turn_deg:.1f}°"
        )
        if found.model_size is not None:
            lines.append(
                f"size of the model: {100.0 * (found.model_size - 1.0):+.1f} %, as depth is (`uav-recon calibrate` measures it "
                f"before a flight); accuracy at the true size {figure(found.shape_accuracy_cm, ' cm')}"
            )
    if report.recall_over_time is not None:
        waited = None if report.waiting_share is None else 100.0 * report.waiting_share
        lines.append(
            f"{_time_to_recall(report, '0.90')}, last view after {figure(report.last_view_s, ' s', 0)}, "
            f"{figure(waited, ' %', 1)} of this time waiting for a plan"
        )
    if quality is not None:
        lines.append(
            f"accuracy {figure(quality.accuracy_cm, ' cm')}, completion {figure(quality.completion_cm, ' cm')}, "
            f"recall at 5 cm {figure(quality.recall_5cm, '', 3)}, PSNR {figure(quality.psnr_db, ' dB', 1)}"
        )
    return "\n".join((*lines, *results_of(folder)))


def results_of(folder: Path) -> list[str]:
    """Return the lines that say where the results are.

    A flight with the depth-only mapper leaves no recording.
    """
    review = [f"replay the flight: uav-recon review {folder}"] if (folder / RECORDING).exists() else []
    return [f"results: {folder / 'report.html'}", *review]


def _time_to_recall(report: Report, recall: str) -> str:
    reached_s, times = report.time_to_recall_s[recall], report.times_oracle(recall)
    if reached_s is None:
        return f"recall {recall} not reached in flight"
    return f"recall {recall} after {reached_s:.0f} s" + ("" if times is None else f" ({times:.1f} times the oracle's time)")
