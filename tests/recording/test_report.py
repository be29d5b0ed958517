"""report.json is strict and stable; report.html needs no other file."""

from __future__ import annotations

import copy
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uav_recon.recording.report import Report, ReportError, save_report
from uav_recon.recording.report_page import Picture, verdict, write_report

PIXEL = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108060000001f15c4890000000d49444154789c63f8cfc0f01f0005000"
    "1ff89993d1d0000000049454e44ae426082"
)


def tree() -> dict[str, Any]:
    times = {"task_s": {"median": 0.03, "p95": 0.05}, "step_s": {"median": 0.07, "p95": 0.11}}
    return {
        "scene": "built-in room", "variant": "adaptive", "seed": 1, "autopilot": "px4", "mount": "fixed:15",
        "depth_noise": "d435i", "outcome": "completed", "stop_reason": "14 frontiers left: 9 too narrow, 5 outside the fence",
        "views": 60, "path_length_m": 38.25, "flight_time_s": 161.5, "wall_time_s": 120.0,
        "last_view_s": 140.5, "waiting_share": 0.021, "recall_over_time": [[8.1, 1, 0.21], [96.4, 41, 0.931]],
        "time_to_recall_s": {"0.90": 96.4, "0.95": None}, "oracle_s": 33.0, "explored_fraction": 0.973,
        "quality": {
            "accuracy_cm": 1.21, "completion_cm": 1.43, "recall_5cm": 0.962, "recall_2cm": 0.871, "f_score_2cm": 0.88,
            "psnr_db": 22.4, "accuracy_point_cm": 1.9, "completion_point_cm": 2.0, "point_floor_cm": 1.34,
        },
        "planning": {"explore": times, "merged": copy.deepcopy(times), "total_s": 2.4, "hover_wait_s": 0.3},
        "stream": {"rate_hz": 29.97, "gap_p99_ms": 38.0, "gap_max_ms": 70.0},
        "safety": {
            "min_clearance_m": 0.184, "fence_overshoot_m": 0.0, "contacts": 0, "way_in_sight": 0.24,
            "way_in_sight_nose_first": 0.86, "refusals": 0, "failsafes": 0,
        },
        "refused_views": {"no depth": 2, "memory is full": 11},
        "reduced_speed_s": {"poses disagree for 0.3 s": 1.5, "no inertial samples": 62.4},
        "rejected_by_perception": {"depth-frame-empty": 4, "pose jump": 7},
        "camera_calibration": {"delay_s": [0.0281, 0.0062]}, "views_calibration": {"depth_scale": [0.0141, 0.0012]},
        "kept_calibration": "begun from an earlier flight",
        "correction": "odometry corrected by 0.21 m", "earlier_map": "not found yet",
        "camera": ["camera streams: depth 424x240 at 30 Hz, colour 424x240 at 30 Hz, IMU none, USB 3.2"],
        "odometry": {
            "ate_cm": 3.41, "largest_cm": 9.2, "shift_cm": 6.5, "turn_deg": 1.2, "model_aligned": True, "model_size": 1.0128,
            "shape_accuracy_cm": 0.59,
        },
        "unseen": {"upper_share": 0.02, "lower_share": 0.01, "split_m": 1.7, "text": ""},
        "sight": {
            "weak_s": 21.62, "blind_s": 8.4, "longest_blind_s": 3.1, "predicted_weak_s": 30.26, "predicted_blind_s": 9.8,
        },
        "ended_early": "",
    }  # fmt: skip


def without(path: str) -> dict[str, Any]:
    changed = copy.deepcopy(tree())
    *way, last = path.split(".")
    place = changed
    for key in way:
        place = place[key]
    del place[last]
    return changed


def refuse(name: str) -> Any:
    raise AssertionError(f"{name} is not JSON")


def test_a_report_is_read_back_unchanged(tmp_path: Path) -> None:
    path = save_report(Report.from_tree(tree()), tmp_path)
    assert json.loads(path.read_text(), parse_constant=refuse) == tree()
    assert list(json.loads(path.read_text())) == list(tree())
    assert Report.load(path) == Report.from_tree(tree())
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.json"]


