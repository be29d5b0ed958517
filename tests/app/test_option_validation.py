"""Unusable paths are one-line errors with exit code 2, in every command.

They are reported before any work is done.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from uav_recon.app.option_validation import UsageError, require_writable_file, require_writable_folder
from uav_recon.cli.main import app

UNREADABLE = "/tmp/" + "x" * 300  # too long a name, which fails even for root


def says(*words: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, list(words))
    assert isinstance(done.exception, SystemExit | None), done.exception
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1, done.stderr
    return done.exit_code, done.stderr


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("review {}/x", 2),
        ("refine {}/x", 2),
        ("params check --config {}/c.toml", 78),
        ("pilot --config {}/c.toml", 78),
        ("sweep --flights 1 --json {}/x.json", 2),
        ("sweep --flights 1 --scenes {}/x", 2),
        ("faults --only A1 --seeds 1 --out {}/x", 2),
        ("faults --only A1 --seeds 1 --json {}/x.json", 2),
        ("faults --only A1 --autopilot px4 --firmware {}/x", 2),
        ("sim --lockstep --out {}/x", 2),
        ("sim --lockstep --scene {}/x", 2),
        ("sim --firmware {}/x", 2),
        ("bench tasks {}/x", 2),
        ("bench planner --stream {}/x", 2),
        ("bench planner --scale --json {}/x.json", 2),
        ("bench mapper --scene {}/x", 2),
    ],
)
def test_an_unreadable_path_is_a_one_line_error(words: str, code: int) -> None:
    told, said = says(*words.format(UNREADABLE).split())
    assert told == code, said
    assert "File name too long" in said
    assert UNREADABLE in said


@pytest.mark.parametrize(
    "words",
    [
        "sweep --flights 1 --json {}",
        "faults --only A1 --seeds 1 --json {}",
        "bench planner --json {}",
        "bench mapper --json {}",
        "bench uncertainty --json {}",
        "bench endurance --json {}",
        "bench setpoints --json {}",
        "bench tasks FLIGHT --json {}",
    ],
)
@pytest.mark.parametrize("where", ["nowhere/x.json", ".", "/proc/x.json"])
def test_an_unwritable_json_file_is_reported_before_the_work(words: str, where: str, tmp_path: Path) -> None:
    told, said = says(*words.format(tmp_path / where).split())
    assert told == 2, said
    assert said.startswith(f"uav-recon: --json {tmp_path / where}: ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("out", ["file/x", "file", "/proc/x"])
def test_an_unwritable_folder_is_reported_before_the_work(out: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    told, said = says("faults", "--only", "A1", "--seeds", "1", "--autopilot", "px4", "--out", str(tmp_path / out))
    assert told == 2
    assert said.startswith(f"uav-recon: --out {tmp_path / out}: cannot be written (")


def test_checking_a_path_leaves_existing_files_unchanged(tmp_path: Path) -> None:
    held = tmp_path / "held.json"
    held.write_text("{}")
    require_writable_file("--json", held)
    require_writable_file("--json", tmp_path / "new.json")
    require_writable_file("--json", None)
    require_writable_folder("--out", tmp_path / "a" / "b")
    require_writable_folder("--out", None)
    assert held.read_text() == "{}"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "b", "held.json"]
    with pytest.raises(UsageError, match="no such folder"):
        require_writable_file("--json", tmp_path / "c" / "x.json")


@pytest.mark.parametrize(
    "words",
    [
        "bench mapper --views 1",
        "bench mapper --mount foo",
        "bench mapper --camera fast",
        "bench endurance --hours 0",
        "bench uncertainty --after x",
        "bench setpoints --minutes 0",
        "bench setpoints --autopilot inav",
        "bench tasks /nowhere",
        "bench planner --stride 0",
        "review /nowhere",
        "refine /nowhere",
        "sweep --mount foo",
        "faults --only Z9",
    ],
)
def test_a_bad_option_has_the_same_exit_code_everywhere(words: str) -> None:
    assert says(*words.split())[0] == 2
