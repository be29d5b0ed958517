"""Review of a flight folder: faults are reported in one line."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from test_rerun_recorder import fly

from uav_recon.recording import review as module
from uav_recon.recording.blueprint import RECORDING, review_blueprint
from uav_recon.recording.review import ReviewError, check_recording, recording_path, review
from uav_recon.recording.viewer import Viewer, open_viewer, viewer_command


def one_line(error: pytest.ExceptionInfo[ReviewError]) -> bool:
    return "\n" not in str(error.value)


def test_a_missing_folder_or_recording_is_named(tmp_path: Path) -> None:
    with pytest.raises(ReviewError, match="no such flight folder") as error:
        review(tmp_path / "nowhere")
    assert one_line(error)
    with pytest.raises(ReviewError, match=r"holds no flight\.rrd"):
        review(tmp_path)
    (tmp_path / RECORDING).touch()
    with pytest.raises(ReviewError, match="is empty"):
        recording_path(tmp_path)


def test_an_invalid_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / RECORDING).write_bytes(b"this is not a recording at all")
    with pytest.raises(ReviewError, match="not a recording") as error:
        check_recording(tmp_path)
    assert one_line(error)


def test_a_failing_viewer_is_a_one_line_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / RECORDING).write_bytes(b"x")
    script = "import sys; sys.stderr.write('first\\nno display\\n'); sys.exit(3)"
    monkeypatch.setattr(module, "viewer_command", lambda *_: [sys.executable, "-c", script])
    with pytest.raises(ReviewError, match="no display") as error:
        review(tmp_path)
    assert one_line(error)


def test_a_missing_viewer_is_a_one_line_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / RECORDING).write_bytes(b"x")
    monkeypatch.setattr(module, "viewer_command", lambda *_: ["/nowhere/viewer"])
    with pytest.raises(ReviewError, match="cannot be started") as error:
        review(tmp_path)
    assert one_line(error)


def test_the_viewer_never_listens_beyond_this_machine() -> None:
    command = viewer_command("--port", "1")
    assert command[command.index("--bind") + 1] == "127.0.0.1"
    assert Path(command[0]).is_file()  # the program itself and no wrapper, so that a kill reaches it
    assert Viewer(9).address == "rerun+http://127.0.0.1:9/proxy"


def test_a_viewer_that_ends_at_once_only_loses_the_live_view(caplog: pytest.LogCaptureFixture) -> None:
    assert open_viewer(port=1, command=[sys.executable, "-c", "raise SystemExit(4)"]) is None
    assert "ended at once with status 4" in caplog.text
    assert open_viewer(port=1, command=["/nowhere/viewer"]) is None
    assert "cannot be started" in caplog.text


def test_the_blueprint_is_made() -> None:
    assert review_blueprint() is not None


def test_a_recording_cut_at_any_byte_is_read_up_to_its_last_whole_message(tmp_path: Path) -> None:
    recorder, _ = fly(tmp_path, duration_s=3.0)
    recorder.close()
    data = (tmp_path / RECORDING).read_bytes()
    whole = check_recording(tmp_path)
    assert whole.cut_bytes == 0
    copy = tmp_path / "copy"
    copy.mkdir()
    read, cut = 0, 0
    for size in range(5000, len(data), len(data) // 25):
        (copy / RECORDING).write_bytes(data[:size])
        summary = check_recording(copy)
        assert read <= summary.chunks <= whole.chunks
        assert 0 <= summary.cut_bytes < size  # 0 where the cut is between two messages
        read, cut = summary.chunks, cut + (summary.cut_bytes > 0)
    assert read > 10
    assert cut > 10


def test_a_cut_within_the_first_values_is_one_line(tmp_path: Path) -> None:
    recorder, _ = fly(tmp_path, duration_s=1.0)
    recorder.close()
    data = (tmp_path / RECORDING).read_bytes()
    for size in (3, 4, 11, 13, 60):
        (tmp_path / RECORDING).write_bytes(data[:size])
        with pytest.raises(ReviewError, match="not a recording") as error:
            check_recording(tmp_path)
        assert one_line(error)


def test_a_cut_recording_is_opened_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    recorder, _ = fly(tmp_path, duration_s=1.0)
    recorder.close()
    path = tmp_path / RECORDING
    path.write_bytes(path.read_bytes()[:-5])
    monkeypatch.setattr(module, "viewer_command", lambda *_: [sys.executable, "-c", ""])
    review(tmp_path)
    assert "is cut" in caplog.text
