from __future__ import annotations

import numpy as np
import pytest

from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.mapping.neural.surface.node_distances import fill_distances
from uav_recon.mapping.neural.surface.surface_nets import node_points, wanted_nodes

LOW, HIGH = np.array([-0.4, 0.1, 0.0]), np.array([1.7, 1.9, 1.3])
CELL_M = 0.05


@pytest.mark.parametrize("voxel_m", [0.02, 0.05, 0.13])
def test_nodes_get_the_distance_of_the_field_at_their_positions(voxel_m: float) -> None:
    random = np.random.default_rng(3)
    field = NumbaSdfField(LOW, HIGH, seed=1)
    field.cover(random.uniform(LOW, LOW + 0.7 * (HIGH - LOW), (4000, 3)).astype(np.float32))  # elsewhere only coarse levels
    field.grid.features[1:] += random.normal(0.0, 3.0, field.grid.features[1:].shape).astype(np.float32)
    shape = np.ceil((HIGH - LOW) / CELL_M).astype(int)
    nodes = wanted_nodes(random.random(shape) < 0.3, LOW, CELL_M, voxel_m)  # up to the box's border
    places, mask = node_points(nodes)
    points = places.astype(np.float32)
    untouched = nodes.values[~mask].copy()
    fill_distances(field, nodes)
    assert len(points) > 100
    assert np.abs(field.distance_m(points)).std() > 0.01
    assert np.allclose(nodes.values[mask], field.distance_m(points), atol=3e-6)
    assert np.array_equal(nodes.values[~mask], untouched)


def test_no_nodes_are_allowed() -> None:
    nodes = wanted_nodes(np.zeros((4, 4, 4), dtype=np.bool_), LOW, CELL_M, CELL_M)
    fill_distances(NumbaSdfField(LOW, HIGH, seed=1), nodes)
    assert nodes.values.size == 0
