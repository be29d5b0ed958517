from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from stub_visible_truth import quick_cut
from typer.testing import CliRunner

import sitl.apps.flight_judge
from sitl.bench.mapper import seeded_views, training_run
from uav_recon.cli.main import app
from uav_recon.evaluation.triangle_surface import TriangleSurface
from uav_recon.measurement.result_file import HEADER

pytestmark = pytest.mark.slow
FIELDS = [
    "step_ms", "view_update_ms", "time_to_recall_s", "extraction_ms", "accuracy_cm", "completion_cm", "recall_seen_5cm",
    "psnr_db", "ause_all", "ause_observed", "hallucinated_fraction", "memory_mb",
]  # fmt: skip


def bench(*arguments: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["bench", "mapper", *arguments])
    return done.exit_code, done.stdout, done.stderr


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sitl.apps.flight_judge, "visible_truth", quick_cut)
    monkeypatch.setattr(seeded_views, "TRUTH_POINTS", 30_000)
    monkeypatch.setattr(seeded_views, "HELD_OUT_STRIDE", 16)
    monkeypatch.setattr(training_run, "RECALL_STEPS", 20)
    monkeypatch.setattr(training_run, "ROOM_RUNS", 2)


@pytest.mark.nightly
def test_measures_every_field_and_writes_json(tmp_path: Path) -> None:
    written = tmp_path / "result.json"
    exact = "--camera", "wide", "--depth-noise", "kinect", "--camera-errors", "none"
    code, out, errors = bench("--views", "6", *exact, "--json", str(written))
    assert code == 0, errors
    result = json.loads(written.read_text())
    assert set(result) == {*FIELDS, "about", HEADER}
    assert set(result["time_to_recall_s"]) == {"0.90", "0.95", "0.99"}
    assert set(result["extraction_ms"]) == {"room", "view"}
    assert 0.0 < result["step_ms"] < result["view_update_ms"]
    assert result["about"]["calibrated"]["step_ms"] == pytest.approx(result["step_ms"] / result["about"]["calibration_cpu"])
    assert 0.8 < result["recall_seen_5cm"] <= 1.0
    assert 0.0 < result["accuracy_cm"] < 2.0
    assert result["hallucinated_fraction"] < 0.05
    assert result["psnr_db"] > 15.0
    assert 0.0 < result["ause_all"] < 1.0
    assert 0.5 < result["about"]["tsdf_2cm"]["recall_seen_5cm"] <= 1.0
    for word in ("step, ms", "extraction, room", "TSDF at 2 cm", "AUSE", result["about"]["commit"]):
        assert word in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--scene", "/nowhere"), ("/nowhere", "no such scene")),
        (("--views", "1"), ("--views 1", "want 4 to 2000")),
        (("--steps-per-view", "0"), ("--steps-per-view 0", "want 1 to 200")),
        (("--camera", "fast"), ("--camera fast", "want one of d435i, wide")),
        (("--depth-noise", "much"), ("--depth-noise much", "want one of")),
        (("--mount", "loose"), ("--mount loose", "want gimbal, or fixed:DEG")),
        (("--pose-noise", "2"), ("--pose-noise 2", "want CM,DEG")),
        (("--pose-noise", "20,1"), ("--pose-noise 20,1", "0 or more and at most 10 and 5")),
        (("--pose-noise", "-1,0"), ("--pose-noise -1,0", "want CM,DEG, 0 or more and at most 10 and 5")),
        (("--exposure", "3"), ("--exposure 3", "want 0 to 2")),
        (("--device", "cuda"), ("--device cuda", "want cpu; the mapper has no other path yet")),
        (("--device", "tpu"), ("--device tpu", "want cpu")),
        (("--json", "/nowhere/x.json"), ("/nowhere/x.json",)),
    ],
)
def test_invalid_options_of_bench_mapper_are_a_one_line_error(arguments: tuple[str, ...], words: tuple[str, ...]) -> None:
    code, out, errors = bench(*arguments)
    assert code != 0
    assert out == ""
    assert errors.startswith("uav-recon: ")
    assert len(errors.strip().splitlines()) == 1
    for word in words:
        assert word in errors


