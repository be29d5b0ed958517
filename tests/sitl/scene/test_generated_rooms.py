"""Generated flats and small rooms: equal for equal seeds, closed, and with space to take off.

Their sizes are within the documented limits.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from sitl.scene.flat_builder import FREE_START_M
from sitl.scene.generated_rooms import FLAT, SMALL_ROOM, generated_room
from sitl.scene.mesh import Mesh
from sitl.scene.mesh_sampling import dense_points
from sitl.scene.scene import SceneError, load_scene

SEEDS = range(12)
BELOW_M = 1.45  # free height that the vehicle needs above its pad; lamps hang higher


@pytest.fixture(scope="module")
def flats() -> dict[int, tuple[Mesh, tuple[float, float, float, float]]]:
    return {seed: generated_room(seed, fine=False) for seed in SEEDS}


def test_a_seed_gives_the_same_flat(flats: dict[int, tuple[Mesh, tuple[float, ...]]]) -> None:
    for seed in (0, 5):
        mesh, start = generated_room(seed, fine=False)
        assert start == flats[seed][1]
        assert mesh.vertices.tobytes() == flats[seed][0].vertices.tobytes()
    assert len({flat[1] for flat in flats.values()}) == len(SEEDS)


def test_sizes_are_within_the_documented_limits(flats: dict[int, tuple[Mesh, tuple[float, ...]]]) -> None:
    extents = np.array([np.ptp(mesh.vertices, axis=0) for mesh, _ in flats.values()])
    area = extents[:, 0] * extents[:, 1]
    assert area.min() >= FLAT.area_m2[0] - 0.01
    assert area.max() <= FLAT.area_m2[1] + 0.01
    assert np.ptp(area) > 15.0
    assert (extents[:, 2] >= FLAT.height_m[0] - 1e-6).all()
    assert (extents[:, 2] <= FLAT.height_m[1] + 1e-6).all()


def test_a_small_room_is_small_and_holds_furniture() -> None:
    for seed in SEEDS:
        mesh, _ = generated_room(seed, fine=False, kind=SMALL_ROOM)
        length, width, height = np.ptp(mesh.vertices.astype(np.float64), axis=0)
        assert SMALL_ROOM.area_m2[0] - 0.01 <= length * width <= SMALL_ROOM.area_m2[1] + 0.01
        assert min(length, width) >= SMALL_ROOM.narrowest_m - 1e-6
        assert SMALL_ROOM.height_m[0] - 1e-6 <= height <= SMALL_ROOM.height_m[1] + 1e-6
        assert len(mesh.faces) > 12 + 12, "more than the shell and one box"


def test_the_outer_shell_is_closed(flats: dict[int, tuple[Mesh, tuple[float, ...]]]) -> None:
    """Each side of the box around a flat is fully covered by triangles that lie in it."""
    for mesh, _ in flats.values():
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        corners = mesh.vertices[mesh.faces].astype(np.float64)
        for axis, border in itertools.product(range(3), (low, high)):
            lying = corners[(np.abs(corners[:, :, axis] - border[axis]) < 1e-6).all(axis=1)]
            areas = 0.5 * np.linalg.norm(np.cross(lying[:, 1] - lying[:, 0], lying[:, 2] - lying[:, 0]), axis=1)
            side = np.delete(high - low, axis).astype(np.float64)
            assert areas.max() == pytest.approx(0.5 * side.prod(), rel=1e-5)  # the two triangles that form the whole side
            assert (np.abs(areas - 0.5 * side.prod()) < 1e-3).sum() == 2


def test_there_is_room_to_take_off(flats: dict[int, tuple[Mesh, tuple[float, ...]]]) -> None:
    for mesh, start in flats.values():
        points = dense_points(mesh.vertices, mesh.faces, 0.02)
        standing = points[(points[:, 2] > 0.02) & (points[:, 2] < BELOW_M)]
        assert np.linalg.norm(standing[:, :2] - np.array(start[:2]), axis=1).min() >= FREE_START_M
        assert start[3] != 0.0


@pytest.mark.parametrize("kind", ["random", "small"])
def test_every_scene_has_room_for_a_large_vehicle(kind: str) -> None:
    for seed in SEEDS:
        scene = load_scene(f"{kind}:{seed}", radius_m=0.30, fine=False)
        assert scene.name == f"{kind}-{seed}"


def test_texture_does_not_change_the_shape() -> None:
    fine, coarse = generated_room(4, fine=True), generated_room(4, fine=False)
    assert fine[1] == coarse[1]
    assert np.ptp(fine[0].rgb.astype(int), axis=0).min() > 150
    assert len(fine[0].faces) > 10 * len(coarse[0].faces)
    for axis in range(3):
        assert np.ptp(fine[0].vertices[:, axis]) == pytest.approx(np.ptp(coarse[0].vertices[:, axis]))


@pytest.mark.parametrize("word", ["random:", "random:-1", "random:1.5", "small:x"])
def test_an_invalid_seed_is_an_error(word: str) -> None:
    with pytest.raises(SceneError, match=f"{word.partition(':')[0]}:SEED with"):
        load_scene(word)
