from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, WALL_RGB, distance_to_walls, look, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.keyframes.keyframe_validation import RejectReason
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.types.camera import PosedFrame
from uav_recon.types.pose import Pose

SEEN_M2 = 17.5  # seen by the twelve views of the tour, of the room's 36 m²


def _trainer(seed: int = 0) -> NeuralMapper:
    return NeuralMapper(MapperConfig(seed=seed), LOW, HIGH, NOISE_PX, BASELINE_M)


@pytest.fixture(scope="module")
def room() -> NeuralMapper:
    """Return a mapper of the box room after twelve noisy views."""
    trainer = _trainer()
    for view in tour(12, sigma_px=NOISE_PX):
        assert trainer.add(view)
        trainer.train(15)
    trainer.polish(60)
    return trainer


def test_the_room_is_learned_to_a_centimetre(room: NeuralMapper) -> None:
    mesh = room.mesh(0.04)
    distance = distance_to_walls(mesh.vertices_world)
    assert distance.mean() < 0.008
    assert np.quantile(distance, 0.98) < 0.03
    corner = mesh.vertices_world[mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum()
    assert 0.85 * SEEN_M2 < area < 1.1 * SEEN_M2


def test_the_mesh_faces_the_air(room: NeuralMapper) -> None:
    mesh = room.mesh(0.04)
    a, b, c = (mesh.vertices_world[mesh.faces[:, n]] for n in range(3))
    normal = np.cross(b - a, c - a)
    to_middle = 0.5 * (LOW + HIGH) - a
    assert (np.einsum("nc,nc->n", normal, to_middle) > 0).mean() > 0.995


def test_colours_are_those_of_the_walls(room: NeuralMapper) -> None:
    mesh = room.mesh(0.04)
    gaps = np.concatenate([mesh.vertices_world - LOW, HIGH - mesh.vertices_world], axis=1)
    wall = np.abs(gaps).argmin(axis=1)
    inner = np.sort(np.abs(gaps), axis=1)[:, 1] > 0.15
    error = np.abs(mesh.rgb[inner].astype(float) - WALL_RGB[wall[inner]]).mean(axis=1)
    assert np.median(error) < 10
    assert np.quantile(error, 0.6) < 25  # the rest is outside the colour images


def test_surface_elements_face_the_air_and_carry_positive_uncertainty(room: NeuralMapper) -> None:
    surface = room.surface()
    assert len(surface.position_world) > 5000
    assert distance_to_walls(surface.position_world).mean() < 0.012
    to_middle = 0.5 * (LOW + HIGH) - surface.position_world
    assert (np.einsum("nc,nc->n", surface.normal_world, to_middle) > 0).mean() > 0.97
    assert np.allclose(np.linalg.norm(surface.normal_world, axis=1), 1.0, atol=1e-3)
    assert (surface.uncertainty > 0).all()


def test_a_wall_seen_once_from_far_away_is_less_certain_than_one_seen_often() -> None:
    trainer = _trainer()
    trainer.add(look((0.6, 1.2, 1.0), 0.0))
    for n in range(4):
        trainer.add(look((0.9, 1.0 + 0.1 * n, 1.0), 180.0, n))
    trainer.train(40)
    surface = trainer.surface()
    x = surface.position_world[:, 0]
    assert np.median(surface.uncertainty[x > 2.9]) > 2.0 * np.median(surface.uncertainty[x < 0.1])


def test_no_surface_is_invented_where_no_view_looked() -> None:
    trainer = _trainer()
    for n in range(3):
        trainer.add(look((1.2, 1.2, 1.0), 0.0, n))  # towards +x only
        trainer.train(40)
    mesh = trainer.mesh(0.04)
    assert len(mesh.faces) > 500
    assert mesh.vertices_world[:, 0].min() > 1.2
    assert np.quantile(distance_to_walls(mesh.vertices_world), 0.999) < 0.05  # 10 cm would be hallucinated
    assert trainer.surface().position_world[:, 0].min() > 1.2


def test_elements_have_the_uncertainty_that_the_configuration_names() -> None:
    trainer = NeuralMapper(MapperConfig(uncertainty="information"), LOW, HIGH, NOISE_PX, BASELINE_M)
    trainer.add(look((0.6, 1.2, 1.0), 0.0))
    trainer.train(20)
    surface = trainer.surface()
    named = trainer.uncertainties["information"].at(surface.position_world.astype(np.float32))
    assert np.array_equal(surface.uncertainty, named.astype(np.float64))
    assert MapperConfig().uncertainty == "agreement"


def test_before_the_first_view_surface_and_mesh_are_empty() -> None:
    trainer = _trainer()
    assert trainer.train(5) == 0.0
    assert len(trainer.surface().position_world) == 0
    assert len(trainer.mesh(0.05).faces) == 0


def test_views_that_cannot_be_used_are_refused_and_counted() -> None:
    trainer, good = _trainer(), look((1.5, 1.2, 1.0), 0.0)
    frame = good.frame
    empty = dataclasses.replace(frame, depth_m=np.full_like(frame.depth_m, np.nan))
    wrong_depth = dataclasses.replace(frame, depth_m=frame.depth_m[:-1])
    wrong_rgb = dataclasses.replace(frame, rgb=frame.rgb[:, :-1])
    for bad in (empty, wrong_depth, wrong_rgb):
        assert not trainer.add(PosedFrame(bad, good.world_from_depth))
    far = Pose.from_yaw(0.0, np.array([30.0, 0.0, 0.0])) @ good.world_from_depth
    assert not trainer.add(PosedFrame(frame, far))
    through_the_wall = Pose(good.world_from_depth.quat_wxyz, np.array([2.95, 1.2, 1.0]))
    deep = dataclasses.replace(frame, depth_m=np.full_like(frame.depth_m, 4.0))
    assert not trainer.add(PosedFrame(deep, through_the_wall))
    assert trainer.refusals.counts == {
        RejectReason.EMPTY: 1,
        RejectReason.SHAPE: 2,
        RejectReason.OUTSIDE: 1,
        RejectReason.ELSEWHERE: 1,
    }
    assert trainer.views == 0
    assert trainer.add(good)


def test_holes_infinities_and_negative_depths_in_a_good_view_do_no_harm() -> None:
    trainer, good = _trainer(), look((1.5, 1.2, 1.0), 0.0)
    depth = good.frame.depth_m.copy()
    depth[::3, ::2] = np.nan
    depth[5, 5:20], depth[6, 5:20], depth[7, 5:20] = np.inf, -1.0, 0.0
    assert trainer.add(PosedFrame(dataclasses.replace(good.frame, depth_m=depth), good.world_from_depth))
    assert np.isfinite(trainer.train(30))
    assert np.isfinite(trainer.field.parameters).all()
    assert np.isfinite(trainer.surface().position_world).all()


def test_the_same_seed_learns_the_same_and_another_does_not() -> None:
    meshes = []
    for seed in (0, 0, 1):
        trainer = _trainer(seed)
        for view in tour(3):
            trainer.add(view)
            trainer.train(25)
        trainer.surface()
        meshes.append(trainer.mesh(0.05))
        assert len(meshes[-1].faces)
    assert np.array_equal(meshes[0].vertices_world, meshes[1].vertices_world)
    assert np.array_equal(meshes[0].uncertainty, meshes[1].uncertainty)
    assert not np.array_equal(meshes[0].rgb, meshes[2].rgb)


def test_an_invalid_box_is_an_error() -> None:
    with pytest.raises(ValueError, match="not a box"):
        NeuralMapper(MapperConfig(), HIGH, LOW, NOISE_PX, BASELINE_M)
