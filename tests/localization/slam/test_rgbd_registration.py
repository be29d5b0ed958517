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

from uav_recon.localization.slam.landmarks import Landmarks, LandmarkTracker, moving_imager, project
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.localization.slam.rgbd_registration import MotionPrior, Registration, register, search
from uav_recon.localization.slam.tsdf_volume import TsdfVolume
from uav_recon.types.camera import Frame
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

NUMBER = 210  # of the frame that is registered: it shows a corner of the room
HERE = truth(NUMBER / RATE_HZ) @ BODY_FROM_DEPTH
STILL = np.zeros(6)
PLACE_M, TURN_RAD = 0.1, math.radians(4.0)


@functools.cache
def _map() -> tuple[TsdfVolume, PreparedView]:
    """The field of the views before, and the view itself."""
    volume = TsdfVolume()
    for number in range(NUMBER - 60, NUMBER, 4):
        volume.integrate(frame(number), truth(number / RATE_HZ) @ BODY_FROM_DEPTH, np.zeros(3))
    return volume, PreparedView(frame(NUMBER))


def _prior(pose: Pose, place_m: float = PLACE_M, turn_rad: float = TURN_RAD) -> MotionPrior:
    covariance = np.diag([turn_rad**2] * 3 + [place_m**2] * 3)
    slow = np.diag([0.005**2, 0.003**2])
    return MotionPrior(pose, covariance, turn_rad, np.zeros(3), np.zeros(3), np.zeros(2), slow, np.zeros(3))


def _off(pose: Pose, moved_m: FloatArray, turned_rad: FloatArray) -> Pose:
    turn = Pose.from_rotation_vector(turned_rad, np.zeros(3))
    return Pose((turn @ pose).quat_wxyz, pose.translation_m + moved_m)


def _followed(pose: Pose) -> Landmarks:
    """The landmarks of the image before, followed to the view as a predicted pose expects them."""
    view, tracker = PreparedView(frame(NUMBER - 1)), LandmarkTracker()
    tracker.follow(view, np.empty((0, 2)))
    tracker.settle(view, truth((NUMBER - 1) / RATE_HZ) @ BODY_FROM_DEPTH, STILL, np.zeros(2), np.zeros(3))
    now = _map()[1]
    predicted: FloatArray = project(tracker.points.place_m, moving_imager(now, pose, STILL, np.zeros(2)))
    return tracker.follow(now, predicted)


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
    volume, view = _map()
    start = _off(HERE, moved_m, turned_rad)
    found = register(view, volume, _followed(start), _prior(start))
    error_m, error_rad = _error(found)
    assert error_m < 0.01
    assert error_rad < math.radians(0.3)
    assert found.fit > 0.9
    assert math.sqrt(np.linalg.eigvalsh(found.covariance[3:, 3:])[-1]) < 0.01


def test_the_landmarks_are_used_where_they_fit() -> None:
    volume, view = _map()
    landmarks = _followed(HERE)
    found = register(view, volume, landmarks, _prior(HERE))
    assert found.landmarks > 0.9 * len(landmarks.place_m) > 30
    without = register(view, volume, Landmarks.none(), _prior(HERE))
    assert without.landmarks == 0
    assert np.trace(found.covariance) < np.trace(without.covariance)


def test_wrong_landmarks_are_left_out() -> None:
    volume, view = _map()
    start = _off(HERE, np.array([0.03, -0.02, 0.01]), np.zeros(3))
    landmarks = _followed(start)
    random = np.random.default_rng(0)
    wrong = landmarks._replace(
        at_px=(landmarks.at_px + 30.0 * random.standard_normal(landmarks.at_px.shape)).astype(np.float32)
    )
    alone, found = register(view, volume, Landmarks.none(), _prior(start)), register(view, volume, wrong, _prior(start))
    assert found.landmarks == 0
    np.testing.assert_array_equal(found.odom_from_depth.matrix(), alone.odom_from_depth.matrix())
    assert _error(found)[0] < 0.02


def test_some_wrong_landmarks_do_little() -> None:
    volume, view = _map()
    landmarks = _followed(HERE)
    at_px = landmarks.at_px.copy()
    at_px[::4] += 25.0
    found = register(view, volume, landmarks._replace(at_px=at_px), _prior(HERE))
    assert found.landmarks > 0.6 * len(at_px)
    assert _error(found)[0] < 0.01


