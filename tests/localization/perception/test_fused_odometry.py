from __future__ import annotations

from dataclasses import replace

import numpy as np

from uav_recon.localization.calibration.camera_mount import FixedMount
from uav_recon.localization.correction.odometry_correction import NoCorrection
from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.localization.perception.fused_odometry import FusedOdometry
from uav_recon.types.pose import Pose, StampedPose

BODY_FROM_DEPTH = Pose.from_yaw(0.0, np.array([0.1, 0.0, 0.0]))


class Moved(NoCorrection):
    """Corrects by one metre; the tracker's map is two metres off."""

    def corrected(self, estimate: StampedPose) -> StampedPose:
        return replace(estimate, odom_from_body=Pose.from_yaw(0.0, np.array([0.0, 1.0, 0.0])) @ estimate.odom_from_body)

    def registered(self, estimate: StampedPose) -> StampedPose:
        return replace(estimate, odom_from_body=Pose.from_yaw(0.0, np.array([0.0, 2.0, 0.0])) @ estimate.odom_from_body)


def flown(until_s: float = 2.0) -> FusedOdometry:
    """Return the odometry of a body that flies at 0.5 m/s along x."""
    odometry = FusedOdometry(FusionFilter(), Moved(), FixedMount(BODY_FROM_DEPTH))
    for k in range(1, round(until_s * 30) + 1):
        pose = Pose.from_yaw(0.0, np.array([k / 60, 0.0, 0.0]))
        odometry.add_pose(StampedPose(k / 30, pose, np.array([0.5, 0.0, 0.0])), k / 30)
    return odometry


def test_nothing_is_known_before_the_first_pose() -> None:
    odometry = FusedOdometry(FusionFilter(), NoCorrection(), FixedMount(BODY_FROM_DEPTH))
    assert odometry.fused(0.0) is odometry.corrected(0.0) is odometry.registered(0.0) is None
    assert odometry.fused_motion(0.0) is odometry.registered_motion(0.0) is None


def test_fused_corrected_and_registered_odometry_of_one_instant() -> None:
    odometry = flown()
    found = [odometry.fused(1.9), odometry.corrected(1.9), odometry.registered(1.9)]
    places_m = [estimate.odom_from_body.translation_m for estimate in found if estimate is not None]
    np.testing.assert_allclose(places_m, [[0.95, 0.0, 0.0], [0.95, 1.0, 0.0], [0.95, 2.0, 0.0]], atol=0.02)


def test_the_motion_of_the_camera_is_that_of_its_mount_on_the_body() -> None:
    odometry = flown()
    for motion, left_m in ((odometry.fused_motion(1.9), 0.0), (odometry.registered_motion(1.9), 2.0)):
        assert motion is not None
        np.testing.assert_allclose(motion.odom_from_depth.translation_m, [1.05, left_m, 0.0], atol=0.02)
        np.testing.assert_allclose(motion.velocity_mps, [0.5, 0.0, 0.0], atol=0.05)