@pytest.mark.parametrize("key", ["scene", "quality.psnr_db", "planning.merged.step_s.p95", "safety.contacts", "stream"])
def test_a_missing_key_is_named(key: str) -> None:
    with pytest.raises(ReportError, match=f"{key}: missing"):
        Report.from_tree(without(key))


def test_an_unknown_or_mistyped_key_is_named() -> None:
    with pytest.raises(ReportError, match=r"safety\.bumps: unknown key"):
        Report.from_tree(tree() | {"safety": tree()["safety"] | {"bumps": 1}})
    with pytest.raises(ReportError, match="views: input should be a valid integer, got 'many'"):
        Report.from_tree(tree() | {"views": "many"})
    with pytest.raises(ReportError, match="views: input should be a valid integer, got True"):
        Report.from_tree(tree() | {"views": True})
    with pytest.raises(ReportError, match="planning: input should be an object, got None"):
        Report.from_tree(tree() | {"planning": None})


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("recall_over_time", 3, r"recall_over_time: input should be a valid array, got 3"),
        ("recall_over_time", [[1.0, 2, 0.5], [1.0, 2]], r"recall_over_time\[1\]\[2\]: missing"),
        ("recall_over_time", [[1.0, 2.5, 0.5]], r"recall_over_time\[0\]\[1\]: input should be a valid integer, got 2.5"),
        ("time_to_recall_s", [1.0], r"time_to_recall_s: input should be an object"),
        ("time_to_recall_s", {"0.90": "soon"}, r"time_to_recall_s\.0\.90: input should be a valid number, got 'soon'"),
    ],
)
def test_a_curve_or_a_table_of_the_wrong_shape_is_named(key: str, value: Any, said: str) -> None:
    with pytest.raises(ReportError, match=said):
        Report.from_tree(tree() | {key: value})


def test_the_ratio_to_the_oracle_needs_both_times() -> None:
    report = Report.from_tree(tree())
    assert report.times_oracle("0.90") == pytest.approx(96.4 / 33.0)
    assert report.times_oracle("0.95") is None
    assert dataclasses.replace(report, oracle_s=None).times_oracle("0.90") is None


def test_an_invalid_report_file_is_a_one_line_error(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match="cannot be read"):
        Report.load(tmp_path / "report.json")
    (tmp_path / "report.json").write_text("{")
    with pytest.raises(ReportError, match="not JSON"):
        Report.load(tmp_path / "report.json")


def test_numbers_that_are_not_finite_become_null() -> None:
    report = Report.from_tree(tree())
    spoilt = dataclasses.replace(report, explored_fraction=float("nan"), path_length_m=np.float64("inf"))
    back = json.loads(spoilt.to_json(), parse_constant=refuse)
    assert back["explored_fraction"] is None and back["path_length_m"] is None


def test_the_page_needs_no_other_file(tmp_path: Path) -> None:
    (tmp_path / "mesh.png").write_bytes(PIXEL)
    pictures = [Picture(tmp_path / "mesh.png", "The <model>"), Picture(tmp_path / "missing.png", "not there")]
    _, page = write_report(tmp_path, Report.from_tree(tree()), pictures, ["a note & more"])
    text = page.read_text()
    assert "data:image/png;base64," in text and "not there" not in text
    assert "The &lt;model&gt;" in text and "a note &amp; more" in text
    assert "http" not in text  # nothing is loaded from a network
    for figure in (
        "Completed without contact",
        "14 frontiers left",
        "97.3 %",
        "1.21 cm",
        "0.18 m",
        "22.4 dB",
        "2:42",
        "70 ms",
        "140.5 s",
        "2.1 %",
        "96.4 s, 2.9 times the oracle",
        "<th>At reduced speed: no inertial samples</th><td>62 s of 162 s</td></tr><tr><th>At reduced speed: poses disagree",
        "<th>Memory is full</th><td>11</td></tr><tr><th>No depth</th><td>2</td></tr><tr><th>All</th><td>13</td>",
        "<th>Error of the position (ATE)</th><td>3.4 cm</td>",
        "<td>after this alignment</td>",
        "<h2>Uncertainty of the place in flight, standard deviation</h2>",
        "<th>Above 2 cm</th><td>21.6 s</td></tr><tr><th>Above 4 cm</th><td>8.4 s</td>",
        "<th>Longest time above 4 cm</th><td>3.1 s</td>",
        "<th>Predicted for the view: above 0.4 cm</th><td>30.3 s</td>",
        "<th>Predicted for the view: above 1.2 cm</th><td>9.8 s</td>",
        "<th>delay_s</th><td>0.0281 ± 0.0062</td>",
        "<th>Pose jump</th><td>7</td></tr><tr><th>Depth frame empty</th><td>4</td></tr><tr><th>All</th><td>11</td>",
    ):
        assert figure in text, figure


