"""`uav-recon bench setpoints`: regularity of setpoints under load, timed at the receiver.

Four processes run: the pilot as in flight, a simulated autopilot as the receiver, the load, and the recorder. The negative
control runs the same pilot as a thread of the load. It must exceed the limits; otherwise the limits detect nothing.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from sitl.apps.launched_process import WORLD_NICENESS
from sitl.bench.mapper.mapper_bench import PRINTED_WIDTH
from sitl.bench.setpoints import load as setpoint_load
from uav_recon import config as configuration
from uav_recon.app.option_validation import UsageError, require_writable_file
from uav_recon.app.process_table import PILOT, RECORDER
from uav_recon.app.reference_safety import REFERENCE_SAFETY
from uav_recon.config import Config
from uav_recon.errors import UserError
from uav_recon.measurement import host_info, result_file
from uav_recon.measurement.machine_speed import measure_machine_speed
from uav_recon.measurement.printed_table import narrow_table
from uav_recon.types.frames import FloatArray

MINUTES = (0.1, 120.0)
LIMITS_MS = {"p99": 50.0, "p99.9": 75.0, "max": 250.0}
AUTOPILOTS = ("px4", "ardupilot")
_LOADED_S = 300.0  # compiling may take long
_MARGIN_S = 240.0  # added to the measured time: boot, parameters, take-off


@dataclass(frozen=True)
class SetpointRegularity:
    """Milliseconds between arriving setpoints. The last gap ends with the measured time."""

    setpoints: int
    rate_hz: float
    median_ms: float
    p99_ms: float
    p999_ms: float
    max_ms: float

    @property
    def kept(self) -> bool:
        """Return True if all three limits are met."""
        return all(measured <= bar for measured, bar in zip(self.limited_ms, LIMITS_MS.values(), strict=True))

    @property
    def limited_ms(self) -> tuple[float, float, float]:
        """Return the values with a limit, in the order of LIMITS_MS."""
        return self.p99_ms, self.p999_ms, self.max_ms


def setpoint_regularity(arrivals_s: FloatArray, begin_s: float, end_s: float) -> SetpointRegularity:
    """Compute the regularity of the arrivals (N,) from begin_s to end_s.

    A stream that stops, or never starts, counts as a gap until the end.
    """
    inside = arrivals_s[(arrivals_s >= begin_s) & (arrivals_s <= end_s)]
    gaps_ms = np.diff(np.concatenate([[begin_s], inside, [end_s]])) * 1e3
    median, p99, p999 = (float(np.percentile(gaps_ms, q, method="higher")) for q in (50, 99, 99.9))
    return SetpointRegularity(len(inside), len(inside) / (end_s - begin_s), median, p99, p999, float(gaps_ms.max()))


def bench_setpoints(minutes: float, negative: bool, autopilot: str, json: Path | None) -> int:
    """Measure, print and write JSON. Raises UserError.

    Returns 1 if a limit is exceeded, or if the negative control meets all limits; else 0.
    """
    if not MINUTES[0] <= minutes <= MINUTES[1]:
        raise UsageError(f"--minutes {minutes:g}: want {MINUTES[0]:g} to {MINUTES[1]:g}")
    if autopilot not in AUTOPILOTS:
        raise UsageError(f"--autopilot {autopilot}: want one of {', '.join(AUTOPILOTS)}")
    require_writable_file("--json", json)
    status = Console(stderr=True)
    with status.status("loading ...") as now:
        measured = measure(minutes * 60.0, negative, autopilot, lambda what: now.update(f"{what} ..."))
    factor = measure_machine_speed().cpu_slowdown
    _show(Console(width=None if sys.stdout.isatty() else PRINTED_WIDTH), measured, minutes, negative, factor)
    if json is not None:
        about = {
            "machine": host_info.processor(), "commit": host_info.commit(), "calibration_cpu": factor, "minutes": minutes,
            "negative": negative, "autopilot": autopilot,
        }  # fmt: skip
        result_file.save(json, {**asdict(measured), "bars_ms": LIMITS_MS, "kept": measured.kept, "about": about})
    return int(measured.kept == negative)


def measure(seconds: float, negative: bool, autopilot: str, say: Callable[[str], None] = lambda _: None) -> SetpointRegularity:
    """Start all processes, fly for ``seconds``, and stop all processes. Raises UserError."""
    with tempfile.TemporaryDirectory(prefix="uav_recon-") as name, contextlib.ExitStack() as ends:
        folder = Path(name)
        config, path, log = _config(folder, autopilot), folder / "config.toml", folder / "log"
        configuration.save(config, path)
        out = folder / "arrivals.npz"
        flight = folder / "flight"
        load = ["sitl.bench.setpoints.load", str(path), str(folder), *(["pilot"] if negative else [])]
        loader = ends.enter_context(_child(load, log, PILOT.niceness if negative else 0))
        say("loading the machine")
        _await(folder / setpoint_load.LEARNING, loader, log)
        ends.enter_context(_child(["uav_recon", *RECORDER.arguments(path, flight)], log, RECORDER.niceness))
        if not negative:
            ends.enter_context(_child(["uav_recon", *PILOT.arguments(path, flight)], log, PILOT.niceness, PILOT.fifo_priority))
        say(f"flying for {seconds / 60.0:g} minutes")
        far = ["sitl.apps.setpoint_receiver", str(path), f"{seconds}", autopilot, str(out)]
        receiver = ends.enter_context(_child(far, log, WORLD_NICENESS))
        try:
            flown = receiver.wait(seconds + _MARGIN_S) == 0
        except subprocess.TimeoutExpired:
            flown = False
        if not flown and not negative:
            raise UserError(f"the vehicle did not fly: {_last_words(log)}")
        if not flown:  # the negative control prevented the take-off: no setpoint arrived
            return setpoint_regularity(np.zeros(0), 0.0, seconds)
        with np.load(out) as measured:
            return setpoint_regularity(measured["arrivals_s"], float(measured["begin_s"]), float(measured["end_s"]))


def _config(folder: Path, autopilot: str) -> Config:
    """Make a config with an empty hall and an unused port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    safety = {
        **REFERENCE_SAFETY,
        "fence_min_m": [-3.0, -3.0, -0.3], "fence_max_m": [3.0, 3.0, 2.5], "fence_inset_m": 0.3, "max_speed_mps": 1.0,
        "vehicle_radius_m": 0.2, "vehicle_height_m": 0.2, "blind_speed_mps": 1.0, "blind_memory_s": 10.0,
    }  # fmt: skip
    tree: dict[str, Any] = {
        "safety": safety,
        "link": {"autopilot": autopilot, "url": f"udp:127.0.0.1:{port}"},
        "recording": {"folder": str(folder)},
        "runtime": {"folder": str(folder / "run")},
    }
    return configuration.parse(tree, "setpoints")


