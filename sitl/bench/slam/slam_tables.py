"""Tables printed by `uav-recon bench slam`."""

from __future__ import annotations

import math
from typing import Any

from rich.console import Console
from rich.table import Table

from uav_recon.measurement.printed_table import narrow_table

Result = dict[str, Any]
_COLUMNS = ("ATE, cm", "drift, %", "turned, °", "ms", "p95", "lost, %", "wrong, %")
_TITLE = "against true poses; drift over 2 m of path; ms a frame; wrong: reported good with an error above 0.3 m"
_KEYS = (
    ("ate_cm", 1, 1.0), ("drift_percent", 2, 1.0), ("rotation_deg", 2, 1.0), ("median_ms", 1, 1.0), ("p95_ms", 1, 1.0),
    ("lost", 1, 100.0), ("false_good", 1, 100.0),
)  # fmt: skip


def show(console: Console, result: Result) -> None:
    """Print the conditions, a row for each sequence, median, worst and reactions to a fault."""
    console.print(header(result["about"]), highlight=False)
    console.print(_sequences(result))
    if any("reactions" in summary for summary in result["summary"].values()):
        console.print(_reactions(result["summary"]))


def show_recordings(console: Console, rows: list[Result], about: Result) -> None:
    """Print a row for each recording and method."""
    console.print(
        f"commit {about['commit']}, {about['machine']}, processor time of all threads, its processor "
        f"{about['calibration_cpu']:.2f} times as slow as the reference machine.", highlight=False,
    )  # fmt: skip
    made = any(row["gyro"] == "reference" for row in rows)
    title = "against the reference poses; RPE over 1 s; lost: without a pose for more than 0.1 s, after the first one"
    table = narrow_table(
        title + ("; GYRO MADE FROM THE REFERENCE" if made else ""), "recording", "method", *(name for name, *_ in _RECORDED)
    )
    for row in rows:
        values = (_figure(row[key], digits, 1.0) for _, key, digits in _RECORDED)
        table.add_row(row["recording"][-18:], row["method"] + (" (black)" if row["fault"] else ""), *values)
    console.print(table)


_RECORDED = (
    ("path, m", "length_m", 1), ("ATE, cm", "ate_cm", 2), ("max", "ate_max_cm", 1), ("RPE, cm", "rpe_cm", 2),
    ("scale", "scale", 3), ("start, s", "first_pose_s", 2), ("lost, s", "lost_s", 2), ("ms", "median_ms", 1),
    ("p95", "p95_ms", 1),
)  # fmt: skip


def header(about: Result) -> str:
    """Return the conditions of the measurement as text."""
    fault = "no fault" if about["fault"] is None else f"fault {about['fault']}"
    return (
        f"{', '.join(about['scenes'])}: {about['paths']} paths of {about['length_m']:g} m, {about['seeds']} seeds, "
        f"camera errors {about['camera_errors']:g}, mount {about['mount']}, {fault}; commit {about['commit']}, "
        f"{about['machine']}, processor time of all threads, its processor {about['calibration_cpu']:.2f} times as slow as the "
        "reference machine."
    )


def _sequences(result: Result) -> Table:
    table = narrow_table(_TITLE, "method", "scene", "path", "seed", *_COLUMNS)
    for method, summary in result["summary"].items():
        rows = [row for row in result["sequences"] if row["method"] == method]
        for n, row in enumerate(rows):
            values = (_figure(row[key], digits, scale) for key, digits, scale in _KEYS)
            table.add_row(
                method, row["scene"], str(row["path"]), str(row["seed"]), *values,
                end_section=n == len(rows) - 1,
            )  # fmt: skip
        for which in ("median", "worst"):
            values = (_figure(summary[key][which], digits, scale) for key, digits, scale in _KEYS)
            table.add_row(method, which, "", "", *values, end_section=which == "worst")
    return table


def _reactions(summaries: Result) -> Table:
    table = narrow_table(
        "reactions to the fault", "method", "windows", "reported in 0.3 s", "median, s", "back in 2 s", "median, s",
        "longest false good, s",
    )  # fmt: skip
    for method, summary in summaries.items():
        r = summary["reactions"]
        table.add_row(
            method, str(r["windows"]), f"{r['reported_in_time']:.0%}", _figure(r["reported_s"], 2, 1.0),
            f"{r['back_in_time']:.0%}", _figure(r["back_s"], 2, 1.0), _figure(r["false_good_s"], 2, 1.0),
        )  # fmt: skip
    return table


def _figure(value: float | None, digits: int, scale: float) -> str:
    """Format a number, or '-' if it was not measured or is not finite."""
    return "-" if value is None or not math.isfinite(value) else f"{value * scale:.{digits}f}"
