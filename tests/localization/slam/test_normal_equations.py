"""Normal equations of depth points and landmarks, against finite differences of their residuals; places of corners."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from hypothesis import given, settings
from hypothesis import strategies as st
from slam_flight import BODY_FROM_DEPTH, CABINET_M, LENS, RGB_LENS, ROOM_M, frame, truth
from textured_room import ranges_m

from uav_recon.localization.slam.depth_points import add_depth_equations
from uav_recon.localization.slam.keyframe_map import KeyframeMap, Keyframes
from uav_recon.localization.slam.landmarks import (
    SIZE,
    Corners,
    Expected,
    Landmarks,
    MovingImager,
    add_landmark_equations,
    moving_imager,
    project,
)
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.types.camera import Frame
from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.pose import Pose

CAMERA = RGB_LENS.pinhole_px()
STEP = 1e-5
CORNER = np.eye(2)
NO_DOUBT = np.zeros((1, 3, 3))
# of a camera: rotation, eye, the depth imager's place beside it
TURN = Pose.from_rotation_vector(np.array([0.4, -0.7, 0.2]), np.array([0.3, -0.2, 0.5]))
EYE_M = TURN.translation_m + np.array([0.01, -0.02, 0.015])
MOTION = np.array([0.3, -0.5, 0.4, 0.2, 0.6, -0.3])  # turn rate and velocity


def _in_view(count: int, seed: int = 0) -> FloatArray:
    """Places (N, 3) in front of the camera."""
    random = np.random.default_rng(seed)
    depth = random.uniform(0.8, 3.0, count)
    across = random.uniform(-0.4, 0.4, (count, 2)) * depth[:, None]
    return np.asarray(np.column_stack((across, depth)) @ TURN.rotation().T + EYE_M)


def _pixels(places: FloatArray, moved: FloatArray, slow: FloatArray) -> FloatArray:
    """Pixels (N, 2) after a change (6,) of the camera: rotation about the depth imager, and translation."""
    turn = Pose.from_rotation_vector(moved[:3], np.zeros(3)).rotation()
    eye_m = TURN.translation_m + moved[3:] + turn @ (EYE_M - TURN.translation_m)
    return _projected(places, _imager(turn @ TURN.rotation(), eye_m, TURN.translation_m + moved[3:], slow))


def _imager(rotation: FloatArray, eye_m: FloatArray, turn_m: FloatArray, slow: FloatArray) -> MovingImager:
    return MovingImager(camera=CAMERA, rotation=rotation, eye_m=eye_m, turn_m=turn_m, motion=MOTION, slow=slow)


def _projected(places: FloatArray, imager: MovingImager) -> FloatArray:
    out: FloatArray = project(places, imager)
    return out


def _equations(
    places: FloatArray, at_px: FloatArray, slope: FloatArray, texture: FloatArray, slow: FloatArray, change: FloatArray
) -> tuple[FloatArray, FloatArray, int]:
    information, gradient = np.zeros((2, SIZE, SIZE)), np.zeros((2, SIZE))
    fitting = np.zeros(2, np.int64)
    number = np.arange(len(places))
    landmarks = Landmarks(places, slope, at_px.astype(np.float32), texture, number % 2, number)
    imager = _imager(TURN.rotation(), EYE_M, TURN.translation_m, slow)
    add_landmark_equations(landmarks, imager, change, 1.0, 1.0, information, gradient, np.zeros((2, 3, 3)), fitting)
    assert len(places) < 2 or information[1].any() == information[0].any(), "each keyframe has its own equations"
    return information.sum(axis=0), gradient.sum(axis=0), int(fitting.sum())


def test_projection_is_that_of_opencv_and_nan_behind_the_camera() -> None:

    places = _in_view(20)
    rotation = TURN.rotation().T
    vector, _ = cv2.Rodrigues(rotation)
    matrix = np.array([[CAMERA[0], 0.0, CAMERA[2]], [0.0, CAMERA[1], CAMERA[3]], [0.0, 0.0, 1.0]])
    expected, _ = cv2.projectPoints(places, vector, -rotation @ EYE_M, matrix, None)
    np.testing.assert_allclose(_pixels(places, np.zeros(6), np.zeros(2)), expected[:, 0], atol=1e-6)
    behind = EYE_M - TURN.rotation()[:, 2]
    assert np.isnan(_pixels(behind[None], np.zeros(6), np.zeros(2))).all()


def test_the_delay_moves_the_camera_and_the_width_the_image() -> None:
    """The camera of a colour image that is late by 10 ms has turned and moved on for this time."""
    places, late_s = _in_view(20), 0.01
    shown = _pixels(places, np.zeros(6), np.array([late_s, 0.0]))
    np.testing.assert_allclose(shown, _pixels(places, late_s * MOTION, np.zeros(2)), atol=0.03)
    wide = _pixels(places, np.zeros(6), np.array([0.0, 0.01]))
    middle = CAMERA[2:]
    np.testing.assert_allclose(wide - middle, 1.01 * (_pixels(places, np.zeros(6), np.zeros(2)) - middle), atol=1e-9)


def test_information_and_gradient_of_landmarks_are_those_of_the_residuals() -> None:
    """Numeric derivatives of the pixels by rotation, translation, delay and width give J; the rest follows."""
    places, slow = _in_view(40, seed=3), np.zeros(2)
    at_px = _pixels(places, np.zeros(6), slow) + 0.02 * np.random.default_rng(1).standard_normal((40, 2))
    columns = np.zeros((40, 2, SIZE))
    for a in range(SIZE):
        step = np.zeros(SIZE)
        step[a] = STEP
        ahead, back = _pixels(places, step[:6], slow + step[6:]), _pixels(places, -step[:6], slow - step[6:])
        columns[:, :, a] = (ahead - back) / (2 * STEP)
    slope = np.random.default_rng(2).standard_normal((40, 3, 2)) * 0.3
    for a in range(2):  # the place of a landmark depends on delay and width as well
        moved = (_pixels(places + STEP * slope[:, :, a], np.zeros(6), slow) - _pixels(places, np.zeros(6), slow)) / STEP
        columns[:, :, 6 + a] += moved
    information, gradient, fitting = _equations(places, at_px, slope, np.tile(CORNER, (40, 1, 1)), slow, np.zeros(2))
    off = at_px.astype(np.float32) - _pixels(places, np.zeros(6), slow)
    np.testing.assert_allclose(information, np.einsum("nka,nkb->ab", columns, columns), rtol=2e-3, atol=30.0)
    np.testing.assert_allclose(gradient, np.einsum("nka,nk->a", columns, off), rtol=2e-2, atol=1.0)
    assert fitting == 40


def test_a_changed_delay_moves_the_places_that_were_measured_with_it() -> None:
    places, slope = _in_view(10), np.zeros((10, 3, 2))
    slope[:, :, 0] = [0.5, -0.2, 0.1]
    change = np.array([0.004, 0.0])
    expected = _pixels(places + slope[:, :, 0] * change[0], np.zeros(6), np.zeros(2))
    _, gradient, fitting = _equations(places, expected, slope, np.tile(CORNER, (10, 1, 1)), np.zeros(2), change)
    _, unmoved, _ = _equations(places, expected, slope, np.tile(CORNER, (10, 1, 1)), np.zeros(2), np.zeros(2))
    assert fitting == 10
    assert np.linalg.norm(gradient) < 0.05 * np.linalg.norm(unmoved)


@given(angle=st.floats(0.0, math.pi))
@settings(max_examples=20, deadline=None)
def test_an_edge_gives_no_information_along_itself(angle: float) -> None:
    across = np.array([math.cos(angle), math.sin(angle)])
    along = np.array([-across[1], across[0]])
    place = _in_view(1)
    edge = np.outer(across, across)[None]
    at_px = _pixels(place, np.zeros(6), np.zeros(2))
    slope = np.zeros((1, 3, 2))
    information, _, _ = _equations(place, at_px, slope, edge, np.zeros(2), np.zeros(2))
    assert np.linalg.matrix_rank(information, tol=1e-6 * information.max()) == 1
    _, gradient, fitting = _equations(place, at_px + 10.0 * along, slope, edge, np.zeros(2), np.zeros(2))
    np.testing.assert_allclose(gradient, 0.0, atol=0.2)
    assert fitting == 1
    _, pulled, fitting = _equations(place, at_px + 10.0 * across, slope, edge, np.zeros(2), np.zeros(2))
    assert np.linalg.norm(pulled) > 1.0
    assert fitting == 0


def test_a_far_residual_counts_little_and_a_place_behind_the_camera_nothing() -> None:
    place, slope = _in_view(1), np.zeros((1, 3, 2))
    at_px = _pixels(place, np.zeros(6), np.zeros(2))
    near, _, _ = _equations(place, at_px + 0.1, slope, CORNER[None], np.zeros(2), np.zeros(2))
    far, _, _ = _equations(place, at_px + 20.0, slope, CORNER[None], np.zeros(2), np.zeros(2))
    assert np.trace(far) < 1e-3 * np.trace(near)
    behind = EYE_M[None] - TURN.rotation()[None, :, 2]
    information, gradient, fitting = _equations(behind, at_px, slope, CORNER[None], np.zeros(2), np.zeros(2))
    assert not information.any()
    assert not gradient.any()
    assert fitting == 0


def _corner_of_the_room() -> tuple[Keyframes, FloatArray, Pose]:
    """One keyframe of a view into a corner of the room, the depth points of the view, and its pose."""
    surfaces = KeyframeMap()
    camera = Pose.from_yaw(0.7, np.array([0.5, 0.3, 0.8])) @ BODY_FROM_DEPTH
    depth = ranges_m(camera, LENS, ROOM_M, (CABINET_M,)).astype(np.float32)
    view = PreparedView(Frame(0.0, 0, depth, LENS, np.zeros((2, 2, 3), np.uint8), RGB_LENS, Pose.identity()))
    surfaces.add(view, camera, np.zeros(6), np.zeros(2), np.zeros(3), 0)
    return surfaces.near(view.depth, camera, 0.0, np.inf), view.points, camera


def _residuals(keyframes: Keyframes, there: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the distances (N,) of points in odom to the plane at the pixel that shows each, and which have one."""
    seen = (there - keyframes.place_m[0]) @ keyframes.rotation[0]
    fx, fy, cx, cy = keyframes.camera[0]
    u, v = np.floor(seen[:, 0] / seen[:, 2] * fx + cx + 0.5), np.floor(seen[:, 1] / seen[:, 2] * fy + cy + 0.5)
    height, width = keyframes.depth_m.shape[1:]
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    column, row = np.where(inside, u, 0).astype(int), np.where(inside, v, 0).astype(int)
    z, normal = keyframes.depth_m[0][row, column].astype(float), keyframes.normal[0][row, column].astype(float)
    surface = np.column_stack(((column - cx) / fx * z, (row - cy) / fy * z, z))
    off = np.einsum("na,na->n", normal, seen - surface)
    return off, inside & (normal[:, 2] != 0.0) & (np.abs(off) <= 0.2)


