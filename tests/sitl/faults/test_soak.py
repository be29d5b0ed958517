"""A soak: what is measured of processes over hours, who is told what, and which flights fail it."""

from __future__ import annotations

import dataclasses
import json
import math
import random
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_evidence import ONSET_S, evidence

from sitl.faults.flights.campaign import Campaign
from sitl.faults.flights.fault_options import FaultOptions
from sitl.faults.injectors.base import InjectionContext
from sitl.faults.process_registry import ProcessRegistry
from sitl.faults.report.resource_chart import Track, draw
from sitl.faults.resource_usage import ResourceUsage, descriptors_of
from sitl.faults.soak import HEAP_FLUCTUATION_MB, RESUME_FOR_S, SOAKS, OperatorCommands, orders, soak
from sitl.faults.table.all_scenarios import SCENARIOS, TABLE
from sitl.faults.table.scenario import judge

FLAT = {
    "pilot MB/h": 0.9, "perception MB/h": -3.0, "pilot descriptors": 0.0, "perception descriptors": 0.0, "ended": 0.0,
}  # fmt: skip
HOLDER = """
import sys
held = []
for line in sys.stdin:
    held.append(bytearray(b"x") * int(line) if int(line) else open("/dev/null"))
    print("done", flush=True)
"""


def injection_context(folder: Path) -> InjectionContext:
    world: Any = None
    return InjectionContext(world, random.Random(1), registry=ProcessRegistry(folder), config=folder / "config.toml")


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that takes as many bytes as it is told, or a descriptor for 0, and keeps them."""
    with subprocess.Popen([sys.executable, "-c", HOLDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        ProcessRegistry(tmp_path).tell({"pilot": process.pid}, [])
        assert taken(process, 1) == "done"
        yield process
        process.kill()


def taken(holder: subprocess.Popen[str], count: int) -> str:
    assert holder.stdin is not None
    assert holder.stdout is not None
    holder.stdin.write(f"{count}\n")
    holder.stdin.flush()
    return holder.stdout.readline().strip()


def track(memory_mb: Any, descriptors: Any = None, period_s: float = 1.0) -> Track:
    since_s = [period_s * k for k in range(len(memory_mb))]
    return Track(1, since_s, list(memory_mb), list(descriptors or [9] * len(memory_mb)))


def test_a_slope_is_told_in_megabytes_an_hour() -> None:
    t = np.arange(600.0)
    assert track(80.0 + 2.0 * t / 3600.0).mb_per_h() == pytest.approx(2.0)
    assert track(80.0 + 0.0 * t).mb_per_h() == pytest.approx(0.0, abs=1e-9)
    noisy = 80.0 + 1.5 * t / 3600.0 + 0.05 * np.random.default_rng(1).standard_normal(600)
    assert track(noisy).mb_per_h() == pytest.approx(np.polyfit(t[120:] / 3600.0, noisy[120:], 1)[0])
    assert math.isnan(track([80.0, 80.0]).mb_per_h()), "two samples prove nothing"


def test_what_is_taken_at_first_is_no_growth() -> None:
    assert track(np.where(np.arange(100) < 20, 50.0, 80.0)).mb_per_h() == pytest.approx(0.0, abs=1e-9)
    assert track(np.where(np.arange(100) < 30, 50.0, 80.0)).mb_per_h() > 10.0


def test_a_descriptor_that_comes_and_goes_is_none_that_is_kept() -> None:
    assert track([1.0] * 40, [9, 9, 9, 9] + [10, 9] * 18).more_descriptors() == 0.0
    assert track([1.0] * 40, [9] * 20 + [10] * 20).more_descriptors() == 1.0


def resident_mb(folder: Path) -> float:
    """The pilot's newest."""
    return float(json.loads((folder / "soak.json").read_text())["pilot"]["memory_mb"][-1])


def test_a_process_that_grows_is_seen_to(tmp_path: Path, holder: subprocess.Popen[str]) -> None:
    at, footprints = injection_context(tmp_path), ResourceUsage(for_s=40.0)
    for second in range(41):
        if second >= 10:
            assert taken(holder, 1_000_000) == "done"
        if second == 30:
            assert taken(holder, 0) == "done"
        for part in range(3):  # turns come more often than it looks
            footprints.turn(at, second + 0.3 * part)
    footprints.turn(at, 41.0)
    footprints.end(at)
    assert at.notes["pilot MB/h"] == pytest.approx(3600.0, rel=0.1), "a megabyte each second"
    assert at.notes["pilot descriptors"] == 1.0
    assert (at.notes["ended"], "mission MB/h" in at.notes) == (0.0, False)
    assert len(json.loads((tmp_path / "soak.json").read_text())["pilot"]["since_s"]) == 41
    assert "pilot" in (tmp_path / "soak.svg").read_text()
    lines = (tmp_path / "soak.csv").read_text().splitlines()
    assert lines[0].startswith("s,pilot MB,pilot descriptors,perception MB,")
    assert len(lines) == 42
    assert [float(word) for word in lines[41].split(",")[:2]] == pytest.approx([40.0, resident_mb(tmp_path)], abs=1e-3)


def test_a_process_that_ends_is_counted_once(tmp_path: Path, holder: subprocess.Popen[str]) -> None:
    at, footprints = injection_context(tmp_path), ResourceUsage(for_s=40.0)
    footprints.turn(at, 0.0)
    holder.kill()
    holder.wait()
    ProcessRegistry(tmp_path).tell({}, [])
    for second in range(1, 5):
        footprints.turn(at, float(second))
    assert at.notes["ended"] == 1.0
    assert descriptors_of(holder.pid) == 0


