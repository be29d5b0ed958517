"""Registration of a frame: what it recovers, what it leaves to the prediction, and landmarks that are wrong."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slam_flight import BODY_FROM_DEPTH, LENS, RATE_HZ, RGB_LENS, frame, truth

from uav_recon.localization.slam.keyframe_map import KeyframeMap, Keyframes
from uav_recon.localization.slam.landmarks import Landmarks, moving_imager, project
from uav_recon.localization.slam.place_errors import PlaceErrors
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.localization.slam.rgbd_registration import MotionPrior, Registration, register, search, uncertain
from uav_recon.types.camera import Frame
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

NUMBER = 210  # of the frame that is registered: it shows a corner of the room
HERE = truth(NUMBER / RATE_HZ) @ BODY_FROM_DEPTH
STILL = np.zeros(6)
PLACE_M, TURN_RAD = 0.1, math.radians(4.0)


@functools.cache
def _map() -> tuple[KeyframeMap, PreparedView]:
    """The keyframes of the views before, and the view itself."""
    surfaces = KeyframeMap()
    for number in range(NUMBER - 60, NUMBER, 4):
        _add(surfaces, PreparedView(frame(number)), truth(number / RATE_HZ) @ BODY_FROM_DEPTH)
    return surfaces, PreparedView(frame(NUMBER))


def _add(surfaces: KeyframeMap, view: PreparedView, pose: Pose) -> None:
    surfaces.add(view, pose, STILL, np.zeros(2), np.zeros(3), 999)


def _near(surfaces: KeyframeMap, view: PreparedView, pose: Pose = HERE) -> tuple[Keyframes, Landmarks]:
    return surfaces.near_view(view, pose, STILL, np.zeros(2))


def _prior(pose: Pose, place_m: float = PLACE_M, turn_rad: float = TURN_RAD, keyframes: int = 40) -> MotionPrior:
    """A prior of a place that is uncertain by place_m against keyframes that are all known."""
    places = PlaceErrors.start(np.diag([1e-10] * 3 + [1.0] * 3)).with_lag().with_lag()
    for _ in range(keyframes):
        places = places.with_keyframe(0.0)
    return _later(places, pose, place_m, turn_rad)


def _later(places: PlaceErrors, pose: Pose, place_m: float, turn_rad: float) -> MotionPrior:
    """Return the prior of a place that has become uncertain by place_m since."""
    state = places.state + np.diag([place_m**2] * 3 + [0.0] * 3)
    slow = np.diag([0.005**2, 0.003**2])
    return MotionPrior(
        pose, turn_rad**2 * np.eye(3), places.predicted(state, np.eye(6)), turn_rad, np.zeros(3), np.zeros(3), np.zeros(2), slow
    )


def _off(pose: Pose, moved_m: FloatArray, turned_rad: FloatArray) -> Pose:
    turn = Pose.from_rotation_vector(turned_rad, np.zeros(3))
    return Pose((turn @ pose).quat_wxyz, pose.translation_m + moved_m)


def _error(found: Registration, true: Pose = HERE) -> tuple[float, float]:
    """Return metres and radians."""
    off = true.inverse() @ found.odom_from_depth
    return float(np.linalg.norm(off.translation_m)), 2.0 * float(np.linalg.norm(off.quat_wxyz[1:]))


DIRECTION = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)).filter(
    lambda d: np.linalg.norm(d) > 0.1
)


@settings(max_examples=12, deadline=None)
@given(moved=DIRECTION, turned=DIRECTION, share=st.floats(0.0, 1.0))
def test_a_random_offset_is_recovered(moved: tuple[float, ...], turned: tuple[float, ...], share: float) -> None:
    moved_m = share * PLACE_M * np.array(moved) / np.linalg.norm(moved)
    turned_rad = share * TURN_RAD * np.array(turned) / np.linalg.norm(turned)
    surfaces, view = _map()
    start = _off(HERE, moved_m, turned_rad)
    found = register(view, *_near(surfaces, view, start), _prior(start))
    error_m, error_rad = _error(found)
    assert error_m < 0.01
    assert error_rad < math.radians(0.3)
    assert found.fit > 0.9
    assert math.sqrt(np.linalg.eigvalsh(found.covariance[3:, 3:])[-1]) < 0.01


def test_the_landmarks_are_used_where_they_fit() -> None:
    surfaces, view = _map()
    keyframes, landmarks = _near(surfaces, view)
    found = register(view, keyframes, landmarks, _prior(HERE))
    assert found.landmarks > 0.8 * len(landmarks.place_m) > 15
    without = register(view, keyframes, Landmarks.none(), _prior(HERE))
    assert without.landmarks == 0
    assert np.trace(found.covariance) < np.trace(without.covariance)


def test_wrong_landmarks_are_left_out() -> None:
    surfaces, view = _map()
    start = _off(HERE, np.array([0.03, -0.02, 0.01]), np.zeros(3))
    keyframes, landmarks = _near(surfaces, view, start)
    random = np.random.default_rng(0)
    wrong = landmarks._replace(
        at_px=(landmarks.at_px + 30.0 * random.standard_normal(landmarks.at_px.shape)).astype(np.float32)
    )
    alone, found = (register(view, keyframes, some, _prior(start)) for some in (Landmarks.none(), wrong))
    assert found.landmarks == 0
    np.testing.assert_array_equal(found.odom_from_depth.matrix(), alone.odom_from_depth.matrix())
    assert _error(found)[0] < 0.02


def test_some_wrong_landmarks_do_little() -> None:
    surfaces, view = _map()
    keyframes, landmarks = _near(surfaces, view)
    at_px = landmarks.at_px.copy()
    at_px[::4] += 25.0
    found = register(view, keyframes, landmarks._replace(at_px=at_px), _prior(HERE))
    assert found.landmarks > 0.6 * len(at_px)
    assert _error(found)[0] < 0.01


def _bare_wall() -> tuple[KeyframeMap, PreparedView, Pose]:
    """A wall 1.5 m ahead that fills the image."""
    pose, surfaces = Pose.identity(), KeyframeMap()
    noise = np.random.default_rng(4)
    views = []
    for _ in range(6):
        depth = (1.5 + 0.006 * noise.standard_normal((LENS.height, LENS.width))).astype(np.float32)
        views.append(Frame(0.0, 0, depth, LENS, np.zeros((2, 2, 3), np.uint8), RGB_LENS, Pose.identity()))
        _add(surfaces, PreparedView(views[-1]), pose)
    return surfaces, PreparedView(views[-1]), pose


@pytest.mark.parametrize("along", [0, 1])
def test_along_a_bare_wall_the_prediction_and_its_uncertainty_are_kept(along: int) -> None:
    surfaces, view, pose = _bare_wall()
    moved = np.array([0.0, 0.0, 0.04]) + 0.05 * np.eye(3)[along]
    prior = _prior(_off(pose, moved, np.zeros(3)), place_m=0.05, turn_rad=math.radians(0.2))
    found = register(view, _near(surfaces, view, prior.odom_from_depth)[0], Landmarks.none(), prior)
    assert found.odom_from_depth.translation_m[2] == pytest.approx(0.0, abs=0.01)
    np.testing.assert_allclose(found.odom_from_depth.translation_m[:2], moved[:2], atol=0.004)
    sigma_m = np.sqrt(np.diagonal(found.covariance)[3:])
    np.testing.assert_allclose(sigma_m[:2], 0.05, rtol=0.05)
    assert sigma_m[2] < 0.01


def test_a_frame_without_depth_and_landmarks_keeps_the_prediction() -> None:
    surfaces, view = _map()
    empty = PreparedView(replace(view.frame, depth_m=np.full_like(view.frame.depth_m, np.nan)))
    prior = _prior(_off(HERE, np.array([0.2, 0.0, 0.0]), np.zeros(3)))
    found = register(empty, _near(surfaces, empty)[0], Landmarks.none(), prior)
    np.testing.assert_allclose(found.odom_from_depth.matrix(), prior.odom_from_depth.matrix(), atol=1e-12)
    np.testing.assert_allclose(found.covariance[:3, :3], prior.attitude_covariance, rtol=1e-6)
    np.testing.assert_allclose(found.joint, prior.places.joint(found.keyframes.number), atol=1e-8)
    np.testing.assert_allclose(found.determined_share, np.zeros((3, 3)), atol=1e-6)
    assert (found.points, found.coverage, found.fit) == (0, 0.0, 0.0)


@pytest.mark.parametrize("moved", [(0.4, -0.3, 0.1), (-0.4, 0.4, -0.2), (0.2, 0.45, 0.2)])
def test_a_search_finds_what_registration_does_not_reach(moved: tuple[float, float, float]) -> None:
    surfaces, view = _map()
    start = _off(HERE, np.array(moved), np.zeros(3))
    prior = _prior(start, place_m=0.25, turn_rad=math.radians(0.5))
    lost, found = (
        register(view, _near(surfaces, view, prior.odom_from_depth)[0], Landmarks.none(), prior),
        search(view, surfaces, prior, np.full(3, 0.5))[0],
    )
    assert _error(lost)[0] > 0.1
    assert _error(found)[0] < 0.02
    assert found.fit > 0.9


def test_a_search_along_a_bare_wall_keeps_the_prediction() -> None:
    surfaces, view, pose = _bare_wall()
    moved = np.array([0.05, 0.03, 0.25])
    prior = _prior(_off(pose, moved, np.zeros(3)), place_m=0.15, turn_rad=math.radians(0.2))
    found, _ = search(view, surfaces, prior, np.full(3, 0.3))
    np.testing.assert_allclose(found.odom_from_depth.translation_m, [0.05, 0.03, 0.0], atol=0.02)


def _elsewhere(off_m: FloatArray, sigma_m: float) -> tuple[PreparedView, Keyframes, Landmarks, MotionPrior]:
    """A view, a keyframe from before, and a new one of a track that is off by as much as the view."""
    surfaces, view, here = KeyframeMap(), _map()[1], _off(HERE, off_m, np.zeros(3))
    places = PlaceErrors.start(np.diag([1e-10] * 3 + [1.0] * 3))
    for number, moved_m, variance in ((NUMBER - 12, np.zeros(3), 0.0), (NUMBER - 2, off_m, sigma_m**2)):
        pose = _off(truth(number / RATE_HZ) @ BODY_FROM_DEPTH, moved_m, np.zeros(3))
        surfaces.add(PreparedView(frame(number)), pose, STILL, np.zeros(2), np.full(3, variance), 0)
        places = places.predicted(places.state + np.diag([variance] * 3 + [0.0] * 3), np.eye(6)).with_keyframe(0.0).with_lag()
    assert surfaces.count == 2
    return view, *_near(surfaces, view, here), _later(places.with_lag(), here, 0.005, math.radians(0.2))


@pytest.mark.parametrize("off", [(0.07, 0.0, 0.0), (-0.05, 0.06, 0.02)])
def test_a_track_that_is_less_certain_than_an_old_keyframe_is_shifted_to_it(off: tuple[float, float, float]) -> None:
    """New keyframe and prediction agree with each other."""
    off_m = np.array(off)
    view, keyframes, landmarks, prior = _elsewhere(off_m, 0.06)
    found = register(view, keyframes, landmarks, prior)
    assert _error(found)[0] < 0.02
    np.testing.assert_allclose(found.shift_m, -off_m, atol=0.02)
    assert found.sigma_m < 0.01
    assert found.surprise(prior) < 9.0, "the motion since is as predicted"
    corrected = dict(zip(keyframes.number.tolist(), found.moved_m[6:].reshape(-1, 3), strict=True))
    np.testing.assert_allclose(corrected[0], np.zeros(3), atol=0.001)
    np.testing.assert_allclose(corrected[1], -off_m, atol=0.02)


def test_a_track_that_is_as_certain_as_the_keyframes_is_not_shifted() -> None:
    view, keyframes, landmarks, prior = _elsewhere(np.array([0.05, 0.0, 0.0]), 0.0)
    assert np.linalg.norm(register(view, keyframes, landmarks, prior).shift_m) < 0.001


def test_along_a_bare_wall_the_error_of_the_track_is_kept() -> None:
    surfaces, view, pose = _bare_wall()
    places = PlaceErrors.start(np.diag([1e-10] * 3 + [1.0] * 3)).with_keyframe(0.0)
    places = places.predicted(places.state + np.diag([0.09**2] * 3 + [0.0] * 3), np.eye(6)).with_lag().with_lag()
    prior = _later(places, _off(pose, np.array([0.05, 0.0, 0.0]), np.zeros(3)), 0.01, math.radians(0.2))
    found = register(view, _near(surfaces, view, pose)[0], Landmarks.none(), prior)
    sigma_m = np.sqrt(found.variance)
    np.testing.assert_allclose(sigma_m[:2], 0.09, rtol=0.1)
    assert sigma_m[2] < 0.02
    assert found.sigma_m > 0.085
    assert found.sigma_against_track_m < 0.015


def test_a_doubted_keyframe_counts_only_where_the_way_to_it_is_certain() -> None:
    """The way along x is uncertain: surfaces that face it do not count, the others do."""
    surfaces, view = _map()
    prior = _prior(_off(HERE, np.array([0.02, 0.0, 0.02]), np.zeros(3)), 0.02, math.radians(0.2), surfaces.count)
    state = prior.places.state.copy()
    state[0, 0] = 0.3**2
    prior = replace(prior, places=prior.places.predicted(state, np.eye(6)))
    keyframes, landmarks = _near(surfaces, view)
    assert uncertain(keyframes, prior).all()
    plain, doubted = register(view, keyframes, landmarks, prior), register(view, keyframes, landmarks, prior, doubted=True)
    assert plain.sigma_m < 0.01
    assert doubted.variance[0] > 0.25**2
    assert doubted.variance[2] < 0.014**2
    assert doubted.landmarks == 0


def test_landmarks_of_a_keyframe_itself_and_depth_confirm_it() -> None:
    surfaces, view = _map()
    keyframes, landmarks = _near(surfaces, view)
    found, doubtful = register(view, keyframes, landmarks, _prior(HERE)), np.arange(len(keyframes.number)) == 0
    followed = landmarks.of(doubtful)
    of_it = np.where(doubtful, len(followed.place_m), 0)
    assert len(followed.place_m) == np.count_nonzero(landmarks.keyframe == 0)
    many = landmarks._replace(keyframe=np.zeros(len(landmarks.keyframe), np.int64))
    enough = replace(found, fitting=np.where(doubtful, len(many.keyframe), 0))
    assert len(many.keyframe) >= 20
    assert enough.confirmed(many, doubtful)
    assert not replace(enough, inliers=enough.known // 2).confirmed(many, doubtful)
    assert not replace(enough, fitting=np.where(doubtful, 0, len(many.keyframe))).confirmed(many, doubtful)
    assert not replace(enough, fitting=of_it // 3).confirmed(many, doubtful)


def test_landmarks_on_one_straight_edge_say_nothing_of_the_way_along_it() -> None:
    """The direction of the edge is off by three degrees, as on a staircase of pixels."""
    surfaces, view, pose = _bare_wall()
    random, count = np.random.default_rng(8), 40
    place_m = np.column_stack((np.linspace(-0.6, 0.6, count), np.full(count, 0.1), np.full(count, 1.5)))
    slope = np.array([math.sin(math.radians(3.0)), math.cos(math.radians(3.0))])
    moved = _off(pose, np.array([0.05, 0.0, 0.0]), np.zeros(3))
    at_px: FloatArray = project(place_m, moving_imager(view, pose, STILL, np.zeros(2)))
    at_px[:, 0] += 0.05 / 1.5 * view.camera[0]  # they follow the prediction
    at_px[:, 1] += 0.3 * random.standard_normal(count)
    edge = Landmarks(
        place_m, np.zeros((count, 3, 2)), at_px.astype(np.float32), np.tile(np.outer(slope, slope), (count, 1, 1)),
        np.zeros(count, np.int64), np.arange(count),
    )  # fmt: skip
    found = register(view, _near(surfaces, view, pose)[0], edge, _prior(moved, place_m=0.05, turn_rad=math.radians(0.2)))
    assert math.sqrt(found.variance[0]) > 0.045
    assert found.odom_from_depth.translation_m[0] == pytest.approx(0.05, abs=0.01)


def test_edges_that_are_almost_parallel_say_nothing_of_the_way_along_them() -> None:
    """Each keyframe shows one edge exactly; between the two edges are two degrees."""
    surfaces, view, pose = _bare_wall()
    _add(surfaces, view, Pose(pose.quat_wxyz, np.array([0.0, 0.6, 0.0])))
    keyframes, count, edges = _near(surfaces, view, pose)[0], 40, []
    for keyframe, lean_rad in enumerate((math.radians(-1.0), math.radians(1.0))):
        along = np.linspace(-0.6, 0.6, count)
        place_m = np.column_stack((along, 0.2 * keyframe + math.tan(lean_rad) * along, np.full(count, 1.5)))
        across = np.array([-math.sin(lean_rad), math.cos(lean_rad)])
        at_px = project(place_m, moving_imager(view, pose, STILL, np.zeros(2)))
        edges.append(
            (place_m, at_px.astype(np.float32), np.tile(np.outer(across, across), (count, 1, 1)), np.full(count, keyframe))
        )
    place_m, at_px, texture, number = (np.concatenate(part) for part in zip(*edges, strict=True))
    followed = Landmarks(place_m, np.zeros((2 * count, 3, 2)), at_px, texture, number, np.arange(2 * count))
    prior = _prior(_off(pose, np.array([0.05, 0.0, 0.0]), np.zeros(3)), place_m=0.05, turn_rad=math.radians(0.2))
    found = register(view, keyframes, followed, prior)
    assert len(keyframes.number) > 1
    assert math.sqrt(found.variance[0]) > 0.045
    assert math.sqrt(found.variance[1]) < 0.03


def test_a_few_landmarks_of_a_keyframe_that_fit_say_nothing() -> None:
    """Of another keyframe, four of five are wrong and the others agree with a place that is off by 6 cm."""
    surfaces, view = _map()
    keyframes, landmarks = _near(surfaces, view)
    assert len(keyframes.number) > 1
    right = landmarks._replace(keyframe=np.zeros(len(landmarks.keyframe), np.int64))
    there = _off(HERE, np.array([0.04, 0.04, 0.02]), np.zeros(3))
    at_px = project(landmarks.place_m, moving_imager(view, there, STILL, np.zeros(2)))
    at_px[np.arange(len(at_px)) % 5 > 0] += 40.0
    wrong = landmarks._replace(at_px=at_px.astype(np.float32), keyframe=np.ones(len(landmarks.keyframe), np.int64))
    both = Landmarks(*(np.concatenate(part) for part in zip(right, wrong, strict=True)))
    empty = PreparedView(replace(view.frame, depth_m=np.full_like(view.frame.depth_m, np.nan)))
    start = _off(HERE, np.array([0.04, 0.04, 0.02]), np.zeros(3))
    prior = _prior(start, place_m=0.06, turn_rad=math.radians(0.2))
    alone, found = (register(empty, keyframes, some, prior) for some in (right, both))
    assert found.fitting[1] == 0
    np.testing.assert_allclose(found.odom_from_depth.translation_m, alone.odom_from_depth.translation_m, atol=1e-6)
    assert _error(found)[0] < 0.02
