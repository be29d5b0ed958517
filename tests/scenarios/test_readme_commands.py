"""Every `uav-recon` command in README.md is accepted by the command line; three of them are run, shortened.

The commands are found in fenced and indented code blocks. Each is parsed and validated like a user's command; what it would
start is replaced by a recorder, so an option that no longer exists, or a value out of its range, makes its test fail.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from uav_recon.cli.main import app

ROOT = Path(__file__).parents[2]
DOCUMENTS = ("README.md", "systemd/README.md")
PLACEHOLDERS = {"X,Y,Z,YAW": "1,1,0,90", "X0,Y0,Z0,X1,Y1,Z1": "0,0,0,4,4,3", "…": "1,1,0,90", "...": "1,1,0,90"}
STARTED = {  # what each command starts once its options are valid
    "sim": "sitl.apps.sim.simulate",
    "sweep": "sitl.apps.sweep.sweep",
    "faults": "sitl.faults.flights.campaign.faults",
    "review": "uav_recon.app.processes.review",
    "refine": "uav_recon.app.refine.refine",
    "pilot": "uav_recon.app.processes.pilot",
    "perception": "uav_recon.app.processes.perception",
    "mission": "uav_recon.app.processes.mission",
    "start": "uav_recon.cli.operator._order",
    "hold": "uav_recon.cli.operator._order",
    "return": "uav_recon.cli.operator._order",
    "land": "uav_recon.cli.operator._order",
    "status": "uav_recon.cli.operator._status",
    "status --watch": "uav_recon.cli.operator._watch",
    "bench planner": "uav_recon.bench.planner.planner_bench.bench_planner",
    "bench tasks": "uav_recon.bench.planner.task_bench.bench_tasks",
    "bench mapper": "sitl.bench.mapper.mapper_bench.bench_mapper",
    "bench endurance": "sitl.bench.mapper.endurance.bench_endurance",
    "bench setpoints": "sitl.bench.setpoints.setpoint_bench.bench_setpoints",
    "bench uncertainty": "sitl.bench.mapper.uncertainty_bench.bench_uncertainty",
    "check camera": "uav_recon.app.camera_check.check",
    "check realsense": "uav_recon.app.realsense_check.check_realsense",
    "params check": "uav_recon.app.parameter_tool.check",
    "params diff": "uav_recon.app.parameter_tool.check",
    "params write": "uav_recon.app.parameter_tool.write",
    "config write": "uav_recon.app.config_template.write",
    "config check": "uav_recon.app.config_template.check",
}
PRINTS = {"--help", "-h", "--version", "--list", "--list-scenes"}  # these commands run as they are
NOT_HERE = (
    "--real-time",
    "--firmware",
    "--live",
    "../shared",
    "path/to",
)  # of the commands that are run: what they may not need
SHORTENED = {
    "sim": ("--lockstep", "--mapper", "depth-only", "--views", "4"),
    "sweep": ("--flights", "1", "--views", "4", "--jobs", "1"),
    "faults": ("--only", "B3", "--autopilot", "px4", "--seeds", "1", "--jobs", "1"),
}


def code_lines(text: str) -> list[str]:
    """Lines of fenced and of indented code blocks, joined where a backslash ends one."""
    lines, fenced = [], False
    for line in re.sub(r"\\\n\s*", " ", text).splitlines():
        if line.strip().startswith("```"):
            fenced = not fenced
        elif fenced or line.startswith(("    ", "\t")):
            lines.append(line.strip())
    return lines


def commands_in(line: str) -> list[tuple[str, ...]]:
    """The words behind `uav-recon` in each command of a line."""
    found = []
    for part in re.split(r"&&|\|\||[;|]| & ", re.sub(r"(^|\s)#.*$", "", line)):
        try:
            words = shlex.split(part)
        except ValueError:  # an apostrophe in something that is no command
            continue
        while words and (words[0] == "sudo" or re.fullmatch(r"[A-Z_]+=.*", words[0])):
            words = words[3:] if words[1:2] == ["-u"] else words[1:]
        if words and Path(words[0]).name == "uav-recon":
            found.append(tuple(word for word in words[1:] if word != "&"))
    return found


def commands() -> list[tuple[str, ...]]:
    texts = [(ROOT / name).read_text(encoding="utf-8") for name in DOCUMENTS]
    return list(dict.fromkeys(words for text in texts for line in code_lines(text) for words in commands_in(line)))


def name_of(words: tuple[str, ...]) -> str:
    """The key of STARTED."""
    two = " ".join(words[:2])
    if words[0] == "status" and "--watch" in words:
        return "status --watch"
    return two if two in STARTED else words[0]


def test_the_readme_has_commands() -> None:
    names = {name_of(words) for words in commands()}
    assert {"sim", "faults", "refine"} <= names


def test_commands_are_found_in_both_kinds_of_blocks() -> None:
    text = "no `uav-recon prose`\n\n    uav-recon a --b 'c d'   # e\n\n"
    text += "```sh\nmake && .venv/bin/uav-recon f \\\n  --g\nsudo -u x /o/uav-recon h\n```\n"
    assert [words for line in code_lines(text) for words in commands_in(line)] == [("a", "--b", "c d"), ("f", "--g"), ("h",)]


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_each_command_is_accepted(words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    firmware = tmp_path / "firmware"
    firmware.write_bytes(b"")
    firmware.chmod(0o755)
    given = [PLACEHOLDERS.get(word, word) for word in words]
    given = [str(firmware) if before == "--firmware" else word for before, word in zip(["", *given], given, strict=False)]
    if words[0] == "params":  # the config of the vehicle is not here
        given += ["--autopilot", "px4", "--link", "udp:127.0.0.1:14540"]
    started: list[str] = []

    def recorder(target: str) -> Callable[..., int]:
        def record(*_: object, **__: object) -> int:
            started.append(target)
            return 0

        return record

    for target in set(STARTED.values()):
        monkeypatch.setattr(target, recorder(target))
    done = CliRunner().invoke(app, given)
    assert done.exit_code == 0, done.output
    assert started == ([] if PRINTS & set(words) else [STARTED[name_of(words)]]), "add the command to STARTED"


@pytest.mark.slow
@pytest.mark.parametrize("name", SHORTENED)
def test_three_commands_run(name: str, tmp_path: Path) -> None:
    words = next(
        words for words in commands() if words[0] == name and not any(need in " ".join(words) for need in (*NOT_HERE, *PRINTS))
    )
    command = [sys.executable, "-m", "uav_recon", *words, *SHORTENED[name]]
    if name == "sim":
        command += ["--out", str(tmp_path / "flight")]
    done = subprocess.run(command, cwd=tmp_path, env=None, capture_output=True, text=True, timeout=280, check=False)
    assert "Traceback" not in done.stderr, done.stderr
    assert done.returncode in ((0, 1) if name == "sim" else (0,)), done.stdout + done.stderr  # four views may end too early
    if name == "sim":
        assert (tmp_path / "flight" / "report.html").stat().st_size > 1000