@contextlib.contextmanager
def _child(module: list[str], log: Path, niceness: int, fifo_priority: int | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """Run a Python module of this project with a priority, if permitted.

    The process ends with this process, for any reason, or with the block.
    """
    from sitl.runtime.die_with_parent import die_with_parent_command
    from sitl.runtime.niceness import set_niceness

    command = die_with_parent_command([sys.executable, "-m", *module])
    with log.open("ab") as out:
        process = subprocess.Popen(  # noqa: S603 - our own programs
            command, stdin=subprocess.PIPE, stdout=out, stderr=out, start_new_session=True
        )
    set_niceness(process.pid, niceness)
    if fifo_priority is not None:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(process.pid, os.SCHED_FIFO, os.sched_param(fifo_priority))
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def _await(path: Path, process: subprocess.Popen[bytes], log: Path) -> None:
    deadline_s = time.monotonic() + _LOADED_S
    while not path.exists():
        if process.poll() is not None or time.monotonic() > deadline_s:
            raise UserError(f"the load did not begin: {_last_words(log)}")
        time.sleep(0.2)


def _last_words(log: Path) -> str:
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return lines[-1].strip() if lines else "and nobody said why"


def _show(console: Console, measured: SetpointRegularity, minutes: float, negative: bool, factor: float) -> None:
    who = "the pilot as a thread of the load (negative control)" if negative else "the pilot as it flies"
    console.print(
        f"{who}: {measured.setpoints} setpoints in {minutes:g} minutes, {measured.rate_hz:.2f} a second", highlight=False
    )
    table = narrow_table("", "between two", "ms", "bar")
    table.add_row("median", f"{measured.median_ms:.1f}", "")
    for (name, bar_ms), value_ms in zip(LIMITS_MS.items(), measured.limited_ms, strict=True):
        table.add_row(name, f"{value_ms:.1f}", f"{bar_ms:.0f}")
    console.print(table)
    word = "kept" if measured.kept else "missed"
    wanted = "missed, as it must be" if negative and not measured.kept else word
    console.print(
        f"{wanted}; commit {host_info.commit()}, {host_info.processor()}, {factor:.2f} times as slow as the reference"
    )
