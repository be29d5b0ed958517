"""Evaluation of a flight against ground truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from sitl.apps import flight_judge
from sitl.apps.flight_judge import add_truth_metrics, results_of
from uav_recon.recording.flight_report import FlightInfo, build_report


def test_a_recall_reached_after_the_landing_has_no_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    curve = ((70.0, 30, 0.91), (190.0, 40, 0.96))
    monkeypatch.setattr(flight_judge, "recall_over_time", lambda *_: curve)
    monkeypatch.setattr(flight_judge, "load_map", lambda _: None)
    flown = replace(build_report(tmp_path, FlightInfo("room", "adaptive", "px4", "fixed:10"), 1.0), flight_time_s=183.0)
    room = cast("Any", SimpleNamespace(name="room", folder=tmp_path))
    report = add_truth_metrics(flown, room, room, room)
    assert report.recall_over_time == curve
    assert report.time_to_recall_s == {"0.90": 70.0, "0.95": None}


def test_a_flight_without_a_recording_names_no_command_that_replays_it(tmp_path: Path) -> None:
    report = f"results: {tmp_path / 'report.html'}"
    assert results_of(tmp_path) == [report]
    (tmp_path / "flight.rrd").touch()
    assert results_of(tmp_path) == [report, f"replay the flight: uav-recon review {tmp_path}"]
