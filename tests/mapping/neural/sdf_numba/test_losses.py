"""Hand-written gradients against torch autograd in double precision.

The reference uses torch's own interpolation and layers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from uav_recon.mapping.neural.sdf_numba.adam import NumbaAdam
from uav_recon.mapping.neural.sdf_numba.feature_grid import LEVELS, POINTS, FeatureGrid
from uav_recon.mapping.neural.sdf_numba.losses import (
    STENCIL_M,
    TETRAHEDRON,
    VARIANCE_SHARE,
    fit_colour,
    fit_distance,
    fit_shape,
)
from uav_recon.mapping.neural.sdf_numba.network import OUTSIDE_BIAS_M, TRUNCATION_M
from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.types.frames import Float32Array

LOW, HIGH = np.zeros(3), np.array([1.0, 0.8, 0.6])
COUNT = 150  # not a multiple of POINTS: the last batch is padded


class TorchField:
    """Torch implementation of the same field: dense volumes, grid_sample, linear layers."""

    def __init__(self, field: NumbaSdfField) -> None:
        torch.set_num_threads(1)
        self._grid = field.grid
        self.volumes = [torch.tensor(_dense(field.grid, level), requires_grad=True) for level in range(LEVELS)]
        self.net = {name: torch.tensor(value.astype(np.float64), requires_grad=True) for name, value in _weights(field)}

    def encode(self, points: torch.Tensor) -> torch.Tensor:
        """Return the features (N, 12) at points (N, 3)."""
        found = []
        for level, volume in enumerate(self.volumes):
            cells = torch.tensor(self._grid.cells[level].astype(np.float64))
            at = points * float(self._grid.inverse_cell_per_m[level]) / cells * 2.0 - 1.0
            features = torch.nn.functional.grid_sample(
                volume.permute(3, 0, 1, 2)[None], at.flip(1)[None, None, None], align_corners=True, padding_mode="border"
            )
            found.append(features[0, :, 0, 0].T)
        return torch.cat(found, dim=1)

    def shape(self, encoded: torch.Tensor) -> torch.Tensor:
        """Return the shape output (N, 16) of features (N, 12); column 0 is the distance in metres."""
        out = torch.relu(encoded @ self.net["w1"].T + self.net["b1"]) @ self.net["w2"].T + self.net["b2"]
        return torch.cat([out[:, :1] * float(TRUNCATION_M) + float(OUTSIDE_BIAS_M), out[:, 1:]], dim=1)

    def distance(self, points: torch.Tensor) -> torch.Tensor:
        """Return the distance (N,) at points (N, 3)."""
        return self.shape(self.encode(points))[:, 0]

    def colour(self, points: torch.Tensor) -> torch.Tensor:
        """Return colour and log variance (N, 4) at points (N, 3)."""
        encoded = self.encode(points)
        x = torch.cat([self.shape(encoded)[:, 1:], encoded], dim=1)
        for layer in ("1", "2"):
            x = torch.relu(x @ self.net["c" + layer].T + self.net["d" + layer])
        rgb = torch.sigmoid(x @ self.net["c3"][:3].T + self.net["d3"][:3])
        return torch.cat([rgb, x.detach() @ self.net["c3"][3:].T + self.net["d3"][3:]], dim=1)


def _weights(field: NumbaSdfField) -> list[tuple[str, Float32Array]]:
    return [(name, getattr(field.network, name)) for name in field.network._fields]


def _slots(grid: FeatureGrid, level: int) -> tuple[Any, Any]:
    nx, ny, nz = grid.cells[level] + 1
    i, j, k = np.meshgrid(np.arange(nx), np.arange(ny), np.arange(nz), indexing="ij")
    blocks = grid.blocks[level]
    entry = grid.first[level] + ((i // 2) * blocks[1] + j // 2) * blocks[2] + k // 2
    return grid.slot[entry], ((i % 2) * 4 + (j % 2) * 2 + k % 2)[..., None] * 2 + np.arange(2)


def _dense(grid: FeatureGrid, level: int) -> Any:
    slot, place = _slots(grid, level)
    return grid.features[slot[..., None], place].astype(np.float64)


@pytest.fixture
def field() -> NumbaSdfField:
    random = np.random.default_rng(3)
    field = NumbaSdfField(LOW, HIGH, seed=1)
    field.grid.features[1 : field.slots] = random.uniform(-0.5, 0.5, field.grid.features[1 : field.slots].shape)
    return field


@pytest.fixture
def points() -> Float32Array:
    return np.random.default_rng(4).uniform(LOW + 0.04, HIGH - 0.04, (COUNT, 3)).astype(np.float32)


def _check(field: NumbaSdfField, optimiser: NumbaAdam, reference: TorchField, loss: float, expected: torch.Tensor) -> None:
    expected.backward()  # type: ignore[no-untyped-call]
    assert loss == pytest.approx(float(expected.detach()), rel=1e-4)
    for name, tensor in reference.net.items():
        wanted = np.zeros(tuple(tensor.shape)) if tensor.grad is None else tensor.grad.numpy()
        _close(getattr(optimiser.network_gradient, name), wanted, name)
    for level, volume in enumerate(reference.volumes):
        assert volume.grad is not None
        slot, place = _slots(field.grid, level)
        _close(_by_slot(optimiser)[slot[..., None], place], volume.grad.numpy(), f"level {level}")


def _by_slot(optimiser: NumbaAdam) -> Any:
    gradient = optimiser.gradient
    used = int(gradient.rows[0])
    out = np.zeros_like(gradient.features)
    out[gradient.touched[:used]] = gradient.features[:used]
    return out


def _close(ours: Any, wanted: Any, name: str) -> None:
    scale = np.abs(wanted).max()
    np.testing.assert_allclose(ours, wanted, atol=5e-4 * scale + 2e-5, rtol=2e-3, err_msg=name)


def test_queries_match_torch(field: NumbaSdfField, points: Float32Array) -> None:
    reference = TorchField(field)
    at = torch.tensor(points.astype(np.float64))
    np.testing.assert_allclose(field.distance_m(points), reference.distance(at).detach().numpy(), atol=1e-6)
    colour = reference.colour(at).detach().numpy()
    np.testing.assert_allclose(field.rgb(points), colour[:, :3], atol=1e-5)
    np.testing.assert_allclose(field.colour_sigma(points), np.exp(0.5 * colour[:, 3]), rtol=1e-4)


def test_distance_gradients_match_torch(field: NumbaSdfField, points: Float32Array) -> None:
    random = np.random.default_rng(5)
    target = random.uniform(-0.1, 0.1, COUNT).astype(np.float32)
    weight = random.uniform(0.0, 2.0, COUNT).astype(np.float32)
    at_least = random.random(COUNT) < 0.5
    optimiser = NumbaAdam(field)
    loss = fit_distance(
        field.grid,
        field.network,
        optimiser.network_gradient,
        optimiser.gradient,
        field.scratch,
        points,
        target,
        weight,
        at_least,
    )
    reference = TorchField(field)
    error = reference.distance(torch.tensor(points.astype(np.float64))) - torch.tensor(target.astype(np.float64))
    error = torch.where(torch.tensor(at_least), torch.clamp(error, max=0.0), error)
    _check(field, optimiser, reference, loss, (torch.tensor(weight.astype(np.float64)) * error**2).sum())


def test_shape_gradients_match_torch(field: NumbaSdfField, points: Float32Array) -> None:
    random = np.random.default_rng(6)
    normal = random.standard_normal((COUNT, 3)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    eikonal, facing = (random.uniform(0.0, 2.0, COUNT).astype(np.float32) for _ in range(2))
    optimiser = NumbaAdam(field)
    corners = np.zeros((POINTS, 3), dtype=np.float32)
    loss = fit_shape(
        field.grid, field.network, optimiser.network_gradient, optimiser.gradient, field.scratch,
        TETRAHEDRON, corners, points, normal, eikonal, facing,
    )  # fmt: skip
    reference = TorchField(field)
    stencil = torch.tensor(TETRAHEDRON.astype(np.float64))
    at = torch.tensor(points.astype(np.float64))[:, None] + float(STENCIL_M) * stencil
    f = reference.distance(at.reshape(-1, 3)).reshape(-1, 4)
    gradient = (f[:, :, None] * stencil).sum(dim=1) / (4 * float(STENCIL_M))
    length = gradient.norm(dim=1)
    apart = ((gradient / length[:, None] - torch.tensor(normal.astype(np.float64))) ** 2).sum(dim=1)
    weights = [torch.tensor(w.astype(np.float64)) for w in (eikonal, facing)]
    _check(field, optimiser, reference, loss, (weights[0] * (length - 1) ** 2 + weights[1] * apart).sum())


def test_colour_gradients_match_torch(field: NumbaSdfField, points: Float32Array) -> None:
    random = np.random.default_rng(7)
    rgb = random.random((COUNT, 3)).astype(np.float32)
    weight = random.uniform(0.0, 2.0, COUNT).astype(np.float32)
    white = random.random((COUNT, 3)) < 0.3
    error = np.zeros(COUNT, dtype=np.float32)
    optimiser = NumbaAdam(field)
    shared = (field.grid, field.network, optimiser.network_gradient, optimiser.gradient, field.scratch)
    loss = fit_colour(*shared, points, rgb, white, weight, error)
    reference = TorchField(field)
    colour = reference.colour(torch.tensor(points.astype(np.float64)))
    apart = colour[:, :3] - torch.tensor(rgb.astype(np.float64))
    counted = ~torch.tensor(white) | (apart <= 0.0)  # a clipped channel that is predicted brighter has no error
    square, channels = (apart * counted) ** 2, counted.sum(dim=1)
    told_square = (square.sum(dim=1) / channels.clamp(min=1)).detach()
    assert 0 < int((channels == 0).sum()) < COUNT // 2
    np.testing.assert_allclose(error, torch.where(channels > 0, told_square, -1.0).numpy(), atol=1e-5)
    gaussian = 0.5 * (told_square / torch.exp(colour[:, 3]) + colour[:, 3]) * (channels > 0)
    expected = (torch.tensor(weight.astype(np.float64)) * (square.mean(dim=1) + float(VARIANCE_SHARE) * gaussian)).sum()
    _check(field, optimiser, reference, loss, expected)


def test_adam_matches_torch(field: NumbaSdfField) -> None:
    optimiser = NumbaAdam(field)
    start = field.parameters.copy()
    tensor = torch.tensor(start.astype(np.float64), requires_grad=True)
    reference = torch.optim.Adam([tensor], lr=4e-3, betas=(0.9, 0.99), eps=1e-8)
    for n in range(5):
        gradient = np.random.default_rng(n).standard_normal(start.shape)
        optimiser.flat_gradient[:] = gradient
        optimiser.step()
        tensor.grad = torch.tensor(gradient)
        reference.step()
    np.testing.assert_allclose(field.parameters, tensor.detach().numpy(), atol=1e-6)
    assert not optimiser.flat_gradient.any()


def test_a_slot_without_gradient_keeps_its_features(field: NumbaSdfField, points: Float32Array) -> None:
    optimiser = NumbaAdam(field)
    before = field.grid.features.copy()
    one = np.ones(1, dtype=np.float32)
    fit_distance(
        field.grid, field.network, optimiser.network_gradient, optimiser.gradient, field.scratch,
        points[:1], one, one, np.zeros(1, dtype=np.bool_),
    )  # fmt: skip
    touched = set(optimiser.gradient.touched[: optimiser.gradient.rows[0]].tolist())
    optimiser.step()
    changed = set(np.nonzero((field.grid.features != before).any(axis=1))[0].tolist())
    assert changed
    assert changed <= touched
    assert 0 not in touched
    assert not optimiser.gradient.features.any()
    assert (optimiser.gradient.row == -1).all()
