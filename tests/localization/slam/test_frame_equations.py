"""Equations of a frame: what the kernels make of depth, landmarks and prediction, against the same in numpy."""

from __future__ import annotations

import numpy as np
import pytest
from slam_flight import RGB_LENS
from test_depth_points import HERE, compared
from textured_room import RGB_FROM_DEPTH

from uav_recon.localization.slam.depth_points import add_depth_equations
from uav_recon.localization.slam.frame_equations import (
    DEPTH_SHARE,
    ComparedFrame,
    Equations,
    PoseEstimate,
    Predicted,
    converge,
    determined_share,
    take_step,
    write_equations,
)
from uav_recon.localization.slam.landmarks import SIZE, Landmarks, MovingImager, add_landmark_equations, project
from uav_recon.localization.slam.weak_directions import add_noise, leave_edges, leave_weak_directions
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

DEPTH_FROM_RGB = RGB_FROM_DEPTH.inverse()
MOTION, SLOW, TURN_SIGMA_RAD = np.array([0.1, -0.2, 0.1, 0.3, 0.2, -0.1]), np.array([0.004, 0.002]), 0.01


def _imager(at: PoseEstimate) -> MovingImager:
    pose = at.rotation @ DEPTH_FROM_RGB.rotation(), at.rotation @ DEPTH_FROM_RGB.translation_m + at.place_m
    return MovingImager(RGB_LENS.pinhole_px(), *pose, at.place_m, MOTION, at.slow)


def _estimate(most: int, moved_m: FloatArray) -> PoseEstimate:
    moved = np.concatenate((moved_m, 0.002 * np.arange(3 + 3 * most)))
    return PoseEstimate(HERE.rotation(), HERE.translation_m + moved_m, np.array([0.01, 0.0, -0.02]), SLOW + 0.001, moved)


def _compared(many: int) -> ComparedFrame:
    """A view of a room against keyframes, with a number of landmarks, some of which are off."""
    points, keyframes = compared()
    most, random = len(keyframes.number), np.random.default_rng(3)
    ahead = np.column_stack((random.uniform(-0.5, 0.5, (many, 2)), np.ones(many))) * random.uniform(1.0, 3.0, (many, 1))
    place_m = (HERE @ DEPTH_FROM_RGB).apply(ahead)
    at_px = (project(place_m, _imager(_estimate(most, np.zeros(3)))) + random.normal(0.0, 1.5, (many, 2))).astype(np.float32)
    texture = np.tile(np.diag([1.0, 0.3]), (many, 1, 1))
    whose = random.integers(0, most, many)
    landmarks = Landmarks(place_m, random.normal(0.0, 0.1, (many, 3, 2)), at_px, texture, whose, np.arange(many))
    return ComparedFrame(
        points, RGB_LENS.pinhole_px(), DEPTH_FROM_RGB.rotation(), DEPTH_FROM_RGB.translation_m, MOTION,
        keyframes, landmarks,
        np.zeros((most, 3, 3)), np.linspace(0.0, 1e-4, most), 0.5, TURN_SIGMA_RAD,
    )  # fmt: skip


def _predicted(most: int) -> Predicted:
    root = np.random.default_rng(4).normal(0.0, 30.0, (6 + 3 * most, 6 + 3 * most))
    return Predicted(1e4 * np.eye(3) + 10.0, np.array([[4e5, 10.0], [10.0, 9e5]]), root @ root.T, SLOW)


@pytest.mark.parametrize("many", [0, 80])
@pytest.mark.parametrize("wide", [1.0, 4.0])
@pytest.mark.parametrize("far", [False, True])
def test_the_equations_are_those_of_depth_and_of_landmarks(many: int, wide: float, far: bool) -> None:
    seen = _compared(many)
    most, keyframes = len(seen.doubt), seen.keyframes
    at, out = _estimate(most, np.array([0.02, -0.03, 0.01])), Equations.empty(most)
    out.noise[:] = 1e-4 * np.diag([1.0, 2.0, 0.0])
    known, inliers, depth_sigma_m, match = write_equations(seen, at, SLOW, wide, far, False, out)

    moved_m = at.moved_m[6:].reshape(-1, 3)
    depth, slope = np.zeros((most, SIZE, SIZE)), np.zeros((most, SIZE))
    there = keyframes._replace(place_m=keyframes.place_m + moved_m)
    counts = add_depth_equations(seen.points, at.rotation, at.place_m, there, seen.doubt, DEPTH_SHARE, wide, depth, slope)
    assert (known, inliers) == counts
    assert match == pytest.approx(np.trace(depth.sum(axis=0)[3:6, 3:6]))
    support = 1.0 if far else np.clip((inliers / known - 0.55) / 0.3, 0.0, 1.0) ** 2 * min(inliers / 250.0, 1.0) ** 2
    depth, slope = support * depth, support * slope
    leaning = seen.leaning[:, None, None] * np.eye(3)
    add_noise(depth, slope, leaning if far else out.noise)
    assert depth_sigma_m == pytest.approx(leave_weak_directions(depth, slope, TURN_SIGMA_RAD, support))
    corners, pull, shown, fitting = np.zeros_like(depth), np.zeros_like(slope), np.zeros((most, 3, 3)), np.zeros(most, np.int64)
    landmarks = seen.landmarks._replace(place_m=seen.landmarks.place_m + moved_m[seen.landmarks.keyframe])
    add_landmark_equations(landmarks, _imager(at), at.slow - SLOW, 0.5, wide, corners, pull, shown, fitting)
    leave_edges(corners, pull, shown)
    add_noise(corners, pull, leaning)
    depth, slope = depth + corners, slope + pull
    leave_weak_directions(depth, slope, TURN_SIGMA_RAD, support)
    np.testing.assert_array_equal(out.fitting, fitting)
    np.testing.assert_allclose(out.information, depth, rtol=1e-7, atol=1e-7 * np.abs(depth).max())
    np.testing.assert_allclose(out.gradient, slope, rtol=1e-7, atol=1e-7 * np.abs(slope).max())


