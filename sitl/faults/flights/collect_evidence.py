"""Evidence of a finished flight with a fault, for its checks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sitl.faults.fault_director import FaultDirector
from sitl.faults.flight_evidence import FlightEvidence, GuardLimits, gather
from uav_recon.config import Config
from uav_recon.recording.flight_log import read_timeline
from uav_recon.types.reason import codes_in


def evidence_of(director: FaultDirector, config: Config, truth: Path, radius_m: float) -> FlightEvidence:
    """Return the evidence of a finished flight.

    truth: file with the simulator's ground truth, in the same folder as the product's own log. radius_m: radius of the hull
    (m).
    """
    safety = config.safety
    limits = GuardLimits(
        safety.fence_min_m, safety.fence_max_m, safety.fence_inset_m, safety.max_speed_mps, safety.max_acceleration_mps2,
        float(np.radians(safety.max_yaw_rate_degps)),
    )  # fmt: skip
    with np.load(truth) as stored:
        measured = np.isfinite(stored["hull_m"])
        hull_s, hull_m = stored["stamp_s"][measured], stored["hull_m"][measured]
    outcomes = read_timeline(truth.parent).outcomes
    stop_codes = outcomes[-1].stop_codes if outcomes else ()
    return gather(director, limits, hull_s, hull_m, radius_m, stop_codes, codes_in)
