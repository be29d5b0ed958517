"""Map of keyframes: which views become one, what is fused, and which ones a view is compared with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from slam_flight import BODY_FROM_DEPTH, RATE_HZ, frame, truth
from textured_room import LENS, frame_of

from uav_recon.localization.slam.keyframe_map import KeyframeMap
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

STILL, SLOW, SURE = np.zeros(6), np.zeros(2), np.zeros(3)


def _add(surfaces: KeyframeMap, view: PreparedView, pose: Pose, variance: FloatArray = SURE, landmarks: int = 999) -> None:
    before = surfaces.count
    assert surfaces.add(view, pose, STILL, SLOW, variance, landmarks) == (surfaces.count > before)


def _turned(yaw: float) -> Pose:
    return Pose.from_rotation_vector(np.array([0.0, yaw, 0.0]), np.zeros(3))


def _wall(away_m: float, noise_m: float = 0.0, seed: int = 0) -> PreparedView:
    noise = noise_m * np.random.default_rng(seed).standard_normal((LENS.height, LENS.width))
    return PreparedView(frame_of(0.0, (away_m + noise).astype(np.float32)))


def _ball() -> PreparedView:
    """The inside of a ball around the camera, which looks the same in every direction."""
    return PreparedView(frame_of(0.0, (2.0 / np.linalg.norm(LENS.bearings(), axis=2)).astype(np.float32)))


def test_a_view_that_adds_nothing_makes_the_depth_of_its_keyframe_more_exact() -> None:
    surfaces = KeyframeMap()
    for seed in range(16):
        _add(surfaces, _wall(2.0, 0.008, seed), Pose.identity())
    assert surfaces.count == 1
    one = _wall(2.0, 0.008).depth.depth_m
    held = surfaces.near(_wall(2.0).depth, Pose.identity(), 0.0, np.inf).depth_m[0]
    assert held[held > 0.0].std() < 0.4 * one[one > 0.0].std()


def test_a_view_of_which_little_is_known_becomes_a_keyframe() -> None:
    surfaces = KeyframeMap()
    for yaw in (0.0, 0.05, 0.9, 0.95, 1.8):
        _add(surfaces, _wall(2.0), _turned(yaw))
    assert surfaces.count == 3


def test_a_view_with_few_landmarks_becomes_a_keyframe_if_it_shows_more() -> None:
    surfaces = KeyframeMap()
    poses = [truth(number / RATE_HZ) @ BODY_FROM_DEPTH for number in (60, 61, 70)]
    for number, pose in zip((60, 61, 70), poses, strict=True):
        _add(surfaces, PreparedView(frame(number)), pose, landmarks=0)
        if number == 61:
            assert surfaces.count == 1, "it was taken from where the first one was"
    assert surfaces.count == 2


def test_a_view_without_corners_becomes_none_for_its_few_landmarks() -> None:
    surfaces = KeyframeMap()
    for across_m in (0.0, 0.15):
        _add(surfaces, _wall(2.0), Pose.from_rotation_vector(np.zeros(3), np.array([across_m, 0.0, 0.0])), landmarks=0)
    assert surfaces.count == 1


def test_a_view_is_compared_with_what_it_resembles_and_with_what_is_known_best() -> None:
    surfaces = KeyframeMap()
    for yaw, variance in ((0.0, 0.0), (0.4, 0.0), (0.8, 1e-4), (3.0, 0.0)):
        _add(surfaces, _ball(), _turned(yaw), np.full(3, variance))
    assert surfaces.count == 4
    found = surfaces.near(_ball().depth, _turned(0.75), 0.0, np.inf).number.tolist()
    assert found[0] == 2
    assert 1 in found
    assert 3 not in found, "it looks the other way"
    assert 2 not in surfaces.near(_ball().depth, _turned(0.75), 0.0, 1e-5).number.tolist()
    assert not len(KeyframeMap().near(_ball().depth, Pose.identity(), 0.0, np.inf).number)


def test_a_keyframe_that_is_known_much_better_is_not_changed() -> None:
    surfaces = KeyframeMap()
    _add(surfaces, _wall(2.0), Pose.identity(), SURE)
    _add(surfaces, _wall(2.01), Pose.identity(), np.full(3, 0.1**2))
    held = surfaces.near(_wall(2.0).depth, Pose.identity(), 0.0, np.inf).depth_m[0]
    np.testing.assert_allclose(held[held > 0.0], 2.0, rtol=1e-6)


def test_a_camera_with_another_resolution_goes_on_in_the_same_map() -> None:
    surfaces = KeyframeMap()
    _add(surfaces, _wall(2.0), Pose.identity())
    small = frame_of(0.0, np.full((LENS.height, LENS.width), 2.0, np.float32))
    lens = replace(
        LENS, width=LENS.width // 2, height=LENS.height // 2, fx=LENS.fx / 2, fy=LENS.fy / 2, cx=LENS.cx / 2, cy=LENS.cy / 2
    )
    view = PreparedView(replace(small, depth_m=small.depth_m[::2, ::2], depth_intrinsics=lens))
    _add(surfaces, view, _turned(1.5))
    assert surfaces.count == 2
    assert surfaces.near(view.depth, _turned(1.5), 0.0, np.inf).number.tolist() == [1]


def test_many_keyframes_are_kept() -> None:
    surfaces = KeyframeMap()
    for number in range(70):
        _add(surfaces, _wall(2.0), Pose.from_rotation_vector(np.zeros(3), np.array([3.5 * number, 0.0, 0.0])))
    assert surfaces.count == 70
    np.testing.assert_allclose(surfaces.pose(69).translation_m, [3.5 * 69, 0.0, 0.0])


def test_keyframes_are_moved_and_the_newest_forgotten() -> None:
    surfaces = KeyframeMap()
    for number in range(5):
        _add(surfaces, _wall(2.0), Pose.from_rotation_vector(np.zeros(3), np.array([4.0 * number, 0.0, 0.0])))
    moved_m, variance = np.outer(np.arange(5), [0.0, 0.01, 0.0]), np.outer(np.arange(5), np.full(3, 1e-4))
    surfaces.move(moved_m, variance)
    np.testing.assert_allclose([surfaces.pose(n).translation_m[1] for n in range(5)], [0.0, 0.01, 0.02, 0.03, 0.04])
    np.testing.assert_allclose(surfaces.near(_wall(2.0).depth, surfaces.pose(2), 0.0, np.inf).variance[0], 2e-4)
    surfaces.keep(4)
    assert surfaces.count == 4
    assert not len(
        surfaces.near(_wall(2.0).depth, Pose.from_rotation_vector(np.zeros(3), np.array([16.0, 0.04, 0.0])), 0.0, np.inf).number
    )
    _add(surfaces, _wall(2.0), Pose.from_rotation_vector(np.zeros(3), np.array([40.0, 0.0, 0.0])))
    assert surfaces.count == 5
