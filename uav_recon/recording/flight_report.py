"""Report of a flight from its own files, with plots; ground truth is added by the simulator."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uav_recon.geometry.view_information import BLIND_M, GOOD_M
from uav_recon.recording.flight_log import Timeline, read_timeline
from uav_recon.recording.map_file import load_map
from uav_recon.recording.mesh_file import load_mesh
from uav_recon.recording.mesh_renders import render_mesh_images
from uav_recon.recording.plots import coverage_over_time, path_over_plan, place_sigma_over_time, planning_over_time
from uav_recon.recording.recall_plot import recall_over_time
from uav_recon.recording.report import (
    BLIND_SIGMA_M,
    TIMED_RECALLS,
    WEAK_SIGMA_M,
    MedianP95,
    ModeTimes,
    Report,
    ReportPlanning,
    ReportSafety,
    ReportSight,
)
from uav_recon.recording.report_page import Picture, write_report
from uav_recon.types.camera_calibration import CALIBRATION_FILE
from uav_recon.types.flight_metrics import StreamStatistics
from uav_recon.types.frames import BoolArray, FloatArray

_LONGEST_SAMPLE_S = 1.0  # time for which a sample of the progress stands: in a longer gap there was no mission process


@dataclass(frozen=True, slots=True)
class FlightInfo:
    """Head of the report. depth_noise and seed are None where they have no meaning."""

    scene: str
    variant: str
    autopilot: str
    mount: str
    seed: int | None = None
    depth_noise: str | None = None


def build_report(folder: Path, card: FlightInfo, wall_s: float) -> Report:
    """Return the report that the flight's own files allow.

    Quality, recall, clearance, contacts and stream are unknown.
    """
    timeline = read_timeline(folder)
    outcome = timeline.outcomes[-1] if timeline.outcomes else None
    stamps_s = [sample.stamp_s for sample in timeline.progress if sample.in_the_air]
    return Report(
        scene=card.scene,
        variant=card.variant,
        seed=card.seed,
        autopilot=card.autopilot,
        mount=card.mount,
        depth_noise=card.depth_noise,
        outcome=outcome.outcome if outcome else "aborted: the mission left no word",
        stop_reason=outcome.stop_reason if outcome else "",
        views=len(timeline.views),
        path_length_m=timeline.progress[-1].path_length_m if timeline.progress else 0.0,
        flight_time_s=max(stamps_s) - min(stamps_s) if stamps_s else 0.0,
        wall_time_s=wall_s,
        last_view_s=timeline.last_view_s(),
        waiting_share=_waiting_share(timeline),
        recall_over_time=None,
        time_to_recall_s=dict.fromkeys(TIMED_RECALLS),
        oracle_s=None,
        explored_fraction=None,
        quality=None,
        planning=_planning(timeline),
        stream=StreamStatistics(None, None, None),
        safety=ReportSafety(None, None, None, None, None, refusals=len(timeline.refusals), failsafes=None),
        refused_views=dict(timeline.refused_views[-1].counts) if timeline.refused_views else None,
        reduced_speed_s=timeline.reduced_speed_s(min(stamps_s), max(stamps_s)) if stamps_s else {},
        rejected_by_perception=dict(timeline.perception[-1].counts) if timeline.perception else None,
        camera_calibration={name: (value, sigma) for name, value, sigma in timeline.perception[-1].calibration}
        if timeline.perception
        else None,
        views_calibration=_views_calibration(folder),
        camera=tuple(dict.fromkeys(text for record in timeline.perception for text in record.camera)),
        kept_calibration=timeline.perception[-1].kept if timeline.perception else "",
        correction=timeline.perception[-1].correction if timeline.perception else "",
        earlier_map=timeline.perception[-1].earlier_map if timeline.perception else "",
        sight=_sight(timeline),
        ended_early=outcome.ended_early if outcome else "",
    )


def _views_calibration(folder: Path) -> dict[str, tuple[float, float]] | None:
    """Return the errors of the camera in calibration.json, None if it is missing or damaged."""
    try:
        tree = json.loads((folder / CALIBRATION_FILE).read_bytes())
        return {str(name): (float(value), float(sigma)) for name, (value, sigma) in tree["elements"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def publish(report: Report, folder: Path) -> None:
    """Draw the plots and write report.json and report.html."""
    write_report(folder, report, _pictures(folder, report))


def _planning(timeline: Timeline) -> ReportPlanning:
    def times(mode: str) -> ModeTimes:
        plans = [plan for plan in timeline.plans if plan.mode == mode]
        return ModeTimes(_spread([plan.task_s for plan in plans]), _spread([plan.step_s for plan in plans]))

    total_s, waited_s = sum(plan.step_s for plan in timeline.plans), sum(plan.hover_wait_s for plan in timeline.plans)
    return ReportPlanning(explore=times("explore"), merged=times("merged"), total_s=total_s, hover_wait_s=waited_s)


def _spread(values: list[float]) -> MedianP95:
    return MedianP95(float(np.median(values)), float(np.percentile(values, 95.0))) if values else MedianP95(None, None)


def _waiting_share(timeline: Timeline) -> float | None:
    """Return the share of the time from take-off to the last view spent waiting for a plan."""
    begin_s, lasted_s = timeline.took_off_s(), timeline.last_view_s()
    return timeline.waited_s(begin_s, begin_s + lasted_s) / lasted_s if begin_s is not None and lasted_s else None


def _sight(timeline: Timeline) -> ReportSight | None:
    """Return how long the view showed the place badly, in the air; None without predictions."""
    stamps_s, predicted_m, measured_m = timeline.place_sigmas_m()
    if not np.isfinite(predicted_m).any():
        return None
    lasted_s = np.append(np.clip(np.diff(stamps_s), 0.0, _LONGEST_SAMPLE_S), 0.0)

    def above_s(sigma_m: FloatArray, limit_m: float) -> float:
        return float(lasted_s[sigma_m > limit_m].sum())

    measured = bool(np.isfinite(measured_m).any())
    return ReportSight(
        weak_s=above_s(measured_m, WEAK_SIGMA_M) if measured else None,
        blind_s=above_s(measured_m, BLIND_SIGMA_M) if measured else None,
        longest_blind_s=_longest_s(lasted_s, measured_m > BLIND_SIGMA_M) if measured else None,
        predicted_weak_s=above_s(predicted_m, GOOD_M),
        predicted_blind_s=above_s(predicted_m, BLIND_M),
    )


def _longest_s(lasted_s: FloatArray, held: BoolArray) -> float:
    """Return the longest time in a row in which something held.

    lasted_s (N,): of each sample. held (N,): whether it held in it.
    """
    longest_s = stretch_s = 0.0
    for sample_s, here in zip(lasted_s.tolist(), held.tolist(), strict=True):
        stretch_s = stretch_s + sample_s if here else 0.0
        longest_s = max(longest_s, stretch_s)
    return longest_s


def _pictures(folder: Path, report: Report) -> list[Picture]:
    timeline, voxels, mesh = read_timeline(folder), load_map(folder), load_mesh(folder)
    drawn = folder / "pictures"
    drawn.mkdir(exist_ok=True)
    pictures = []
    if mesh is not None and timeline.views:
        inside = np.median([view.translation_m for view in timeline.views], axis=0)
        said = ("The model in colour.", "The model by uncertainty: blue is well known, red badly.", "The model from above.")
        pictures += [Picture(path, text) for path, text in zip(render_mesh_images(drawn, mesh, inside), said, strict=False)]
    path_over_plan(drawn / "path.png", timeline, voxels)
    coverage_over_time(drawn / "coverage.png", timeline)
    planning_over_time(drawn / "planning.png", timeline)
    if report.recall_over_time:
        recall_over_time(drawn / "recall.png", timeline, report)
        pictures.append(Picture(drawn / "recall.png", "How much of the surface the model held, while it flew."))
    pictures += [
        Picture(drawn / "path.png", "The flown path over the floor plan that the drone found."),
        Picture(drawn / "coverage.png", "Explored volume and views over time."),
        Picture(drawn / "planning.png", "Computing time of each plan."),
    ]
    if report.sight is not None:
        place_sigma_over_time(drawn / "place.png", timeline)
        pictures.append(Picture(drawn / "place.png", "How well the place was known, and how well the view should show it."))
    return pictures
