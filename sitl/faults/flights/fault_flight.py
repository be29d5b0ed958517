"""Flights of the fault campaign: a row's trouble in lockstep or in real time, and the verdict."""

from __future__ import annotations

import shlex
import shutil
import tempfile
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sitl.camera.d435i import Model
from sitl.faults.fault import Fault
from sitl.faults.fault_director import FaultDirector, never_split
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.flights.collect_evidence import evidence_of
from sitl.faults.injectors.operator_silence import TIMEOUT_S
from sitl.faults.judges.invariants import violations
from sitl.faults.table.all_scenarios import ROWS
from sitl.faults.table.arenas import arena
from sitl.faults.table.scenario import Arena, Scenario, ScenarioVerdict, judge
from sitl.runtime.process_fork import FlightFork
from sitl.scene.scene import HULL_RADIUS_M

if TYPE_CHECKING:
    from uav_recon.config import Config


@dataclass(frozen=True)
class Stage:
    """What a flight in lockstep is before its trouble begins; number is its seed."""

    autopilot: str
    number: int
    arena: Arena
    views: int
    radius_m: float = HULL_RADIUS_M
    variant: str = "adaptive"
    camera: Model = "fast"


@dataclass(frozen=True)
class FaultCase:
    """A flight: number is its seed, and which of the row's cases is flown. live: in real time, with processes. firmware: and
    with a real one.
    """

    row: str
    autopilot: str
    number: int
    out: Path | None = None
    live: bool = False
    firmware: Path | None = None

    @property
    def how(self) -> str:
        """The words of `faults` that fly it this way."""
        if self.firmware is not None:
            return f"--firmware {shlex.quote(str(self.firmware))}"
        return "--real-time" if self.live else ""

    @property
    def stage(self) -> Stage:
        """Cases with the same one are the same flight until their troubles begin."""
        row = ROWS[self.row]
        return Stage(self.autopilot, self.number, row.arena, row.views, row.radius_m(self.number), row.variant, row.camera)


@dataclass(frozen=True)
class FaultRecord:
    """What came of a case; trace: of a program that broke. firmware: the version of a real one, "" for none."""

    case: FaultCase
    verdict: ScenarioVerdict
    simulated_s: float = 0.0
    trace: str = ""
    firmware: str = ""


def fly(cases: Sequence[FaultCase]) -> list[FaultRecord]:
    """Fly cases of one stage together, or some in real time one by one."""
    return [_fly_live(case) for case in cases] if cases[0].live else fly_together(cases)


def _fly_live(case: FaultCase) -> FaultRecord:
    try:
        with tempfile.TemporaryDirectory(prefix="uav_recon-") as folder:
            return record_of(case, flight_live(ROWS[case.row], case, Path(folder)))
    except Exception as error:  # a campaign goes on: what broke is in its record
        return broken(case, error)


def fly_together(cases: Sequence[FaultCase]) -> list[FaultRecord]:
    """Fly cases of one stage: once until their troubles begin, and then, one after the other, each in a fork of this process.

    An exception of a flight's program breaks its row, not the campaign, and so does the end of its process.
    """
    with tempfile.TemporaryDirectory(prefix="uav_recon-") as folder, FlightFork[list[FaultRecord]](Path(folder)) as fork:
        return _ForkedFlights(cases, Path(folder), fork).records()


class _ForkedFlights:
    """left: the cases that this process flies, by their rows."""

    def __init__(self, cases: Sequence[FaultCase], folder: Path, fork: FlightFork[list[FaultRecord]]) -> None:
        self._left = {case.row: case for case in cases}
        self._folder = folder
        self._fork = fork
        self._elsewhere: list[FaultRecord] = []
        self._stage = cases[0].stage

    def records(self) -> list[FaultRecord]:
        """Of all cases; in a fork, it does not return."""
        try:
            evidence = flight([ROWS[row] for row in self._left], self._stage, self._folder, self._split)
            records = [record_of(case, evidence) for case in self._left.values()]
            for case in self._left.values():
                if case.out is not None:
                    shutil.copytree(self._folder / "flight", case.out)
        except Exception as error:  # a campaign goes on: what broke is in its record
            records = [broken(case, error) for case in self._left.values()]
        self._fork.give(records)
        return [*self._elsewhere, *records]

    def _split(self, row: str) -> bool:
        if self._fork.split():
            self._left = {row: self._left[row]}
            self._elsewhere = []
            return True
        case = self._left.pop(row)
        self._elsewhere += self._fork.answer or [broken(case, RuntimeError("the process died"))]
        return False


def record_of(case: FaultCase, evidence: FlightEvidence) -> FaultRecord:
    """Judged."""
    row = ROWS[case.row]
    verdict = judge(row, evidence, violations(evidence, row.room))
    return FaultRecord(case, verdict, float(evidence.end_s - evidence.stamp_s[0]), firmware=evidence.firmware)


def broken(case: FaultCase, error: Exception) -> FaultRecord:
    """It tells why."""
    said = f"{type(error).__name__}: {error}".splitlines()[0]
    trace = "".join(traceback.format_exception(error))
    return FaultRecord(case, ScenarioVerdict((float("nan"),) * len(ROWS[case.row].bars), (said,)), trace=trace)


def flight(rows: Sequence[Scenario], stage: Stage, folder: Path, split: Callable[[str], bool] = never_split) -> FlightEvidence:
    """Fly rows' troubles in lockstep, and gather what their judges may look at. folder: for all that the flight writes, the
    product's account in its `flight`. split: of Meddler. Raises whatever the flight raises.
    """
    from rich.console import Console

    from sitl.apps.lockstep import fly_in_lockstep
    from sitl.apps.sim_options import SimOptions
    from sitl.faults.flights.hostile_planner import hostile
    from uav_recon import config as product_config

    options = SimOptions.parse(
        seed=stage.number,
        views=stage.views,
        autopilot=stage.autopilot,
        radius=stage.radius_m,
        variant=stage.variant,
        camera=stage.camera,
        mapper="depth-only",
        lockstep=True,
        out=folder / "flight",
    )
    scene = arena(stage.arena, options.radius_m, painted=stage.camera != "fast")
    options.make_folder()
    config = attended(options.config(scene, folder))
    product_config.save(config, options.out / "config.toml")
    troubles = [
        Fault(
            row.id,
            [*row.injectors(stage.number), *hostile(row.id, config)],
            row.onset,
            row.observe_s,
            row.observe_after_disarm_s,
        )
        for row in rows
    ]
    meddler = FaultDirector(troubles, stage.number, split=split)
    fly_in_lockstep(options, config, scene, Console(quiet=True), meddler.lands, timelapse=False, meddler=meddler)
    return evidence_of(meddler, config, options.out / "truth.npz", options.radius_m)


def attended(config: Config) -> Config:
    """The same where an operator has to attend, as one does in every flight in lockstep."""
    return config.model_copy(update={"mission": config.mission.model_copy(update={"operator_timeout_s": TIMEOUT_S})})


def flight_live(row: Scenario, case: FaultCase, folder: Path) -> FlightEvidence:
    """The same in real time, with the mapper that learns. Raises Failure."""
    from sitl.apps.sim_options import SimOptions
    from sitl.faults.flights.fault_flight_real_time import flight_in_real_time, free_port

    options = SimOptions.parse(
        seed=case.number,
        views=row.views,
        autopilot=case.autopilot,
        radius=row.radius_m(case.number),
        variant=row.variant,
        port=free_port(),
        out=case.out or folder / "flight",
    )
    options.make_folder()
    return flight_in_real_time(row, options, folder, case.number, case.firmware)
