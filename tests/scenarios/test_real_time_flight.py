"""The real processes in real time: a short flight, an operator's Ctrl-C, a second one, and a process that dies."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import short_training

from uav_recon.recording.flight_log import outcome_text
from uav_recon.recording.report import Report
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

pytestmark = [pytest.mark.slow, pytest.mark.real_time]
READY_S = 240.0


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def descendants(pid: int) -> set[int]:
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                stat = (entry / "stat").read_text()
            except OSError:
                continue
            parents[int(entry.name)] = int(stat.rpartition(")")[2].split()[1])
    found: set[int] = set()
    todo = {pid}
    while todo:
        todo = {child for child, parent in parents.items() if parent in todo} - found
        found |= todo
    return found


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


class Sim:
    """`uav-recon sim` as a child, its output read line by line."""

    def __init__(self, folder: Path, views: int, program: tuple[str, ...] = ("-m", "uav_recon")) -> None:
        self.folder = folder
        command = [sys.executable, *program, "sim", "--views", str(views), "--out", str(folder)]
        self.process = subprocess.Popen(
            [*command, "--port", str(free_port())], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self.said: list[str] = []

    def wait_for(self, pattern: str) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.said.append(line)
            if re.search(pattern, line):
                return
        raise AssertionError(f"ended without saying {pattern!r}:\n{''.join(self.said)}")

    def end(self, timeout_s: float = READY_S) -> str:
        rest, _ = self.process.communicate(timeout=timeout_s)
        return "".join(self.said) + rest


def all_gone(pids: set[int], within_s: float) -> bool:
    deadline_s = time.monotonic() + within_s
    while time.monotonic() < deadline_s:
        if not any(alive(pid) for pid in pids):
            return True
        os.sched_yield()
    return False


def test_a_short_flight_is_completed(tmp_path: Path) -> None:
    """The gate's one real-time flight: it asserts no rate, because the machine may be busy."""
    sim = Sim(tmp_path / "f", views=6, program=(short_training.__file__,))
    said = sim.end(800.0)
    assert sim.process.returncode == 0, said
    assert "Traceback" not in said
    report = Report.load(tmp_path / "f" / "report.json")
    assert report.outcome == "completed"
    assert report.safety.contacts == 0
    for name in ("report.html", "mesh.ply", "flight.rrd", "flight.tlog", "config.toml", "keyframes/poses.json"):
        assert (tmp_path / "f" / name).stat().st_size > 0, name


@pytest.mark.nightly
def test_a_short_flight_in_real_time_keeps_its_stream(tmp_path: Path) -> None:
    sim = Sim(tmp_path / "f", views=12)
    said = sim.end(400.0)
    assert sim.process.returncode == 0, said
    assert "Traceback" not in said
    report = Report.load(tmp_path / "f" / "report.json")
    assert report.outcome == "completed"
    assert report.views == 12
    assert report.safety.contacts == 0
    assert report.stream.rate_hz is not None
    assert report.stream.gap_p99_ms is not None
    assert report.stream.rate_hz >= 28.0
    assert report.stream.gap_p99_ms <= 60.0
    assert report.stream.gap_max_ms is not None
    assert report.stream.gap_max_ms <= 250.0
    assert report.safety.failsafes == 0
    for name in ("report.html", "mesh.ply", "flight.rrd", "flight.tlog", "config.toml", "keyframes/poses.json"):
        assert (tmp_path / "f" / name).stat().st_size > 0, name


@pytest.mark.nightly
def test_ctrl_c_lands_and_still_writes_the_report(tmp_path: Path) -> None:
    sim = Sim(tmp_path / "f", views=60)
    sim.wait_for("^survey")
    pids = descendants(sim.process.pid)
    assert len(pids) >= 6  # world, pilot, perception, mission, mapper, recorder
    sim.process.send_signal(signal.SIGINT)
    said = sim.end()
    assert (tmp_path / "f" / "report.json").exists(), said
    report = Report.load(tmp_path / "f" / "report.json")
    assert report.outcome == outcome_text(Reason(ReasonCode.OPERATOR_LAND))
    assert report.safety.contacts == 0
    assert (tmp_path / "f" / "report.html").exists()
    assert sim.process.returncode == 1, said
    assert all_gone(pids, 2.0)


@pytest.mark.nightly
def test_a_second_ctrl_c_ends_everything_at_once(tmp_path: Path) -> None:
    sim = Sim(tmp_path / "f", views=60)
    sim.wait_for("^survey")
    pids = descendants(sim.process.pid)
    sim.process.send_signal(signal.SIGINT)
    sim.wait_for("press Ctrl-C again")
    sim.process.send_signal(signal.SIGINT)
    sim.end(20.0)
    assert sim.process.returncode == 130
    assert all_gone(pids, 2.0)


@pytest.mark.nightly
def test_a_process_that_dies_is_named_and_nothing_is_left(tmp_path: Path) -> None:
    sim = Sim(tmp_path / "f", views=60)
    sim.wait_for("^survey")
    pids = descendants(sim.process.pid)
    victims = [pid for pid in pids if b"perception" in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")]
    os.kill(victims[0], signal.SIGKILL)
    said = sim.end()
    assert sim.process.returncode == 1
    assert "uav-recon: perception died" in said
    assert "Traceback" not in said
    assert all_gone(pids, 2.0)
    assert Report.load(tmp_path / "f" / "report.json").outcome.startswith("aborted: perception died")
