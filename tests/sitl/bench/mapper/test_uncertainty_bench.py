from __future__ import annotations

import json
from pathlib import Path

import pytest
from stub_visible_truth import quick_cut
from typer.testing import CliRunner

import sitl.apps.flight_judge
from sitl.bench.mapper import seeded_views
from uav_recon.cli.main import app

MEASURES = ["paper", "colour", "information", "product", "agreement"]
SCORES = {"ause_all", "ause_observed", "spearman_all", "spearman_observed"}


def bench(*arguments: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["bench", "uncertainty", *arguments])
    return done.exit_code, done.stdout, done.stderr


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sitl.apps.flight_judge, "visible_truth", quick_cut)
    monkeypatch.setattr(seeded_views, "TRUTH_POINTS", 30_000)
    monkeypatch.setattr(seeded_views, "HELD_OUT_STRIDE", 16)


@pytest.mark.nightly
def test_scores_every_measure_on_every_partial_map(tmp_path: Path) -> None:
    written = tmp_path / "result.json"
    code, out, errors = bench("--after", "6,3", "--json", str(written))
    assert code == 0, errors
    result = json.loads(written.read_text())
    assert [partial["views"] for partial in result["partial_maps"]] == [3, 6]
    for partial in result["partial_maps"]:
        assert list(partial["scores"]) == MEASURES
        assert all(set(score) == SCORES for score in partial["scores"].values())
        assert partial["scores"]["agreement"]["ause_all"] < partial["random_all"]
        assert 0.0 < partial["error_observed_cm"] < partial["error_all_cm"]
        assert 0.0 < partial["observed_share"] < 1.0
    for word in (*MEASURES, "AUSE", "3 views", "6 views"):
        assert word in out


@pytest.mark.parametrize("words", ["0", "twenty", "3,,5", "5000"])
def test_invalid_numbers_of_views_are_a_one_line_error(words: str) -> None:
    code, out, errors = bench("--after", words)
    assert code != 0
    assert out == ""
    assert errors.startswith(f"uav-recon: --after {words}: want numbers of views")
    assert len(errors.strip().splitlines()) == 1
