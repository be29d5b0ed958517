"""Exported mesh files, as other programs read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from uav_recon.mapping.neural.watertight.mesh_export import (
    GLTF_FROM_WORLD,
    OBSERVED,
    UNSEEN,
    write_closed_ply,
    write_textured_glb,
)
from uav_recon.mapping.neural.watertight.watertight_mesh import ClosedMesh
from uav_recon.recording.mesh_file import load_mesh
from uav_recon.types.frames import Float32Array


class Rainbow:
    """Field whose colour at a point encodes the position."""

    def distance_m(self, points: Float32Array) -> Float32Array:
        return np.zeros(len(points), dtype=np.float32)

    def rgb(self, points: Float32Array) -> Float32Array:
        found: Float32Array = np.clip(points + np.float32(0.5), 0.0, 1.0)
        return found


@pytest.fixture
def mesh() -> ClosedMesh:
    """Return a ball whose upper cap was not observed."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int64)
    rgb = np.round(Rainbow().rgb(vertices.astype(np.float32)) * 255.0).astype(np.uint8)
    observed = vertices[faces].mean(axis=1)[:, 2] < 0.3
    return ClosedMesh(vertices, faces, vertices.astype(np.float32) * 2, rgb, np.ones(len(vertices), np.float32), observed)


def test_the_ply_is_watertight_coloured_and_marks_observed_faces(mesh: ClosedMesh, tmp_path: Path) -> None:
    write_closed_ply(tmp_path / "mesh.ply", mesh)
    read = trimesh.load(tmp_path / "mesh.ply", process=False)
    assert read.is_watertight
    np.testing.assert_allclose(read.vertices, mesh.vertices_world, atol=1e-6)
    np.testing.assert_array_equal(read.visual.vertex_colors[:, :3], mesh.rgb)
    is_observed = read.metadata["_ply_raw"]["face"]["data"]["observed"].ravel()
    np.testing.assert_array_equal(is_observed != 0, mesh.observed)


def test_unobserved_faces_are_excluded_from_the_evaluated_model(mesh: ClosedMesh, tmp_path: Path) -> None:
    write_closed_ply(tmp_path / "mesh.ply", mesh)
    model = load_mesh(tmp_path)
    assert model is not None
    np.testing.assert_array_equal(model.faces, mesh.faces[mesh.observed])


def test_the_glb_has_a_texture_and_a_primitive_for_unseen_faces(mesh: ClosedMesh, tmp_path: Path) -> None:
    write_textured_glb(tmp_path / "mesh.glb", mesh, Rainbow(), 0.02)
    scene = trimesh.load(tmp_path / "mesh.glb")
    assert set(scene.geometry) == {OBSERVED, UNSEEN}
    seen, unseen = scene.geometry[OBSERVED], scene.geometry[UNSEEN]
    assert len(seen.faces) == int(mesh.observed.sum())
    assert len(unseen.faces) == int((~mesh.observed).sum())
    assert unseen.visual.material.name == UNSEEN
    assert unseen.visual.material.baseColorTexture is None
    assert np.asarray(seen.visual.material.baseColorTexture).any(axis=2).all()  # no black between the charts
    drawn = seen.visual.to_color().vertex_colors[:, :3] / 255.0
    np.testing.assert_allclose(drawn, Rainbow().rgb(np.asarray(seen.vertices, dtype=np.float32)), atol=0.06)


def test_both_primitives_together_are_watertight_and_stand_upright(mesh: ClosedMesh, tmp_path: Path) -> None:
    write_textured_glb(tmp_path / "mesh.glb", mesh, Rainbow(), 0.02)
    scene = trimesh.load(tmp_path / "mesh.glb")
    np.testing.assert_allclose(scene.graph[OBSERVED][0], GLTF_FROM_WORLD)
    both = scene.to_geometry()
    both.merge_vertices(merge_tex=True, merge_norm=True)
    assert both.is_watertight
    cap = scene.geometry[UNSEEN].vertices @ GLTF_FROM_WORLD[:3, :3].T
    assert cap[:, 1].min() > 0.2  # up in glTF


@pytest.mark.parametrize("all_seen", [True, False])
def test_a_mesh_with_only_observed_or_only_unseen_faces_is_written(mesh: ClosedMesh, tmp_path: Path, all_seen: bool) -> None:
    mesh.observed[:] = all_seen
    write_textured_glb(tmp_path / "mesh.glb", mesh, Rainbow(), 0.02)
    assert set(trimesh.load(tmp_path / "mesh.glb").geometry) == {OBSERVED if all_seen else UNSEEN}