def _depth_equations(
    keyframes: Keyframes, points: FloatArray, camera: Pose, wider: float, doubt: FloatArray = NO_DOUBT
) -> tuple[FloatArray, FloatArray, int, int]:
    information, gradient = np.zeros((1, SIZE, SIZE)), np.zeros((1, SIZE))
    known, inliers = add_depth_equations(
        points, camera.rotation(), camera.translation_m, keyframes, doubt, 1.0, wider, information, gradient
    )
    return information[0], gradient[0], known, inliers


def test_the_gradient_of_depth_is_that_of_its_squared_residuals() -> None:
    """Off by a little, weights hardly change: the gradient is the numeric one of half the weighted sum of squares."""
    keyframes, points, exact = _corner_of_the_room()
    camera = Pose(exact.quat_wxyz, exact.translation_m + np.array([0.01, -0.006, 0.004]))

    def cost(moved: FloatArray) -> tuple[FloatArray, BoolArray]:
        turn = Pose.from_rotation_vector(moved[:3], np.zeros(3)).rotation()
        return _residuals(keyframes, points @ (turn @ camera.rotation()).T + camera.translation_m + moved[3:])

    information, gradient, known, inliers = _depth_equations(keyframes, points, camera, 1e6)
    off, valid = cost(np.zeros(6))
    assert known >= valid.sum() > 800
    assert inliers > 0.95 * known
    columns = np.zeros((len(points), 6))
    for a in range(6):
        step = np.zeros(6)
        step[a] = 1e-5
        ahead, back = cost(step), cost(-step)
        columns[:, a] = np.where(valid & ahead[1] & back[1], (ahead[0] - back[0]) / 2e-5, 0.0)
    smooth = np.abs(columns).max(axis=1) < 5.0  # a step over the edge of a pixel changes the normal
    weight = np.where(valid & smooth, (0.008 + 0.003 * points[:, 2] ** 2) ** -2, 0.0)
    expected = (columns * weight[:, None]).T @ columns
    np.testing.assert_allclose(information[:6, :6], expected, atol=0.03 * np.diagonal(expected).max())
    slip = -columns.T @ (weight * off)
    np.testing.assert_allclose(gradient[:6], slip, atol=float(0.05 * np.linalg.norm(slip)))
    assert not information[6:].any()


