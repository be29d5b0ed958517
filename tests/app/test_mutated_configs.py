"""Broken configs are refused before anything starts.

mutated_configs.py starts a pilot on each of them.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import tomli_w
from mutated_configs import FLOWN, SerialLine, command, end_of, mutants

from uav_recon.app import processes
from uav_recon.cli.exit_codes import exit_with
from uav_recon.config import load

ALL = mutants()


def test_each_of_two_hundred_is_refused_at_start_by_one_line_that_names_key_and_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uav_recon.app.processes.file_channels", lambda folder, writes: pytest.fail("it began to run"))
    path = tmp_path / "config.toml"
    assert len(ALL) >= 200
    for mutant in ALL:
        path.write_text(tomli_w.dumps(mutant.tree))
        with pytest.raises(BaseException) as ended:
            exit_with(lambda: processes.pilot(path, None))
        said = capsys.readouterr()
        assert getattr(ended.value, "exit_code", None) == 78, (mutant.words, ended.value)
        assert len(said.err.splitlines()) == 1, said.err
        assert said.out == ""
        for word in mutant.words:
            assert word in said.err


@pytest.fixture
def line() -> Iterator[SerialLine]:
    found = SerialLine()
    yield found
    found.close()


def test_a_pilot_process_refuses_it_too(tmp_path: Path, line: SerialLine) -> None:
    assert end_of(ALL[len(ALL) // 2], tmp_path, line).fault == ""


def test_the_unbroken_config_starts_a_pilot_that_sends_on_the_line(tmp_path: Path, line: SerialLine) -> None:
    tree = load(FLOWN).model_dump(mode="json", exclude_none=True)
    assert tree["safety"]["max_speed_mps"] == 1.0
    with subprocess.Popen(command(tree, tmp_path, line), stderr=subprocess.DEVNULL) as pilot:
        try:
            assert line.heard(timeout_s=60.0), "a pilot that runs says so"
        finally:
            pilot.kill()
