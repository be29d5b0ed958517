"""Torch implementation against the numba kernels.

Equal parameters and batches must give equal results.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch

from uav_recon.mapping.neural.keyframes import ray_sampling
from uav_recon.mapping.neural.keyframes.ray_records import COLUMNS
from uav_recon.mapping.neural.sdf_numba.adam import NumbaAdam
from uav_recon.mapping.neural.sdf_numba.feature_grid import FINEST_CELL_M, POINTS, Gradient
from uav_recon.mapping.neural.sdf_numba.losses import TETRAHEDRON, fit_colour, fit_distance, fit_shape
from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.mapping.neural.sdf_torch.adam import TorchAdam
from uav_recon.mapping.neural.sdf_torch.feature_grid import GridError, lay_out
from uav_recon.mapping.neural.sdf_torch.ray_sampling import DeviceViews, TorchBatch, draw, state_before
from uav_recon.mapping.neural.sdf_torch.sdf_field import TorchSdfField
from uav_recon.types.frames import Float32Array

LOW, HIGH = np.zeros(3), np.array([1.7, 1.2, 0.9])
CPU = torch.device("cpu")


@pytest.fixture
def kernels() -> NumbaSdfField:
    """Return a field with random features in every cell that points cover."""
    random = np.random.default_rng(3)
    field = NumbaSdfField(LOW, HIGH, seed=1)
    field.cover(random.uniform(LOW, HIGH, (3000, 3)).astype(np.float32))
    field.grid.features[1 : field.slots] = random.uniform(-0.5, 0.5, field.grid.features[1 : field.slots].shape)
    return field


def same(kernels: NumbaSdfField, device: torch.device = CPU) -> TorchSdfField:
    layout = lay_out(LOW, HIGH, FINEST_CELL_M)
    tensors = TorchSdfField(layout, torch.tensor(kernels.grid.slot), len(kernels.grid.features), 0, device)
    with torch.no_grad():
        tensors.features.copy_(torch.tensor(kernels.grid.features))
        tensors.weights.copy_(torch.tensor(kernels.parameters))
    return tensors


def views() -> ray_sampling.Views:
    """Return three views with all kinds of rays.

    There are rays without a normal, without colour, with white, and out of the box.
    """
    random = np.random.default_rng(8)
    records = np.zeros((900, COLUMNS), dtype=np.int16)
    records[:, :2] = random.integers(-8000, 8000, (900, 2))
    records[:, 2] = random.integers(1500, 6000, 900)
    normal = random.standard_normal((900, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    records[:, 3:6] = np.where(random.random((900, 1)) < 0.8, np.round(normal * 32767), 0)
    records[:, 6:9] = np.minimum(random.integers(0, 320, (900, 3)), 255)
    records[:, 9] = random.random(900) < 0.7
    turn, _ = np.linalg.qr(random.standard_normal((3, 3, 3)))
    position = random.uniform(LOW + 0.3, HIGH - 0.3, (3, 3))
    first = np.array([0, 200, 500, 900])
    sigma = np.array([0.003, 0.004, 0.005], dtype=np.float32)
    gain = random.uniform(0.7, 1.4, (3, 3)).astype(np.float32)
    stretch = random.uniform(0.97, 1.03, (3, 2)).astype(np.float32)
    return ray_sampling.Views(records, first, turn.astype(np.float32), position.astype(np.float32), sigma, gain, stretch)


def drawn_by_kernels(draws: int) -> tuple[ray_sampling.NumbaBatch, int]:
    """Return the last of several batches, and the number of its rays that have colour."""
    batch, state = ray_sampling.make_batch(), np.array([5], dtype=np.uint64)
    coloured = 0
    for _ in range(draws):
        coloured = ray_sampling.draw(state, views(), 3, LOW.astype(np.float32), HIGH.astype(np.float32), batch)
    return batch, coloured


def drawn(draws: int, device: torch.device = CPU) -> TorchBatch:
    state = torch.tensor(state_before(5, draws - 1, ray_sampling.RAYS), device=device)
    low, high = (torch.tensor(c, dtype=torch.float32, device=device) for c in (LOW, HIGH))
    return draw(state, DeviceViews.of(views(), 3, device), low, high, ray_sampling.RAYS, ray_sampling.RECENT_SHARE)


def gradients_of_kernels(field: NumbaSdfField, batch: ray_sampling.NumbaBatch, coloured: int) -> tuple[NumbaAdam, float]:
    optimiser = NumbaAdam(field)
    shared = (field.grid, field.network, optimiser.network_gradient, optimiser.gradient, field.scratch)
    b, corners = batch, np.zeros((POINTS, 3), dtype=np.float32)
    loss = fit_distance(*shared, b.points, b.target_m, b.weight, b.at_least)
    loss += fit_shape(*shared, TETRAHEDRON, corners, b.surface, b.normal, b.eikonal_weight, b.normal_weight)
    loss += fit_colour(*shared, b.coloured[:coloured], b.rgb[:coloured], b.at_least_rgb[:coloured], b.colour_weight[:coloured],
                       b.colour_error[:coloured])  # fmt: skip
    return optimiser, loss


def by_slot(gradient: Gradient) -> Float32Array:
    out, used = np.zeros_like(gradient.features), int(gradient.rows[0])
    out[gradient.touched[:used]] = gradient.features[:used]
    return out


def assert_like(ours: torch.Tensor | None, theirs: Float32Array) -> None:
    assert ours is not None
    np.testing.assert_allclose(ours.detach().cpu().numpy(), theirs, rtol=2e-3, atol=1e-4 * float(np.abs(theirs).max()))


def test_the_grid_layout_equals_that_of_the_kernels(kernels: NumbaSdfField) -> None:
    layout = lay_out(LOW, HIGH, FINEST_CELL_M)
    for name in ("origin_world_m", "inverse_cell_per_m", "cells", "blocks", "first"):
        np.testing.assert_array_equal(getattr(layout, name).numpy(), getattr(kernels.grid, name))


def test_a_box_too_large_for_its_cells_names_what_fits() -> None:
    with pytest.raises(GridError, match=r"50\.0x50\.0x10\.0 m holds cells of 0\.0\d\d m at the finest"):
        lay_out(np.zeros(3), np.array([50.0, 50.0, 10.0]), 0.004)


def test_queries_agree_with_the_kernels_inside_and_outside_the_box(kernels: NumbaSdfField) -> None:
    points = np.random.default_rng(4).uniform(LOW - 0.1, HIGH + 0.1, (500, 3)).astype(np.float32)
    tensors = same(kernels)
    np.testing.assert_allclose(tensors.distance_m(points), kernels.distance_m(points), atol=2e-6)
    np.testing.assert_allclose(tensors.rgb(points), kernels.rgb(points), atol=1e-5)


@pytest.mark.parametrize("draws", [1, 3])
def test_batches_equal_those_of_the_kernels(draws: int) -> None:
    theirs, coloured = drawn_by_kernels(draws)
    ours = drawn(draws)
    for name in ("points", "target_m", "weight", "at_least", "surface", "normal", "eikonal_weight", "normal_weight"):
        np.testing.assert_allclose(getattr(ours, name).numpy(), getattr(theirs, name), rtol=2e-5, atol=2e-6, err_msg=name)
    held = ours.colour_weight > 0
    for name in ("coloured", "rgb", "at_least_rgb", "colour_weight"):
        np.testing.assert_allclose(getattr(ours, name)[held].numpy(), getattr(theirs, name)[:coloured], rtol=2e-5, atol=2e-6)
    assert not bool(ours.weight.bool().all())  # some samples fell out of the box


def test_loss_and_gradients_agree_with_the_kernels(kernels: NumbaSdfField) -> None:
    batch, coloured = drawn_by_kernels(1)
    optimiser, loss = gradients_of_kernels(kernels, batch, coloured)
    tensors = same(kernels)
    ours = tensors(drawn(1))
    ours.backward()
    assert float(ours.detach()) == pytest.approx(loss, rel=1e-4)
    assert_like(tensors.weights.grad, optimiser.flat_gradient)
    assert_like(tensors.features.grad, by_slot(optimiser.gradient))


def test_an_optimiser_step_equals_that_of_the_kernels_and_keeps_features_without_gradient(kernels: NumbaSdfField) -> None:
    optimiser, _ = gradients_of_kernels(kernels, *drawn_by_kernels(1))
    tensors, before = same(kernels), kernels.grid.features.copy()
    adam = TorchAdam(tensors.features, tensors.weights)
    weights, features = optimiser.flat_gradient.copy(), by_slot(optimiser.gradient)
    held = Gradient(*(part.copy() for part in optimiser.gradient))
    tensors.weights.grad, tensors.features.grad = torch.tensor(weights), torch.tensor(features)
    for count in (1, 2):  # the same gradient twice, so that the moments matter
        optimiser.flat_gradient[:], optimiser.gradient = weights, Gradient(*(part.copy() for part in held))
        optimiser.step(0.5)
        adam.step(tensors.features, tensors.weights, torch.tensor(float(count)), torch.tensor(0.5))
    np.testing.assert_allclose(tensors.weights.detach().numpy(), kernels.parameters, atol=1e-6)
    moved = tensors.features.detach().numpy()
    np.testing.assert_allclose(moved, kernels.grid.features, atol=1e-6)
    np.testing.assert_array_equal(moved[features == 0.0], before[features == 0.0])


def test_points_outside_the_box_leave_the_gradients_finite(kernels: NumbaSdfField) -> None:
    tensors = same(kernels)
    batch = drawn(1)
    batch.surface[:] = torch.tensor([9.0, 9.0, 9.0])
    tensors(batch._replace(eikonal_weight=torch.zeros_like(batch.eikonal_weight))).backward()
    assert tensors.features.grad is not None
    assert bool(torch.isfinite(tensors.features.grad).all())
