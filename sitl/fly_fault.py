"""One flight of the fault campaign: a row's trouble in lockstep, and the verdict."""

from __future__ import annotations

import tempfile
import traceback
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sitl.faults.arena import arena
from sitl.faults.everywhere import violations
from sitl.faults.evidence import Evidence, Limits, gather
from sitl.faults.meddler import Meddler
from sitl.faults.row import Row, Verdict, judge
from sitl.faults.table import ROWS


@dataclass(frozen=True)
class FaultCase:
    """A flight: number is its seed, and which of the row's cases is flown."""

    row: str
    autopilot: str
    number: int
    out: Path | None = None


@dataclass(frozen=True)
class FaultRecord:
    """What came of a case; trace: of a program that broke."""

    case: FaultCase
    verdict: Verdict
    simulated_s: float = 0.0
    trace: str = ""


def fly_fault(case: FaultCase) -> FaultRecord:
    """Fly it in this process; an exception of the flight's program breaks the row, not the campaign."""
    row = ROWS[case.row]
    try:
        with tempfile.TemporaryDirectory(prefix="uav_recon-") as folder:
            evidence = flight(row, case, Path(folder))
        return FaultRecord(case, judge(row, evidence, violations(evidence)), float(evidence.end_s - evidence.stamp_s[0]))
    except Exception as error:  # a campaign goes on: what broke is in its record
        said = f"{type(error).__name__}: {error}".splitlines()[0]
        return FaultRecord(case, Verdict((float("nan"),) * len(row.bars), (said,)), trace=traceback.format_exc())


def flight(row: Row, case: FaultCase, folder: Path) -> Evidence:
    """Fly a row's trouble, and gather what its judges may look at. Raises whatever the flight raises."""
    from rich.console import Console

    from sitl.fly_hostile import hostile
    from sitl.fly_lockstep import fly_in_lockstep
    from sitl.fly_options import SimOptions
    from uav_recon import config as product_config

    options = SimOptions.parse(
        seed=case.number, views=row.views, autopilot=case.autopilot, mapper="stand-in", lockstep=True,
        out=case.out or folder / "flight",
    )  # fmt: skip
    scene = arena(row.arena, options.radius_m)
    options.make_folder()
    config = options.config(scene, folder)
    product_config.save(config, options.out / "config.toml")
    injectors = [*row.injectors(case.number), *hostile(row.id, config)]
    meddler = Meddler(injectors, row.onset, case.number, row.longest_s)
    fly_in_lockstep(options, config, scene, Console(quiet=True), meddler.lands, timelapse=False, meddler=meddler)
    safety = config.safety
    limits = Limits(
        safety.fence_min_m, safety.fence_max_m, safety.fence_inset_m, safety.max_speed_mps, safety.max_acceleration_mps2,
        float(np.radians(safety.max_yaw_rate_degps)),
    )  # fmt: skip
    with np.load(options.out / "truth.npz") as truth:
        measured = np.isfinite(truth["hull_m"])
        hull_s, hull_m = truth["stamp_s"][measured], truth["hull_m"][measured]
    return gather(meddler, limits, hull_s, hull_m, options.radius_m, "")
