from __future__ import annotations

from pathlib import Path

import trimesh
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, bent, correction, distance_to_walls, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.keyframe_store import KeyframeFolder
from uav_recon.mapping.neural.keyframes.keyframe_validation import RejectReason
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.worker.inline_mapper import InlineMapper

CONFIG = MapperConfig(steps_per_view=10, polish_steps=20, mesh_voxel_m=0.05)


def test_it_learns_at_once_saves_and_meshes(tmp_path: Path) -> None:
    keyframes = KeyframeFolder(tmp_path / "keyframes")
    mapper = InlineMapper(NeuralMapper(CONFIG, LOW, HIGH, NOISE_PX, BASELINE_M), CONFIG, keyframes)
    assert mapper.surface() is None
    for view in tour(4):
        assert mapper.add(view)
    surface = mapper.surface()
    assert surface is not None
    assert len(surface.position_world) > 1000
    assert mapper.surface() is surface
    assert len(keyframes) == 4
    assert mapper.alive()
    mapper.finish(tmp_path)
    assert len(trimesh.load(tmp_path / "mesh.ply").faces) > 1000


def test_a_new_map_epoch_is_learned_at_once(tmp_path: Path) -> None:
    keyframes = KeyframeFolder(tmp_path / "keyframes")
    mapper = InlineMapper(NeuralMapper(CONFIG, LOW, HIGH, NOISE_PX, BASELINE_M), CONFIG, keyframes)
    views = tour(6)
    for view in bent(views):
        assert mapper.add(view)
    mapper.repose(correction(views[:5], 2))
    assert mapper.refusals() == {RejectReason.UNPLACED: 1}
    surface = mapper.surface()
    assert surface is not None
    assert surface.map_epoch == 2
    assert distance_to_walls(surface.position_world).mean() < 0.02
    assert [keyframes.pose(n) is None for n in range(6)] == 5 * [False] + [True]