def test_depth_pulls_back_what_was_moved() -> None:
    keyframes, points, camera = _corner_of_the_room()
    for moved in (np.array([0.03, 0.0, 0.0]), np.array([0.0, -0.03, 0.0]), np.array([0.0, 0.0, 0.03])):
        there = Pose(camera.quat_wxyz, camera.translation_m + moved)
        information, gradient, _, _ = _depth_equations(keyframes, points, there, 1.0)
        step = np.linalg.solve(information[:6, :6], gradient[:6])
        np.testing.assert_allclose(step[3:], -moved, atol=0.012)


def test_a_surface_that_faces_a_doubted_direction_does_not_count() -> None:
    keyframes, points, camera = _corner_of_the_room()
    whole, _, known, _ = _depth_equations(keyframes, points, camera, 1.0)
    for axis in range(2):
        doubt = np.zeros((1, 3, 3))
        doubt[0, axis, axis] = 100.0
        found, _, *counts = _depth_equations(keyframes, points, camera, 1.0, doubt)
        assert 0 < max(counts) < known
        assert found[3 + axis, 3 + axis] < 0.01 * whole[3 + axis, 3 + axis]
        np.testing.assert_allclose(found[5, 5], whole[5, 5], rtol=0.2)


RGB_FROM_DEPTH = Pose.from_rotation_vector(np.array([0.01, -0.02, 0.015]), np.array([0.03, 0.005, -0.03]))


