"""A whole mission in real time with a real firmware's binary in the simulated autopilot's place.

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

pytestmark = [pytest.mark.firmware, pytest.mark.slow, pytest.mark.timeout(1800)]
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


@pytest.mark.parametrize("autopilot", sorted(BINARIES))
def test_a_real_firmware_flies_a_whole_mission_and_touches_nothing(autopilot: str, tmp_path: Path) -> None:
    words = ["--autopilot", autopilot, "--firmware", binary(autopilot), "--port", str(free_port(autopilot)), "--views", "20"]
    command = [sys.executable, "-m", "uav_recon.cli", "sim", *words, "--out", str(tmp_path / "f")]
    flown = subprocess.run(command, capture_output=True, text=True, timeout=1500.0, check=False)
    logs = "\n".join(f"{log.name}: {log.read_text(errors='replace')[-2000:]}" for log in tmp_path.glob("f/logs/*.log"))
    assert flown.returncode == 0, flown.stdout + flown.stderr + logs
    report = Report.load(tmp_path / "f" / "report.json")
    assert report.outcome == "completed"
    assert report.safety.contacts == 0
    assert report.safety.fence_overshoot_m is not None
    assert report.safety.fence_overshoot_m <= 0.30
    assert report.safety.min_clearance_m is not None
    assert report.views >= 12
