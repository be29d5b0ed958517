from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from sitl.camera.d435i import COLOUR_SPEC, DEPTH_SPEC
from sitl.scene.mesh import Mesh, joined
from sitl.scene.scene import Scene, scene_from_mesh
from sitl.truth import visibility
from sitl.truth.visibility import VisibleTruth, load_visible_truth, reachable_positions


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    made = trimesh.creation.box(bounds=[low, high])
    return Mesh(made.vertices.astype(np.float32), made.faces.astype(np.int32), np.full((8, 3), 90, np.uint8))


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Return a 4 x 4 x 2.5 m room with a closed cupboard and a neighbouring cell.

    A box is hidden in the cupboard. The cell beyond the wall at x = 4 is sealed.
    """
    parts = [box((0, 0, 0), (4, 4, 2.5)), box((3, 0.1, 0), (3.9, 1, 1)), box((3.3, 0.4, 0.3), (3.6, 0.7, 0.6))]
    return scene_from_mesh("box", joined([*parts, box((4.2, 0, 0), (8, 4, 2.5))]), (1.5, 2.0, 0.5, 0.0), None)


@pytest.fixture(scope="module")
def cut(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> VisibleTruth:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(visibility, "POSES", 150)
        return load_visible_truth(scene, "gimbal", "d435i", tmp_path_factory.mktemp("cut"))


def in_scene(points: NDArray[np.float32], scene: Scene) -> NDArray[np.float64]:
    return np.asarray(points + scene.scene_from_world_m)


def test_reachable_is_connected_and_clear(scene: Scene) -> None:
    positions = in_scene(reachable_positions(scene), scene)
    assert (positions.min(axis=0) >= (0.349, 0.349, 0.399)).all()
    assert (positions.max(axis=0) <= (3.651, 3.651, 2.151)).all()
    near_cupboard = np.linalg.norm(np.maximum(np.maximum((3, 0.1, 0) - positions, positions - (3.9, 1, 1)), 0), axis=1)
    assert near_cupboard.min() >= 0.349
    assert len(positions) > 0.8 * 33 * 33 * 17 * 0.9
    assert np.abs(positions[:, 0] - 1.5).min() < 1e-5  # the start is on a column of the grid


def test_hidden_surfaces_and_other_rooms_are_not_part_of_the_truth(scene: Scene, cut: VisibleTruth) -> None:
    points = in_scene(cut.points, scene)
    inside = ((points > (3.2, 0.3, 0.2)) & (points < (3.7, 0.8, 0.7))).all(axis=1)
    assert not inside.any()
    assert (points[:, 0] <= 4.001).all()
    top = ((points > (3.0, 0.1, 0.99)) & (points < (3.9, 1.0, 1.01))).all(axis=1)
    assert top.sum() > 500
    east = np.abs(points[:, 0] - 4.0) < 1e-3
    assert east.sum() > 1000


def test_visible_free_space_is_only_the_room(scene: Scene, cut: VisibleTruth) -> None:
    centres = np.stack(np.meshgrid(*(np.arange(n) for n in cut.free_seen.shape), indexing="ij"), axis=-1) + 0.5
    centres = centres * cut.free_cell_m + cut.free_origin_m + scene.scene_from_world_m
    room = ((centres > 0.1) & (centres < (3.9, 3.9, 2.4))).all(axis=-1)
    cupboard = ((centres > (2.9, 0.0, -1)) & (centres < (4.0, 1.1, 1.1))).all(axis=-1)
    assert cut.free_seen[room & ~cupboard].mean() > 0.99
    assert not cut.free_seen[centres[..., 0] > 4.1].any()
    inner = ((centres > (3.1, 0.2, 0.0)) & (centres < (3.8, 0.9, 0.9))).all(axis=-1)
    assert not cut.free_seen[inner].any()


def test_held_out_views_are_poses_of_the_colour_camera(scene: Scene, cut: VisibleTruth) -> None:
    assert cut.views.shape == (100, 4, 4)
    assert cut.view_spec == COLOUR_SPEC
    np.testing.assert_allclose(
        cut.views[:, :3, :3] @ cut.views[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (100, 1, 1)), atol=1e-9
    )
    pitch = np.degrees(np.arcsin(-cut.views[:, 2, 2]))
    assert pitch.min() < -50
    assert pitch.max() > 50
    assert np.abs(cut.views[:, 2, 0]).max() < 1e-9  # no roll


def test_a_fixed_mount_keeps_its_angle_and_sees_less(
    scene: Scene, cut: VisibleTruth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(visibility, "POSES", 150)
    fixed = load_visible_truth(scene, "fixed:15", "wide", tmp_path)
    np.testing.assert_allclose(np.arcsin(-fixed.views[:, 2, 2]), math.radians(15), atol=1e-9)
    assert fixed.view_spec == DEPTH_SPEC
    assert len(fixed.points) < len(cut.points)


def test_the_cache_is_used_and_a_damaged_one_is_recomputed(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(visibility, "POSES", 8)
    monkeypatch.setattr(visibility, "SAMPLES", 20_000)
    first = load_visible_truth(scene, "fixed:15", "d435i", tmp_path)
    (file,) = tmp_path.iterdir()

    def refuse(*_: object) -> VisibleTruth:
        raise AssertionError("the cache was not used")

    with monkeypatch.context() as patch:
        patch.setattr(visibility, "_cut", refuse)
        again = load_visible_truth(scene, "fixed:15", "d435i", tmp_path)
    np.testing.assert_array_equal(first.points, again.points)
    np.testing.assert_array_equal(first.free_seen, again.free_seen)
    content = file.read_bytes()
    for broken in (b"", b"not an archive", content[: len(content) // 2], content[:-4000] + bytes(4000)):
        file.write_bytes(broken)
        np.testing.assert_array_equal(load_visible_truth(scene, "fixed:15", "d435i", tmp_path).points, first.points)
    assert len(list(tmp_path.iterdir())) == 1


def test_an_unwritable_cache_only_costs_time(scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(visibility, "POSES", 5)
    monkeypatch.setattr(visibility, "SAMPLES", 20_000)
    (tmp_path / "taken").write_text("a file where the folder should be")
    assert len(load_visible_truth(scene, "fixed:15", "d435i", tmp_path / "taken").points) > 0


def test_unknown_mount_is_refused(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="mount 'loose'"):
        load_visible_truth(scene, "loose", "d435i", tmp_path)