def _places(
    view: PreparedView, odom_from_depth: Pose, at_px: npt.NDArray[Any], motion: FloatArray, slow: FloatArray
) -> FloatArray:
    """Return the places (N, 3) in odom that a view gives to pixels (N, 2) as corners."""
    corners = Corners.of(view, odom_from_depth, motion, slow)
    count = len(at_px)
    chosen = replace(corners, at_px=at_px.astype(np.float32), place_m=np.full((count, 3), np.nan))
    chosen.place(view.depth)
    return np.asarray(odom_from_depth.apply(chosen.place_m))


@given(yaw=st.floats(-3.1, 3.1), x=st.floats(-0.8, 0.8), y=st.floats(-0.7, 0.7), z=st.floats(0.3, 1.6), seed=st.integers(0, 99))
@settings(max_examples=15, deadline=None)
def test_corners_lie_where_exact_rays_meet_the_room(yaw: float, x: float, y: float, z: float, seed: int) -> None:
    odom_from_depth = Pose.from_yaw(yaw, np.array([x, y, z])) @ BODY_FROM_DEPTH
    depth = ranges_m(odom_from_depth, LENS, ROOM_M, ()).astype(np.float32)
    view = PreparedView(Frame(0.0, 0, depth, LENS, np.zeros((120, 212, 3), np.uint8), RGB_LENS, RGB_FROM_DEPTH))
    odom_from_rgb = odom_from_depth @ RGB_FROM_DEPTH.inverse()
    exact = ranges_m(odom_from_rgb, RGB_LENS, ROOM_M, ())
    at_px = np.random.default_rng(seed).integers([10, 10], [202, 110], (40, 2))
    far = exact[at_px[:, 1], at_px[:, 0]]
    expected = odom_from_rgb.apply(RGB_LENS.bearings()[at_px[:, 1], at_px[:, 0]] * far[:, None])
    places = _places(view, odom_from_depth, at_px, np.zeros(6), np.zeros(2))
    known = np.isfinite(places[:, 0])
    assert known.sum() >= 4  # not on a floor at a grazing angle
    # half a pixel of the depth image on a wall at a grazing angle
    assert np.median(np.linalg.norm(places[known] - expected[known], axis=1)) < 0.008
    assert np.linalg.norm(places[known] - expected[known], axis=1).max() < 0.08


