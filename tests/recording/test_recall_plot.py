"""Plot of recall over flight time, complete for every flight.

Its appearance was checked by eye.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
from flight_inputs import START_S, write_timeline

from uav_recon.recording.flight_log import FlightLog, read_timeline
from uav_recon.recording.flight_report import FlightInfo, build_report, publish
from uav_recon.recording.recall_plot import recall_over_time
from uav_recon.recording.report import Report

CARD = FlightInfo("kitchen", "adaptive", "px4", "fixed:15")


def judged(folder: Path) -> Report:
    curve = tuple((2.0 + 3.0 * k, 1 + k, 1.0 - 0.5 * float(np.exp(-k / 3))) for k in range(9))
    times = {"0.90": 17.0, "0.95": 23.0}
    return dataclasses.replace(build_report(folder, CARD, 30.0), recall_over_time=curve, time_to_recall_s=times, oracle_s=10.0)


def content(picture: Path) -> float:
    image = cv2.imread(str(picture))
    assert image is not None and image.shape[1] == 1200
    return float(np.mean(image < 250))


def test_recall_views_and_modes_are_drawn(tmp_path: Path) -> None:
    write_timeline(tmp_path)
    report = judged(tmp_path)
    recall_over_time(tmp_path / "recall.png", read_timeline(tmp_path), report)
    assert 0.2 < content(tmp_path / "recall.png") < 0.95
    publish(report, tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words in ("while it flew", "17.0 s, 1.7 times the oracle", "23.0 s, 2.3 times the oracle", "18.0 s"):
        assert words in text, words


def test_a_flight_without_plans_or_views_also_has_a_plot(tmp_path: Path) -> None:
    log = FlightLog(tmp_path)
    log.phase(START_S, "take-off", None)
    log.close()
    recall_over_time(tmp_path / "recall.png", read_timeline(tmp_path), judged(tmp_path))
    bare = dataclasses.replace(judged(tmp_path), recall_over_time=((1.0, 0, 0.0),), time_to_recall_s={"0.90": None})
    recall_over_time(tmp_path / "bare.png", read_timeline(tmp_path), bare)
    assert content(tmp_path / "bare.png") < content(tmp_path / "recall.png")


def test_without_ground_truth_there_is_no_recall_plot(tmp_path: Path) -> None:
    write_timeline(tmp_path)
    publish(build_report(tmp_path, CARD, 30.0), tmp_path)
    assert not (tmp_path / "pictures" / "recall.png").exists()
