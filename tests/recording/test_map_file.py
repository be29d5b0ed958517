"""Maps and meshes that a flight saves are read back unchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uav_recon.mapping.neural.surface.ply_writer import write_ply
from uav_recon.recording.map_file import load_map, save_map
from uav_recon.recording.mesh_file import load_mesh
from uav_recon.types.maps import GridSpec, TriangleMesh, VoxelMap


def test_a_map_reads_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    grid = GridSpec(np.array([-1.0, 2.0, 0.5]), 0.1, (4, 5, 6))
    voxels = VoxelMap.whole(
        grid, rng.integers(0, 3, grid.shape).astype(np.uint8), rng.integers(0, 99, grid.shape).astype(np.uint8), 7, 2
    )
    save_map(tmp_path, voxels)
    back = load_map(tmp_path)
    assert back is not None
    np.testing.assert_array_equal(back.state, voxels.state)
    np.testing.assert_array_equal(back.distance2, voxels.distance2)
    np.testing.assert_array_equal(back.grid.origin_world_m, grid.origin_world_m)
    assert (back.grid.shape, back.grid.resolution_m, back.revision, back.map_epoch) == (grid.shape, 0.1, 7, 2)


def test_no_map_is_none(tmp_path: Path) -> None:
    assert load_map(tmp_path) is None
    assert load_mesh(tmp_path) is None


def test_an_unreadable_mesh_is_none_and_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "mesh.ply").write_bytes(b"ply\nformat nonsense\n")
    assert load_mesh(tmp_path) is None
    assert "cannot be read as a mesh" in caplog.text


def test_a_mesh_reads_back_with_colour_and_uncertainty(tmp_path: Path) -> None:
    vertices, faces = np.eye(3), np.array([[0, 1, 2]])
    rgb = np.array([[10, 20, 30], [40, 50, 60], [70, 80, 90]], np.uint8)
    write_ply(tmp_path / "mesh.ply", TriangleMesh(vertices, faces, rgb, np.array([0.5, 1.5, 2.5], np.float32)))
    mesh = load_mesh(tmp_path)
    assert mesh is not None
    assert mesh.vertices_world.tolist() == vertices.tolist()
    assert mesh.rgb.tolist() == rgb.tolist()
    assert mesh.uncertainty.tolist() == [0.5, 1.5, 2.5]
    assert mesh.faces.tolist() == [[0, 1, 2]]