def test_a_late_colour_image_places_its_corners_from_where_the_camera_was() -> None:
    late_s, motion = 0.02, np.array([0.0, 0.0, 0.8, 0.5, 0.0, 0.0])
    here = Pose.from_yaw(0.0, np.array([-0.5, 0.0, 0.8])) @ BODY_FROM_DEPTH
    later = Pose.from_yaw(late_s * 0.8, np.zeros(3)) @ here
    there = Pose(later.quat_wxyz, here.translation_m + late_s * motion[3:])
    depth = ranges_m(here, LENS, ROOM_M, ()).astype(np.float32)
    view = PreparedView(Frame(0.0, 0, depth, LENS, np.zeros((120, 212, 3), np.uint8), RGB_LENS, RGB_FROM_DEPTH))
    odom_from_rgb, at_px = there @ RGB_FROM_DEPTH.inverse(), np.array([[60, 60], [106, 59], [150, 50]])
    exact = ranges_m(odom_from_rgb, RGB_LENS, ROOM_M, ())[at_px[:, 1], at_px[:, 0]]
    expected = odom_from_rgb.apply(RGB_LENS.bearings()[at_px[:, 1], at_px[:, 0]] * exact[:, None])
    found = _places(view, here, at_px, motion, np.array([late_s, 0.0]))
    np.testing.assert_allclose(found, expected, atol=0.01)
    assert np.abs(_places(view, here, at_px, motion, np.zeros(2)) - expected).max() > 0.02


def test_there_is_no_place_at_an_edge_of_depth_or_without_depth() -> None:
    depth = np.full((LENS.height, LENS.width), 3.0, np.float32)
    depth[:, 106:] = 1.5
    depth[:30] = np.nan
    view = PreparedView(Frame(0.0, 0, depth, LENS, np.zeros((120, 212, 3), np.uint8), LENS, Pose.identity()))
    at_px = np.array(
        [[u, 60.0] for u in range(96, 116)] + [[50.0, 20.0], [50.0, 31.0], [-5.0, 60.0], [400.0, 60.0]], np.float32
    )
    places = _places(view, Pose.identity(), at_px, np.zeros(6), np.zeros(2))
    known = np.isfinite(places[:, 0])
    np.testing.assert_array_equal(known[:20], [not 104 <= u <= 107 for u in range(96, 116)])
    assert not known[20:].any()
    np.testing.assert_allclose(places[0, 2], 3.0)
    np.testing.assert_allclose(places[19, 2], 1.5)


def _seen(corners: Corners, here: Pose, view: PreparedView, predicted: Pose) -> Landmarks:
    """Return the landmarks that a view shows, looked for from a predicted pose."""
    expected = _expected(corners, here, view, moving_imager(view, predicted, np.zeros(6), np.zeros(2)), np.zeros(2))
    return corners.follow(view, 0, here.rotation(), expected)


def _expected(corners: Corners, here: Pose, view: PreparedView, imager: MovingImager, slow: FloatArray) -> Expected:
    return corners.expected(here.rotation(), here.translation_m, view, imager, slow)


def test_corners_are_followed_to_where_the_room_shows_them() -> None:
    """Corners of one image, seen again 0.3 s later: the pixels are those of their places."""
    poses = [truth(n / 15) @ BODY_FROM_DEPTH for n in (60, 64)]
    corners, second = Corners.of(PreparedView(frame(60)), poses[0], np.zeros(6), np.zeros(2)), PreparedView(frame(64))
    known = int(np.isfinite(corners.place_m[:, 0]).sum())
    assert known > 25
    off = Pose(poses[1].quat_wxyz, poses[1].translation_m + np.array([0.0, 0.02, 0.0]))  # two pixels
    found = _seen(corners, poses[0], second, off)
    assert len(found.place_m) > 0.5 * known
    shown = _projected(found.place_m, moving_imager(second, poses[1], np.zeros(6), np.zeros(2)))
    off_px = np.linalg.norm(found.at_px - shown, axis=1)
    assert np.median(off_px) < 0.5
    assert np.quantile(off_px, 0.9) < 2.0


def test_corners_that_the_image_no_longer_shows_are_not_found() -> None:
    """The right half of the image shows something else."""
    pose = truth(6.0) @ BODY_FROM_DEPTH
    corners = Corners.of(PreparedView(frame(90)), pose, np.zeros(6), np.zeros(2))
    same = _seen(corners, pose, PreparedView(frame(90)), pose)
    rgb = frame(90).rgb.copy()
    rgb[:, 106:] = np.kron(np.random.default_rng(0).integers(0, 255, (24, 22, 1)), np.ones((5, 5, 3)))[:120, :106]
    found = _seen(corners, pose, PreparedView(replace(frame(90), rgb=rgb)), pose)
    left, right = same.at_px[:, 0] < 90.0, same.at_px[:, 0] > 120.0
    assert right.sum() > 10
    assert (found.at_px[:, 0] < 90.0).sum() > 0.9 * left.sum()
    assert (found.at_px[:, 0] > 120.0).sum() < 0.2 * right.sum()


