"""Faults in flight, a few scenarios of the campaign: what the vehicle tolerates, and that a harmful flight is detected."""

from __future__ import annotations

import dataclasses
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from sitl.faults.fault import Onset
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.flights.fault_flight import FaultCase, FaultRecord, Stage, flight, fly, record_of
from sitl.faults.injectors.companion import Stall
from sitl.faults.injectors.vehicle_and_autopilot import Push
from sitl.faults.judges.invariants import violations
from sitl.faults.table.all_scenarios import SCENARIOS
from sitl.faults.table.scenario import Scenario, judge

pytestmark = [pytest.mark.slow, pytest.mark.nightly, pytest.mark.timeout(900)]
PROMISES = {
    "A7": "a pilot restarted in the air commands nothing",
    "D2": "a dead uplink ends in the firmware's landing, and nobody takes it back",
    "D3": "a fifth of the frames lost is borne",
    "E1": "a pilot's switch wins and ends our stream",
    "E4": "forged commands have no effect",
    "E6": "a refused arming is given up, never forced",
    "E10": "the operator's key lands at once",
    "F1": "a planner gone mad flies nothing",
    "F4": "without an origin nothing is armed",
    "F6": "a gap that is too narrow is refused in words",
    "G2": "a full disk is not felt",
    "G6": "an unknown firmware is not armed",
    "A1+B1": "of two troubles the worse is answered: without a pose it lands, whatever the planner does",
}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, FaultRecord]]:
    """All of them as a campaign flies them, those of a stage together, in a process that has no threads; and their folders."""
    out = tmp_path_factory.mktemp("faults")
    stages: dict[Stage, list[FaultCase]] = {}
    for scenario in PROMISES:
        case = FaultCase(scenario, "px4", 0, out / scenario)
        stages.setdefault(case.stage, []).append(case)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        records = [record for cases in stages.values() for record in pool.submit(fly, cases).result()]
    return out, {record.case.scenario: record for record in records}


@pytest.mark.parametrize("scenario", PROMISES)
def test_the_promise_is_kept(scenario: str, campaign: tuple[Path, dict[str, FaultRecord]]) -> None:
    record = campaign[1][scenario]
    assert not record.trace, record.trace
    assert record.verdict.passed(SCENARIOS[scenario], "px4"), (PROMISES[scenario], record.verdict)


def test_a_flight_of_a_campaign_is_the_same_flight_alone(campaign: tuple[Path, dict[str, FaultRecord]], tmp_path: Path) -> None:
    case = campaign[1]["E10"].case
    assert case.out is not None
    evidence = flight([SCENARIOS["E10"]], case.stage, tmp_path)
    assert record_of(case, evidence) == campaign[1]["E10"]
    assert (case.out / "flight.tlog").read_bytes() == (tmp_path / "flight" / "flight.tlog").read_bytes()
    with np.load(case.out / "truth.npz") as shared, np.load(tmp_path / "flight" / "truth.npz") as alone:
        assert all(shared[name].tobytes() == alone[name].tobytes() for name in alone.files)


def flown(scenario: Scenario, folder: Path) -> FlightEvidence:
    folder.mkdir(exist_ok=True)
    return flight(
        [scenario],
        Stage("px4", 1, scenario.arena, scenario.views, scenario.radius_m(1), scenario.variant, scenario.camera),
        folder,
    )


def test_a_vehicle_pushed_into_a_wall_is_seen(tmp_path: Path) -> None:
    scenario = dataclasses.replace(
        SCENARIOS["F2"],
        arena="hall",
        injectors=lambda n: [Push(6.0, 4.0)],
        onset=Onset((1.0, 2.0), speed_mps=0.3),
        observe_s=8.0,
    )
    evidence = flown(scenario, tmp_path)
    said = violations(evidence)
    assert any("contact" in words for words in said), said
    assert not judge(scenario, evidence, said).passed(scenario, "px4")


def test_a_stream_that_dies_breaks_its_bar(tmp_path: Path) -> None:
    scenario = dataclasses.replace(SCENARIOS["A1"], injectors=lambda n: [Stall("pilot", for_s=0.4)], observe_s=4.0)
    figures = dict(
        zip((limit.name for limit in scenario.limits), judge(scenario, flown(scenario, tmp_path), []).figures, strict=True)
    )
    assert figures["setpoint gap"] == pytest.approx(0.4, abs=0.08)
    assert figures["setpoints in a second"] < 20.0


@pytest.mark.parametrize(("views", "passes"), [(46, True), (10, False)], ids=["through", "views spent before"])
def test_a_tight_passage_is_flown_or_the_row_is_lost(tmp_path: Path, views: int, passes: bool) -> None:
    scenario = dataclasses.replace(SCENARIOS["F6"], views=views)
    verdict = judge(scenario, flown(scenario, tmp_path), [])
    assert verdict.passed(scenario, "px4") is passes, verdict
    assert verdict.figures[2:] == ((0.0, 0.0) if passes else (1.0, 0.0)), "it came home either way"


@pytest.mark.real_time
@pytest.mark.parametrize("scenario", ["A8", "A9", "G9-1min"])
def test_real_processes_in_real_time(scenario: str) -> None:
    record = fly([FaultCase(scenario, "px4", 0, live=True)])[0]
    assert not record.trace, record.trace
    assert record.verdict.passed(SCENARIOS[scenario], "px4"), record.verdict
