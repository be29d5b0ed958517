"""Rasteriser against values computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from uav_recon.recording.software_renderer import _rasterise, corner_view, facing_inwards, render, top_view
from uav_recon.types.frames import FloatArray, IntArray

FLOOR = np.array([[0.0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]])
UP = np.array([[0, 1, 2], [0, 2, 3]])


def test_top_view_is_to_scale() -> None:
    view = top_view(np.zeros(3), np.array([4.0, 2.0, 2.5]), 1200, 800)
    corners = view.project(np.array([[0.0, 0, 0], [4, 0, 0], [0, 2, 0]]))
    assert corners[1, 0] - corners[0, 0] == pytest.approx(4 * view.scale_px)
    assert corners[0, 1] - corners[2, 1] == pytest.approx(2 * view.scale_px)  # y points up in the image
    assert corners[0, 2] == pytest.approx(3.5)


@pytest.mark.parametrize("azimuth_rad", [-1.0, 0.4, 2.5])
@pytest.mark.parametrize("size", [(8.0, 2.5, 3.0), (5.0, 6.0, 2.4), (0.5, 0.5, 5.0)])
def test_the_whole_box_is_in_the_corner_view(azimuth_rad: float, size: tuple[float, float, float]) -> None:
    view = corner_view(np.zeros(3), np.array(size), 1200, 800, azimuth_rad)
    corners = view.project(np.array([[x, y, z] for x in (0, size[0]) for y in (0, size[1]) for z in (0, size[2])]))
    assert corners[:, 0].min() > 0 and corners[:, 0].max() < 1200
    assert corners[:, 1].min() > 0 and corners[:, 1].max() < 800
    assert corners[:, 2].min() > 0.5
    assert view.camera_from_world @ view.camera_from_world.T == pytest.approx(np.eye(3))
    assert np.linalg.det(view.camera_from_world) == pytest.approx(1.0)


def test_only_the_front_is_drawn() -> None:
    view = top_view(np.zeros(3), np.array([2.0, 1.0, 1.0]), 120, 80)
    grey = np.full((4, 3), 120, dtype=np.uint8)
    assert (render(FLOOR, UP, grey, view)[40, 60] < 200).all()
    assert (render(FLOOR, UP[:, ::-1], grey, view) == 255).all()


def test_the_nearer_surface_hides_the_farther_one() -> None:
    view = top_view(np.zeros(3), np.array([2.0, 1.0, 1.0]), 120, 80)
    vertices = np.concatenate([FLOOR, FLOOR * [0.5, 1, 1] + [0, 0, 0.5]])
    rgb = np.array([[200, 0, 0]] * 4 + [[0, 0, 200]] * 4, dtype=np.uint8)
    image = render(vertices, np.concatenate([UP + 4, UP]), rgb, view)
    assert image[40, 30].argmax() == 2 and image[40, 90].argmax() == 0


def test_depth_is_perspective_correct() -> None:
    """On a slanted plane, the depth of a pixel is where its ray meets the plane.

    It is not interpolated linearly over the screen.
    """
    corners: FloatArray = np.array([[-1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.0, 5.0], [-1.0, 1.0, 5.0]])  # y = 1, RDF
    focal, centre = 50.0, 60.0
    screen = np.column_stack([corners[:, :2] / corners[:, 2:] * focal + centre, corners[:, 2]])
    faces: IntArray = np.array([[0, 1, 2], [0, 2, 3]])
    _, depth = _rasterise(screen, faces, np.ones((4, 3)), 120, 120, False)
    _, turned = _rasterise(screen, np.ascontiguousarray(faces[:, ::-1]), np.ones((4, 3)), 120, 120, False)
    depth = np.minimum(depth, turned)
    for row in (75, 85, 100):
        assert depth[row, 60] == pytest.approx(focal / (row + 0.5 - centre))


def test_a_room_turned_inside_out_is_turned_back() -> None:
    box = trimesh.creation.box((2.0, 2.0, 2.0))  # faces point outwards
    turned = facing_inwards(box.vertices, box.faces, np.zeros(3))
    assert np.array_equal(turned, np.asarray(box.faces)[:, ::-1])
    assert np.array_equal(facing_inwards(box.vertices, turned, np.zeros(3)), turned)