def test_a_dark_image_loses_no_corner_for_the_next_one() -> None:
    pose, view = truth(4.0) @ BODY_FROM_DEPTH, PreparedView(frame(60))
    corners = Corners.of(view, pose, np.zeros(6), np.zeros(2))
    before = _seen(corners, pose, view, pose)
    dark = PreparedView(replace(frame(61), rgb=np.zeros_like(frame(61).rgb)))
    assert not len(_seen(corners, pose, dark, pose).place_m)
    assert len(_seen(corners, pose, view, pose).place_m) == len(before.place_m) > 25


def test_a_corner_is_not_looked_for_from_another_side_or_distance() -> None:
    pose, view = truth(4.0) @ BODY_FROM_DEPTH, PreparedView(frame(60))
    corners = Corners.of(view, pose, np.zeros(6), np.zeros(2))
    middle = np.nanmean(pose.apply(corners.place_m), axis=0)
    half = Pose(pose.quat_wxyz, 0.4 * pose.translation_m + 0.6 * middle)
    assert len(_seen(corners, pose, view, pose).place_m) > 25
    assert len(_seen(corners, pose, view, half).place_m) < 8


def test_a_remembered_difference_is_where_the_search_begins() -> None:
    pose, view = truth(4.0) @ BODY_FROM_DEPTH, PreparedView(frame(60))
    corners = Corners.of(view, pose, np.zeros(6), np.zeros(2))
    imager, which = moving_imager(view, pose, np.zeros(6), np.zeros(2)), np.arange(3)
    plain = _expected(corners, pose, view, imager, np.zeros(2))
    corners.remember(plain.which[:3], np.full((3, 2), 1.5, np.float32), view.frame.stamp_s - 0.1)
    moved = _expected(corners, pose, view, imager, np.zeros(2))
    np.testing.assert_allclose(moved.at_px[which] - plain.at_px[which], 1.5, atol=1e-4)
    later = PreparedView(replace(view.frame, stamp_s=view.frame.stamp_s + 1.0))
    np.testing.assert_allclose(_expected(corners, pose, later, imager, np.zeros(2)).at_px, plain.at_px, atol=1e-4)


def test_the_expected_corners_are_those_of_plain_numpy() -> None:
    pose, view = truth(4.0) @ BODY_FROM_DEPTH, PreparedView(frame(60))
    corners = Corners.of(view, pose, MOTION, np.array([0.01, 0.002]))
    corners.remember(np.arange(0, 40, 3), np.full((14, 2), 4.0, np.float32), view.frame.stamp_s)
    turn = Pose.from_rotation_vector(np.array([0.1, -0.5, 0.05]), np.array([0.25, 0.1, -0.1]))
    imager, slow = moving_imager(view, pose @ turn, MOTION, np.array([0.02, 0.001])), np.array([0.02, 0.001])
    found = _expected(corners, pose, view, imager, slow)

    place_m = pose.apply(corners.place_m + corners.slope @ (slow - corners.slow))
    at_px = _projected(place_m, imager) + np.where((corners.off_s == view.frame.stamp_s)[:, None], corners.off_px, 0.0)
    there, here = place_m - imager.eye_m, place_m - pose.translation_m
    nearer = np.linalg.norm(there, axis=1) / np.linalg.norm(here, axis=1)
    alike = (nearer > 0.7) & (nearer < 1 / 0.7)
    alike &= np.einsum("na,na->n", there, here) > 0.9 * np.linalg.norm(there, axis=1) * np.linalg.norm(here, axis=1)
    within = (at_px >= 5.0).all(axis=1) & (at_px <= np.array([212 - 6, 120 - 6])).all(axis=1)
    expected = np.flatnonzero(alike & within)
    assert 10 < len(expected) < np.isfinite(corners.place_m[:, 0]).sum()
    np.testing.assert_array_equal(found.which, expected)
    np.testing.assert_allclose(found.place_m, place_m[expected])
    np.testing.assert_allclose(found.at_px, at_px[expected], rtol=1e-5)