def test_the_page_states_that_ground_truth_is_missing(tmp_path: Path) -> None:
    safety = tree()["safety"] | {"min_clearance_m": None, "fence_overshoot_m": None, "contacts": None}
    real = tree() | {"recall_over_time": None, "time_to_recall_s": {"0.90": None, "0.95": None}, "oracle_s": None}
    real |= {"quality": None, "explored_fraction": None, "seed": None, "depth_noise": None, "safety": safety}
    real |= {
        "refused_views": None,
        "rejected_by_perception": None,
        "camera_calibration": None,
        "views_calibration": None,
        "camera": [],
    }
    real |= {"odometry": None}
    _, page = write_report(tmp_path, Report.from_tree(real))
    text = page.read_text()
    assert "no truth to be held against" in text
    assert "refused</h2>" not in text
    assert "rejected</h2>" not in text
    assert "Errors of the camera" not in text
    assert "Remarks about the camera" not in text
    assert "Accuracy" not in text and "None" not in text and "nan" not in text


@pytest.mark.parametrize(
    ("outcome", "contacts", "failsafes", "headline", "mood"),
    [
        ("completed", 0, 0, "Completed without contact", "good"),
        ("completed", None, 0, "Completed", "good"),
        ("completed", 1, 0, "Completed, but with 1 contact", "bad"),
        ("completed", 0, 2, "Completed, with 2 failsafes", "fair"),
        ("aborted: pose lost", 0, 0, "Aborted: pose lost", "bad"),
    ],
)
def test_the_headline_states_outcome_contacts_and_failsafes(
    outcome: str, contacts: int | None, failsafes: int, headline: str, mood: str
) -> None:
    safety = tree()["safety"] | {"contacts": contacts, "failsafes": failsafes}
    assert verdict(Report.from_tree(tree() | {"outcome": outcome, "safety": safety})) == (headline, mood)


def test_much_unseen_space_is_said_first_and_is_no_good_flight() -> None:
    unseen = {"upper_share": 0.35, "lower_share": 0.02, "split_m": 1.7, "text": "35 % of the room above 1.7 m was not seen"}
    report = Report.from_tree(tree() | {"unseen": unseen})
    assert verdict(report) == ("Completed, but 35 % of the room above 1.7 m was not seen", "fair")
    assert report.headline == "completed, but 35 % of the room above 1.7 m was not seen"
    assert Report.from_tree(tree()).headline == "completed"


def test_a_report_from_before_the_sight_was_measured_is_read(tmp_path: Path) -> None:
    report = Report.from_tree(without("sight"))
    assert report.sight is None
    _, page = write_report(tmp_path, report)
    assert "Uncertainty of the place" not in page.read_text()


def test_a_report_from_before_reduced_speed_was_logged_is_read(tmp_path: Path) -> None:
    report = Report.from_tree(without("reduced_speed_s"))
    assert report.reduced_speed_s is None
    _, page = write_report(tmp_path, report)
    assert "reduced speed" not in page.read_text()
