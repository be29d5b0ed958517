"""Event log of the mission: timeline.jsonl, one line per event, readable after any crash.

Each line is written at once. A partial line (loss of power while writing) only loses that event.
"""

from __future__ import annotations

import itertools
import json
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon import json_codec
from uav_recon.json_codec import Float
from uav_recon.types.frames import FloatArray
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason, codes_of, text_of
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import MissionProgress

TIMELINE = "timeline.jsonl"
TAKE_OFF = "take-off"
_ON_THE_GROUND = ("idle", "ready", "done")
SEEN_TO_THE_END = (ReasonCode.NO_FRONTIERS_LEFT, ReasonCode.FRONTIERS_LEFT)
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ProgressSample:
    """One MissionProgress. position_world in metres.

    predicted_sigma_m, measured_sigma_m: as there; None also in logs from before they were written.
    """

    stamp_s: Float
    phase: str
    mode: str
    views: int
    explored_m3: Float
    path_length_m: Float
    frontiers: int
    planning_s: Float
    position_world: tuple[Float, Float, Float]
    predicted_sigma_m: float | None = None
    measured_sigma_m: float | None = None

    @property
    def in_the_air(self) -> bool:
        """True in the phases of a flight."""
        return self.phase not in _ON_THE_GROUND


@dataclass(frozen=True, slots=True)
class PlanRecord:
    """One plan. mode: explore | merged, "" when nothing was left.

    hover_wait_s: time that the vehicle hovered waiting for the plan.
    """

    stamp_s: Float
    mode: str
    task_s: Float
    step_s: Float
    frontiers: int
    tasks: int
    views: int
    hover_wait_s: Float


@dataclass(frozen=True, slots=True)
class ViewRecord:
    """One keyframe given to the mapper: capture stamp and pose of its depth imager."""

    stamp_s: Float
    index: int
    quat_wxyz: tuple[Float, Float, Float, Float]
    translation_m: tuple[Float, Float, Float]

    def world_from_depth(self) -> Pose:
        """Return the pose of the depth imager."""
        return Pose(np.array(self.quat_wxyz), np.array(self.translation_m))


@dataclass(frozen=True, slots=True)
class PhaseRecord:
    """A new phase of the mission, with its reason as text and codes."""

    stamp_s: Float
    phase: str
    note: str
    codes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RefusalRecord:
    """A rejection by guard, autopilot or mapper, with its reason as text and codes."""

    stamp_s: Float
    reason: str
    codes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SpeedLimitRecord:
    """A change of the reason for a reduced speed, as text and codes.

    "" and null: it is no longer reduced.
    """

    stamp_s: Float
    max_speed_mps: float | None
    reason: str
    codes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RefusedViewsRecord:
    """Keyframes that the mapper rejected during the flight: (reason as text, count) each."""

    stamp_s: Float
    counts: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class PerceptionRecord:
    """Rejections by perception until this stamp: (reason, count) each.

    newest: the newest rejected depth frame as text. origin: where the take-off pad is, if not at the pose source's origin.
    calibration: errors of the camera: name with unit, value, standard deviation. camera: its streams, and what is wrong with
    it. kept: whether the errors began from an earlier flight. correction: of the odometry, for a drift of the pose source.
    earlier_map: whether the flight was found in the map of an earlier one.
    """

    stamp_s: Float
    frames: int
    counts: tuple[tuple[str, int], ...]
    newest: str = ""
    origin: str = ""
    calibration: tuple[tuple[str, Float, Float], ...] = ()
    camera: tuple[str, ...] = ()
    kept: str = ""
    correction: str = ""
    earlier_map: str = ""


@dataclass(frozen=True, slots=True)
class OutcomeRecord:
    """Outcome of the flight: "completed" or "aborted: reason".

    stop_reason: reason for the end of the survey. ended_early: what ended it before everything was seen, '' if nothing did.
    """

    stamp_s: Float
    outcome: str
    stop_reason: str
    codes: tuple[str, ...] = ()
    stop_codes: tuple[str, ...] = ()
    ended_early: str = ""


