"""A thin wall from its other side: its first side's surface must not pull the camera."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.localization.slam.depth_points import add_depth_equations
from uav_recon.localization.slam.keyframe_map import KeyframeMap
from uav_recon.localization.slam.landmarks import SIZE
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

LENS = Intrinsics.from_fov(64, 48, 1.2, 0.9)
BACK = Pose.from_rotation_vector(np.array([0.0, np.pi, 0.0]), np.array([0.0, 0.0, 4.0]))  # 4 m ahead, looks back


def _view(away_m: float) -> PreparedView:
    depth_m, none = np.full((48, 64), away_m, np.float32), np.zeros((2, 4, 3), np.uint8)
    return PreparedView(Frame(0.0, 0, depth_m, LENS, none, Intrinsics.from_fov(4, 2, 1.0, 1.0), Pose.identity()))


def _compared(surfaces: KeyframeMap, view: PreparedView, pose: Pose) -> tuple[int, int, FloatArray]:
    """Return the numbers of known points and inliers, and the information."""
    keyframes = surfaces.near(view.depth, pose, 1.0, np.inf)
    most = len(keyframes.number)
    information, gradient, doubt = np.zeros((most, SIZE, SIZE)), np.zeros((most, SIZE)), np.zeros((most, 3, 3))
    known, inliers = add_depth_equations(
        view.points, pose.rotation(), pose.translation_m, keyframes, doubt, 1.0, 1.0, information, gradient
    )
    return known, inliers, information


def _add(surfaces: KeyframeMap, view: PreparedView, pose: Pose) -> None:
    surfaces.add(view, pose, np.zeros(6), np.zeros(2), np.zeros(3), 0)


def test_the_other_side_of_a_wall_is_unknown() -> None:
    """A wall of 10 cm, 2 m ahead, whose far side is seen from 4 m ahead."""
    surfaces = KeyframeMap()
    _add(surfaces, _view(2.0), Pose.identity())
    for away_m, pose, seen in ((2.0, Pose.identity(), True), (1.9, BACK, False)):
        known, inliers, information = _compared(surfaces, _view(away_m), pose)
        assert (known > 400, inliers > 400) == (seen, seen)
        assert bool(information.any()) == seen


@pytest.mark.parametrize("thick_m", [0.08, 0.12, 0.20])
@pytest.mark.parametrize("far_frames", [1, 12])
def test_a_wall_seen_from_both_sides_does_not_contradict_a_view_of_it(thick_m: float, far_frames: int) -> None:
    """Its two surfaces both stay where they are: they do not cancel out, and none moves the other."""
    surfaces, near, far = KeyframeMap(), _view(2.0), _view(2.0 - thick_m)
    for _ in range(6):
        _add(surfaces, near, Pose.identity())
    for _ in range(far_frames):
        _add(surfaces, far, BACK)
    for view, pose in ((near, Pose.identity()), (far, BACK)):
        known, inliers, _ = _compared(surfaces, view, pose)
        assert known == inliers > 400
