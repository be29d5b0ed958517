"""Figures of the poses that reached the wire: how true, how steady, how old, and for how long."""

from __future__ import annotations

import math

import numpy as np

from sitl.faults.flight_evidence import F64, Bools, FlightEvidence
from sitl.faults.judges.reaction_metrics import Measure

_OLDEST_POSE_S = 0.15


def pose_error_step(for_s: float = 3.0) -> Measure:
    """How far (m) the error of ODOMETRY against truth moved within so long after the trouble."""

    def measure(e: FlightEvidence) -> float:
        w = e.wire
        k = np.flatnonzero((w.odometry_s >= e.onset_s - 0.1) & (w.odometry_s <= e.onset_s + for_s))
        if len(k) < 2:
            return math.inf
        truth = np.stack([np.interp(w.odometry_s[k], e.stamp_s, e.position_m[:, axis]) for axis in range(3)], axis=1)
        error = w.odometry_m[k] - truth
        return float(np.linalg.norm(error - error[0], axis=1).max())

    return measure


def heading_error_step(for_s: float = 3.0) -> Measure:
    """How far (degrees) the error of ODOMETRY's heading against truth moved within so long after the trouble."""

    def measure(e: FlightEvidence) -> float:
        w = e.wire
        k = np.flatnonzero((w.odometry_s >= e.onset_s - 0.1) & (w.odometry_s <= e.onset_s + for_s))
        if len(k) < 2:
            return math.inf
        error_rad = w.odometry_yaw_rad[k] - np.interp(w.odometry_s[k], e.stamp_s, np.unwrap(e.yaw_rad))
        moved_rad = np.remainder(error_rad - error_rad[0] + math.pi, math.tau) - math.pi
        return math.degrees(float(np.abs(moved_rad).max()))

    return measure


def pose_step(e: FlightEvidence) -> float:
    """Longest step (m) of ODOMETRY beyond what the vehicle flew, while the reset counter stays as it is."""
    w = e.wire
    k = np.flatnonzero(w.odometry_s >= e.onset_s)
    if len(k) < 2:
        return 0.0
    truth = np.stack([np.interp(w.odometry_s[k], e.stamp_s, e.position_m[:, axis]) for axis in range(3)], axis=1)
    steps = np.linalg.norm(np.diff(w.odometry_m[k] - truth, axis=0), axis=1)
    same = np.diff(w.reset_counter[k]) == 0
    return float(steps[same].max(initial=0.0))


def resets(e: FlightEvidence) -> float:
    """How often the reset counter changed from the trouble on."""
    return float(np.count_nonzero(np.diff(e.wire.reset_counter[e.wire.odometry_s >= e.onset_s])))


def pose_rate(e: FlightEvidence) -> float:
    """Fewest ODOMETRY in any second of the first eight after the trouble, while the vehicle is ours."""
    stamps = e.wire.odometry_s
    starts = np.arange(e.onset_s, e.onset_s + min(8.0, e.since(~e.ours, e.onset_s)) - 1.0, 0.1)
    counts = np.searchsorted(stamps, starts + 1.0) - np.searchsorted(stamps, starts)
    return float(counts.min()) if len(counts) else math.inf


def pose_age(e: FlightEvidence) -> float:
    """Oldest stamp (s) of any ODOMETRY when it was sent."""
    w = e.wire
    return float(np.abs(w.odometry_s - e.boot_s - w.odometry_stamp_us * 1e-6).max()) if len(w.odometry_s) else 0.0


def misdated_for(e: FlightEvidence) -> float:
    """Seconds from the trouble to the last ODOMETRY whose stamp is off the autopilot's clock of then; 0 for none."""
    stamps, off = _dated(e)
    return float(stamps[off][-1]) - e.onset_s if off.any() else 0.0


def dated_after(e: FlightEvidence) -> float:
    """Seconds from the trouble to the first ODOMETRY whose stamp is right."""
    stamps, off = _dated(e)
    return float(stamps[~off][0]) - e.onset_s if not off.all() else math.inf


def _dated(e: FlightEvidence) -> tuple[F64, Bools]:
    """ODOMETRY since the trouble: when it was sent (N,), and whether its stamp was older or newer than a pose may be (N,)."""
    w = e.wire
    after = w.odometry_s >= e.onset_s
    age_s = w.odometry_s[after] - e.boot_s - w.odometry_stamp_us[after] * 1e-6
    return w.odometry_s[after], np.abs(age_s) > _OLDEST_POSE_S


def poses_until(e: FlightEvidence) -> float:
    """Seconds from the trouble to the last ODOMETRY on the wire."""
    return max(float(e.wire.odometry_s[-1]) - e.onset_s, 0.0) if len(e.wire.odometry_s) else 0.0


def poses_again_after(late_s: float) -> Measure:
    """Seconds from the end of a trouble of late_s to the first ODOMETRY on the wire."""

    def measure(e: FlightEvidence) -> float:
        after = e.wire.odometry_s[e.wire.odometry_s >= e.onset_s + late_s]
        return float(after[0]) - e.onset_s - late_s if len(after) else math.inf

    return measure