def test_a_step_solves_the_equations_with_the_prediction() -> None:
    seen = _compared(80)
    most = len(seen.doubt)
    predicted, at, out = _predicted(most), _estimate(most, np.array([0.02, -0.03, 0.01])), Equations.empty(most)
    write_equations(seen, at, SLOW, 1.0, False, True, out)
    before = PoseEstimate(*(each.copy() for each in at))
    size, places = SIZE + 3 + 3 * most, np.concatenate((np.arange(3, 6), np.arange(SIZE, SIZE + 3 + 3 * most)))
    expected, pull = np.zeros((size, size)), np.zeros(size)
    for m in range(most):
        rows = np.zeros((SIZE, size))  # of the unknowns of a camera, relative to a keyframe
        rows[:, :SIZE] = np.eye(SIZE)
        rows[3:6, SIZE + 3 + 3 * m : SIZE + 6 + 3 * m] = -np.eye(3)
        expected, pull = expected + rows.T @ out.information[m] @ rows, pull + rows.T @ out.gradient[m]
    for elements, known, off in (
        (np.arange(3), predicted.attitude, at.turned_rad),
        (np.arange(6, 8), predicted.slow, at.slow - SLOW),
        (places, predicted.places, at.moved_m),
    ):
        expected[np.ix_(elements, elements)] += known
        pull[elements] -= known @ off
    whole = np.empty((size, size))
    assert not take_step(out, predicted, at, whole)
    np.testing.assert_allclose(whole, expected, rtol=1e-9, atol=1e-6)
    step: FloatArray = np.asarray(np.linalg.solve(expected, pull), dtype=np.float64)
    turn = Pose.from_rotation_vector(step[:3], np.zeros(3)).rotation()
    np.testing.assert_allclose(at.rotation, turn @ before.rotation, atol=1e-9)
    np.testing.assert_allclose(at.place_m, before.place_m + step[3:6], atol=1e-9)
    np.testing.assert_allclose(at.turned_rad, before.turned_rad + step[:3], atol=1e-9)
    np.testing.assert_allclose(at.slow, before.slow + step[6:8], atol=1e-9)
    np.testing.assert_allclose(at.moved_m, before.moved_m + step[places], atol=1e-9)


def test_at_the_end_a_step_is_still() -> None:
    seen = _compared(0)
    most = len(seen.doubt)
    at, out, whole = _estimate(most, np.zeros(3)), Equations.empty(most), np.empty((SIZE + 3 + 3 * most,) * 2)
    converge(seen, _predicted(most), at, out, whole, False)
    assert take_step(out, _predicted(most), at, whole)


def test_the_determined_share_is_that_of_what_is_known_after_the_frame() -> None:
    """Against the place that the prediction alone knows, with turn, delay and width eliminated from the frame's equations."""
    seen = _compared(80)
    most = len(seen.doubt)
    predicted, out = _predicted(most), Equations.empty(most)
    write_equations(seen, _estimate(most, np.zeros(3)), SLOW, 1.0, False, True, out)
    shown, others = out.information.sum(axis=0), np.array([0, 1, 2, 6, 7])
    prior = np.zeros((5, 5))
    prior[:3, :3], prior[3:, 3:] = predicted.attitude, predicted.slow
    across = shown[np.ix_(others, np.arange(3, 6))]
    place = shown[3:6, 3:6] - across.T @ np.linalg.inv(shown[np.ix_(others, others)] + prior) @ across
    values, axes = np.linalg.eigh(np.linalg.inv(predicted.places[:3, :3]))
    root = (axes * np.sqrt(values)) @ axes.T
    share = determined_share(out, predicted)
    np.testing.assert_allclose(share, np.eye(3) - np.linalg.inv(np.eye(3) + root @ place @ root), atol=1e-9)
    assert -1e-9 < np.linalg.eigvalsh(share)[0] < np.linalg.eigvalsh(share)[2] < 1.0
