"""`uav-recon check camera`: watches a camera stream and prints a table of findings."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from uav_recon.app import camera_sources, config_file
from uav_recon.clock import MonotonicClock
from uav_recon.errors import EXIT_FAILURE, EXIT_USAGE, UserError
from uav_recon.sensors.stream_conformance import Finding, judge, observe
from uav_recon.sensors.stream_format import StreamError, StreamReader

_MIN_S, _MAX_S = 1.0, 600.0


def check(stream: Path | None, config: Path, duration_s: float) -> int:
    """Watch a stream for duration_s, print a table, and return the exit code.

    stream: its file; None: the stream of the config. Returns 0 if every finding is good, else 1.
    Raises UserError (one line) if the file is not a stream.
    """
    if not _MIN_S <= duration_s <= _MAX_S:
        raise UserError(f"--seconds {duration_s:g} is outside {_MIN_S:g} to {_MAX_S:g}", EXIT_USAGE)
    path = stream or camera_sources.stream_path(config_file.load_config(config))
    console = Console()
    try:
        reader = StreamReader(path)
    except StreamError as error:
        raise UserError(str(error)) from None
    with console.status(f"watching {path} for {duration_s:g} s: hold the camera level and still") as status:
        seen = observe(
            reader, MonotonicClock(), duration_s,
            lambda elapsed_s: status.update(f"watching {path}: {elapsed_s:.0f} of {duration_s:g} s"),
        )  # fmt: skip
    findings = judge(seen)
    console.print(_table(findings))
    wrong = sum(not one.good for one in findings)
    size = f"{reader.header.depth.width}x{reader.header.depth.height}"
    console.print(f"{path}: depth {size}, {len(findings)} findings, {wrong} wrong", soft_wrap=True)
    return EXIT_FAILURE if wrong else 0


def _table(findings: list[Finding]) -> Table:
    table = Table("", "finding", "value", "allowed", box=None)
    for one in findings:
        table.add_row("ok" if one.good else "WRONG", one.name, one.value, one.allowed, style=None if one.good else "bold red")
    return table
