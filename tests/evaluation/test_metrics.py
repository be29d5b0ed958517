"""Quality metrics on shapes whose result is known beforehand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from uav_recon.evaluation.metrics import (
    SurfaceTruth,
    explored_fraction,
    f_score,
    measure,
    point_distance_m,
    psnr_db,
    share_within,
    stream_statistics,
)
from uav_recon.evaluation.triangle_surface import TriangleSurface

COUNT = 20_000


def plane(z_m: float = 0.0, width_m: float = 1.0) -> TriangleSurface:
    vertices = np.array([[0.0, 0, z_m], [width_m, 0, z_m], [width_m, 1, z_m], [0, 1, z_m]])
    return TriangleSurface(vertices, np.array([[0, 1, 2], [0, 2, 3]]))


def truth_of(surface: TriangleSurface) -> SurfaceTruth:
    return SurfaceTruth(surface, surface.sample(COUNT, 100), surface.sample(COUNT, 101))


def test_a_perfect_model_has_no_error_but_point_metrics_keep_their_floor() -> None:
    box = trimesh.creation.box((1, 1, 1))
    cube = TriangleSurface(box.vertices, box.faces)
    quality = measure(cube, truth_of(cube), psnr=30.0, samples=COUNT)
    assert quality.accuracy_cm == pytest.approx(0.0, abs=1e-3)
    assert quality.completion_cm == pytest.approx(0.0, abs=1e-3)
    assert (quality.recall_5cm, quality.recall_2cm, quality.f_score_2cm, quality.psnr_db) == (1.0, 1.0, 1.0, 30.0)
    # 20,000 points on 6 m2: mean distance to the nearest of a random set of density n is 1 / (2 sqrt(n))
    expected_cm = 100.0 / (2.0 * np.sqrt(COUNT / 6.0))
    assert quality.point_floor_cm == pytest.approx(expected_cm, rel=0.08)
    assert quality.accuracy_point_cm == pytest.approx(quality.point_floor_cm, rel=0.05)
    assert quality.completion_point_cm == pytest.approx(quality.point_floor_cm, rel=0.05)


def test_the_floor_of_one_set_of_points_agrees_with_that_of_two() -> None:
    twice = truth_of(plane())
    once = SurfaceTruth(twice.surface, twice.points_world)
    floors = [measure(plane(), truth, None, samples=COUNT).point_floor_cm for truth in (once, twice)]
    assert floors[0] == pytest.approx(floors[1], rel=0.05)


def test_a_shifted_plane_is_off_by_its_shift() -> None:
    quality = measure(plane(0.03), truth_of(plane()), psnr=None, samples=COUNT)
    assert quality.accuracy_cm == pytest.approx(3.0)
    assert quality.completion_cm == pytest.approx(3.0)
    assert (quality.recall_5cm, quality.recall_2cm, quality.f_score_2cm) == (1.0, 0.0, 0.0)
    assert quality.psnr_db is None


def test_half_a_plane_is_accurate_but_not_complete() -> None:
    quality = measure(plane(width_m=0.5), truth_of(plane()), psnr=None, samples=COUNT)
    assert quality.accuracy_cm == pytest.approx(0.0, abs=1e-3)
    assert quality.completion_cm == pytest.approx(12.5, rel=0.02)  # half at 0, half uniform in 0 to 50 cm
    assert quality.recall_5cm == pytest.approx(0.55, abs=0.01)
    assert quality.recall_2cm == pytest.approx(0.52, abs=0.01)
    assert quality.f_score_2cm == pytest.approx(2 * 0.52 / 1.52, abs=0.01)


def test_an_unseen_part_of_truth_does_not_count_against_the_model() -> None:
    seen = plane(width_m=0.5)
    truth = SurfaceTruth(plane(), seen.sample(COUNT, 1), seen.sample(COUNT, 2))
    quality = measure(plane(), truth, psnr=None, samples=COUNT)
    assert quality.accuracy_cm == pytest.approx(0.0, abs=1e-3)
    assert quality.recall_2cm == 1.0


def test_an_empty_model_recalls_nothing() -> None:
    nothing = TriangleSurface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    quality = measure(nothing, truth_of(plane()), psnr=None, samples=COUNT)
    assert quality.accuracy_cm is None and quality.completion_cm is None and quality.completion_point_cm is None
    assert (quality.recall_5cm, quality.f_score_2cm) == (0.0, 0.0)


def test_the_same_seed_measures_the_same() -> None:
    truth = truth_of(plane())
    assert measure(plane(0.01), truth, None, 4, COUNT) == measure(plane(0.01), truth, None, 4, COUNT)


def test_quality_has_the_names_of_the_report() -> None:
    quality = measure(plane(), truth_of(plane()), psnr=None, samples=100)
    assert list(dataclasses.asdict(quality)) == [
        "accuracy_cm", "completion_cm", "recall_5cm", "recall_2cm", "f_score_2cm", "psnr_db",
        "accuracy_point_cm", "completion_point_cm", "point_floor_cm",
    ]  # fmt: skip


def test_point_distance_agrees_with_a_full_table() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.random((40, 3)), rng.random((30, 3))
    assert point_distance_m(a, b) == pytest.approx(np.linalg.norm(a[:, None] - b[None], axis=2).min(axis=1))
    assert point_distance_m(a, b) == pytest.approx(cKDTree(b).query(a)[0])


def test_share_and_f_score() -> None:
    assert share_within(np.array([0.01, 0.02, 0.03]), 0.02) == pytest.approx(1 / 3)
    assert share_within(np.array([]), 0.02) is None
    assert f_score(0.5, 1.0) == pytest.approx(2 / 3)
    assert f_score(None, 0.0) == 0.0


def test_psnr_of_a_known_error() -> None:
    truth = np.full((4, 5, 3), 100, dtype=np.uint8)
    assert psnr_db([truth + np.uint8(10)], [truth]) == pytest.approx(20 * np.log10(25.5))
    assert psnr_db([truth], [truth]) == 100.0
    assert psnr_db([], []) is None
    with pytest.raises(ValueError, match="1 images for 0"):
        psnr_db([truth], [])
    with pytest.raises(ValueError, match="does not fit"):
        psnr_db([truth], [truth[:2]])


def test_stream_with_one_gap() -> None:
    arrivals = np.concatenate([np.arange(0, 100) / 30, 99 / 30 + 0.2 + np.arange(0, 101) / 30])
    statistics = stream_statistics(arrivals)
    assert statistics.rate_hz == pytest.approx(200 / (199 / 30 + 0.2))
    assert statistics.gap_max_ms == pytest.approx(200.0)
    assert statistics.gap_p99_ms == pytest.approx(1000 / 30)
    assert stream_statistics([1.0]).rate_hz is None


def test_explored_fraction_counts_only_visible_space() -> None:
    seen = np.zeros((2, 2, 2), dtype=bool)
    seen[0] = True
    known = np.ones((2, 2, 2), dtype=bool)
    known[0, 0, 0] = False
    assert explored_fraction(known, seen) == 0.75
    assert explored_fraction(known, np.zeros_like(seen)) is None
    with pytest.raises(ValueError, match="different grids"):
        explored_fraction(known[:1], seen)
