"""A whole mission in real time with a firmware's binary in the simulated autopilot's place: a stand-in, or the real ones.

    UAV_RECON_ARDUCOPTER=/path/to/arducopter UAV_RECON_PX4=/path/to/bin/px4 pytest -m firmware

It flies on two cores that have nothing else to do.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from sitl.firmware.px4 import COMPANION_PORT
from uav_recon.recording.report import Report

pytestmark = [pytest.mark.slow, pytest.mark.real_time, pytest.mark.timeout(1800)]
STAND_IN = Path(__file__).with_name("firmware_stand_in.py")
BINARIES = {"ardupilot": "UAV_RECON_ARDUCOPTER", "px4": "UAV_RECON_PX4"}


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
    command = [sys.executable, "-m", "uav_recon.cli", "sim", *words, "--out", str(folder)]
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


def test_the_way_from_the_option_to_the_report_is_flown_with_a_stand_in(tmp_path: Path) -> None:
    program = tmp_path / "arducopter"
    program.write_text(f"#!{sys.executable}\n{STAND_IN.read_text(encoding='utf-8')}", encoding="utf-8")
    program.chmod(0o755)
    assert flown("ardupilot", str(program), 8, tmp_path / "f").safety.failsafes == 0
