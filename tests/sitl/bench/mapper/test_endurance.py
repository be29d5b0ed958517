from __future__ import annotations

import json
from pathlib import Path

import pytest
from stub_visible_truth import quick_cut
from typer.testing import CliRunner

import sitl.apps.flight_judge
from sitl.bench.mapper import endurance, seeded_views, training_run
from uav_recon.cli.main import app
from uav_recon.mapping.neural.keyframes import keyframe_buffer


def bench(*arguments: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["bench", "endurance", *arguments])
    return done.exit_code, done.stdout, done.stderr


@pytest.mark.nightly
@pytest.mark.slow
def test_memory_disk_and_views_stay_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sitl.apps.flight_judge, "visible_truth", quick_cut)
    monkeypatch.setattr(seeded_views, "TRUTH_POINTS", 30_000)
    monkeypatch.setattr(training_run, "SAMPLES", 30_000)
    monkeypatch.setattr(keyframe_buffer, "MAX_VIEWS", 16)
    monkeypatch.setattr(endurance, "MAX_VIEWS", 16)
    monkeypatch.setattr(keyframe_buffer, "KEPT_VIEWS", 12)
    written = tmp_path / "result.json"
    short = ("--views", "8", "--hours", "0.02", "--steps-per-view", "2")
    exact = ("--camera-errors", "none")  # two steps a view do not average the errors of a camera out
    code, out, errors = bench(*short, *exact, "--json", str(written))
    assert code == 0, errors
    result = json.loads(written.read_text())
    parts = result["parts"]
    assert len(parts) == 10
    assert parts[-1]["views"] == 48
    assert max(part["kept"] for part in parts) <= 16
    assert parts[-1]["kept"] >= 12
    assert parts[-1]["resident_mb"] < parts[5]["resident_mb"] + 20.0
    assert parts[-1]["checkpoint_mb"] < parts[5]["checkpoint_mb"] + 10.0
    assert result["at_the_end"]["accuracy_cm"] < result["when_full"]["accuracy_cm"] + 0.1
    assert "when 16 views were kept" in out


@pytest.mark.parametrize("arguments", [("--hours", "0"), ("--hours", "1000"), ("--period-s", "0"), ("--views", "1")])
def test_invalid_options_are_a_one_line_error(arguments: tuple[str, str]) -> None:
    code, _, errors = bench(*arguments)
    assert code != 0
    assert len(errors.strip().splitlines()) == 1
