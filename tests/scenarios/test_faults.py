"""Faults in flight, a few of the campaign's rows: what the vehicle bears, and that a flight that does harm is seen."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from sitl.faults.body import Push
from sitl.faults.everywhere import violations
from sitl.faults.evidence import Evidence
from sitl.faults.host import Stall
from sitl.faults.row import Row, judge
from sitl.faults.table import ROWS
from sitl.faults.trouble import Onset
from sitl.fly_fault import FaultCase, Stage, flight, fly

pytestmark = pytest.mark.slow
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
    "G2": "a full disk is not felt",
    "G6": "an unknown firmware is not armed",
}


@pytest.mark.parametrize("row", PROMISES)
def test_the_promise_is_kept(row: str) -> None:
    record = fly([FaultCase(row, "px4", 0)])[0]
    assert not record.trace, record.trace
    assert record.verdict.passed(ROWS[row], "px4"), (PROMISES[row], record.verdict)


def flown(row: Row, folder: Path) -> Evidence:
    folder.mkdir(exist_ok=True)
    return flight([row], Stage("px4", 1, row.arena, row.views), folder)


def test_a_vehicle_pushed_into_a_wall_is_seen(tmp_path: Path) -> None:
    row = dataclasses.replace(
        ROWS["F2"], arena="hall", injectors=lambda n: [Push(6.0, 4.0)], onset=Onset((1.0, 2.0), speed_mps=0.3), longest_s=8.0
    )
    evidence = flown(row, tmp_path)
    said = violations(evidence)
    assert any("contact" in words for words in said), said
    assert not judge(row, evidence, said).passed(row, "px4")


def test_a_stream_that_dies_breaks_its_bar(tmp_path: Path) -> None:
    row = dataclasses.replace(ROWS["A1"], injectors=lambda n: [Stall("pilot", for_s=0.4)], longest_s=4.0)
    figures = dict(zip((bar.name for bar in row.bars), judge(row, flown(row, tmp_path), []).figures, strict=True))
    assert figures["setpoint gap"] == pytest.approx(0.4, abs=0.08)
    assert figures["setpoints in a second"] < 20.0


@pytest.mark.parametrize("row", ["A8", "A9"])
def test_real_processes_in_real_time(row: str) -> None:
    record = fly([FaultCase(row, "px4", 0, live=True)])[0]
    assert not record.trace, record.trace
    assert record.verdict.passed(ROWS[row], "px4"), record.verdict


def test_a_row_repeats_itself(tmp_path: Path) -> None:
    first, again = (flown(ROWS["E10"], tmp_path / name) for name in ("a", "b"))
    assert first.position_m.tobytes() == again.position_m.tobytes()
    assert first.wire.orders == again.wire.orders