def test_landmarks_alone_bring_back_a_turn_that_was_not_predicted() -> None:
    """A hand turns the camera at once by 4 degrees, and no gyro tells: the landmarks are 10 pixels off, all together."""
    view, landmarks = _map()[1], _followed(HERE)
    blind = PreparedView(replace(view.frame, depth_m=np.full_like(view.frame.depth_m, np.nan)))
    start = _off(HERE, np.zeros(3), np.array([0.0, 0.0, math.radians(4.0)]))
    prior = _prior(start, place_m=0.01, turn_rad=math.radians(0.3))
    found = register(blind, TsdfVolume(), landmarks, replace(prior, turn_sigma_rad=math.radians(3.0)))
    assert found.landmarks > 0.7 * len(landmarks.place_m)
    assert _error(found)[1] < math.radians(1.5)


def _bare_wall() -> tuple[TsdfVolume, PreparedView, Pose]:
    """A wall 1.5 m ahead that fills the image."""
    pose, volume = Pose.identity(), TsdfVolume()
    noise = np.random.default_rng(4)
    views = []
    for _ in range(6):
        depth = (1.5 + 0.006 * noise.standard_normal((LENS.height, LENS.width))).astype(np.float32)
        views.append(Frame(0.0, 0, depth, LENS, np.zeros((2, 2, 3), np.uint8), RGB_LENS, Pose.identity()))
        volume.integrate(views[-1], pose, np.zeros(3))
    return volume, PreparedView(views[-1]), pose


@pytest.mark.parametrize("along", [0, 1])
def test_along_a_bare_wall_the_prediction_and_its_uncertainty_are_kept(along: int) -> None:
    volume, view, pose = _bare_wall()
    moved = np.array([0.0, 0.0, 0.04]) + 0.05 * np.eye(3)[along]
    prior = _prior(_off(pose, moved, np.zeros(3)), place_m=0.05, turn_rad=math.radians(0.2))
    found = register(view, volume, Landmarks.none(), prior)
    assert found.odom_from_depth.translation_m[2] == pytest.approx(0.0, abs=0.01)
    np.testing.assert_allclose(found.odom_from_depth.translation_m[:2], moved[:2], atol=0.004)
    sigma_m = np.sqrt(np.diagonal(found.covariance)[3:])
    np.testing.assert_allclose(sigma_m[:2], 0.05, rtol=0.05)
    assert sigma_m[2] < 0.01


def test_a_frame_without_depth_and_landmarks_keeps_the_prediction() -> None:
    volume, view = _map()
    empty = PreparedView(replace(view.frame, depth_m=np.full_like(view.frame.depth_m, np.nan)))
    prior = _prior(_off(HERE, np.array([0.2, 0.0, 0.0]), np.zeros(3)))
    found = register(empty, volume, Landmarks.none(), prior)
    np.testing.assert_allclose(found.odom_from_depth.matrix(), prior.odom_from_depth.matrix(), atol=1e-12)
    np.testing.assert_allclose(found.covariance, prior.covariance, rtol=1e-6)
    assert (found.points, found.coverage, found.fit) == (0, 0.0, 0.0)


@pytest.mark.parametrize("moved", [(0.4, -0.3, 0.1), (-0.4, 0.4, -0.2), (0.2, 0.45, 0.2)])
def test_a_search_finds_what_registration_does_not_reach(moved: tuple[float, float, float]) -> None:
    volume, view = _map()
    start = _off(HERE, np.array(moved), np.zeros(3))
    prior = _prior(start, place_m=0.25, turn_rad=math.radians(0.5))
    lost, found = register(view, volume, Landmarks.none(), prior), search(view, volume, prior, np.full(3, 0.5))[0]
    assert _error(lost)[0] > 0.1
    assert _error(found)[0] < 0.02
    assert found.fit > 0.9


