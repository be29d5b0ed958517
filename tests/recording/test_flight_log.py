"""The mission's log survives crashes, damage and a full disk."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flight_inputs import START_S, TOO_FAST, frame, position, progress, write_timeline

from uav_recon.recording.flight_log import TIMELINE, FlightLog, read_timeline


def test_everything_written_is_read_back(tmp_path: Path) -> None:
    write_timeline(tmp_path)
    timeline = read_timeline(tmp_path)
    assert [record.phase for record in timeline.phases] == ["take-off", "survey", "landing"]
    assert [plan.mode for plan in timeline.plans] == ["explore"] * 5 + ["merged"] * 5 + [""]
    assert timeline.plans[3].step_s == pytest.approx(0.08)
    assert [view.index for view in timeline.views] == list(range(10))
    assert (timeline.refusals[0].reason, timeline.refusals[0].codes) == (TOO_FAST.text(), TOO_FAST.codes())
    assert timeline.torn_lines == 0
    assert timeline.start_s() == START_S
    stamps, path = timeline.path_world()
    assert stamps.shape == (60,) and path[7] == pytest.approx(position(3.5))
    samples = timeline.progress
    assert (samples[1].predicted_sigma_m, samples[1].measured_sigma_m) == (0.0035, None)
    assert (samples[4].predicted_sigma_m, samples[4].measured_sigma_m) == (0.005, 0.011)
    assert timeline.views[4].world_from_depth().matrix() == pytest.approx(frame(8.0).world_from_depth.matrix())


def test_a_log_from_before_the_uncertainty_of_the_place_was_written_is_read(tmp_path: Path) -> None:
    write_timeline(tmp_path)
    lines = [json.loads(line) for line in (tmp_path / TIMELINE).read_text().splitlines()]
    old = [{key: value for key, value in line.items() if not key.endswith("_sigma_m")} for line in lines]
    assert old != lines
    (tmp_path / TIMELINE).write_text("".join(json.dumps(line) + "\n" for line in old))
    timeline = read_timeline(tmp_path)
    assert (timeline.torn_lines, len(timeline.progress)) == (0, 60)
    assert {(sample.predicted_sigma_m, sample.measured_sigma_m) for sample in timeline.progress} == {(None, None)}


def test_the_uncertainty_of_the_place_is_unknown_on_the_ground(tmp_path: Path) -> None:
    log = FlightLog(tmp_path)
    for t_s, phase in ((0.5, "ready"), (1.5, "survey"), (2.5, "done")):
        log.progress(progress(t_s, phase))
    log.close()
    stamps_s, predicted_m, measured_m = read_timeline(tmp_path).place_sigmas_m()
    assert stamps_s == pytest.approx([START_S + 0.5, START_S + 1.5, START_S + 2.5])
    assert predicted_m == pytest.approx([np.nan, 0.0045, np.nan], nan_ok=True)
    assert measured_m == pytest.approx([np.nan, 0.011, np.nan], nan_ok=True)


def test_each_line_is_on_disk_before_the_log_is_closed(tmp_path: Path) -> None:
    log = FlightLog(tmp_path)
    log.refusal(1.0, TOO_FAST)
    assert read_timeline(tmp_path).refusals[0].reason == TOO_FAST.text()
    log.close()


def test_a_torn_last_line_loses_only_that_line(tmp_path: Path) -> None:
    write_timeline(tmp_path)
    path = tmp_path / TIMELINE
    path.write_bytes(path.read_bytes()[:-9])
    timeline = read_timeline(tmp_path)
    assert timeline.torn_lines == 1
    assert len(timeline.refusals) == 0 and len(timeline.progress) == 60


def test_a_mission_restarted_after_a_crash_appends_after_the_torn_line(tmp_path: Path) -> None:
    (tmp_path / TIMELINE).write_text('{"event": "refusal", "stamp_s": 1.0, "rea')
    log = FlightLog(tmp_path)
    log.refusal(2.0, TOO_FAST)
    log.close()
    timeline = read_timeline(tmp_path)
    assert [record.reason for record in timeline.refusals] == [TOO_FAST.text()]
    assert timeline.torn_lines == 1


def test_garbage_is_counted_and_skipped(tmp_path: Path) -> None:
    lines = [b"\xff\xfe", b"[1]", b'{"event": "nothing we know"}', b'{"event": "refusal", "stamp_s": 1.0}', b"null"]
    (tmp_path / TIMELINE).write_bytes(b"\n".join(lines) + b"\n")
    assert read_timeline(tmp_path).torn_lines == 5


def test_the_file_is_strict_json_even_for_numbers_that_are_not_finite(tmp_path: Path) -> None:
    log = FlightLog(tmp_path)
    log.plan(1.0, "explore", np.float64(np.nan), np.float32(0.5), 1, 2, 3, np.inf)  # type: ignore[arg-type]
    log.close()

    def refuse(name: str) -> Any:
        raise AssertionError(name)

    json.loads((tmp_path / TIMELINE).read_text(), parse_constant=refuse)
    (plan,) = read_timeline(tmp_path).plans
    assert np.isnan(plan.task_s) and plan.step_s == 0.5


def test_a_full_disk_never_stops_the_flight(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    class Full:
        def write(self, text: str) -> int:
            raise OSError(28, "No space left on device")

    log = FlightLog(tmp_path)
    log.close()
    log._file = Full()  # type: ignore[assignment]
    log.progress(progress(1.0))
    log.refusal(2.0, TOO_FAST)
    assert log.lost_lines == 2
    assert [record.message for record in caplog.records] == [
        f"{tmp_path / TIMELINE}: No space left on device; events are being lost"
    ]


def test_a_missing_timeline_is_read_as_empty(tmp_path: Path) -> None:
    timeline = read_timeline(tmp_path)
    assert timeline.progress == () and timeline.start_s() == 0.0
    assert timeline.path_world()[1].shape == (0, 3)
