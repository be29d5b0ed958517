"""Floor plans: doorways of the width that is named, walls everywhere else, room to take off."""

from __future__ import annotations

import numpy as np
import pytest

from sitl.scene import floor_plans
from sitl.scene.floor_plans import WALL_M
from sitl.scene.mesh_sampling import dense_points
from sitl.scene.scene import SceneError, load_scene
from sitl.scene.scene_kinds import KINDS

PLANS = ["corridor", "hall", "l-shape", "dead-end", "tall"]


@pytest.mark.parametrize("name", [f"{plan}:{seed}" for plan in PLANS for seed in range(6)] + ["door:65", "door:120"])
def test_a_vehicle_can_take_off_in_every_plan(name: str) -> None:
    scene = load_scene(name, radius_m=0.30, fine=False)
    assert scene.name == name.replace(":", "-")


@pytest.mark.parametrize("width_cm", [50, 65, 120])
def test_a_doorway_is_as_wide_as_its_name_says(width_cm: int) -> None:
    mesh, _ = KINDS["door"].draw(width_cm, False)
    points = dense_points(mesh.vertices, mesh.faces, 0.01)
    inside = (points[:, 0] > 4.0 + 0.2 * WALL_M) & (points[:, 0] < 4.0 + 0.8 * WALL_M)
    y = points[inside & (points[:, 2] > 0.9) & (points[:, 2] < 1.1), 1]
    jambs = np.sort(y[(y > 0.1) & (y < 3.9)])
    assert np.diff(jambs).max() == pytest.approx(0.01 * width_cm, abs=0.02)


def test_furniture_stands_in_rooms_and_leaves_doorsteps_free() -> None:
    for seed in range(4):
        mesh, _ = floor_plans.CORRIDOR.build(seed, fine=False)
        points = dense_points(mesh.vertices, mesh.faces, 0.02)
        standing = points[(points[:, 2] > 0.05) & (points[:, 2] < 1.9)]
        for x0, y0, x1, y1 in floor_plans.CORRIDOR.doorways:
            before = (standing[:, 0] > x0 + 0.02) & (standing[:, 0] < x1 - 0.02)
            assert not (before & (standing[:, 1] > y0 - 0.5) & (standing[:, 1] < y1 + 0.5)).any()


def test_what_is_in_no_room_is_wall() -> None:
    mesh, _ = floor_plans.L_SHAPE.build(0, fine=False)
    points = dense_points(mesh.vertices, mesh.faces, 0.03)
    assert np.ptp(mesh.vertices, axis=0)[:2] == pytest.approx([7.0, 8.0], abs=0.01)
    block = (points[:, 0] > 2.9) & (points[:, 1] > 2.7) & (points[:, 2] > 0.1) & (points[:, 2] < 2.4)
    inside = points[block & (points[:, 0] < 6.9) & (points[:, 1] < 7.9)]
    assert not len(inside), "the outer corner is solid: nothing is drawn in it"
    side = points[(np.abs(points[:, 1] - 2.6) < 0.01) & (points[:, 0] > 2.9) & (points[:, 2] > 0.1)]
    assert np.ptp(side[:, 0]) > 3.9, "and closed towards the room"


@pytest.mark.parametrize("name", ["door:20", "door:201", "hall:x"])
def test_a_number_outside_its_range_is_an_error(name: str) -> None:
    kind = name.partition(":")[0]
    with pytest.raises(SceneError, match=f"{kind}:{KINDS[kind].number} with a whole number, {KINDS[kind].least} "):
        load_scene(name)
