"""Command line: values that each option accepts, and the errors for others."""

from __future__ import annotations

import ast
import errno
import json
import os
import re
import subprocess
import sys
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from sitl.apps import sim_options
from sitl.apps.scene_list import print_scenes
from uav_recon.app import config_template
from uav_recon.app.option_validation import mount_pitch_deg
from uav_recon.cli import choices
from uav_recon.cli.exit_codes import exit_with
from uav_recon.cli.main import app, main
from uav_recon.config import Config, LocalizationConfig, UncertaintyName, VariantName, parse

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def callbacks(group: typer.Typer) -> Iterator[Callable[..., Any]]:
    for command in group.registered_commands:
        assert command.callback is not None
        yield command.callback
    for inner in group.registered_groups:
        assert inner.typer_instance is not None
        yield from callbacks(inner.typer_instance)


@pytest.mark.parametrize("command", list(callbacks(app)), ids=lambda command: command.__qualname__)
def test_paths_are_checked_by_the_code_that_opens_them_and_not_by_the_parser(command: Callable[..., Any]) -> None:
    """The parser would print five lines and exit with code 2.

    systemd would then restart the pilot for ever.
    """
    for name, hint in typing.get_type_hints(command, include_extras=True).items():
        if name != "return":
            kind, said = typing.get_args(hint)
            assert not said.exists, name
            assert not (said.readable and Path in (kind, *typing.get_args(kind))), name


def test_an_interrupt_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        raise KeyboardInterrupt

    with pytest.raises(typer.Exit) as ended:
        exit_with(work)
    assert ended.value.exit_code == 130
    assert capsys.readouterr().err == "uav-recon: interrupted\n"


def test_a_file_that_the_system_refuses_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        raise PermissionError(13, "Permission denied", "walk.mcap")

    with pytest.raises(typer.Exit) as ended:
        exit_with(work)
    assert ended.value.exit_code == 1
    assert capsys.readouterr().err == "uav-recon: walk.mcap: cannot be read or written (Permission denied)\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("sim --views 3", "--views 3: want 4 to 5000"),
        ("sim --views=5001", "--views 5001: want 4 to 5000"),
        ("sim --views many", "--views many: want a whole number, 4 to 5000"),
        ("sim --seed 1.5", "--seed 1.5: want a whole number, 0 or more"),
        ("sim --seed -1", "--seed -1: want 0 or more"),
        ("faults --jobs 257", "--jobs 257: want 1 to 256"),
        ("sim --radius wide", "--radius wide: "),
        ("sim --nope", "no such option: --nope"),
        ("review", "missing argument"),
        ("fly", "no such command"),
        ("refine EMPTY", "an argument is empty: want a value"),
        ("sim --out EMPTY", "--out is empty: want a value"),
        ("sim --out=", "--out is empty: want a value"),
        ("sim --scene EMPTY", "--scene is empty: want a value"),
        ("bench uncertainty --after EMPTY", "--after is empty: want a value"),
        ("bench mapper --json EMPTY", "--json is empty: want a value"),
    ],
)
def test_a_parser_error_is_one_line(
    words: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["uav-recon", *("" if word == "EMPTY" else word for word in words.split())])
    with pytest.raises(SystemExit) as ended:
        main()
    told = capsys.readouterr()
    assert ended.value.code == 2
    assert told.out == ""
    assert told.err.startswith(f"uav-recon: {said}"), told.err
    assert len(told.err.splitlines()) == 1


