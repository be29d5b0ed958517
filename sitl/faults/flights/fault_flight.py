"""Flights of the fault campaign, in lockstep or in real time, each with a verdict."""

from __future__ import annotations

import shlex
import shutil
import tempfile
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sitl.camera.camera_error_scale import DEFAULT_SCALE
from sitl.camera.d435i import Model
from sitl.faults.fault import Fault
from sitl.faults.fault_director import FaultDirector, never_split
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.flights.collect_evidence import evidence_of
from sitl.faults.injectors.operator_silence import TIMEOUT_S
from sitl.faults.judges.invariants import violations
from sitl.faults.table.all_scenarios import SCENARIOS
from sitl.faults.table.arenas import arena
from sitl.faults.table.scenario import Arena, Scenario, ScenarioVerdict, judge, standing_conditions
from sitl.runtime.process_fork import FlightFork
from sitl.scene.scene import HULL_RADIUS_M

if TYPE_CHECKING:
    from uav_recon.config import Config

MOUNT = "fixed:15"  # camera mount of every scenario


@dataclass(frozen=True)
class Stage:
    """Properties of a lockstep flight before its fault begins.

    number: the flight's number, which is its seed. camera_errors: scale of the camera's errors, which depend on the seed only.
    """

    autopilot: str
    number: int
    arena: Arena
    views: int
    radius_m: float = HULL_RADIUS_M
    variant: str = "adaptive"
    camera: Model = "fast"
    camera_errors: float = DEFAULT_SCALE
    poses: str = "stream"
    claimed_m: float | None = None


@dataclass(frozen=True)
class FaultCase:
    """One flight of a scenario.

    number: its seed, which also selects the case of the scenario. live: in real time, with processes. firmware: a real
    firmware, flown in real time. camera_errors: the factor of `sim --camera-errors`.
    """

    scenario: str
    autopilot: str
    number: int
    out: Path | None = None
    live: bool = False
    firmware: Path | None = None
    camera_errors: float = DEFAULT_SCALE

    @property
    def how(self) -> str:
        """Options of `faults`: real time or a real firmware, and the camera's errors."""
        errors = f"--camera-errors {self.camera_errors:g}"
        if self.firmware is not None:
            return f"--firmware {shlex.quote(str(self.firmware))} {errors}"
        return f"--real-time {errors}" if self.live else errors

    @property
    def stage(self) -> Stage:
        """Stage of this case.

        Cases with equal stages are the same flight until their faults begin.
        """
        scenario = SCENARIOS[self.scenario]
        return Stage(
            self.autopilot,
            self.number,
            scenario.arena,
            scenario.views,
            scenario.radius_m(self.number),
            scenario.variant,
            scenario.camera,
            self.camera_errors,
            scenario.poses,
            scenario.claimed_m,
        )


@dataclass(frozen=True)
class FaultRecord:
    """Result of a case.

    trace: traceback of a program that raised an exception. firmware: version of a real firmware, "" for none.
    """

    case: FaultCase
    verdict: ScenarioVerdict
    simulated_s: float = 0.0
    trace: str = ""
    firmware: str = ""


def fly(cases: Sequence[FaultCase]) -> list[FaultRecord]:
    """Fly cases of one stage together, or cases in real time one after the other."""
    return [_fly_live(case) for case in cases] if cases[0].live else fly_together(cases)


def _fly_live(case: FaultCase) -> FaultRecord:
    try:
        with tempfile.TemporaryDirectory(prefix="uav_recon-") as folder:
            return record_of(case, flight_live(SCENARIOS[case.scenario], case, Path(folder)))
    except Exception as error:  # the campaign continues; the record contains the error
        return broken(case, error)


def fly_together(cases: Sequence[FaultCase]) -> list[FaultRecord]:
    """Fly cases of one stage.

    They are flown once until their faults begin. Then each is flown in a fork of this process, one after the other. An
    exception of a flight's program, or the end of its process, fails its scenario and does not stop the campaign.
    """
    with tempfile.TemporaryDirectory(prefix="uav_recon-") as folder, FlightFork[list[FaultRecord]](Path(folder)) as fork:
        return _ForkedFlights(cases, Path(folder), fork).records()


