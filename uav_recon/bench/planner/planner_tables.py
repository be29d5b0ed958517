"""Tables printed by `uav-recon bench planner`."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from uav_recon.measurement.printed_table import narrow_table

Result = dict[str, Any]


def show(console: Console, result: Result) -> None:
    """Print the results and the conditions of the measurement."""
    console.print(
        f"{result['stream']}: {result['frames']} frames of {result['image']} at stride {result['stride']}, one thread; "
        f"commit {result['commit']}, {result['machine']}, {result['calibration']:.2f} times as slow as the reference machine "
        f"(its processor {result['calibration_cpu']:.2f}). "
        f"Compiled in {result['compile_s']:.1f} s beforehand, not counted.",
        highlight=False,
    )
    if "scale" in result:
        console.print(_scale(result["scale"]))
        return
    console.print(_stages(result))
    if result["tour"]:
        console.print(_tours(result))
    for line in _quality(result):
        console.print(line, highlight=False)


def _stages(result: Result) -> Table:
    title = "milliseconds a frame: by the clock, of the processor (a busy machine does not lengthen it), both calibrated"
    table = narrow_table(title, "stage", "median", "p95", "max", "cal.", "p95", "proc.", "p95", "cal.", "p95")
    for name in result["stages"]:
        tables = ("stages", "stages_calibrated", "stages_cpu", "stages_cpu_calibrated")
        wall, wall_there, cpu, cpu_there = (result[table][name] for table in tables)
        values = [wall["median_ms"], wall["p95_ms"], wall["max_ms"]]
        for spread in (wall_there, cpu, cpu_there):
            values += [spread["median_ms"], spread["p95_ms"]]
        table.add_row(name, *(f"{value:.2f}" for value in values))
    return table


def _tours(result: Result) -> Table:
    table = narrow_table("tours, processor's milliseconds", "tasks", "median", "calibrated", "mean gap", "worst gap")
    for tasks, score in result["tour"].items():
        calibrated_ms = score["median_ms"] / result["calibration_cpu"]
        table.add_row(
            tasks, f"{score['median_ms']:.3f}", f"{calibrated_ms:.3f}", f"{score['gap']:.2%}", f"{score['worst_gap']:.2%}"
        )
    return table


def _quality(result: Result) -> list[str]:
    lengths = result["path_lengths"]
    lines = []
    if result["agreement"] is not None:
        lines.append(
            f"map: {result['agreement']:.2%} of the voxels agree with the reference to within one; "
            f"{result['occupied_freed']} that it calls occupied are free"
        )
    for mount, key in (("gimbal", "best_view_ratio"), ("fixed", "best_view_ratio_fixed")):
        ratio = result[key]
        if ratio["views"]:
            lines.append(
                f"views, {mount}: {ratio['median']:.3f} of what the best of 1,000 random ones sees (median of "
                f"{ratio['views']}; 5th percentile {ratio['p05']:.3f}, lowest {ratio['min']:.3f}; "
                f"{ratio['share_of_95']:.1%} of them see 95 % of it)"
            )
    if lengths is not None:
        lines.append(
            f"paths: {lengths['mean_m']:.3f} m on {lengths['pairs']} pairs, {lengths['mean_excess']:+.2%} beside exact search "
            f"(p95 {lengths['p95_excess']:+.2%}, worst {lengths['max_excess']:+.2%})"
        )
    return lines


def _scale(sizes: list[Result]) -> Table:
    title = "growth: processor's milliseconds a frame, and times the smallest"
    table = narrow_table(title, "stage", "m²", "voxels", "median", "p95", "median x", "p95 x", "memory MB")
    for size in sizes:
        for n, (name, spread) in enumerate(size["stages"].items()):
            ratio = size["ratio"][name]
            table.add_row(
                name,
                f"{size['area_m2']:.0f}" if n == 0 else "",
                "x".join(map(str, size["voxels"])) if n == 0 else "",
                f"{spread['median_ms']:.2f}",
                f"{spread['p95_ms']:.2f}",
                f"{ratio['median']:.2f}",
                f"{ratio['p95']:.2f}",
                f"{size['memory_mb']:.0f}" if n == 0 else "",
                end_section=n == len(size["stages"]) - 1,
            )
    return table
