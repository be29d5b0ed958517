"""Folder and files of a flight, refused before its work begins."""

from __future__ import annotations

from pathlib import Path

import pytest

from sitl.apps.flight_folder import check_folder, check_kept_file, check_program, dated_folder, make_own_folder
from uav_recon.app.option_validation import UsageError
from uav_recon.errors import UserError
from uav_recon.localization.calibration import kept_calibration
from uav_recon.localization.calibration.kept_calibration import is_calibration


def test_a_folder_that_cannot_be_used_is_refused_before_the_scene_is_loaded(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "flown").mkdir()
    (tmp_path / "flown" / "timeline.jsonl").touch()
    for out, named in (
        ("file/x", "is not a folder"),
        ("file", "is not a folder"),
        ("flown", "already contains timeline.jsonl"),
    ):
        with pytest.raises(UsageError, match=named):
            check_folder(tmp_path / out)
    check_folder(tmp_path / "a" / "b")
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("name", ["config.toml", "keyframes", "mesh.ply", "report.json", "timeline.jsonl"])
def test_a_folder_with_something_that_a_flight_would_replace_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    with pytest.raises(UsageError, match=rf"--out .*: already contains {name}; name another folder") as failure:
        check_folder(tmp_path)
    assert failure.value.code == 2
    (tmp_path / name).rename(tmp_path / "notes.txt")
    check_folder(tmp_path)


def test_a_calibration_file_that_cannot_be_used_is_refused_before_the_flight(tmp_path: Path) -> None:
    notes, kept, new = tmp_path / "notes.txt", tmp_path / "kept.json", tmp_path / "new.json"
    notes.write_text("notes\n", encoding="ascii")
    kept_calibration.write(kept, "a camera", (("delay_s", 0.02, 0.004),))
    for file, named in (
        (notes, f"--calibration {notes}: not a calibration file"),
        (tmp_path / "no" / "c.json", f"--calibration {tmp_path / 'no' / 'c.json'}: folder {tmp_path / 'no'} does not exist"),
        (tmp_path, f"--calibration {tmp_path}: is a folder"),
        (Path("/dev/null"), "--calibration /dev/null: not a calibration file"),
        (notes / "c.json", f"--calibration {notes / 'c.json'}: folder {notes} does not exist"),
        (tmp_path / ("x" * 300), f"--calibration {tmp_path / ('x' * 300)}: cannot be read (File name too long)"),
    ):
        with pytest.raises(UserError) as failure:
            check_kept_file("--calibration", file, is_calibration, "a calibration file")
        assert (str(failure.value), failure.value.code) == (named, 2)
    for file in (kept, new):
        check_kept_file("--calibration", file, is_calibration, "a calibration file")
    assert sorted(tmp_path.iterdir()) == [kept, notes]


def test_flights_that_begin_in_the_same_second_get_folders_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    dated = dated_folder("random:7")
    assert dated.is_absolute()
    assert dated.name.startswith("random-7-")
    made = [make_own_folder(dated) for _ in range(3)]
    assert [folder.name for folder in made] == [dated.name, f"{dated.name}-2", f"{dated.name}-3"]
    assert all(folder.is_dir() for folder in made)


def test_a_program_that_cannot_be_started_is_a_one_line_error(tmp_path: Path) -> None:
    plain, program = tmp_path / "readme", tmp_path / "arducopter"
    plain.write_text("", encoding="ascii")
    program.write_text("", encoding="ascii")
    program.chmod(0o755)
    check_program(program)
    check_program(None)
    for path, named in (
        (tmp_path / "none", "none: no such file"),
        (tmp_path, "is a folder; want the binary"),
        (plain, "readme: not executable"),
    ):
        with pytest.raises(UsageError, match=named) as failure:
            check_program(path)
        assert "\n" not in str(failure.value)
