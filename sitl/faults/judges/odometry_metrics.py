"""Metrics of the poses sent to the autopilot: error, steps, age and duration."""

from __future__ import annotations

import math

import numpy as np

from sitl.faults.flight_evidence import F64, Bools, FlightEvidence
from sitl.faults.judges.reaction_metrics import Measure

_OLDEST_POSE_S = 0.15


def pose_error_step(for_s: float = 3.0) -> Measure:
    """Return a measure of the greatest change of ODOMETRY's position error (m).

    It covers for_s after the fault began, and is inf with fewer than two ODOMETRY.
    """

    def measure(e: FlightEvidence) -> float:
        w = e.wire
        k = np.flatnonzero((w.odometry_s >= e.onset_s - 0.1) & (w.odometry_s <= e.onset_s + for_s))
        if len(k) < 2:
            return math.inf
        truth = np.stack([np.interp(w.odometry_s[k], e.stamp_s, e.position_m[:, axis]) for axis in range(3)], axis=1)
        error = w.odometry_m[k] - truth
        return float(np.linalg.norm(error - error[0], axis=1).max())

    return measure


def wrong_and_flown(beyond_m: float = 0.3) -> Measure:
    """Return a measure of the longest time (s) of flight by an ODOMETRY that is off.

    Off: by more than beyond_m against its error as the fault began. Flight: in the product's own mode, with the motors
    running.
    """

    def measure(e: FlightEvidence) -> float:
        w = e.wire
        k = np.flatnonzero(w.odometry_s >= e.onset_s - 0.1)
        if len(k) < 2:
            return math.inf
        stamps = w.odometry_s[k]
        truth = np.stack([np.interp(stamps, e.stamp_s, e.position_m[:, axis]) for axis in range(3)], axis=1)
        error = w.odometry_m[k] - truth
        flown = np.interp(stamps, e.stamp_s, e.ours.astype(np.float64)) > 0.5
        wrong = flown & (np.linalg.norm(error - error[0], axis=1) > beyond_m)
        longest, since = 0.0, math.inf
        for stamp_s, is_wrong in zip(stamps.tolist(), wrong.tolist(), strict=True):
            since = min(since, stamp_s) if is_wrong else math.inf
            longest = max(longest, stamp_s - since)
        return longest

    return measure


def heading_error_step(for_s: float = 3.0) -> Measure:
    """Return a measure of the greatest change of ODOMETRY's heading error (degrees).

    It covers for_s after the fault began, and is inf with fewer than two ODOMETRY.
    """

    def measure(e: FlightEvidence) -> float:
        w = e.wire
        k = np.flatnonzero((w.odometry_s >= e.onset_s - 0.1) & (w.odometry_s <= e.onset_s + for_s))
        if len(k) < 2:
            return math.inf
        error_rad = w.odometry_yaw_rad[k] - np.interp(w.odometry_s[k], e.stamp_s, np.unwrap(e.yaw_rad))
        moved_rad = np.remainder(error_rad - error_rad[0] + math.pi, math.tau) - math.pi
        return math.degrees(float(np.abs(moved_rad).max()))

    return measure


def pose_error_armed(e: FlightEvidence) -> float:
    """Return ODOMETRY's greatest distance (m) from the true position while the motors run.

    It is inf without ODOMETRY in that time.
    """
    w = e.wire
    armed = np.interp(w.odometry_s, e.stamp_s, e.armed.astype(np.float64)) > 0.5
    truth = np.stack([np.interp(w.odometry_s, e.stamp_s, e.position_m[:, axis]) for axis in range(3)], axis=1)
    return float(np.linalg.norm(w.odometry_m - truth, axis=1)[armed].max()) if armed.any() else math.inf


def pose_step(e: FlightEvidence) -> float:
    """Return the longest step (m) of ODOMETRY beyond the true motion.

    Steps at which the reset counter changes do not count.
    """
    w = e.wire
    k = np.flatnonzero(w.odometry_s >= e.onset_s)
    if len(k) < 2:
        return 0.0
    truth = np.stack([np.interp(w.odometry_s[k], e.stamp_s, e.position_m[:, axis]) for axis in range(3)], axis=1)
    steps = np.linalg.norm(np.diff(w.odometry_m[k] - truth, axis=0), axis=1)
    same = np.diff(w.reset_counter[k]) == 0
    return float(steps[same].max(initial=0.0))


def resets(e: FlightEvidence) -> float:
    """Return the number of changes of the reset counter since the fault began."""
    return float(np.count_nonzero(np.diff(e.wire.reset_counter[e.wire.odometry_s >= e.onset_s])))


def pose_rate(e: FlightEvidence) -> float:
    """Return the fewest ODOMETRY in any second of the first eight after the fault began.

    Only the time until the vehicle leaves our mode counts.
    """
    stamps = e.wire.odometry_s
    starts = np.arange(e.onset_s, e.onset_s + min(8.0, e.since(~e.ours, e.onset_s)) - 1.0, 0.1)
    counts = np.searchsorted(stamps, starts + 1.0) - np.searchsorted(stamps, starts)
    return float(counts.min()) if len(counts) else math.inf


def pose_age(e: FlightEvidence) -> float:
    """Return the greatest age (s) of any ODOMETRY's timestamp when it was sent."""
    w = e.wire
    return float(np.abs(w.odometry_s - e.boot_s - w.odometry_stamp_us * 1e-6).max()) if len(w.odometry_s) else 0.0


def misdated_for(e: FlightEvidence) -> float:
    """Return the seconds from the fault to the last ODOMETRY with a wrong timestamp; 0 for none.

    A timestamp is wrong if it differs from the autopilot's clock by more than _OLDEST_POSE_S.
    """
    stamps, off = _dated(e)
    return float(stamps[off][-1]) - e.onset_s if off.any() else 0.0


def dated_after(e: FlightEvidence) -> float:
    """Return the seconds from the fault to the first ODOMETRY with a correct timestamp."""
    stamps, off = _dated(e)
    return float(stamps[~off][0]) - e.onset_s if not off.all() else math.inf


def _dated(e: FlightEvidence) -> tuple[F64, Bools]:
    """Return the send times (N,) of ODOMETRY since the fault, and a mask (N,) of wrong stamps.

    A timestamp is wrong if it is older or newer than _OLDEST_POSE_S.
    """
    w = e.wire
    after = w.odometry_s >= e.onset_s
    age_s = w.odometry_s[after] - e.boot_s - w.odometry_stamp_us[after] * 1e-6
    return w.odometry_s[after], np.abs(age_s) > _OLDEST_POSE_S


def poses_until(e: FlightEvidence) -> float:
    """Return the seconds from the fault to the last ODOMETRY sent."""
    return max(float(e.wire.odometry_s[-1]) - e.onset_s, 0.0) if len(e.wire.odometry_s) else 0.0


def poses_again_after(late_s: float) -> Measure:
    """Return a measure of the seconds from the end of a fault of late_s to the next ODOMETRY."""

    def measure(e: FlightEvidence) -> float:
        after = e.wire.odometry_s[e.wire.odometry_s >= e.onset_s + late_s]
        return float(after[0]) - e.onset_s - late_s if len(after) else math.inf

    return measure
