"""Recall of surface elements, by hand, by brute force, and against triangles."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.evaluation.recall import RADIUS_OVER_SPACING, WITHIN_M, ElementRecall, time_to
from uav_recon.evaluation.triangle_surface import TriangleSurface
from uav_recon.types.frames import FloatArray

UP = np.array([[0.0, 0.0, 1.0]])


def one_disc(point: list[float]) -> float:
    return ElementRecall(np.array([point]), spacing_m=0.08).of(np.zeros((1, 3)), UP)


@pytest.mark.parametrize(
    ("point", "recalled"),
    [
        ([0.0, 0.0, 0.0499], True),
        ([0.0, 0.0, 0.0501], False),
        ([0.03, 0.0, -0.0499], True),  # below the disc: the distance is that to its plane
        ([0.0899, 0.0, 0.0], True),  # the disc's radius is 0.04, and the limit 0.05
        ([0.0901, 0.0, 0.0], False),
        ([0.04 + 0.0299, 0.0, 0.04], True),  # beside its edge: a 3-4-5 triangle
        ([0.04 + 0.0301, 0.0, 0.04], False),
        ([0.0635, 0.0635, 0.0], True),
        ([0.064, 0.064, 0.0], False),  # round, not square
    ],
)
def test_the_distance_is_to_a_disc(point: list[float], recalled: bool) -> None:
    assert one_disc(point) == float(recalled)


def brute_force(points: FloatArray, position: FloatArray, normal: FloatArray, spacing_m: float) -> float:
    way = points[:, None] - position
    off = np.einsum("pnc,nc->pn", way, normal)
    aside = np.linalg.norm(way - off[..., None] * normal, axis=2)
    distance = np.hypot(off, np.maximum(aside - RADIUS_OVER_SPACING * spacing_m, 0.0))
    return float(np.mean((distance < WITHIN_M).any(axis=1)))


@pytest.mark.parametrize("seed", range(12))
def test_every_point_is_compared_with_every_disc_within_reach(seed: int) -> None:
    random = np.random.default_rng(seed)
    points, position = random.uniform(-1.0, 1.0, (400, 3)), random.uniform(-1.2, 1.2, (300, 3))  # some are outside the truth
    normal = random.normal(size=(300, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    spacing_m = float(random.uniform(0.02, 0.4))
    found = ElementRecall(points, spacing_m).of(position, normal)
    assert found == brute_force(points, position, normal, spacing_m)
    assert 0.0 < found < 1.0


def test_the_recall_of_elements_equals_that_of_triangles() -> None:
    """Half a floor of 4 x 3 m is modelled, 2 cm too high.

    The recall is its share plus the strip within the limit of its border.
    """
    spacing_m = 0.05
    x, y = np.meshgrid(np.arange(0.0, 2.0 + 1e-9, spacing_m), np.arange(0.0, 3.0 + 1e-9, spacing_m), indexing="ij")
    position = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.02)], axis=1)
    sheet = TriangleSurface(
        np.array([[0, 0, 0.02], [2, 0, 0.02], [2, 3, 0.02], [0, 3, 0.02]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    truth = np.random.default_rng(1).uniform([0, 0, 0], [4, 3, 0], (20_000, 3))
    by_triangles = float(np.mean(sheet.distance_m(truth) < WITHIN_M))
    by_elements = ElementRecall(truth, spacing_m).of(position, np.tile(UP, (len(position), 1)))
    assert 0.50 < by_triangles < 0.53
    assert by_triangles <= by_elements < by_triangles + 0.008


def test_no_elements_give_recall_zero_and_empty_truth_is_refused() -> None:
    assert ElementRecall(np.zeros((3, 3)), 0.05).of(np.zeros((0, 3)), np.zeros((0, 3))) == 0.0
    with pytest.raises(ValueError, match="no truth"):
        ElementRecall(np.zeros((0, 3)), 0.05)


def test_read_only_arrays_are_accepted() -> None:
    position, normal = np.zeros((1, 3)), UP.copy()
    for array in (position, normal):
        array.setflags(write=False)
    assert ElementRecall(np.zeros((1, 3)), 0.05).of(position, normal) == 1.0


def test_the_time_to_a_recall_is_the_first_time_it_is_reached() -> None:
    curve = [(3.0, 1, 0.5), (6.0, 2, 0.90), (9.0, 3, 0.89), (12.0, 4, 0.93)]
    assert time_to(curve, 0.90) == 6.0
    assert time_to(curve, 0.93) == 12.0
    assert time_to(curve, 0.95) is None
    assert time_to([], 0.1) is None
