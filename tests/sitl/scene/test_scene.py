from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from sitl.scene.mesh import Mesh, joined
from sitl.scene.scene import SceneError, free_height_m, load_scene, scene_from_mesh

SHARED = Path(__file__).resolve().parents[4] / "shared" / "scenes"
START = (2.0, 2.0, 0.5, 90.0)


def box(low: tuple[float, float, float], high: tuple[float, float, float], grey: int = 100) -> Mesh:
    made = trimesh.creation.box(bounds=[low, high])
    return Mesh(made.vertices.astype(np.float32), made.faces.astype(np.int32), np.full((8, 3), grey, np.uint8))


ROOM = box((0, 0, 0), (5, 4, 2.5))


def with_obstacle(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    return joined([ROOM, box(low, high)])


def test_the_start_becomes_the_origin_ten_centimetres_over_the_floor() -> None:
    scene = scene_from_mesh("box", ROOM, START, None)
    np.testing.assert_allclose(scene.scene_from_world_m, (2.0, 2.0, 0.1), atol=1e-6)
    np.testing.assert_allclose(scene.vertices + scene.scene_from_world_m, ROOM.vertices, atol=1e-5)
    np.testing.assert_allclose(scene.fence_min, (-2.0, -2.0, -0.1), atol=1e-6)
    np.testing.assert_allclose(scene.fence_max, (3.0, 2.0, 2.4), atol=1e-6)
    assert scene.start_yaw_rad == pytest.approx(math.pi / 2)
    assert [a.dtype.name for a in (scene.vertices, scene.faces, scene.rgb)] == ["float32", "int32", "uint8"]


def test_the_floor_is_the_surface_below_the_start() -> None:
    """A platform wider than the hull is the floor."""
    scene = scene_from_mesh("box", with_obstacle((1, 1, 0), (3, 3, 0.2)), START, None)
    assert scene.scene_from_world_m[2] == pytest.approx(0.3, abs=1e-6)


def test_a_fence_is_given_in_the_frame_of_the_scene() -> None:
    scene = scene_from_mesh("box", ROOM, START, (1, 1, 0, 4, 3, 2))
    np.testing.assert_allclose(scene.fence_min, (-1, -1, -0.1), atol=1e-6)
    np.testing.assert_allclose(scene.fence_max, (2, 1, 1.9), atol=1e-6)


@pytest.mark.parametrize(
    ("low", "high", "blocked"),
    [
        ((2.34, 1.5, 0.0), (2.6, 2.5, 1.0), True),  # 0.34 m from the axis, above the pad
        ((2.36, 1.5, 0.0), (2.6, 2.5, 1.0), False),
        ((2.19, 1.5, 0.0), (2.6, 2.5, 0.3), True),  # at the height of the pad only the hull's radius counts
        ((2.21, 1.5, 0.0), (2.6, 2.5, 0.3), False),
        ((1.5, 1.5, 1.30), (2.5, 2.5, 1.5), True),  # above the take-off height
        ((1.5, 1.5, 1.40), (2.5, 2.5, 1.5), False),
    ],
)
def test_start_needs_a_free_column(low: tuple[float, float, float], high: tuple[float, float, float], blocked: bool) -> None:
    mesh = with_obstacle(low, high)
    if blocked:
        with pytest.raises(SceneError, match="start is blocked"):
            scene_from_mesh("box", mesh, START, None)
    else:
        scene_from_mesh("box", mesh, START, None)


def test_start_close_to_a_wall_is_blocked() -> None:
    with pytest.raises(SceneError, match=r"blocked.*0\.30 m from its axis"):
        scene_from_mesh("box", ROOM, (0.3, 2, 0.5, 0), None)


def test_the_column_above_the_pad_is_free_up_to_the_ceiling_or_a_lamp() -> None:
    empty = scene_from_mesh("box", ROOM, START, None)
    lamp = scene_from_mesh("lamp", with_obstacle((2.3, 1.9, 1.9), (2.6, 2.1, 2.3)), START, None)
    assert free_height_m(empty, 0.5) == pytest.approx(2.4)
    assert free_height_m(lamp, 0.5) == pytest.approx(1.8)
    assert free_height_m(lamp, 0.25) == pytest.approx(2.4)
    bare = dataclasses.replace(empty, faces=empty.faces[:0])
    assert free_height_m(bare, 0.5) == pytest.approx(2.4), "where there is no surface the fence is the limit"


def test_an_open_scene_needs_a_fence() -> None:
    roofless = Mesh(ROOM.vertices, ROOM.faces[(ROOM.vertices[ROOM.faces][..., 2] < 2.4).any(axis=1)], ROOM.rgb)
    with pytest.raises(SceneError, match=r"open.*--fence"):
        scene_from_mesh("box", roofless, START, None)
    assert scene_from_mesh("box", roofless, START, (0, 0, 0, 5, 4, 2)).fence_max[2] == pytest.approx(1.9, abs=1e-6)


@pytest.mark.parametrize(
    ("mesh", "start", "fence", "message"),
    [
        (ROOM, (7.0, 2.0, 0.5, 0.0), None, "outside the scene's bounds"),
        (ROOM, (2.0, 2.0, 0.5), None, "want a start X,Y,Z,YAW"),
        (ROOM, (2.0, math.nan, 0.5, 0.0), None, "want a start X,Y,Z,YAW"),
        (ROOM, START, (3, 0, 0, 5, 4, 2), "outside the fence"),
        (ROOM, START, (0, 0, 0, 5, 4), "want a fence of 6 numbers"),
        (ROOM, (2.0, 2.0, 0.5, 1e9), None, r"start yaw 1e\+09: want -360 to 360 degrees"),
        (ROOM, START, (-1, -1, -0.1, 600, 3, 0.9), r"fence reaches 598 m from the start; want at most 500 m"),
        (Mesh(ROOM.vertices, ROOM.faces[:0], ROOM.rgb), START, None, "empty"),
        (Mesh(ROOM.vertices * 100, ROOM.faces, ROOM.rgb), START, None, "500 m across"),
        (box((0, 0, 0), (90, 90, 20)), START, None, r"scene of \(90.00, 90.00, 20.00\) m holds 162000 m3; want at most 30000"),
        (box((0, 0, 0), (99, 99, 2.5)), START, None, "a surface of 20592 m2; want at most 12000"),
        (
            ROOM,
            START,
            (-100, -100, -1, 100, 100, 9),
            r"fence of \(200.00, 200.00, 10.00\) m holds 400000 m3; want at most 30000",
        ),
        (
            Mesh(np.where(ROOM.vertices > 4.5, np.float32(np.nan), ROOM.vertices), ROOM.faces, ROOM.rgb),
            START,
            None,
            "4 vertices",
        ),
        (Mesh(ROOM.vertices, ROOM.faces + 1, ROOM.rgb), START, None, "a face names vertex 8 of 8"),
    ],
)
def test_invalid_scenes_are_one_line_errors(
    mesh: Mesh, start: tuple[float, ...], fence: tuple[float, ...] | None, message: str
) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        scene_from_mesh("box", mesh, start, fence)
    assert "\n" not in str(caught.value)


def test_invalid_files_are_one_line_errors(tmp_path: Path) -> None:
    (tmp_path / "text.ply").write_text("this is no mesh\n")
    (tmp_path / "empty.obj").write_text("")
    (tmp_path / "room.dae").write_text("")
    folders = {
        "bare": None,
        "broken": "{",
        "listed": "[]",
        "nested": "[" * 100_000,
        "pointless": '{"name": "x"}',
        "gone": '{"name": "x", "file": "x.ply"}',
        "far": f'{{"name": "x", "file": "x.ply", "start": {{"x": 1{"0" * 400}, "y": 0, "z": 0, "yaw": 0}}}}',
        "long": f'{{"name": "x", "file": "x.ply", "start": {{"x": 1{"0" * 5000}, "y": 0, "z": 0, "yaw": 0}}}}',
    }
    for name, text in folders.items():
        (tmp_path / name).mkdir()
        if text is not None:
            (tmp_path / name / "scene.json").write_text(text)
    for name in ("missing.ply", "text.ply", "empty.obj", "room.dae", *folders):
        with pytest.raises(SceneError) as caught:
            load_scene(tmp_path / name, START, None)
        assert str(tmp_path) in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb", ".stl"])
def test_mesh_files_load_with_their_colours(tmp_path: Path, suffix: str) -> None:
    made = trimesh.Trimesh(ROOM.vertices, ROOM.faces, process=False)
    made.visual.vertex_colors = np.tile(np.array([10, 200, 30, 255], np.uint8), (8, 1))
    path = tmp_path / f"room{suffix}"
    made.export(path)
    with pytest.raises(SceneError, match="no start given"):
        load_scene(path, None, None)
    scene = load_scene(path, START, None)
    expected = (160, 160, 160) if suffix == ".stl" else (10, 200, 30)
    np.testing.assert_array_equal(np.unique(scene.rgb, axis=0), [expected])
    np.testing.assert_allclose(scene.vertices.max(axis=0), (3, 2, 2.4), atol=1e-5)


def test_face_colours_become_vertex_colours(tmp_path: Path) -> None:
    made = trimesh.Trimesh(ROOM.vertices, ROOM.faces, process=False)
    colours = np.full((12, 4), 255, np.uint8)
    colours[:, 0] = np.arange(12) * 20
    made.visual.face_colors = colours
    path = tmp_path / "room.ply"
    made.export(path)
    scene = load_scene(path, START, None)
    np.testing.assert_array_equal(scene.rgb[scene.faces][:, :, 0], np.repeat(np.arange(12)[:, None] * 20, 3, axis=1))


def test_a_texture_becomes_vertex_colours(tmp_path: Path) -> None:
    from PIL import Image

    made = trimesh.Trimesh(ROOM.vertices, ROOM.faces, process=False)
    image = Image.fromarray(np.full((4, 4, 3), (200, 40, 90), np.uint8))
    made.visual = trimesh.visual.TextureVisuals(uv=np.full((8, 2), 0.5), image=image)
    path = tmp_path / "room.glb"
    made.export(path)
    np.testing.assert_array_equal(np.unique(load_scene(path, START, None).rgb, axis=0), [(200, 40, 90)])


def test_a_scene_folder_defines_the_start(tmp_path: Path) -> None:
    trimesh.Trimesh(ROOM.vertices, ROOM.faces, process=False).export(tmp_path / "m.ply")
    start = {"x": 2.0, "y": 1.5, "z": 1.2, "yaw": 0.5}
    (tmp_path / "scene.json").write_text(json.dumps({"name": "hall", "file": "m.ply", "start": start}))
    scene = load_scene(tmp_path, None, None)
    assert scene.name == "hall"
    assert scene.start_yaw_rad == pytest.approx(0.5)
    np.testing.assert_allclose(scene.scene_from_world_m, (2.0, 1.5, 0.1), atol=1e-6)
    np.testing.assert_allclose(load_scene(tmp_path, START, None).scene_from_world_m, (2.0, 2.0, 0.1), atol=1e-6)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["meeting_room", "narrow_room"])
def test_shared_scenes_load(name: str) -> None:
    scene = load_scene(SHARED / name, None, None)
    assert scene.name == name
    assert -0.16 < scene.vertices[:, 2].min() < -0.08
    assert len(scene.faces) > 200_000


def test_file_errors_are_not_reported_as_python_exceptions(tmp_path: Path) -> None:
    (tmp_path / "garb.ply").write_bytes(b"ply\n")
    (tmp_path / "scene.json").write_text('{"name": "x", "file": "garb.ply", "start": 3}')
    for scene, words in (
        (tmp_path / "garb.ply", "garb.ply: cannot be read as a mesh (damaged, or of another kind)"),
        (tmp_path, "scene.json: not a scene description (want name, file and a start with x, y, z, yaw)"),
        ("random:-1", "random:-1: want random:SEED with a whole number, 0 or more"),
    ):
        with pytest.raises(SceneError, match=re.escape(words)):
            load_scene(scene)