@pytest.mark.nightly
def test_noisy_poses_have_the_requested_errors() -> None:
    def load(sigma: tuple[float, float]) -> seeded_views.MapperScene:
        return seeded_views.load(seeded_views.SceneOptions(None, 40, "d435i", "none", "fixed:15", sigma, 0))

    true, told = load((0.0, 0.0)), load((0.02, 0.01))
    shift, turn = [], []
    for a, b in zip(true.keyframes, told.keyframes, strict=True):
        assert np.array_equal(a.frame.depth_m, b.frame.depth_m, equal_nan=True)
        shift.append(b.world_from_depth.translation_m - a.world_from_depth.translation_m)
        between = b.world_from_depth.rotation() @ a.world_from_depth.rotation().T
        turn.append(np.arccos(np.clip((np.trace(between) - 1) / 2, -1, 1)))
    assert np.std(shift) == pytest.approx(0.02, rel=0.2)
    assert np.sqrt(np.mean(np.square(turn)) / 3) == pytest.approx(0.01, rel=0.25)


@pytest.mark.nightly
def test_reports_the_effect_of_the_corrections(tmp_path: Path) -> None:
    written = tmp_path / "result.json"
    wild = ("--pose-noise", "2,1", "--exposure", "1", "--steps-per-view", "8")
    code, out, errors = bench("--views", "6", *wild, "--json", str(written))
    assert code == 0, errors
    about = json.loads(written.read_text())["about"]
    assert about["uncorrected"]["accuracy_cm"] > 0.0
    assert set(about["colour_sigma"]) == {"one_exposure", "many_exposures"}
    assert "without corrections" in out
    assert "±1 EV" in out


def test_exposure_multiplies_light_and_clips() -> None:
    scene = seeded_views.load(seeded_views.SceneOptions(None, 6, "d435i", "none", "fixed:15", (0.0, 0.0), 0))
    shown = seeded_views.exposed(scene, seeded_views.exposures(scene, 1.0, 0))
    ev = []
    for a, b in zip(scene.keyframes, shown.keyframes, strict=True):
        before, after = (((k.frame.rgb / 255.0 + 0.055) / 1.055) ** 2.4 for k in (a, b))
        mid = (a.frame.rgb > 60) & (b.frame.rgb > 60) & (b.frame.rgb < 255)
        ev.append(np.log2(np.median(after[mid] / before[mid])))
        assert np.quantile(np.abs(np.log2(after[mid] / before[mid]) - ev[-1]), 0.9) < 0.03
    assert np.abs(ev).max() < 1.01
    assert np.ptp(ev) > 0.5
    before, after = (((p.rgb / 255.0 + 0.055) / 1.055) ** 2.4 for p in (scene.pictures, shown.pictures))
    mid = (scene.pictures.rgb > 60) & (scene.pictures.rgb < 200)
    assert np.log2(np.median(after[mid] / before[mid])) == pytest.approx(np.mean(ev), abs=0.05)


def test_accuracy_is_point_to_surface_both_ways() -> None:
    scene = seeded_views.load(seeded_views.SceneOptions(None, 4, "d435i", "none", "fixed:15", (0.0, 0.0), 0))
    perfect = training_run.against_truth(scene.surface, scene)
    assert perfect.accuracy_cm == pytest.approx(0.0, abs=1e-3)
    assert perfect.completion_cm == pytest.approx(0.0, abs=1e-3)
    assert (perfect.recall_seen_5cm, perfect.hallucinated_fraction) == (1.0, 0.0)
    empty = training_run.against_truth(TriangleSurface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)), scene)
    assert (empty.accuracy_cm, empty.recall_seen_5cm) == (None, 0.0)
