"""Figures of a flight that are measured against ground truth or at the receiver."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ModelQuality:
    """Quality of a model against ground truth: cm, shares of 1, dB; None if not measurable.

    See evaluation/metrics. It is the section `quality` of report.json.
    """

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
class StreamStatistics:
    """Rate and gaps of a periodic stream; None if there were too few arrivals."""

    rate_hz: float | None
    gap_p99_ms: float | None
    gap_max_ms: float | None
