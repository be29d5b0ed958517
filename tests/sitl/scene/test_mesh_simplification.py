from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sitl.camera.d435i import FAST_DEPTH_SPEC
from sitl.geometry.transform import body_from_camera, world_from_body
from sitl.scene import mesh_simplification as module
from sitl.scene.builtin_room import built_in_room
from sitl.scene.mesh_simplification import simplified
from sitl.scene.rasterizer import Renderer

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]


def fine(vertices: F32, faces: I32, times: int) -> tuple[F32, I32]:
    """Split each triangle into four, several times; the surface is unchanged."""
    import trimesh

    for _ in range(times):
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    return vertices.astype(np.float32), faces.astype(np.int32)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WORTH_FACES", 10_000)
    monkeypatch.setattr(module, "SAMPLES", 20_000)


@pytest.fixture(scope="module")
def room() -> tuple[F32, I32]:
    mesh = built_in_room(fine=False)
    return fine(mesh.vertices, mesh.faces, 1)


def picture(vertices: F32, faces: I32, pose: NDArray[np.float64]) -> tuple[F32, F32]:
    drawn = Renderer(vertices, faces, np.zeros(vertices.shape, np.uint8)).render(pose, FAST_DEPTH_SPEC, colour=False)
    return drawn.depth_m, drawn.incidence_cos


def test_a_fraction_of_the_triangles_renders_the_same_images(room: tuple[F32, I32], tmp_path: Path) -> None:
    vertices, faces = room
    assert len(faces) > module.WORTH_FACES
    fewer, triangles = simplified(vertices, faces, tmp_path)
    assert len(triangles) < len(faces) / 3
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    rng = np.random.default_rng(3)
    off = []
    for _ in range(8):
        body = world_from_body(rng.uniform(low + 0.5, high - 0.5), rng.uniform(-math.pi, math.pi))
        pose = body @ body_from_camera((0.0, 0.0, 0.0), 0.26)
        (depth, cosine), (other_depth, other_cosine) = picture(vertices, faces, pose), picture(fewer, triangles, pose)
        assert (depth > 0).mean() > 0.9
        off.append((np.abs(depth - other_depth) > 0.001) | (np.abs(cosine - other_cosine) > 0.02))
    assert np.mean(off) < 1e-3  # a few pixels at silhouettes


def test_the_simplified_mesh_is_cached(room: tuple[F32, I32], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = simplified(*room, tmp_path)

    def again(*_: object) -> None:
        raise AssertionError("the cache was not used")

    monkeypatch.setattr(module, "_collapsed", again)
    for a, b in zip(first, simplified(*room, tmp_path), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_small_mesh_is_not_simplified() -> None:
    mesh = built_in_room(fine=False)
    few = mesh.faces[:1000]
    vertices, faces = simplified(mesh.vertices, few)
    assert vertices is mesh.vertices and faces is few


def test_a_mesh_that_cannot_be_simplified_well_is_rendered_unchanged(
    room: tuple[F32, I32], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(module, "MAX_FACE_ERROR_M", 10.0)  # no lost surface is restored
    vertices, faces = simplified(*room, tmp_path)
    np.testing.assert_array_equal(faces, room[1])
    np.testing.assert_array_equal(vertices, room[0])
    assert "without simplification" in caplog.text


def test_a_sliver_that_the_simplification_loses_is_restored(room: tuple[F32, I32], tmp_path: Path) -> None:
    vertices, faces = room
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    sliver = middle + np.array([[0, 0, 0], [0, 0, 0.02], [0, 1e-6, 0.01]], np.float32)
    with_sliver = np.concatenate([vertices, sliver.astype(np.float32)])
    more = np.concatenate([faces, np.arange(3, dtype=np.int32)[None] + np.int32(len(vertices))])
    corners, triangles = simplified(with_sliver, more, tmp_path)
    assert np.isin(triangles, np.flatnonzero(np.linalg.norm(corners - middle, axis=1) < 0.03)).all(axis=1).any()
