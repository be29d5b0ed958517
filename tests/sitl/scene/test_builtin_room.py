from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from sitl.geometry.point_grid import PointGrid
from sitl.scene.builtin_room import built_in_room
from sitl.scene.mesh import Mesh
from sitl.scene.mesh_sampling import dense_points
from sitl.scene.scene import Scene, load_scene


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return built_in_room()


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(None)


def test_size_and_resolution(mesh: Mesh) -> None:
    np.testing.assert_allclose(mesh.vertices.min(axis=0), 0.0, atol=1e-6)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), (8.0, 3.0, 2.5), atol=1e-6)
    assert len(mesh.vertices) < 350_000
    corners = mesh.vertices[mesh.faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert np.median(edges) < 0.03
    assert edges.max() < 0.06
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert (area > 0).mean() > 0.998  # only triangles at the poles of discs and spheres are degenerate


def test_the_room_is_the_same_every_time(mesh: Mesh) -> None:
    again = built_in_room()
    np.testing.assert_array_equal(mesh.vertices, again.vertices)
    np.testing.assert_array_equal(mesh.rgb, again.rgb)


def test_walls_are_textured(mesh: Mesh) -> None:
    """No square of half a metre on a wall or on the floor has only one colour."""
    for axis, value in ((1, 0.0), (1, 3.0), (0, 0.0), (0, 8.0), (2, 0.0)):
        on = np.abs(mesh.vertices[:, axis] - value) < 1e-6
        rest = [i for i in range(3) if i != axis]
        tile = np.floor(mesh.vertices[on][:, rest] / 0.5).astype(int)
        grey = mesh.rgb[on].mean(axis=1)
        for key in np.unique(tile, axis=0):
            values = grey[(tile == key).all(axis=1)]
            assert len(values) < 50 or values.std() > 4.0, (axis, value, key)


def test_a_vehicle_with_a_clearance_of_forty_centimetres_reaches_both_ends(scene: Scene) -> None:
    bins = PointGrid(dense_points(scene.vertices, scene.faces, 0.02))
    x, y, z = (np.arange(low, high, 0.1) for low, high in zip(scene.fence_min, scene.fence_max, strict=True))
    centres = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    clear = bins.distances(centres.reshape(-1, 3), 0.0, 0.0, 0.5).reshape(centres.shape[:3]) >= 0.40
    level = clear & (np.abs(centres[..., 2] - 1.0) < 0.15)
    labels, _ = ndimage.label(level)
    largest = labels == np.bincount(labels[labels > 0]).argmax()
    reached = centres[largest][:, 0] + scene.scene_from_world_m[0]
    assert reached.min() < 0.6
    assert reached.max() > 7.3
    assert largest[np.linalg.norm(centres[..., :2], axis=-1) < 0.1].any()  # the column above the start is part of it