class _ForkedFlights:
    """Flights of one stage in this process and its forks.

    _left: the cases that this process flies, by scenario id.
    """

    def __init__(self, cases: Sequence[FaultCase], folder: Path, fork: FlightFork[list[FaultRecord]]) -> None:
        self._left = {case.scenario: case for case in cases}
        self._folder = folder
        self._fork = fork
        self._elsewhere: list[FaultRecord] = []
        self._stage = cases[0].stage

    def records(self) -> list[FaultRecord]:
        """Return the records of all cases; in a fork it does not return."""
        try:
            evidence = flight([SCENARIOS[scenario] for scenario in self._left], self._stage, self._folder, self._split)
            records = [record_of(case, evidence) for case in self._left.values()]
            for case in self._left.values():
                if case.out is not None:
                    shutil.copytree(self._folder / "flight", case.out)
        except Exception as error:  # the campaign continues; the record contains the error
            records = [broken(case, error) for case in self._left.values()]
        self._fork.give(records)
        return [*self._elsewhere, *records]

    def _split(self, scenario: str) -> bool:
        if self._fork.split():
            self._left = {scenario: self._left[scenario]}
            self._elsewhere = []
            return True
        case = self._left.pop(scenario)
        self._elsewhere += self._fork.answer or [broken(case, RuntimeError("the process died"))]
        return False


def record_of(case: FaultCase, evidence: FlightEvidence) -> FaultRecord:
    """Return the record of a finished flight, with its verdict."""
    scenario = SCENARIOS[case.scenario]
    verdict = judge(scenario, evidence, violations(evidence, scenario.room))
    return FaultRecord(case, verdict, float(evidence.end_s - evidence.stamp_s[0]), firmware=evidence.firmware)


def broken(case: FaultCase, error: Exception) -> FaultRecord:
    """Return the record of a flight that ended with an exception, which it names."""
    said = f"{type(error).__name__}: {error}".splitlines()[0]
    trace = "".join(traceback.format_exception(error))
    return FaultRecord(case, ScenarioVerdict((float("nan"),) * len(SCENARIOS[case.scenario].limits), (said,)), trace=trace)


def flight(
    scenarios: Sequence[Scenario], stage: Stage, folder: Path, split: Callable[[str], bool] = never_split
) -> FlightEvidence:
    """Fly the faults of scenarios in lockstep, and return the evidence for their checks.

    folder: receives all that the flight writes; the product's log goes to its `flight`. split: see FaultDirector. Raises
    whatever the flight raises.
    """
    from rich.console import Console

    from sitl.apps.flight_config import flight_config
    from sitl.apps.flight_folder import make_folder
    from sitl.apps.lockstep import fly_in_lockstep
    from sitl.apps.sim_options import SimOptions
    from sitl.faults.flights.hostile_planner import hostile
    from uav_recon import config as product_config

    options = SimOptions(
        seed=stage.number,
        views=stage.views,
        autopilot=stage.autopilot,
        radius_m=stage.radius_m,
        mount=MOUNT,
        variant=stage.variant,
        camera=stage.camera,
        mapper="depth-only",
        lockstep=True,
        out=folder / "flight",
        camera_errors=str(stage.camera_errors),
        pose=stage.poses,
    )
    scene = arena(stage.arena, options.radius_m, painted=stage.camera != "fast")
    make_folder(options.folder)
    config = attended(flight_config(options, scene, folder))
    product_config.save(config, options.folder / "config.toml")
    faults = [
        Fault(
            scenario.id,
            [*scenario.injectors(stage.number), *hostile(scenario.id, config)],
            scenario.onset,
            scenario.observe_s,
            scenario.observe_after_disarm_s,
        )
        for scenario in scenarios
    ]
    director = FaultDirector(faults, stage.number, split=split, conditions=standing_conditions(stage.claimed_m))
    fly_in_lockstep(options, config, scene, Console(quiet=True), director.lands, timelapse=False, hook=director)
    return evidence_of(director, config, options.folder / "truth.npz", options.radius_m)


def attended(config: Config) -> Config:
    """Return the config with an operator timeout, as in every lockstep flight."""
    return config.model_copy(update={"mission": config.mission.model_copy(update={"operator_timeout_s": TIMEOUT_S})})


def flight_live(scenario: Scenario, case: FaultCase, folder: Path) -> FlightEvidence:
    """Fly a scenario in real time, with the neural mapper. Raises UserError."""
    from sitl.apps.flight_folder import make_folder
    from sitl.apps.sim_options import SimOptions
    from sitl.faults.flights.fault_flight_real_time import flight_in_real_time, free_port

    options = SimOptions(
        seed=case.number,
        views=scenario.views,
        autopilot=case.autopilot,
        radius_m=scenario.radius_m(case.number),
        mount=MOUNT,
        variant=scenario.variant,
        pose=scenario.poses,
        port=free_port(),
        out=case.out or folder / "flight",
        camera_errors=str(case.camera_errors),
    )
    make_folder(options.folder)
    return flight_in_real_time(scenario, options, folder, case.number, case.firmware)
