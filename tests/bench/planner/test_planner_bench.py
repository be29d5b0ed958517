from __future__ import annotations

import json
from pathlib import Path

import pytest
from small_recorded_stream import SIZE, write_stream
from typer.testing import CliRunner

from uav_recon.bench.planner.stages import STAGES
from uav_recon.cli.main import app

STREAM = Path(__file__).parents[4] / "shared" / "streams" / "two_room"
SPREAD = {"median_ms", "p95_ms", "max_ms"}


def bench(*arguments: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["bench", "planner", *arguments])
    return done.exit_code, done.stdout, done.stderr


def test_prints_tables_and_writes_json(tmp_path: Path) -> None:
    written = tmp_path / "result.json"
    stream = str(write_stream(tmp_path / "s"))
    code, out, _ = bench("--stream", stream, "--size", SIZE, "--stride", "1", "--json", str(written))
    assert code == 0, out
    result = json.loads(written.read_text())
    assert list(result["stages"]) == ["fusion", "distance", "search", "viewpoints", "tour", "decision", "total", "plan"]
    for stages in (result["stages"], result["stages_calibrated"], result["stages_cpu"], result["stages_cpu_calibrated"]):
        assert all(set(stage) == SPREAD for stage in stages.values())
    fusion = result["stages"]["fusion"]["median_ms"]
    assert result["stages_calibrated"]["fusion"]["median_ms"] == pytest.approx(fusion / result["calibration"])
    assert result["frames"] == 6
    assert result["agreement"] is None  # this stream has no reference
    assert result["tour"] == {}
    assert result["compile_s"] > 0
    for word in ("fusion", "total", "calibrated", "Compiled in", result["commit"]):
        assert word in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--stream", "/nowhere"), ("/nowhere", "no such folder")),
        (("--stride", "9"), ("--stride 9", "want 1 to 8")),
        (("--size", "big"), ("--size big", "want one of")),
        (("--json", "/nowhere/x.json"), ("/nowhere/x.json",)),
    ],
)
def test_invalid_options_are_a_one_line_error(tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]) -> None:
    stream = () if "--stream" in arguments else ("--stream", str(write_stream(tmp_path / "s")))
    size = () if "--size" in arguments else ("--size", SIZE)
    code, out, err = bench(*stream, *size, *arguments)
    assert code != 0
    lines = [line for line in (out + err).splitlines() if line.strip()]
    assert len(lines) == 1
    for word in words:
        assert word in lines[0]


@pytest.mark.nightly
@pytest.mark.shared
def test_the_shared_stream_meets_the_limits_that_do_not_depend_on_the_machine(tmp_path: Path) -> None:
    written = tmp_path / "result.json"
    code, out, _ = bench("--stream", str(STREAM), "--json", str(written))
    assert code == 0, out
    result = json.loads(written.read_text())
    assert set(result["stages"]) == {*STAGES, "plan"}
    assert result["agreement"] >= 0.99
    assert result["occupied_freed"] == 0
    assert result["best_view_ratio"]["median"] >= 0.95
    assert result["path_lengths"]["mean_excess"] <= 0.01
    assert result["path_lengths"]["p95_excess"] <= 0.04
    for tasks in ("10", "20", "30", "50"):
        assert result["tour"][tasks]["gap"] <= 0.002


@pytest.mark.parametrize(("option", "value"), [("--size", "foo"), ("--stride", "0"), ("--stride", "99")])
def test_stream_options_are_refused_without_a_stream(option: str, value: str) -> None:
    code, out, err = bench(option, value)
    assert (code, out) == (2, "")
    assert err == f"uav-recon: {option} needs --stream\n"
