from __future__ import annotations

import numpy as np
import pytest
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, look, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.surface.extraction import MeasuredCells
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import SurfaceElements


def _trainer(voxel_m: float = 0.05) -> NeuralMapper:
    return NeuralMapper(MapperConfig(surface_voxel_m=voxel_m), LOW, HIGH, NOISE_PX, BASELINE_M)


def _sorted(surface: SurfaceElements) -> FloatArray:
    rows = np.concatenate([surface.position_world, surface.normal_world, surface.uncertainty[:, None]], axis=1)
    return rows[np.lexsort(rows.T)]


@pytest.mark.parametrize("voxel_m", [0.03, 0.05, 0.08])
def test_incremental_updates_of_an_unchanged_field_equal_the_whole_surface(voxel_m: float) -> None:
    trainer = _trainer(voxel_m)
    views = tour(5)
    for view in views:
        trainer.add(view)
    trainer.train(40)
    first = trainer.surface()
    assert np.array_equal(_sorted(first), _sorted(trainer.all_surface_elements()))
    for n in range(3):  # more evidence, the same field
        trainer.add(look((1.2, 1.0, 1.0), 70.0 * n, 10 + n))
        assert np.array_equal(_sorted(trainer.surface()), _sorted(trainer.all_surface_elements()))


def test_a_view_updates_the_surface_it_saw_and_leaves_the_far_side() -> None:
    trainer = _trainer()
    for n in range(4):
        trainer.add(look((1.5, 1.2, 1.0), 90.0 * n, n))
    trainer.train(30)
    before = trainer.surface().position_world
    trainer.add(look((1.5, 1.2, 1.0), 0.0, 9))  # towards +x
    trainer.train(30)
    after = trainer.surface().position_world
    kept = {tuple(p) for p in before} & {tuple(p) for p in after}
    kept_x = np.array([p[0] for p in kept])
    assert (before[:, 0] < 0.1).sum() * 0.5 < (kept_x < 0.1).sum()
    assert (kept_x > 2.9).sum() == 0


def test_training_without_new_views_updates_all_of_the_surface() -> None:
    trainer = _trainer()
    trainer.add(look((1.5, 1.2, 1.0), 0.0))
    trainer.train(20)
    before = {tuple(p) for p in trainer.surface().position_world}
    trainer.train(20)
    for _ in range(25):
        after = trainer.surface()
    assert not before & {tuple(p) for p in after.position_world}
    assert np.array_equal(_sorted(after), _sorted(trainer.all_surface_elements()))


def test_both_sides_of_a_thin_plate_are_surface() -> None:
    evidence = MeasuredCells(LOW, HIGH)
    n = 4000
    plate = np.column_stack([np.random.default_rng(0).uniform(1.0, 2.0, (n, 2)), np.full(n, 1.0)]).astype(np.float32)
    up = np.tile(np.array([[0.0, 0.0, 1.0]], dtype=np.float32), (n, 1))
    sigma = np.full(n, 0.01, dtype=np.float32)
    often, seldom = plate, plate[: n // 4] - np.float32(0.03) * up[: n // 4]
    evidence.add(np.array([1.5, 1.2, 1.9]), often, up, sigma, sigma)
    evidence.add(np.array([1.5, 1.2, 0.1]), seldom, -up[: n // 4], sigma[: n // 4], sigma[: n // 4])
    inner = (np.abs(plate[:, :2] - 1.5) < 0.3).all(axis=1)
    for facing in (up, -up):
        assert not evidence.contradicts(plate[inner], facing[inner]).any()
    sideways = np.roll(up, 1, axis=1)
    assert not evidence.contradicts(plate[inner], sideways[inner]).any()  # no measurement faces this direction


def test_a_side_without_measurements_is_contradicted() -> None:
    evidence = MeasuredCells(LOW, HIGH)
    point, up = np.array([[1.5, 1.2, 1.0]], dtype=np.float32), np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
    sigma = np.full(1, 0.01, dtype=np.float32)
    for _ in range(5):
        evidence.add(np.array([1.5, 1.2, 1.9]), point, up, sigma, sigma)
    assert evidence.contradicts(point, -up).all()
    assert not evidence.contradicts(point, up).any()
