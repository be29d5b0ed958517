"""Normal equations of depth points and landmarks, against finite differences of their residuals; places of corners."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from slam_flight import BODY_FROM_DEPTH, CABINET_M, LENS, RGB_LENS, ROOM_M, frame, truth
from textured_room import ranges_m

from uav_recon.localization.slam.depth_points import add_depth_equations, depth_points
from uav_recon.localization.slam.landmarks import (
    SIZE,
    LandmarkTracker,
    MovingImager,
    add_landmark_equations,
    moving_imager,
    project,
)
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.localization.slam.tsdf_volume import TsdfBlocks, TsdfVolume, sample
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.pose import Pose

CAMERA = RGB_LENS.pinhole_px()
STEP = 1e-5
CORNER = np.eye(2)
EXACT = np.zeros(3), np.inf  # nothing known better, and no surface is unknown
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
    information, gradient = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    fitting = add_landmark_equations(
        places, slope, texture, at_px.astype(np.float32), _imager(TURN.rotation(), EYE_M, TURN.translation_m, slow), change,
        1.0, information, gradient, np.zeros((3, 3)),
    )  # fmt: skip
    return information, gradient, fitting


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


def _corner_volume() -> tuple[TsdfVolume, FloatArray, Pose]:
    """The field of one view into a corner of the room, the depth points of another, and its pose."""
    volume = TsdfVolume()
    camera = Pose.from_yaw(0.7, np.array([0.5, 0.3, 0.8])) @ BODY_FROM_DEPTH
    depth = ranges_m(camera, LENS, ROOM_M, (CABINET_M,)).astype(np.float32)
    image = Frame(0.0, 0, depth, LENS, np.zeros((2, 2, 3), np.uint8), RGB_LENS, Pose.identity())
    volume.integrate(image, camera, np.zeros(3))
    points: FloatArray = depth_points(depth, LENS.pinhole_px())
    return volume, points, camera


def _exact(volume: TsdfVolume) -> TsdfBlocks:
    """The surfaces of a volume, without errors of place."""
    return volume.blocks._replace(variance=np.zeros((1024, 3)))


def test_depth_points_lie_on_the_rays_of_their_pixels() -> None:
    depth = ranges_m(Pose.identity(), LENS, ROOM_M, ()).astype(np.float32)
    depth[:, :40] = np.nan
    depth[:20] = 0.0
    depth[20:40] = 9.0
    points = depth_points(depth, LENS.pinhole_px())
    assert 0 < len(points) < 30 * 48
    u, v = (points[:, :2] / points[:, 2:] * LENS.pinhole_px()[:2] + LENS.pinhole_px()[2:]).T
    np.testing.assert_allclose(u, np.rint(u), atol=1e-9)
    np.testing.assert_allclose(depth[np.rint(v).astype(int), np.rint(u).astype(int)], points[:, 2], rtol=1e-6)
    assert u.min() >= 40.0
    assert v.min() >= 40.0
    small = depth_points(np.ones((4, 5), np.float32), Intrinsics.from_fov(5, 4, 1.0, 0.8).pinhole_px())
    assert len(small) == 20


def test_the_gradient_of_depth_is_that_of_its_squared_residuals() -> None:
    """Off by a little, weights hardly change: the gradient is the numeric one of half the weighted sum of squares."""
    volume, points, camera = _corner_volume()

    def cost(moved: FloatArray) -> tuple[FloatArray, BoolArray]:
        turn = Pose.from_rotation_vector(moved[:3], np.zeros(3)).rotation()
        there = points @ (turn @ camera.rotation()).T + camera.translation_m + moved[3:]
        out, off, known = np.empty(5), np.zeros(len(points)), np.zeros(len(points), bool)
        for n, point in enumerate(there):
            if sample(point, volume.index, volume.distance, volume.weight, out):
                slope = np.linalg.norm(out[1:4])
                known[n], off[n] = 0.35 < slope < 1.5, out[0] / slope
        return off, known

    information, gradient = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    known, inliers = add_depth_equations(
        points, camera.rotation(), camera.translation_m, _exact(volume), *EXACT, 1.0, 1e6, information, gradient,
        np.zeros((2, 3)),
    )  # fmt: skip
    sigma = 0.012 + 0.004 * points[:, 2] ** 2
    off, valid = cost(np.zeros(6))
    assert known >= valid.sum() > 800
    assert inliers > 0.95 * known
    columns = np.zeros((len(points), 6))
    for a in range(6):
        step = np.zeros(6)
        step[a] = 1e-4
        ahead, back = cost(step), cost(-step)
        columns[:, a] = np.where(valid & ahead[1] & back[1], (ahead[0] - back[0]) / 2e-4, 0.0)
    smooth = np.abs(columns).max(axis=1) < 5.0  # a step over the edge of a voxel changes the normal
    weight = np.where(valid & smooth, sigma**-2, 0.0)
    expected = (columns * weight[:, None]).T @ columns
    np.testing.assert_allclose(np.diagonal(information)[:6], np.diagonal(expected), rtol=0.05)
    np.testing.assert_allclose(information[:6, :6], expected, atol=0.05 * np.diagonal(expected).max())
    slip = -columns.T @ (weight * off)
    np.testing.assert_allclose(gradient[:6], slip, atol=float(0.1 * np.linalg.norm(slip) + 100.0))
    assert not information[6:].any()


def test_depth_pulls_back_what_was_moved() -> None:
    volume, points, camera = _corner_volume()
    for moved in (np.array([0.03, 0.0, 0.0]), np.array([0.0, -0.03, 0.0]), np.array([0.0, 0.0, 0.03])):
        information, gradient = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
        add_depth_equations(
            points, camera.rotation(), camera.translation_m + moved, _exact(volume), *EXACT, 1.0, 1.0, information, gradient,
            np.zeros((2, 3)),
        )  # fmt: skip
        step = np.linalg.solve(information[:6, :6], gradient[:6])
        np.testing.assert_allclose(step[3:], -moved, atol=0.012)


RGB_FROM_DEPTH = Pose.from_rotation_vector(np.array([0.01, -0.02, 0.015]), np.array([0.03, 0.005, -0.03]))


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
    places = view.places(at_px.astype(np.float32), odom_from_depth, np.zeros(6), np.zeros(2))
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
    found = view.places(at_px.astype(np.float32), here, motion, np.array([late_s, 0.0]))
    np.testing.assert_allclose(found, expected, atol=0.01)
    assert np.abs(view.places(at_px.astype(np.float32), here, motion, np.zeros(2)) - expected).max() > 0.02


def test_there_is_no_place_at_an_edge_of_depth_or_without_depth() -> None:
    depth = np.full((LENS.height, LENS.width), 3.0, np.float32)
    depth[:, 106:] = 1.5
    depth[:30] = np.nan
    view = PreparedView(Frame(0.0, 0, depth, LENS, np.zeros((120, 212, 3), np.uint8), LENS, Pose.identity()))
    at_px = np.array(
        [[u, 60.0] for u in range(96, 116)] + [[50.0, 20.0], [50.0, 31.0], [-5.0, 60.0], [400.0, 60.0]], np.float32
    )
    places = view.places(at_px, Pose.identity(), np.zeros(6), np.zeros(2))
    known = np.isfinite(places[:, 0])
    np.testing.assert_array_equal(known[:20], [not 104 <= u <= 107 for u in range(96, 116)])
    assert not known[20:].any()
    np.testing.assert_allclose(places[0, 2], 3.0)
    np.testing.assert_allclose(places[19, 2], 1.5)


def test_corners_are_followed_to_where_the_room_shows_them() -> None:
    """Landmarks of the first image, seen again from the next pose: the pixels are those of their places."""
    tracker, motion, slow = LandmarkTracker(), np.zeros(6), np.zeros(2)

    poses = [truth(n / 15) @ BODY_FROM_DEPTH for n in (60, 61)]
    first, second = PreparedView(frame(60)), PreparedView(frame(61))
    assert len(tracker.follow(first, np.empty((0, 2))).place_m) == 0
    tracker.settle(first, poses[0], motion, slow, np.zeros(3))
    points = tracker.points
    assert len(points.place_m) > 25
    imager = moving_imager(second, poses[1], motion, slow)
    expected = _projected(points.place_m, imager)
    # the prediction is off by two pixels; the images are not
    found = tracker.follow(second, expected + 2.0)
    assert len(found.place_m) > 0.6 * len(points.place_m)
    shown = _projected(found.place_m, imager)
    off = np.linalg.norm(found.at_px - shown, axis=1)
    assert np.median(off) < 0.5
    assert np.quantile(off, 0.9) < 1.5


def test_corners_that_the_image_no_longer_shows_are_dropped() -> None:
    """The right half of the next image shows something else."""
    tracker, first = LandmarkTracker(), PreparedView(frame(90))
    tracker.follow(first, np.empty((0, 2)))
    tracker.settle(first, truth(6.0) @ BODY_FROM_DEPTH, np.zeros(6), np.zeros(2), np.zeros(3))
    before = tracker.points.at_px
    rgb = frame(90).rgb.copy()
    rgb[:, 106:] = np.kron(np.random.default_rng(0).integers(0, 255, (24, 22, 1)), np.ones((5, 5, 3)))[:120, :106]
    found = tracker.follow(PreparedView(replace(frame(90), rgb=rgb)), before.astype(np.float64))
    left, right = before[:, 0] < 90.0, before[:, 0] > 120.0
    assert right.sum() > 10
    assert (found.at_px[:, 0] < 90.0).sum() > 0.9 * left.sum()
    assert (found.at_px[:, 0] > 120.0).sum() < 0.2 * right.sum()


def test_recalled_landmarks_are_those_of_the_newest_settled_image() -> None:
    tracker, view = LandmarkTracker(), PreparedView(frame(60))

    tracker.settle(view, truth(4.0) @ BODY_FROM_DEPTH, np.zeros(6), np.zeros(2), np.zeros(3))
    tracker.follow(view, np.empty((0, 2)))
    tracker.settle(view, truth(4.0) @ BODY_FROM_DEPTH, np.zeros(6), np.zeros(2), np.zeros(3))
    before = tracker.points
    dark = PreparedView(Frame(4.1, 61, frame(61).depth_m, LENS, np.zeros((120, 212, 3), np.uint8), RGB_LENS, Pose.identity()))
    assert len(tracker.follow(dark, before.at_px.astype(np.float64)).place_m) == 0
    tracker.recall()
    assert tracker.points is before
    again = tracker.follow(view, before.at_px.astype(np.float64))
    assert len(again.place_m) == len(before.place_m)
