"""Closed mesh of an exactly known field: a box room that twelve views saw in part."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, WALL_RGB, distance_to_walls, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.training_data import TrainingData
from uav_recon.mapping.neural.watertight import watertight_mesh
from uav_recon.mapping.neural.watertight.watertight_mesh import ClosedMesh, MeshResolutionError, closed_mesh
from uav_recon.types.frames import Float32Array

VOXEL_M = 0.04


class ExactRoom:
    """Box room as a field that is exact everywhere, also where no view looked."""

    def distance_m(self, points: Float32Array) -> Float32Array:
        inside = ((points > LOW) & (points < HIGH)).all(axis=1)
        distance = distance_to_walls(points.astype(np.float64))
        found: Float32Array = np.where(inside, distance, -distance).astype(np.float32)
        return found

    def rgb(self, points: Float32Array) -> Float32Array:
        wall = np.abs(np.concatenate([points - LOW, points - HIGH], axis=1)).argmin(axis=1)
        found: Float32Array = (WALL_RGB[wall] / 255.0).astype(np.float32)
        return found


@pytest.fixture(scope="module")
def gathered() -> TrainingData:
    trainer = NeuralMapper(MapperConfig(), LOW, HIGH, NOISE_PX, BASELINE_M)
    for view in tour(12):
        assert trainer.add(view)
    return trainer.training_data()


@pytest.fixture(scope="module")
def mesh(gathered: TrainingData) -> ClosedMesh:
    return closed_mesh(ExactRoom(), gathered, VOXEL_M)


def body(mesh: ClosedMesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices_world, mesh.faces, process=False)


def test_is_watertight_and_faces_the_air(mesh: ClosedMesh) -> None:
    assert body(mesh).is_watertight
    assert body(mesh).is_winding_consistent
    assert body(mesh).volume < 0  # the solid encloses the air, so its volume is negative
    assert -body(mesh).volume < float(np.prod(HIGH - LOW)) * 1.02


def test_observed_faces_lie_on_the_walls_and_lids_are_marked(mesh: ClosedMesh) -> None:
    seen = mesh.seen()
    assert 10.0 < body(mesh).area_faces[mesh.observed].sum() < 18.5  # the tour sees 17.5 m² of 36
    assert distance_to_walls(seen.vertices_world).max() < 0.006
    lids = mesh.vertices_world[np.unique(mesh.faces[~mesh.observed])]
    assert distance_to_walls(lids).max() > 0.2
    assert 0.2 < mesh.seen_share() < 0.9


def test_colours_are_those_of_the_field(mesh: ClosedMesh) -> None:
    wall = np.abs(np.concatenate([mesh.vertices_world - LOW, mesh.vertices_world - HIGH], axis=1)).argmin(axis=1)
    at = np.unique(mesh.faces[mesh.observed])
    assert np.mean((mesh.rgb[at] == WALL_RGB[wall[at]]).all(axis=1)) > 0.98  # points on an edge belong to two walls


def test_a_false_cavity_behind_a_wall_is_filled(gathered: TrainingData, mesh: ClosedMesh) -> None:
    class Dreamer(ExactRoom):
        def distance_m(self, points: Float32Array) -> Float32Array:
            """Return a distance with a second cavity 4 cm behind the wall."""
            bubble = np.float32(0.03) - np.abs(points[:, 0] - np.float32(HIGH[0] + 0.09))
            found: Float32Array = np.maximum(super().distance_m(points), bubble)
            return found

    dreamt = closed_mesh(Dreamer(), gathered, 0.02)
    assert body(dreamt).is_watertight
    assert dreamt.vertices_world[:, 0].max() < HIGH[0] + 0.03


def test_a_voxel_too_fine_for_the_box_names_what_fits(gathered: TrainingData, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watertight_mesh, "MAX_NODES", 100_000)
    with pytest.raises(MeshResolutionError, match=r"voxels of 0\.\d\d\d m at the finest"):
        closed_mesh(ExactRoom(), gathered, VOXEL_M)
