from __future__ import annotations

import numpy as np
import pytest
from skimage.measure import marching_cubes

from uav_recon.mapping.neural.surface.surface_nets import SparseNodes, node_points, surface_net, wanted_nodes
from uav_recon.types.frames import AnyArray, FloatArray

CENTRE, RADIUS_M = np.array([0.55, 0.5, 0.45]), 0.31
CELL_M, VOXEL_M = 0.05, 0.02


def _sphere(points: AnyArray) -> FloatArray:
    distance: FloatArray = np.linalg.norm(points - CENTRE, axis=1) - RADIUS_M
    return distance


def _nodes(upper_half: bool = False) -> SparseNodes:
    shape = (22, 20, 18)
    centres = (np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1) + 0.5) * CELL_M
    wanted = np.abs(_sphere(centres.reshape(-1, 3)).reshape(shape)) < 0.1
    if upper_half:
        wanted &= centres[..., 2] > CENTRE[2]
    nodes = wanted_nodes(wanted, np.zeros(3), CELL_M, VOXEL_M)
    points, mask = node_points(nodes)
    nodes.values[mask] = _sphere(points)
    return nodes


def test_a_sphere_is_closed_and_its_faces_point_outwards() -> None:
    vertices, normals, quads = surface_net(_nodes())
    assert np.abs(_sphere(vertices.astype(np.float64))).max() < 0.2 * VOXEL_M
    radial = (vertices - CENTRE) / np.linalg.norm(vertices - CENTRE, axis=1, keepdims=True)
    assert np.einsum("nc,nc->n", radial, normals).min() > 0.98
    a, b, c = (vertices[quads[:, n]].astype(np.float64) for n in range(3))
    assert (np.einsum("nc,nc->n", np.cross(b - a, c - a), radial[quads[:, 0]]) > 0).all()
    edges = np.sort(np.concatenate([quads[:, [n, (n + 1) % 4]] for n in range(4)]), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert (uses % 2 == 0).all()


def test_it_agrees_with_marching_cubes() -> None:
    vertices, _, quads = surface_net(_nodes())
    shape = (55, 50, 45)
    lattice = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3) * VOXEL_M
    volume = _sphere(lattice).reshape(shape)
    other, faces, _, _ = marching_cubes(volume, 0.0, spacing=(VOXEL_M,) * 3)
    corner = other[faces]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum()
    q = vertices[quads].astype(np.float64)
    ours = 0.5 * np.linalg.norm(np.cross(q[:, 2] - q[:, 0], q[:, 3] - q[:, 1]), axis=1).sum()
    assert ours == pytest.approx(area, rel=0.02)


def test_the_surface_stays_open_at_the_border_of_the_requested_cells() -> None:
    vertices, _, quads = surface_net(_nodes(upper_half=True))
    assert len(quads)
    assert vertices[:, 2].min() > CENTRE[2] - CELL_M - VOXEL_M
    assert np.abs(_sphere(vertices.astype(np.float64))).max() < 0.2 * VOXEL_M


def test_no_requested_cell_gives_no_surface() -> None:
    nodes = wanted_nodes(np.zeros((4, 4, 4), dtype=np.bool_), np.zeros(3), CELL_M, VOXEL_M)
    vertices, normals, quads = surface_net(nodes)
    assert (len(vertices), len(normals), len(quads)) == (0, 0, 0)