def test_a_search_along_a_bare_wall_keeps_the_prediction() -> None:
    volume, view, pose = _bare_wall()
    moved = np.array([0.05, 0.03, 0.25])
    prior = _prior(_off(pose, moved, np.zeros(3)), place_m=0.15, turn_rad=math.radians(0.2))
    found, _ = search(view, volume, prior, np.full(3, 0.3))
    np.testing.assert_allclose(found.odom_from_depth.translation_m, [0.05, 0.03, 0.0], atol=0.02)


def _elsewhere(landmarks: Landmarks, off_m: FloatArray, sigma_m: float) -> Landmarks:
    """The same landmarks, placed from a track that is off."""
    return landmarks._replace(place_m=landmarks.place_m + off_m, variance=np.full(landmarks.place_m.shape, sigma_m**2))


@pytest.mark.parametrize("off", [(0.07, 0.0, 0.0), (-0.05, 0.06, 0.02)])
def test_a_track_that_is_less_certain_than_the_surfaces_is_shifted_to_them(off: tuple[float, float, float]) -> None:
    """Landmarks and prediction agree with each other, and hundreds of landmarks outweigh depth."""
    (volume, view), off_m = _map(), np.array(off)
    start = _off(HERE, off_m, np.zeros(3))
    prior = replace(_prior(start, place_m=0.005, turn_rad=math.radians(0.2)), track_variance=np.full(3, 0.06**2))
    found = register(view, volume, _elsewhere(_followed(HERE), off_m, 0.06), prior)
    assert _error(found)[0] < 0.015
    np.testing.assert_allclose(found.shift_m, -off_m, atol=0.015)
    assert math.sqrt(float(found.track_variance.max())) < 0.025
    assert found.sigma_m < 0.025


def test_a_track_that_is_as_certain_as_the_surfaces_stays_where_it_is() -> None:
    volume, view = _map()
    off_m = np.array([0.05, 0.0, 0.0])
    prior = _prior(_off(HERE, off_m, np.zeros(3)), place_m=0.005, turn_rad=math.radians(0.2))
    found = register(view, volume, _elsewhere(_followed(HERE), off_m, 0.0), prior)
    assert np.linalg.norm(found.shift_m) < 0.001
    assert not found.track_variance.max() > 1e-6


def test_along_a_bare_wall_the_error_of_the_track_is_kept() -> None:
    volume, view, pose = _bare_wall()
    prior = _prior(_off(pose, np.array([0.05, 0.0, 0.0]), np.zeros(3)), place_m=0.01, turn_rad=math.radians(0.2))
    found = register(view, volume, Landmarks.none(), replace(prior, track_variance=np.full(3, 0.09**2)))
    sigma_m = np.sqrt(found.variance)
    np.testing.assert_allclose(sigma_m[:2], 0.09, rtol=0.1)
    assert sigma_m[2] < 0.02
    assert found.sigma_m > 0.085


def test_landmarks_on_one_straight_edge_say_nothing_of_the_way_along_it() -> None:
    """The direction of the edge is off by three degrees, as on a staircase of pixels."""
    volume, view, pose = _bare_wall()
    random, count = np.random.default_rng(8), 40
    place_m = np.column_stack((np.linspace(-0.6, 0.6, count), np.full(count, 0.1), np.full(count, 1.5)))
    slope = np.array([math.sin(math.radians(3.0)), math.cos(math.radians(3.0))])
    moved = _off(pose, np.array([0.05, 0.0, 0.0]), np.zeros(3))
    at_px: FloatArray = project(place_m, moving_imager(view, pose, STILL, np.zeros(2)))
    at_px[:, 0] += 0.05 / 1.5 * view.camera[0]  # they follow the prediction
    at_px[:, 1] += 0.3 * random.standard_normal(count)
    edge = Landmarks(
        place_m, np.zeros((count, 3, 2)), at_px.astype(np.float32), np.zeros((count, 2), np.float32), np.ones(count),
        np.tile(np.outer(slope, slope), (count, 1, 1)), np.zeros((count, 3)),
    )  # fmt: skip
    found = register(view, volume, edge, _prior(moved, place_m=0.05, turn_rad=math.radians(0.2)))
    assert math.sqrt(found.variance[0]) > 0.045
    assert found.odom_from_depth.translation_m[0] == pytest.approx(0.05, abs=0.01)
