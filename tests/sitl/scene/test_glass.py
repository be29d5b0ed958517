from __future__ import annotations

import numpy as np
import pytest

from sitl.camera.d435i import pinhole
from sitl.geometry.transform import body_from_camera, world_from_body
from sitl.scene.glass import GlassView, Pane, widest_panes
from sitl.scene.primitives import MeshBuilder
from sitl.scene.rasterizer import Renderer
from sitl.scene.scene import Scene, load_scene, scene_from_mesh
from sitl.scene.texture import plain

SPEC = pinhole(160, 120, 80.0, 60.0)


def box_room() -> Scene:
    """Return an empty room: x -2 to 4, y -2 to 2 from the pad; floor at -0.1, ceiling at 2.4."""
    w = MeshBuilder(fine=False)
    return scene_from_mesh("box", w.box((0, 0, 0), (6, 4, 2.5), plain((0.5, 0.5, 0.5))), (2.0, 2.0, 0.1, 0.0), None)


def facing(pane: Pane, away_m: float) -> np.ndarray:
    """Return the pose of a camera that looks at the middle of a pane from away_m before it."""
    centre = pane.middle_m * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.2]
    yaw = float(np.arctan2(-pane.normal[1], -pane.normal[0]))
    return world_from_body(centre + away_m * pane.normal, yaw) @ body_from_camera((0.0, 0.0, 0.0), 0.0)


def windows(scene: Scene) -> tuple[GlassView, Pane, Pane]:
    view = GlassView(scene, Renderer(scene.vertices, scene.faces, scene.rgb))
    return view, view._clear, view._mirror


def test_panes_lie_in_two_walls_that_are_not_parallel() -> None:
    for scene in (box_room(), load_scene(None, fine=False)):
        first, second = widest_panes(scene)
        assert abs(first.normal @ second.normal) < 0.7
        for pane in (first, second):
            assert abs(pane.normal[2]) < 1e-9
            assert np.linalg.norm(pane.normal) == pytest.approx(1.0)


def test_one_wall_has_no_depth_and_the_other_shows_the_mirrored_room() -> None:
    scene = box_room()
    view, clear, mirror = windows(scene)
    plain_view = Renderer(scene.vertices, scene.faces, scene.rgb)
    through = view.render(facing(clear, 1.0), SPEC)
    assert through.depth_m[60, 80] == 0.0
    assert plain_view.render(facing(clear, 1.0), SPEC).depth_m[60, 80] == pytest.approx(1.0, abs=0.02)
    reflected = view.render(facing(mirror, 1.0), SPEC)
    size_m = {0: 6.0, 1: 4.0}[int(np.argmax(np.abs(mirror.normal)))]
    assert reflected.depth_m[60, 80] == pytest.approx(1.0 + size_m, abs=0.02), "the opposite wall, behind the pane"


def test_beside_the_glass_nothing_changes() -> None:
    scene = box_room()
    view, _, mirror = windows(scene)
    pose = facing(mirror, 2.5)
    before, after = Renderer(scene.vertices, scene.faces, scene.rgb).render(pose, SPEC), view.render(pose, SPEC)
    changed = before.depth_m != after.depth_m
    u, v = np.arange(SPEC.width), np.arange(SPEC.height)[:, None]
    rays = np.stack([(u - SPEC.cx) / SPEC.fx + 0 * v, (v - SPEC.cy) / SPEC.fy + 0 * u, np.ones(changed.shape)], axis=-1)
    height_m = (before.depth_m[..., None] * rays @ pose[:3, :3].T + pose[:3, 3])[..., 2]
    glass = (height_m > 0.1) & (height_m < 2.2)
    assert 0.2 < glass.mean() < 0.8
    assert not changed[~glass].any(), "floor and ceiling"
    assert changed[60, 80]
    assert np.array_equal(before.rgb[~changed], after.rgb[~changed])


def test_a_scene_without_walls_has_no_glass() -> None:
    floor = Scene(
        "floor",
        np.array([[-3, -3, 0], [3, -3, 0], [0, 3, 0]], np.float32),
        np.array([[0, 1, 2]], np.int32),
        np.zeros((3, 3), np.uint8),
        0.0,
        np.array([-3.0, -3.0, 0.0]),
        np.array([3.0, 3.0, 2.0]),
        np.zeros(3),
    )
    with pytest.raises(ValueError, match="floor: no walls to be of glass"):
        widest_panes(floor)
