"""The text that the launcher prints at the end of a flight."""

from __future__ import annotations

from pathlib import Path

from sitl.apps.flight_judge import results_of


def test_a_flight_without_a_recording_names_no_command_that_replays_it(tmp_path: Path) -> None:
    report = f"results: {tmp_path / 'report.html'}"
    assert results_of(tmp_path) == [report]
    (tmp_path / "flight.rrd").touch()
    assert results_of(tmp_path) == [report, f"replay the flight: uav-recon review {tmp_path}"]
