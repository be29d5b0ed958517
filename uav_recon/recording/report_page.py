"""HTML page of the report: self-contained (no files, no network) and readable on a phone."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from uav_recon.geometry.view_information import BLIND_M, GOOD_M
from uav_recon.recording.report import BLIND_SIGMA_M, WEAK_SIGMA_M, MedianP95, ModeTimes, Report, save_report
from uav_recon.recording.report_style import CSS

PAGE = "report.html"

MEASURED = (
    "Accuracy and completion are point to surface: 300,000 points of one side, evenly over the area, each to the nearest"
    " triangle of the other. Recall is the share of truth points with model surface within the distance. Truth is what the"
    " camera can see from 600 poses that the vehicle can reach, drawn once per scene and mount by a fixed seed; it never"
    " depends on what this flight saw. The explored share is over the space seen from the same poses. PSNR is over 100"
    " held-out views from such poses, pixels without model black. Point-to-point figures are those of the literature;"
    " their floor is truth drawn twice against itself. Clearance and contacts are measured from the hull by the"
    " simulator's truth. Recall over time holds the surface elements that the mapper published in flight against the same"
    " truth: each counts as a disc of half their spacing in radius. Its clock starts at the order to take off; the oracle knows"
    " the scene and needs its seconds, without take-off, to see 95 % of it within 3 m and 70° of incidence."
)
NOT_MEASURED = "This flight has no truth to be held against, so its quality, clearance and contacts were not measured."


@dataclass(frozen=True, slots=True)
class Picture:
    """A PNG image of the flight folder and its caption."""

    path: Path
    caption: str


def write_report(
    folder: Path, report: Report, pictures: Sequence[Picture] = (), notes: Sequence[str] = ()
) -> tuple[Path, Path]:
    """Write report.json and report.html; returns both paths. Missing images are left out.

    notes: further sentences for the reader, for example about what could not be measured and why.
    """
    json_path = save_report(report, folder)
    page = folder / PAGE
    page.write_text(render_page(report, pictures, notes), encoding="utf-8")
    return json_path, page


def verdict(report: Report) -> tuple[str, str]:
    """Return the headline and its colour class: good, fair or bad."""
    if not report.completed:
        return report.outcome[:1].upper() + report.outcome[1:], "bad"
    if report.safety.contacts:
        return f"Completed, but with {_count(report.safety.contacts, 'contact')}", "bad"
    if report.safety.failsafes:
        return f"Completed, with {_count(report.safety.failsafes, 'failsafe')}", "fair"
    if report.headline != report.outcome:
        return report.headline[:1].upper() + report.headline[1:], "fair"
    return "Completed" + (" without contact" if report.safety.contacts == 0 else ""), "good"


def render_page(report: Report, pictures: Sequence[Picture], notes: Sequence[str]) -> str:
    """Return the whole page as HTML."""
    headline, mood = verdict(report)
    shown = [picture for picture in pictures if picture.path.is_file()]
    sections = [
        _header(report, headline, mood),
        _tiles(report),
        _figures(shown[:1], "hero"),
        _figures(shown[1:], "pictures"),
        '<div class="tables">',
        _quality(report),
        _refused_views(report),
        _rejected_by_perception(report),
        _camera(report),
        _odometry(report),
        _sight(report),
        _camera_calibration(report),
        _views_calibration(report),
        _correction(report),
        _earlier_map(report),
        _safety(report),
        _planning(report),
        _flight(report),
        "</div>",
        _notes([MEASURED if report.quality is not None else NOT_MEASURED, *notes]),
    ]
    title = html.escape(f"{report.scene}: {headline}")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{CSS}</style></head><body><main>{''.join(sections)}</main></body></html>\n"
    )


def _header(report: Report, headline: str, mood: str) -> str:
    labels = [report.scene, report.variant, report.autopilot, f"mount {report.mount}"]
    labels += [] if report.depth_noise is None else [f"{report.depth_noise} depth noise"]
    labels += [] if report.seed is None else [f"seed {report.seed}"]
    chips = "".join(f"<span>{html.escape(label)}</span>" for label in labels)
    return (
        f'<header class="{mood}"><h1>{html.escape(headline)}</h1>'
        f'<p class="stop">{html.escape(report.stop_reason)}</p><p class="chips">{chips}</p></header>'
    )


def _tiles(report: Report) -> str:
    quality, safety = report.quality, report.safety
    minutes, seconds = divmod(round(report.flight_time_s), 60)
    tiles = [
        ("explored", _percent(report.explored_fraction), "of the space that can be seen"),
        ("views", str(report.views), "given to the model"),
        ("flight", f"{minutes}:{seconds:02d}", f"minutes, {report.path_length_m:.1f} m of path"),
        *_unseen(report),
        ("clearance", _number(safety.min_clearance_m, 2, " m"), "smallest, hull to anything"),
    ]
    if quality is not None:
        tiles += [
            ("recall", _percent(quality.recall_5cm), "of the surface within 5 cm"),
            ("accuracy", _number(quality.accuracy_cm, 2, " cm"), "model to truth"),
            ("completion", _number(quality.completion_cm, 2, " cm"), "truth to model"),
            ("picture", _number(quality.psnr_db, 1, " dB"), "PSNR of unseen views"),
        ]
    cells = "".join(f"<div><h3>{name}</h3><b>{value}</b><p>{what}</p></div>" for name, value, what in tiles)
    return f'<section class="tiles">{cells}</section>'


def _unseen(report: Report) -> list[tuple[str, str, str]]:
    """Return a tile with the unknown share of the upper part of the room."""
    if report.unseen is None:
        return []
    return [("unseen", _percent(report.unseen.upper_share), f"of the room above {report.unseen.split_m:g} m")]


def _figures(pictures: Sequence[Picture], kind: str) -> str:
    if not pictures:
        return ""
    parts = []
    for picture in pictures:
        data = base64.b64encode(picture.path.read_bytes()).decode("ascii")
        caption = html.escape(picture.caption)
        parts.append(
            f'<figure><img src="data:image/png;base64,{data}" alt="{caption}"><figcaption>{caption}</figcaption></figure>'
        )
    return f'<section class="{kind}">{"".join(parts)}</section>'


def _quality(report: Report) -> str:
    quality = report.quality
    if quality is None:
        return ""
    return _table(
        "Quality",
        [
            ("Accuracy, point to surface", _number(quality.accuracy_cm, 2, " cm")),
            ("Completion, point to surface", _number(quality.completion_cm, 2, " cm")),
            ("Recall within 5 cm", _percent(quality.recall_5cm)),
            ("Recall within 2 cm", _percent(quality.recall_2cm)),
            ("F-score at 2 cm", _number(quality.f_score_2cm, 3, "")),
            ("PSNR, held-out views", _number(quality.psnr_db, 1, " dB")),
            ("Accuracy, point to point", _number(quality.accuracy_point_cm, 2, " cm")),
            ("Completion, point to point", _number(quality.completion_point_cm, 2, " cm")),
            ("Floor of point to point", _number(quality.point_floor_cm, 2, " cm")),
        ],
    )


def _refused_views(report: Report) -> str:
    refused = report.refused_views
    if refused is None:
        return ""
    reasons = sorted(refused.items(), key=lambda item: (-item[1], item[0]))
    rows = [(reason[:1].upper() + reason[1:], str(count)) for reason, count in reasons]
    return _table("Views that the mapper refused", [*rows, ("All", str(sum(refused.values())))])


def _odometry(report: Report) -> str:
    found = report.odometry
    if found is None:
        return ""
    rows = [
        ("Error of the position (ATE)", _number(found.ate_cm, 1, " cm")),
        ("Largest error", _number(found.largest_cm, 1, " cm")),
        ("Alignment with the true path", f"{found.shift_cm:.1f} cm, {found.turn_deg:.1f}°"),
        ("Model compared", "after this alignment" if found.model_aligned else "as it is"),
    ]
    if found.model_size is not None:
        rows.append(("Size of the model, against the true one", f"{100.0 * (found.model_size - 1.0):+.1f} %"))
        rows.append(("Its accuracy at the true size", _number(found.shape_accuracy_cm, 2, " cm")))
    return _table("Odometry against the true path", rows)


def _sight(report: Report) -> str:
    found = report.sight
    if found is None:
        return ""
    rows = [
        (f"Above {_centimetres(WEAK_SIGMA_M)}", _number(found.weak_s, 1, " s")),
        (f"Above {_centimetres(BLIND_SIGMA_M)}", _number(found.blind_s, 1, " s")),
        (f"Longest time above {_centimetres(BLIND_SIGMA_M)}", _number(found.longest_blind_s, 1, " s")),
        (f"Predicted for the view: above {_centimetres(GOOD_M)}", f"{found.predicted_weak_s:.1f} s"),
        (f"Predicted for the view: above {_centimetres(BLIND_M)}", f"{found.predicted_blind_s:.1f} s"),
    ]
    return _table("Uncertainty of the place in flight, standard deviation", rows)


def _camera_calibration(report: Report) -> str:
    errors = report.camera_calibration
    if not errors:
        return ""
    rows = _error_rows(errors)
    if report.kept_calibration:
        rows.append(("Begun from", report.kept_calibration))
    return _table("Errors of the camera, as estimated in flight", rows)


def _views_calibration(report: Report) -> str:
    errors = report.views_calibration
    return _table("Errors of the camera that the model is corrected for", _error_rows(errors)) if errors else ""


def _error_rows(errors: Mapping[str, tuple[float, float]]) -> list[tuple[str, str]]:
    return [(name, f"{value:.4f} ± {sigma:.4f}") for name, (value, sigma) in errors.items()]


def _correction(report: Report) -> str:
    return _table("Correction of the odometry", [("At the end", report.correction)]) if report.correction else ""


def _earlier_map(report: Report) -> str:
    return _table("Map of an earlier flight", [("At the end", report.earlier_map)]) if report.earlier_map else ""


def _rejected_by_perception(report: Report) -> str:
    rejected = report.rejected_by_perception
    if rejected is None:
        return ""
    reasons = sorted(rejected.items(), key=lambda item: (-item[1], item[0]))
    rows = [(reason[:1].upper() + reason[1:].replace("-", " "), str(count)) for reason, count in reasons]
    return _table("What perception rejected", [*rows, ("All", str(sum(rejected.values())))])


def _camera(report: Report) -> str:
    rows = [(str(number), text) for number, text in enumerate(report.camera, start=1)]
    return _table("Remarks about the camera", rows) if rows else ""


def _safety(report: Report) -> str:
    safety, stream = report.safety, report.stream
    return _table(
        "Safety and stream",
        [
            ("Smallest clearance of the hull", _number(safety.min_clearance_m, 3, " m")),
            ("Contacts", _number(safety.contacts, 0, "")),
            ("Over the fence by", _number(safety.fence_overshoot_m, 3, " m")),
            ("Proposals the guard refused", str(safety.refusals)),
            ("Way into the camera's sight", _percent(safety.way_in_sight)),
            ("... with the nose ahead it would be", _percent(safety.way_in_sight_nose_first)),
            ("Failsafes of the autopilot", _number(safety.failsafes, 0, "")),
            ("Setpoint rate", _number(stream.rate_hz, 1, " Hz")),
            ("Gap, 99th percentile", _number(stream.gap_p99_ms, 0, " ms")),
            ("Gap, longest", _number(stream.gap_max_ms, 0, " ms")),
        ],
    )


def _planning(report: Report) -> str:
    planning = report.planning
    rows = [
        (f"{name}: {what}", f"{_milliseconds(spread.median)} / {_milliseconds(spread.p95)}")
        for name, mode in (("Explore", planning.explore), ("Merged", planning.merged))
        for what, spread in _steps(mode)
    ]
    rows += [("All planning", f"{planning.total_s:.2f} s"), ("Hovered waiting for a plan", f"{planning.hover_wait_s:.2f} s")]
    return _table("Planning, median / 95th percentile", rows)


def _steps(mode: ModeTimes) -> tuple[tuple[str, MedianP95], ...]:
    return ("tasks", mode.task_s), ("whole step", mode.step_s)


def _flight(report: Report) -> str:
    files = ("report.json", "config.toml", "mesh.ply", "flight.rrd", "flight.tlog", "timeline.jsonl")
    links = " ".join(f'<a href="{name}">{name}</a>' for name in files)
    return _table(
        "Flight",
        [
            ("Path", f"{report.path_length_m:.2f} m"),
            ("Flight time, armed to disarmed", f"{report.flight_time_s:.1f} s"),
            *_reduced_speed(report),
            ("From the order to take off to the last view", _number(report.last_view_s, 1, " s")),
            ("Share of it spent waiting for a plan", _percent(report.waiting_share)),
            *((f"To a recall of {recall}", _time_to(report, recall)) for recall in report.time_to_recall_s),
            ("Wall time", f"{report.wall_time_s:.1f} s"),
        ],
        f'<p class="files">{links}</p>',
    )


def _reduced_speed(report: Report) -> list[tuple[str, str]]:
    """Return a row for each reason of a reduced speed, the longest first."""
    reasons = sorted((report.reduced_speed_s or {}).items(), key=lambda item: (-item[1], item[0]))
    flight_s = report.flight_time_s
    return [(f"At reduced speed: {reason}", f"{lasted_s:.0f} s of {flight_s:.0f} s") for reason, lasted_s in reasons]


def _table(title: str, rows: Sequence[tuple[str, str]], after: str = "") -> str:
    body = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in rows)
    return f"<section><h2>{html.escape(title)}</h2><table>{body}</table>{after}</section>"


def _notes(notes: Sequence[str]) -> str:
    text = "".join(f"<p>{html.escape(note)}</p>" for note in notes)
    return f'<section class="notes"><h2>How this was measured</h2>{text}</section>'


def _time_to(report: Report, recall: str) -> str:
    times = report.times_oracle(recall)
    return _number(report.time_to_recall_s[recall], 1, " s") + ("" if times is None else f", {times:.1f} times the oracle")


def _number(value: float | None, digits: int, unit: str) -> str:
    return "–" if value is None else f"{value:.{digits}f}{unit}"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.1f} %"


def _centimetres(value_m: float) -> str:
    return f"{100.0 * value_m:g} cm"


def _milliseconds(value: float | None) -> str:
    return "–" if value is None else f"{1e3 * value:.0f} ms"


def _count(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