def test_a_chart_is_a_picture_of_every_process() -> None:
    drawn = ET.fromstring(draw({"pilot": track([60.0] * 50), "mapper": track([200.0 + 0.1 * k for k in range(50)])}))
    lines = [e.get("points", "") for e in drawn.iter() if e.tag.endswith("polyline")]
    assert len(lines) == 2
    flat, steep = ([float(point.split(",")[1]) for point in line.split()] for line in lines)
    assert len(set(flat)) == 1
    assert steep[0] > steep[-1] + 100.0
    assert ET.fromstring(draw({})) is not None


def test_the_operator_holds_lets_go_a_few_times_and_lands() -> None:
    told = orders(7200.0)
    assert (told[0], told[-1]) == ((0.0, "hold"), (7200.0, "land"))
    assert [word for _, word in told[1:-1]] == ["start", "hold"] * 10
    assert told[2][0] - told[1][0] == RESUME_FOR_S
    assert [at_s for at_s, _ in told] == sorted(at_s for at_s, _ in told)
    assert orders(60.0) == [(0.0, "hold"), (30.0, "start"), (35.0, "hold"), (60.0, "land")]


def test_orders_are_given_once_by_the_command_line_and_nobody_is_left(tmp_path: Path) -> None:
    at, told = injection_context(tmp_path), OperatorCommands([(0.0, "hold"), (2.0, "land")])
    (tmp_path / "config.toml").write_text("[nonsense]\n", encoding="utf-8")
    begun_s = time.monotonic()
    told.turn(at, 0.0)
    told.turn(at, 0.1)
    assert time.monotonic() - begun_s < 2.0, "nobody waits for it"
    assert len(told._orders_sent) == 1
    deadline_s, pause = time.monotonic() + 60.0, threading.Event()
    while told._orders_sent:
        assert time.monotonic() < deadline_s
        told.turn(at, 0.2)
        pause.wait(0.05)
    told.turn(at, 2.0)
    assert len(told._orders_sent) == 1
    told.end(at)
    assert told._orders_sent[0].returncode == 78, "it read the flight's own config"


def test_a_soak_is_held_to_flat_memory_descriptors_and_its_length() -> None:
    """The flight of the evidence lands 10 s after the moment."""
    scenario = soak("X", "ten seconds", 9.5, 1.0, 1.0)
    assert judge(scenario, evidence(notes=FLAT), []).passed(scenario, "px4")
    for name in FLAT:
        assert not judge(scenario, evidence(notes=FLAT | {name: 1.1}), []).passed(scenario, "px4"), name
        without = {key: value for key, value in FLAT.items() if key != name}
        assert not judge(scenario, evidence(notes=without), []).passed(scenario, "px4"), f"without {name}"
    assert not judge(scenario, evidence(notes=FLAT | {"pilot MB/h": math.nan}), []).passed(scenario, "px4")
    longer = soak("X", "eleven seconds", 11.0, 1.0, 1.0)
    assert not judge(longer, evidence(notes=FLAT), []).passed(longer, "px4"), "it was cut short"
    flown = evidence(notes=FLAT)
    thin = flown.wire.setpoint_s[(flown.wire.setpoint_s < ONSET_S + 3.0) | (np.arange(len(flown.wire.setpoint_s)) % 2 == 0)]
    starved = dataclasses.replace(flown, wire=dataclasses.replace(flown.wire, setpoint_s=thin))
    assert not judge(scenario, starved, []).passed(scenario, "px4"), "fifteen setpoints a second"


@pytest.mark.parametrize(("scenario", "for_s"), [("G9-5min", 300.0), ("G9-1min", 60.0)])
def test_a_breath_is_no_growth_and_a_colour_image_kept_each_second_is(scenario: str, for_s: float) -> None:
    t, limit = np.arange(for_s), SCENARIOS[scenario].limits[1]
    steepest = max(track(np.where(t < at_s, 240.0, 240.0 + HEAP_FLUCTUATION_MB)).mb_per_h() for at_s in t)
    leaking = track(240.0 + 424 * 240 * 3 / 1e6 * t).mb_per_h()
    assert 0.9 * limit.limit < steepest < limit.limit < 0.5 * leaking


def test_a_soak_is_flown_by_its_rows_name_in_real_time_alone_and_not_by_default() -> None:
    assert [scenario.id for scenario in Campaign.of(FaultOptions(only="G9", real_time=True, seeds=1)).scenarios] == ["G9-2h"]
    assert [scenario.id for scenario in Campaign.of(FaultOptions(only="G9-1min,A9", real_time=True)).scenarios] == [
        "A9",
        "G9-1min",
    ]
    assert not {scenario.id for scenario in SOAKS} & {
        scenario.id for scenario in Campaign.of(FaultOptions(real_time=True)).scenarios
    }
    assert Campaign.of(FaultOptions(only="G9-5min")).cases(SCENARIOS["G9-5min"], "px4") == []
    assert "G9" in {scenario.id for scenario in TABLE}
    assert "--only G9 --real-time" in SCENARIOS["G9"].why
    assert [limit.limit for limit in SCENARIOS["G9-2h"].limits[:2]] == [1.0, 1.0], "megabytes an hour"