@dataclass(frozen=True, slots=True)
class Timeline:
    """The events of a flight, each list in the order of writing.

    torn_lines: number of lines that could not be read.
    """

    progress: tuple[ProgressSample, ...]
    plans: tuple[PlanRecord, ...]
    views: tuple[ViewRecord, ...]
    phases: tuple[PhaseRecord, ...]
    refusals: tuple[RefusalRecord, ...]
    speed_limits: tuple[SpeedLimitRecord, ...]
    refused_views: tuple[RefusedViewsRecord, ...]
    perception: tuple[PerceptionRecord, ...]
    outcomes: tuple[OutcomeRecord, ...]
    torn_lines: int

    def start_s(self) -> float:
        """Return the stamp of the first event, 0 for an empty timeline."""
        records: tuple[Sequence[Any], ...] = (self.progress, self.plans, self.views, self.phases, self.refusals)
        return min((float(record[0].stamp_s) for record in records if record), default=0.0)

    def took_off_s(self) -> float | None:
        """Return the stamp of the take-off command; None if there was none."""
        return next((record.stamp_s for record in self.phases if record.phase == TAKE_OFF), None)

    def last_view_s(self) -> float | None:
        """Return the seconds from the take-off command to the last view; None if either is missing."""
        start_s = self.took_off_s()
        return None if start_s is None or not self.views else self.views[-1].stamp_s - start_s

    def reduced_speed_s(self, begin_s: float, end_s: float) -> dict[str, float]:
        """Return the time between two stamps at a reduced speed, by reason as text.

        Reasons with the same code are one entry, with the text of the first.
        """
        found: dict[tuple[str, ...], tuple[str, float]] = {}
        for record, follower in itertools.zip_longest(self.speed_limits, self.speed_limits[1:]):
            until_s = math.inf if follower is None else follower.stamp_s
            lasted_s = min(until_s, end_s) - max(record.stamp_s, begin_s)
            if record.codes and lasted_s > 0.0:
                text, before_s = found.get(record.codes, (record.reason, 0.0))
                found[record.codes] = (text, before_s + lasted_s)
        return dict(found.values())

    def waited_s(self, begin_s: float, end_s: float) -> float:
        """Return the time between two stamps that the vehicle hovered waiting for a plan."""
        return sum(max(0.0, min(plan.stamp_s, end_s) - max(plan.stamp_s - plan.hover_wait_s, begin_s)) for plan in self.plans)

    def path_world(self) -> tuple[FloatArray, FloatArray]:
        """Return stamps (N,) and positions (N, 3) of the progress samples."""
        stamps = np.array([sample.stamp_s for sample in self.progress])
        return stamps, np.array([sample.position_world for sample in self.progress]).reshape(-1, 3)

    def place_sigmas_m(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the standard deviations of the place: stamps, predicted, measured (N,) each.

        Those of the progress samples. NaN where they are unknown, and on the ground.
        """
        samples = self.progress
        predicted_m = [sample.predicted_sigma_m if sample.in_the_air else None for sample in samples]
        measured_m = [sample.measured_sigma_m if sample.in_the_air else None for sample in samples]
        stamps_s = np.array([sample.stamp_s for sample in samples])
        return stamps_s, np.array(predicted_m, dtype=np.float64), np.array(measured_m, dtype=np.float64)


_KINDS: dict[str, type[Any]] = {
    "progress": ProgressSample,
    "plan": PlanRecord,
    "view": ViewRecord,
    "phase": PhaseRecord,
    "refusal": RefusalRecord,
    "speed limit": SpeedLimitRecord,
    "refused views": RefusedViewsRecord,
    "perception": PerceptionRecord,
    "outcome": OutcomeRecord,
}


class FlightLog:
    """Appends events to ``folder``/timeline.jsonl.

    A full disk is logged once and the lost events are counted; it never stops a flight.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / TIMELINE
        self.lost_lines = 0
        before = self.path.read_bytes() if self.path.exists() else b""
        self._file = self.path.open("a", encoding="utf-8", buffering=1)
        if before and not before.endswith(b"\n"):
            self._file.write("\n")  # a crash left a partial last line: keep it separate from the next one

    def progress(self, now: MissionProgress) -> None:
        """Add a sample of the mission's progress."""
        self._write(
            "progress",
            ProgressSample(
                stamp_s=now.stamp_s,
                phase=now.phase,
                mode=now.mode,
                views=now.views,
                explored_m3=now.explored_m3,
                path_length_m=now.path_length_m,
                frontiers=now.frontiers,
                planning_s=now.planning_s,
                position_world=_vec3(now.position_world),
                predicted_sigma_m=now.predicted_sigma_m,
                measured_sigma_m=now.measured_sigma_m,
            ),
        )

    def plan(
        self,
        stamp_s: float,
        mode: str,
        task_s: float,
        step_s: float,
        frontiers: int,
        tasks: int,
        views: int,
        hover_wait_s: float,
    ) -> None:
        """Add a plan."""
        self._write("plan", PlanRecord(stamp_s, mode, task_s, step_s, frontiers, tasks, views, hover_wait_s))

    def view(self, stamp_s: float, index: int, world_from_depth: Pose) -> None:
        """Add a keyframe."""
        w, x, y, z = (float(v) for v in world_from_depth.quat_wxyz)
        self._write("view", ViewRecord(stamp_s, index, (w, x, y, z), _vec3(world_from_depth.translation_m)))

    def phase(self, stamp_s: float, phase: str, note: Reason | None) -> None:
        """Add a change of phase."""
        self._write("phase", PhaseRecord(stamp_s, phase, text_of(note), codes_of(note)))

    def refusal(self, stamp_s: float, reason: Reason) -> None:
        """Add a refusal."""
        self._write("refusal", RefusalRecord(stamp_s, reason.text(), reason.codes()))

    def speed_limit(self, stamp_s: float, max_speed_mps: float, reason: Reason | None) -> None:
        """Add a change of the reason for a reduced speed; None: it is no longer reduced."""
        limit_mps = max_speed_mps if math.isfinite(max_speed_mps) else None
        self._write("speed limit", SpeedLimitRecord(stamp_s, limit_mps, text_of(reason), codes_of(reason)))

    def refused_views(self, stamp_s: float, counts: Mapping[str, int]) -> None:
        """Add the number of keyframes that the mapper rejected, by reason."""
        self._write("refused views", RefusedViewsRecord(stamp_s, tuple(sorted(counts.items()))))

    def perception(self, status: PerceptionStatus) -> None:
        """Add the counts of what perception has rejected."""
        counts = tuple(sorted(status.counts().items()))
        texts = text_of(status.newest), text_of(status.origin)
        camera = tuple(text_of(reason) for reason in status.camera)
        last = text_of(status.kept), text_of(status.correction), text_of(status.earlier_map)
        self._write(
            "perception", PerceptionRecord(status.stamp_s, status.frames, counts, *texts, status.calibration, camera, *last)
        )

    def outcome(self, stamp_s: float, aborted: Reason | None, stop_reason: Reason | None) -> None:
        """Add the last line. aborted: None for a flight that was completed."""
        codes, stop_codes = codes_of(aborted), codes_of(stop_reason)
        early = early_end_text(stop_reason)
        self._write("outcome", OutcomeRecord(stamp_s, outcome_text(aborted), text_of(stop_reason), codes, stop_codes, early))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, kind: str, record: Any) -> None:
        line = json_codec.to_line({"event": kind} | json_codec.to_tree(record))
        try:
            self._file.write(line + "\n")
        except OSError as error:
            if self.lost_lines == 0:
                _LOG.warning("%s: %s; events are being lost", self.path, error.strerror)
            self.lost_lines += 1


