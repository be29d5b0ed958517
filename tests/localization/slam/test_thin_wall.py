"""A thin wall from its other side: its first side's surface must not pull the camera."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.localization.slam.depth_points import add_depth_equations, depth_points
from uav_recon.localization.slam.landmarks import SIZE
from uav_recon.localization.slam.tsdf_volume import TsdfVolume, sample
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.pose import Pose

LENS = Intrinsics.from_fov(64, 48, 1.2, 0.9)
BACK = Pose.from_rotation_vector(np.array([0.0, np.pi, 0.0]), np.array([0.0, 0.0, 4.0]))  # 4 m ahead, looks back


def _frame(away_m: float) -> Frame:
    depth_m, none = np.full((48, 64), away_m, np.float32), np.zeros((2, 4, 3), np.uint8)
    return Frame(0.0, 0, depth_m, LENS, none, Intrinsics.from_fov(4, 2, 1.0, 1.0), Pose.identity())


def test_the_other_side_of_a_wall_is_unknown() -> None:
    """A wall of 10 cm, 2 m ahead, whose far side is seen from 4 m ahead."""
    volume, near = TsdfVolume(), _frame(2.0)
    volume.integrate(near, Pose.identity(), np.zeros(3))
    for away_m, pose, seen in ((2.0, Pose.identity(), True), (1.9, BACK, False)):
        information, points = np.zeros((SIZE, SIZE)), depth_points(_frame(away_m).depth_m, LENS.pinhole_px())
        known, inliers = add_depth_equations(
            points, pose.rotation(), pose.translation_m, volume.blocks, np.zeros(3), np.inf, 1.0, 1.0, information,
            np.zeros(SIZE), np.zeros((2, 3)),
        )  # fmt: skip
        assert (known > 800, inliers > 800) == (seen, seen)
        assert bool(information.any()) == seen


@pytest.mark.parametrize("thick_m", [0.08, 0.10, 0.12, 0.15, 0.20])
@pytest.mark.parametrize("far_frames", [1, 2, 3, 6, 12])
def test_a_wall_seen_from_both_sides_does_not_contradict_a_view_of_it(thick_m: float, far_frames: int) -> None:
    """Its two surfaces both stay where they are: they do not cancel out, and none moves the other."""
    volume, near, far = TsdfVolume(), _frame(2.0), _frame(2.0 - thick_m)
    for _ in range(6):
        volume.integrate(near, Pose.identity(), np.zeros(3))
    for _ in range(far_frames):
        volume.integrate(far, BACK, np.zeros(3))
    known, inliers = add_depth_equations(
        depth_points(far.depth_m, LENS.pinhole_px()), BACK.rotation(), BACK.translation_m, volume.blocks, np.zeros(3), np.inf,
        1.0, 1.0, np.zeros((SIZE, SIZE)), np.zeros(SIZE), np.zeros((2, 3)),
    )  # fmt: skip
    assert known - inliers <= 0.25 * known
    found = np.empty(5)
    for at_m in (2.0, 2.0 + thick_m):
        assert sample(np.array([0.01, 0.01, at_m]), volume.index, volume.distance, volume.weight, found)
        assert abs(found[0]) < 0.02
