"""One flight of the fault campaign: a row's trouble in lockstep or in real time, and the verdict."""

from __future__ import annotations

import tempfile
import traceback
from dataclasses import dataclass
from pathlib import Path

from sitl.faults.arena import arena
from sitl.faults.everywhere import violations
from sitl.faults.evidence import Evidence
from sitl.faults.meddler import Meddler
from sitl.faults.row import Row, Verdict, judge
from sitl.faults.table import ROWS
from sitl.fly_evidence import evidence_of


@dataclass(frozen=True)
class FaultCase:
    """A flight: number is its seed, and which of the row's cases is flown. live: in real time, with processes."""

    row: str
    autopilot: str
    number: int
    out: Path | None = None
    live: bool = False


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
            evidence = (flight_live if case.live else flight)(row, case, Path(folder))
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
    return evidence_of(meddler, config, options.out / "truth.npz", options.radius_m)


def flight_live(row: Row, case: FaultCase, folder: Path) -> Evidence:
    """The same in real time, with the mapper that learns. Raises run.Failure."""
    from sitl.fly_fault_live import flight_in_real_time, free_port
    from sitl.fly_options import SimOptions

    options = SimOptions.parse(
        seed=case.number, views=row.views, autopilot=case.autopilot, port=free_port(), out=case.out or folder / "flight"
    )
    options.make_folder()
    return flight_in_real_time(row, options, folder, case.number)
