"""Typed content of report.json. Its names are stable, because other programs read them.

A number that was not or could not be measured is null. Without ground truth, as on a real flight, quality, clearance and
contacts are null, never zero.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

T = TypeVar("T")

REPORT = "report.json"
TIMED_RECALLS = ("0.90", "0.95")  # the keys of time_to_recall_s


class ReportError(Exception):
    """Raised for a report with an invalid structure; the text is one line that names the key."""


@dataclass(frozen=True, slots=True)
class ReportQuality:
    """Quality against ground truth: cm, shares of 1, dB. See evaluation.metrics."""

    accuracy_cm: float | None
    completion_cm: float | None
    recall_5cm: float | None
    recall_2cm: float | None
    f_score_2cm: float | None
    psnr_db: float | None
    accuracy_point_cm: float | None
    completion_point_cm: float | None
    point_floor_cm: float | None


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
class ReportStream:
    """Setpoint stream as received by the autopilot."""

    rate_hz: float | None
    gap_p99_ms: float | None
    gap_max_ms: float | None


@dataclass(frozen=True, slots=True)
class ReportSafety:
    """Clearance, contacts, rejections and failsafes of a flight.

    Clearance and contacts are measured from the hull against the simulator's ground truth (null without it). way_in_sight:
    share of the path inside the camera's field of view; way_in_sight_nose_first: the share if the vehicle always yawed into
    the direction of motion (both null without ground truth, or with a gimbal).
    """

    min_clearance_m: float | None
    fence_overshoot_m: float | None
    contacts: int | None
    way_in_sight: float | None
    way_in_sight_nose_first: float | None
    refusals: int
    failsafes: int


@dataclass(frozen=True, slots=True)
class Report:
    """One flight. outcome: "completed" or "aborted: reason"; stop_reason: text with counts.

    last_view_s: from the take-off command to the last view; waiting_share: share of it spent hovering for a plan.
    recall_over_time: (seconds since the take-off command, views taken by then, recall within 5 cm of the mapper's surface at
    that time); time_to_recall_s: by recall, the first of these times that reaches it. oracle_s: time that a tour with full
    knowledge of the scene needs to see 95 % of it well. refused_views: keyframes that the mapper rejected, by reason.
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
    quality: ReportQuality | None
    planning: ReportPlanning
    stream: ReportStream
    safety: ReportSafety
    refused_views: Mapping[str, int] | None

    @property
    def completed(self) -> bool:
        """True if the mission completed."""
        return self.outcome == "completed"

    def times_oracle(self, recall: str) -> float | None:
        """Return the time to one of TIMED_RECALLS over the oracle's; None if either is unknown."""
        time_s = self.time_to_recall_s.get(recall)
        return None if time_s is None or self.oracle_s is None else time_s / self.oracle_s

    def to_json(self) -> str:
        """Return strict JSON, in the order of the fields; non-finite numbers become null."""
        return json.dumps(_strict(dataclasses.asdict(self)), indent=1, allow_nan=False, ensure_ascii=False) + "\n"

    @staticmethod
    def from_tree(tree: dict[str, Any]) -> Report:
        """Check and type a parsed report.

        Raises ReportError naming the first missing, unknown or mistyped key.
        """
        return _typed(tree, Report, "")

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
    temporary = folder / (REPORT + ".new")
    temporary.write_text(report.to_json(), encoding="utf-8")
    temporary.replace(path)
    return path


def _strict(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    if hasattr(value, "item"):  # a numpy number
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _typed(tree: Any, kind: type[T], where: str) -> T:
    """Build a dataclass from a parsed tree, strictly."""
    if not isinstance(tree, dict):
        raise ReportError(f"report: {where or 'top level'}: must be a table, got {tree!r}")
    hints = typing.get_type_hints(kind)
    prefix = f"{where}." if where else ""
    for key in tree:
        if key not in hints:
            raise ReportError(f"report: {prefix}{key}: unknown key")
    values = {}
    for key, hint in hints.items():
        if key not in tree:
            raise ReportError(f"report: {prefix}{key}: missing")
        values[key] = _value(tree[key], hint, prefix + key)
    return kind(**values)


def _value(value: Any, hint: Any, where: str) -> Any:
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        if value is None:
            return None
        (hint,) = [inner for inner in typing.get_args(hint) if inner is not type(None)]
    if typing.get_origin(hint) is Mapping:
        if not isinstance(value, dict):
            raise ReportError(f"report: {where}: must be a table, got {value!r}")
        return {key: _value(item, typing.get_args(hint)[1], f"{where}.{key}") for key, item in value.items()}
    if typing.get_origin(hint) is tuple:
        return _row(value, typing.get_args(hint), where)
    if dataclasses.is_dataclass(hint):
        return _typed(value, cast("type[Any]", hint), where)
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, hint) or isinstance(value, bool):
        raise ReportError(f"report: {where}: must be {hint.__name__}, got {value!r}")
    return value


def _row(value: Any, hints: tuple[Any, ...], where: str) -> tuple[Any, ...]:
    """Return a typed tuple from a list of any length of one type, or of fixed types.

    hints: (type, ...) with Ellipsis for any length, else one type per element.
    """
    if not isinstance(value, list):
        raise ReportError(f"report: {where}: must be a list, got {value!r}")
    kinds = hints[:1] * len(value) if hints[-1] is Ellipsis else hints
    if len(value) != len(kinds):
        raise ReportError(f"report: {where}: must be a list of {len(kinds)}, got {value!r}")
    return tuple(_value(item, kind, f"{where}[{n}]") for n, (item, kind) in enumerate(zip(value, kinds, strict=True)))
