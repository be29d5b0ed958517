"""Tables printed by `uav-recon bench mapper` and `uav-recon bench uncertainty`."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from uav_recon.measurement.printed_table import narrow_table

Result = dict[str, Any]


def show(console: Console, result: Result) -> None:
    """Print the results of `bench mapper` and the conditions of the measurement."""
    about = result["about"]
    console.print(header(about), highlight=False)
    console.print(_times(result))
    console.print(_quality(result))
    psnr, hallucinated = result["psnr_db"], result["hallucinated_fraction"]
    console.print(
        f"pictures: {figure(psnr, 1)} dB ({figure(about['psnr_unpainted_db'], 1)} dB in learned colours alone) over "
        f"{about['held_out_pixels']} held-out pixels that some view saw; "
        f"hallucinated: {percent(hallucinated)} of the mesh's area is more than 10 cm from truth",
        highlight=False,
    )
    console.print(
        f"uncertainty of a partial map, AUSE: {figure(result['ause_all'], 3)} over all vertices, "
        f"{figure(result['ause_observed'], 3)} over observed ones; memory: {result['memory_mb']:.0f} MB",
        highlight=False,
    )
    for line in _corrections(about):
        console.print(line, highlight=False)


def show_uncertainties(console: Console, result: Result) -> None:
    """Print the results of `bench uncertainty`."""
    console.print(header(result["about"]), highlight=False)
    title = "AUSE (0 = a perfect ranking of errors) and Spearman's rank correlation (1 = perfect) against true error"
    table = narrow_table(title, "map after", "uncertainty", "AUSE all", "observed", "Spearman all", "observed")
    for partial in result["partial_maps"]:
        for n, (name, score) in enumerate(partial["scores"].items()):
            table.add_row(
                f"{partial['views']} views" if n == 0 else "",
                name,
                *(figure(score[key], 3) for key in ("ause_all", "ause_observed", "spearman_all", "spearman_observed")),
                end_section=n == len(partial["scores"]) - 1,
            )
    console.print(table)
    for partial in result["partial_maps"]:
        console.print(
            f"after {partial['views']} views: {partial['vertices']} vertices, {percent(partial['observed_share'])} observed; "
            f"mean error {partial['error_all_cm']:.2f} cm, observed {partial['error_observed_cm']:.2f} cm; "
            f"a random ranking has AUSE {figure(partial['random_all'], 3)}, observed {figure(partial['random_observed'], 3)}",
            highlight=False,
        )


def header(about: Result) -> str:
    """Return the conditions of the measurement as text."""
    return (
        f"{about['scene']}: {about['views']} views, camera {about['camera']}, noise {about['depth_noise']}, "
        f"mount {about['mount']}, pose noise {about['pose_noise']} (cm, deg), {about['steps_per_view']} steps a view, "
        f"seed {about['seed']}; commit {about['commit']}, {about['machine']}, one thread, "
        f"its processor {about['calibration_cpu']:.2f} times as slow as the reference machine."
    )


def figure(value: float | None, digits: int) -> str:
    """Format a number, or '-' if it was not measured."""
    return "-" if value is None else f"{value:.{digits}f}"


def percent(share: float | None) -> str:
    """Format a share of one as a percentage, or '-' if it was not measured."""
    return "-" if share is None else f"{share:.2%}"


def _corrections(about: Result) -> list[str]:
    lines = []
    if "uncorrected" in about:
        row = about["uncorrected"]
        lines.append(
            f"without corrections of pose and exposure: accuracy {figure(row['accuracy_cm'], 2)} cm, "
            f"recall {row['recall_seen_5cm']:.4f}, pictures {figure(row['psnr_db'], 1)} dB"
        )
    if "colour_sigma" in about:
        one, many = about["colour_sigma"]["one_exposure"], about["colour_sigma"]["many_exposures"]
        changes = ", ".join(f"{name} {many[name] / one[name] - 1.0:+.1%}" for name in one)
        lines.append(f"exposures in ±{about['exposure']:g} EV change the median colour sigma: {changes}")
    return lines


def _times(result: Result) -> Table:
    about = result["about"]
    calibrated, p95, wall = about["calibrated"], about["p95_ms"], about["wall_ms"]
    table = narrow_table(
        "processor's time (a busy machine does not lengthen it)", "", "median", "calibrated", "p95", "by the clock"
    )
    for name, key in (("step, ms", "step"), ("view update, ms", "view_update")):
        values = (result[f"{key}_ms"], calibrated[f"{key}_ms"], p95[key], wall[key])
        table.add_row(name, *(f"{value:.2f}" for value in values))
    for where in ("room", "view"):
        took = (result["extraction_ms"][where], calibrated["extraction_ms"][where], p95[f"extraction_{where}"])
        table.add_row(f"extraction, {where}, ms", *(f"{value:.2f}" for value in took), "")
    for recall, seconds in result["time_to_recall_s"].items():
        there = calibrated["time_to_recall_s"][recall]
        table.add_row(f"all views at once, recall {recall}, s", figure(seconds, 2), figure(there, 2), "", "")
    return table


def _quality(result: Result) -> Table:
    table = narrow_table(
        "against truth, point to surface", "", "recall of seen, 5 cm", "accuracy, cm", "completion, cm", "far off"
    )
    for name, row in (("this mapper", result), ("TSDF at 2 cm", result["about"]["tsdf_2cm"])):
        table.add_row(
            name,
            figure(row["recall_seen_5cm"], 4),
            figure(row["accuracy_cm"], 2),
            figure(row["completion_cm"], 2),
            percent(row["hallucinated_fraction"]),
        )
    return table
