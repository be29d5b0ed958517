"""Typed content of report.json. Its names are stable, because other programs read them.

A number that was not or could not be measured is null. Without ground truth, as on a real flight, quality, clearance and
contacts are null, never zero.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uav_recon import atomic_file, json_codec
from uav_recon.types.flight_metrics import ModelQuality, StreamStatistics

REPORT = "report.json"
TIMED_RECALLS = ("0.90", "0.95")  # the keys of time_to_recall_s
# measured standard deviation of the place above which the view shows it weakly, or not at all
WEAK_SIGMA_M, BLIND_SIGMA_M = 0.02, 0.04


class ReportError(Exception):
    """Raised for a report with an invalid structure; the text is one line that names the key."""


@dataclass(frozen=True, slots=True)
class ReportOdometry:
    """Error of the odometry against the true path, after the best rigid alignment of the two.

    ate_cm: root mean square; largest_cm. shift_cm, turn_deg: of the alignment. model_aligned: True if the model was compared
    with the truth after this alignment, as a flight by the embedded SLAM is. model_size: of the model, in true sizes.
    shape_accuracy_cm: its accuracy at the true size. Both are None without a model, or if it is compared as it is.
    """

    ate_cm: float
    largest_cm: float
    shift_cm: float
    turn_deg: float
    model_aligned: bool
    model_size: float | None = None
    shape_accuracy_cm: float | None = None


@dataclass(frozen=True, slots=True)
class ReportUnseen:
    """Space of the room that the flight left unknown.

    upper_share, lower_share: of the room above and below split_m over the floor. text: reason and remedy in one sentence; ''
    if the shares are small.
    """

    upper_share: float
    lower_share: float
    split_m: float
    text: str


@dataclass(frozen=True, slots=True)
class ReportSight:
    """Seconds in the air in which the view showed the place badly, as measured and as predicted.

    weak_s, blind_s: the place of the newest frame had a standard deviation above 2 cm, 4 cm; longest_blind_s: longest stretch
    above 4 cm; null if it was not measured. It is measured against the place of one or two seconds before, and never below
    1 cm. While no frame has a pose, the last one that had a pose counts.
    predicted_weak_s, predicted_blind_s: that which one view should give by the map of surface was above 0.4 cm, 1.2 cm (GOOD_M
    and BLIND_M of view_information). It is 1 m where no surface is known. A measured value and a predicted one are not on the
    same scale.
    """

    weak_s: float | None
    blind_s: float | None
    longest_blind_s: float | None
    predicted_weak_s: float
    predicted_blind_s: float


@dataclass(frozen=True, slots=True)
class MedianP95:
    """Median and 95th percentile of a quantity, in its unit."""

    median: float | None
    p95: float | None


@dataclass(frozen=True, slots=True)
class ModeTimes:
    """Computation time per plan of one mode: task generation, and the whole step."""

    task_s: MedianP95
    step_s: MedianP95


@dataclass(frozen=True, slots=True)
class ReportPlanning:
    """Planning times by mode, their sum, and the time that the vehicle hovered for a plan."""

    explore: ModeTimes
    merged: ModeTimes
    total_s: float
    hover_wait_s: float


@dataclass(frozen=True, slots=True)
class ReportSafety:
    """Clearance, contacts, rejections and failsafes of a flight.

    Clearance and contacts are measured from the hull against the simulator's ground truth; failsafes are those of the simulated
    autopilot (all null without a simulator). way_in_sight: share of the path inside the camera's field of view;
    way_in_sight_nose_first: the share if the vehicle always yawed into the direction of motion (both null without ground truth,
    or with a gimbal).
    """

    min_clearance_m: float | None
    fence_overshoot_m: float | None
    contacts: int | None
    way_in_sight: float | None
    way_in_sight_nose_first: float | None
    refusals: int
    failsafes: int | None


@dataclass(frozen=True, slots=True)
class Report:
    """One flight. outcome: "completed" or "aborted: reason"; stop_reason: text with counts.

    last_view_s: from the take-off command to the last view; waiting_share: share of it spent hovering for a plan.
    recall_over_time: (seconds since the take-off command, views taken by then, recall within 5 cm of the mapper's surface at
    that time); time_to_recall_s: by recall, the first of these times that reaches it. oracle_s: time that a tour with full
    knowledge of the scene needs to see 95 % of it well. refused_views: keyframes that the mapper rejected, by reason.
    reduced_speed_s: seconds of the flight at a reduced speed, by reason; null in reports from before it was logged.
    camera_calibration: errors of the camera at the end, by name with unit: value and standard deviation; None if not published.
    views_calibration: the same, as all views of the final model show them together; None without a final model.
    kept_calibration: whether these began from an earlier flight, as text; '' for nothing. correction: of the odometry at the
    end, for a drift of the pose source; '' for none. earlier_map: whether the flight was found in the map of an earlier one,
    and where it began there; '' without one.
    rejected_by_perception: depth frames, poses and inertial samples that perception rejected, by reason; None if it published
    no counts. camera: its streams, and what was wrong with it, as texts. odometry: against the true path; None without it.
    unseen: space that the flight left unknown; None without a map, and in reports from before it was measured.
    ended_early: what ended the survey before everything was seen, as text; '' if nothing did.
    sight: how well the view showed the place; None where it is not predicted, and in reports from before it was.
    """

    scene: str
    variant: str
    seed: int | None
    autopilot: str
    mount: str
    depth_noise: str | None
    outcome: str
    stop_reason: str
    views: int
    path_length_m: float
    flight_time_s: float
    wall_time_s: float
    last_view_s: float | None
    waiting_share: float | None
    recall_over_time: tuple[tuple[float, int, float], ...] | None
    time_to_recall_s: Mapping[str, float | None]
    oracle_s: float | None
    explored_fraction: float | None
    quality: ModelQuality | None
    planning: ReportPlanning
    stream: StreamStatistics
    safety: ReportSafety
    refused_views: Mapping[str, int] | None
    reduced_speed_s: Mapping[str, float] | None = None
    rejected_by_perception: Mapping[str, int] | None = None
    camera_calibration: Mapping[str, tuple[float, float]] | None = None
    views_calibration: Mapping[str, tuple[float, float]] | None = None
    kept_calibration: str = ""
    correction: str = ""
    earlier_map: str = ""
    camera: tuple[str, ...] = ()
    odometry: ReportOdometry | None = None
    unseen: ReportUnseen | None = None
    sight: ReportSight | None = None
    ended_early: str = ""

    @property
    def completed(self) -> bool:
        """True if the mission completed."""
        return self.outcome == "completed"

    @property
    def headline(self) -> str:
        """The outcome; of a completed flight, also what ended it early, and what it left unseen.

        The latter if it is much.
        """
        if not self.completed:
            return self.outcome
        unseen = f", but {self.unseen.text}" if self.unseen is not None and self.unseen.text else ""
        return self.outcome + (f", {self.ended_early}" if self.ended_early else "") + unseen

    def times_oracle(self, recall: str) -> float | None:
        """Return the time to one of TIMED_RECALLS over the oracle's; None if either is unknown."""
        time_s = self.time_to_recall_s.get(recall)
        return None if time_s is None or self.oracle_s is None else time_s / self.oracle_s

    def to_json(self) -> str:
        """Return strict JSON, in the order of the fields; non-finite numbers become null."""
        return json_codec.to_page(self)

    @staticmethod
    def from_tree(tree: dict[str, Any]) -> Report:
        """Check and type a parsed report.

        Raises ReportError naming the first missing, unknown or mistyped key.
        """
        try:
            return json_codec.from_tree(Report, tree)
        except ValueError as error:
            raise ReportError(f"report: {error}") from None

    @staticmethod
    def load(path: Path) -> Report:
        """Read a report.json. Raises ReportError."""
        try:
            return Report.from_tree(json.loads(path.read_text(encoding="utf-8")))
        except OSError as error:
            raise ReportError(f"{path}: cannot be read ({error.strerror})") from None
        except (ValueError, RecursionError) as error:
            raise ReportError(f"{path}: not JSON: {error}") from None


def save_report(report: Report, folder: Path) -> Path:
    """Write ``folder``/report.json atomically; returns its path."""
    path = folder / REPORT
    atomic_file.replace(path, report.to_json().encode(), durable=False)
    return path
