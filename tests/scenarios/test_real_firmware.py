"""A whole mission and scenarios of the fault table in real time with a firmware's binary in the simulated autopilot's place: a
stand-in, or the real ones.

    UAV_RECON_ARDUCOPTER=/path/to/arducopter UAV_RECON_PX4=/path/to/bin/px4 pytest -m firmware

It flies on two cores that have nothing else to do.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from sitl.faults.flights.campaign import FIRMWARE_OFFERS
from sitl.faults.table.all_scenarios import SCENARIOS
from sitl.real_firmware.px4 import COMPANION_PORT
from uav_recon.recording.report import Report

pytestmark = [pytest.mark.slow, pytest.mark.nightly, pytest.mark.real_time, pytest.mark.timeout(1800)]
STAND_IN = Path(__file__).with_name("simulated_firmware_program.py")
ALWAYS_FLOWN = ("A1", "A6", "B1", "B4", "E1")
BINARIES = {"ardupilot": "UAV_RECON_ARDUCOPTER", "px4": "UAV_RECON_PX4"}
FLOWN = [
    (autopilot, scenario)
    for autopilot in sorted(BINARIES)
    for scenario in ALWAYS_FLOWN
    if SCENARIOS[scenario].flown_by(FIRMWARE_OFFERS[autopilot])
]


def binary(autopilot: str) -> str:
    path = os.environ.get(BINARIES[autopilot])
    if not path:
        pytest.skip(f"{BINARIES[autopilot]} names no firmware")
    return path


def free_port(autopilot: str) -> int:
    if autopilot == "px4":
        return COMPANION_PORT  # its start script knows no other
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def flown(autopilot: str, firmware: str, views: int, folder: Path) -> Report:
    """The report of a flight that completed."""
    words = ["--autopilot", autopilot, "--firmware", firmware, "--port", str(free_port(autopilot)), "--views", str(views)]
    command = [sys.executable, "-m", "uav_recon", "sim", *words, "--out", str(folder)]
    sim = subprocess.run(command, capture_output=True, text=True, timeout=1500.0, check=False)
    logs = "\n".join(f"{log.name}: {log.read_text(errors='replace')[-2000:]}" for log in folder.glob("logs/*.log"))
    assert sim.returncode == 0, sim.stdout + sim.stderr + logs
    report = Report.load(folder / "report.json")
    assert report.outcome == "completed"
    assert report.safety.contacts == 0
    assert report.safety.fence_overshoot_m is not None
    assert report.safety.fence_overshoot_m <= 0.30
    assert report.safety.min_clearance_m is not None  # it was followed: this is measured along its true path
    assert report.path_length_m > 1.0
    return report


@pytest.mark.firmware
@pytest.mark.parametrize("autopilot", sorted(BINARIES))
def test_a_real_firmware_flies_a_whole_mission_and_touches_nothing(autopilot: str, tmp_path: Path) -> None:
    assert flown(autopilot, binary(autopilot), 20, tmp_path / "f").views >= 12


@pytest.mark.firmware
@pytest.mark.parametrize(("autopilot", "scenario"), FLOWN)
def test_a_real_firmware_stands_what_goes_wrong(autopilot: str, scenario: str, tmp_path: Path) -> None:
    result = fault_row(autopilot, binary(autopilot), scenario, tmp_path)
    assert result["passed"], result
    assert (result["tier"], bool(result["firmware"])) == ("T1", True)


def test_no_row_is_left_out_but_the_takeover_that_px4_has_no_sticks_for() -> None:
    """SIH under PX4's own start script is given no transmitter."""
    everything = {(autopilot, scenario) for autopilot in BINARIES for scenario in ALWAYS_FLOWN}
    assert everything - set(FLOWN) == {("px4", "E1")}


def fault_row(autopilot: str, firmware: str, scenario: str, folder: Path) -> dict[str, object]:
    """Outcome of one flight of a scenario."""
    words = [
        "--only",
        scenario,
        "--seeds",
        "1",
        "--autopilot",
        autopilot,
        "--firmware",
        firmware,
        "--json",
        str(folder / "f.json"),
    ]
    command = [sys.executable, "-m", "uav_recon", "faults", *words, "--out", str(folder / "f")]
    told = subprocess.run(command, capture_output=True, text=True, timeout=900.0, check=False)
    assert told.returncode in (0, 1), told.stdout + told.stderr
    scenarios: list[dict[str, object]] = json.loads((folder / "f.json").read_text(encoding="utf-8"))["scenarios"]
    return scenarios[0]


def stand_in(folder: Path) -> str:
    """A program that is started as ArduPilot's is."""
    program = folder / "arducopter"
    program.write_text(f"#!{sys.executable}\n{STAND_IN.read_text(encoding='utf-8')}", encoding="utf-8")
    program.chmod(0o755)
    return str(program)


def test_the_way_from_the_option_to_the_table_is_flown_with_a_stand_in(tmp_path: Path) -> None:
    result = fault_row("ardupilot", stand_in(tmp_path), "B1", tmp_path)
    assert result["passed"], result


def test_the_way_from_the_option_to_the_report_is_flown_with_a_stand_in(tmp_path: Path) -> None:
    assert flown("ardupilot", stand_in(tmp_path), 8, tmp_path / "f").safety.failsafes == 0