@pytest.mark.parametrize(("words", "code"), [("--help", 0), ("sim --help", 0), ("", 2), ("review /nowhere", 2)])
def test_help_and_other_errors_keep_their_exit_codes(
    words: str, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["uav-recon", *words.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == code
    told = capsys.readouterr()
    assert "Usage" in told.out + told.err or words.startswith("review")


def all_commands(group: typer.Typer, before: str = "") -> Iterator[str]:
    yield before
    for command in group.registered_commands:
        yield f"{before} {command.name}".strip()
    for inner in group.registered_groups:
        assert inner.typer_instance is not None
        yield from all_commands(inner.typer_instance, f"{before} {inner.name}".strip())


@pytest.mark.parametrize("words", list(all_commands(app)))
@pytest.mark.parametrize("option", ["-h", "--help"])
def test_each_command_has_help(words: str, option: str) -> None:
    done = CliRunner().invoke(app, [*words.split(), option])
    assert done.exit_code == 0, done.output
    assert f"Usage: root {words}".strip() in done.output


@pytest.mark.parametrize(
    "words", ["sim", "faults", "sweep", "refine", "review", "bench mapper", "bench planner", "params check"]
)
def test_help_has_examples_that_can_be_copied(words: str) -> None:
    done = CliRunner().invoke(app, [*words.split(), "--help"], env={"COLUMNS": "200"})
    assert f"uav-recon {words}" in done.output.partition("Examples:")[2]


def test_help_loads_nothing_heavy() -> None:
    """0.5 s at most: the parser and its colours are 0.3 s of it."""
    script = "import sys, uav_recon.cli.main; print(sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    heavy = {
        "numpy",
        "pydantic",
        "rich",
        "numba",
        "scipy",
        "pymavlink",
        "cv2",
        "open3d",
        "torch",
        "rerun",
        "uav_recon.config",
    }
    modules = set(ast.literal_eval(loaded))
    assert not heavy & modules
    simulator = {name for name in modules if name.startswith("sitl") and not name.endswith(("option", "options", "scale"))}
    assert simulator == {"sitl", "sitl.apps", "sitl.camera", "sitl.faults", "sitl.faults.flights"}, "only the options"


def test_the_version_names_package_and_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uav_recon.measurement.host_info.commit", lambda: "abc1234")
    shown = CliRunner().invoke(app, ["--version"]).output
    assert re.fullmatch(r"uav-recon (\d+\.\d+\.\d+|\(not installed\))( \(commit [0-9a-f]{7}\))?\n", shown), shown


def test_the_words_of_completion_are_those_that_are_accepted() -> None:
    assert {*sim_options.POSES} - {"corrected"} <= set(typing.get_args(LocalizationConfig.model_fields["source"].annotation))
    assert typing.get_args(VariantName) == sim_options.VARIANTS
    assert typing.get_args(UncertaintyName) == sim_options.UNCERTAINTIES
    assert choices.AUTOPILOTS == sim_options.AUTOPILOTS
    for mount in sim_options.MOUNTS:
        mount_pitch_deg(mount)
    assert choices.one_of(sim_options.VARIANTS)("adaptive,explore-") == ["adaptive,explore-yaw", "adaptive,explore-then-refine"]


def test_the_scenarios_are_listed_with_fault_and_limits() -> None:
    done = CliRunner().invoke(app, ["faults", "--list"])
    assert done.exit_code == 0, done.output
    for word in ("planner stalls 5 s", "hold commanded <= 0.6 s", "lockstep, real time", "not flown", "A1+B1"):
        assert word in done.output
    some = CliRunner().invoke(app, ["faults", "--list", "--only", "A6"]).output
    assert "(ArduPilot 2.5)" in some
    assert "A1" not in some


def test_the_scenes_are_listed_with_size_and_licence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, text in (
        ("hall", json.dumps({"description": "a hall: big", "floor_area_m2": 30.4, "licence": "MIT (x)"})),
        ("bad", "["),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / "scene.json").write_text(text)
    assert print_scenes(tmp_path) == 0
    shown = capsys.readouterr().out
    assert re.search(rf"{tmp_path / 'hall'} +a hall +30 m² +MIT", shown), shown
    assert "scene.json cannot be read" in shown
    assert "random:SEED" in shown
    assert print_scenes(tmp_path / "none") == 0
    assert "no reference scenes" in capsys.readouterr().out


def test_the_config_that_is_written_has_every_key_and_waits_for_the_protective_numbers(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    assert CliRunner().invoke(app, ["config", "write", str(path)]).exit_code == 0
    text = path.read_text()
    assert tomllib.loads(text) == {name: {} for name in Config.model_fields}
    for section in Config.model_fields.values():
        for key in getattr(section.annotation, "model_fields", ()):
            assert re.search(rf"^# {key} = .+   # ", text, re.MULTILINE), key
    checked = CliRunner().invoke(app, ["config", "check", str(path)])
    assert checked.exit_code == 78
    assert "safety.fence_min_m: field required" in checked.stderr
    again = CliRunner().invoke(app, ["config", "write", str(path)])
    assert again.exit_code == 2
    assert "exists already" in again.stderr
    flown = Path(__file__).parents[2] / "systemd" / "config.toml"
    assert CliRunner().invoke(app, ["config", "check", str(flown)]).output == f"{flown}: valid\n"


def test_a_full_disk_leaves_the_old_config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path = tmp_path / "config.toml"
    path.write_text("old", encoding="ascii")
    monkeypatch.setattr(os, "fsync", full)
    refused = CliRunner().invoke(app, ["config", "write", str(path), "--force"])
    assert refused.exit_code == 1
    assert refused.stderr == f"uav-recon: {path}: cannot be written (No space left on device)\n"
    assert path.read_text(encoding="ascii") == "old"


def test_what_the_template_shows_is_what_the_config_takes() -> None:
    """With the example's protective numbers and every shown default the config is the default one."""
    lines = [line.removeprefix("# ") for line in config_template.text().splitlines() if re.match(r"# \w+ = |\[", line)]
    shown = tomllib.loads("\n".join(line for line in lines if " = REQUIRED" not in line and " = UNSET" not in line))
    safety = tomllib.loads((Path(__file__).parents[2] / "systemd" / "config.toml").read_text())["safety"]
    assert parse(shown | {"safety": safety}, "shown") == parse({"safety": safety}, "default")