def outcome_text(aborted: Reason | None) -> str:
    """Return how a flight ended, in words: "completed" or "aborted: reason"."""
    return "completed" if aborted is None else f"aborted: {aborted.text()}"


def early_end_text(stop_reason: Reason | None) -> str:
    """Return what ended the survey before everything was seen, in words; '' if nothing did.

    Frontiers that the vehicle could not have seen do not count. Example: '2 place(s) left unseen'.
    """
    if stop_reason is None or stop_reason.code in SEEN_TO_THE_END:
        return ""
    frontiers = [one for one in stop_reason.details if one.code is ReasonCode.FRONTIERS_IN_LAST_PLAN and one.values != (0,)]
    return ", ".join(one.text() for one in (Reason(stop_reason.code, stop_reason.values), *frontiers))


def read_timeline(folder: Path) -> Timeline:
    """Read ``folder``/timeline.jsonl; without the file the timeline is empty.

    Unreadable lines are counted, not raised.
    """
    found: dict[str, list[Any]] = {kind: [] for kind in _KINDS}
    torn = 0
    path = folder / TIMELINE
    for line in path.read_bytes().splitlines() if path.exists() else []:
        try:
            tree = json.loads(line)
            kind = tree.pop("event")
            found[kind].append(json_codec.from_tree(_KINDS[kind], tree))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            torn += 1
    return Timeline(
        progress=tuple(found["progress"]),
        plans=tuple(found["plan"]),
        views=tuple(found["view"]),
        phases=tuple(found["phase"]),
        refusals=tuple(found["refusal"]),
        speed_limits=tuple(found["speed limit"]),
        refused_views=tuple(found["refused views"]),
        perception=tuple(found["perception"]),
        outcomes=tuple(found["outcome"]),
        torn_lines=torn,
    )


def _vec3(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in vector)
    return x, y, z
