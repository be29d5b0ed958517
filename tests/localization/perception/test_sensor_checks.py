from __future__ import annotations

import numpy as np
import pytest

from uav_recon.config import LocalizationConfig
from uav_recon.localization.calibration.camera_mount import FixedMount
from uav_recon.localization.consistency.depth_consistency import DepthConsistencyMonitor
from uav_recon.localization.perception.fused_odometry import FusedOdometry
from uav_recon.localization.perception.sensor_checks import SensorChecks
from uav_recon.types.camera import Frame, ImuSample, Intrinsics
from uav_recon.types.camera_calibration import CameraMotion
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

LENS = Intrinsics(10.0, 10.0, 3.5, 2.5, 8, 6)
UNSURE = Reason(ReasonCode.PLACE_UNSURE, (0.1,))
CONFIG = LocalizationConfig()


def odometry_of(*poses: StampedPose) -> FusedOdometry:
    odometry = FusedOdometry.of(CONFIG, FixedMount(Pose.identity()))
    for k in range(70):  # noise: samples that repeat are frozen
        noise = 1e-3 * np.sin(k * np.arange(1.0, 4.0))
        odometry.add_imu([ImuSample(k / 200, noise, np.array([0.0, 0.0, 9.81]) + noise)], k / 200)
    for pose in poses:
        odometry.add_pose(pose, 0.35)
    return odometry


def resting(health: PoseHealth = PoseHealth.GOOD, why: Reason | None = None) -> list[StampedPose]:
    return [StampedPose(k / 30, Pose.identity(), np.zeros(3), health=health, health_reason=why) for k in range(10)]


def checked(monkeypatch: pytest.MonkeyPatch, odometry: FusedOdometry, stamp_s: float) -> tuple[list[CameraMotion | None], int]:
    """Return the motions with which depth is compared, and how often the drift is forgotten."""
    motions, forgotten = list[CameraMotion | None](), list[bool]()

    def rejection(_: DepthConsistencyMonitor, frame: Frame, motion: CameraMotion | None, *rest: object) -> None:
        motions.append(motion)

    monkeypatch.setattr(DepthConsistencyMonitor, "rejection", rejection)
    monkeypatch.setattr(DepthConsistencyMonitor, "forget_drift", lambda _: forgotten.append(True))
    depth_m, rgb = np.ones((6, 8), np.float32), np.zeros((6, 8, 3), np.uint8)
    frame = Frame(stamp_s, 0, depth_m, LENS, rgb, LENS, Pose.identity())
    assert SensorChecks(CONFIG).rejection(frame, Pose.identity(), odometry) is None
    return motions, len(forgotten)


def test_a_frame_is_compared_where_odometry_is_known_and_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    motions, forgotten = checked(monkeypatch, odometry_of(*resting()), 0.3)
    assert motions[0] is not None
    np.testing.assert_allclose(motions[0].odom_from_depth.translation_m, 0.0, atol=1e-3)
    assert not forgotten


def test_without_odometry_and_after_its_loss_a_frame_is_judged_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    assert checked(monkeypatch, odometry_of(), 0.3) == ([None], 0)
    assert checked(monkeypatch, odometry_of(*resting()), 1.0) == ([None], 0)


def test_at_an_uncertain_place_no_drift_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    assert checked(monkeypatch, odometry_of(*resting(PoseHealth.DEGRADED, UNSURE)), 0.3) == ([None], 1)


def test_wrong_axes_and_a_drift_both_forbid_to_fly_by_the_odometry(monkeypatch: pytest.MonkeyPatch) -> None:
    checks, drift = SensorChecks(CONFIG), Reason(ReasonCode.ODOMETRY_DRIFT, (0.05,))
    assert checks.fault(1.0) is None
    monkeypatch.setattr(DepthConsistencyMonitor, "drift", lambda *_: drift)
    assert checks.fault(1.0) is drift
    checks._axes.reason = axes = Reason(ReasonCode.AXES_GRAVITY)
    assert checks.fault(1.0) is axes


def test_poses_made_of_the_frames_contain_the_errors_of_the_camera() -> None:
    checks = SensorChecks(LocalizationConfig(source="slam"))
    checks.calibration_filter.begin((("delay_s", 0.02, 0.001),))
    assert checks.calibration.delay_s == 0.0
    checks = SensorChecks(CONFIG)
    checks.calibration_filter.begin((("delay_s", 0.02, 0.001),))
    assert checks.calibration.delay_s == pytest.approx(0.02, abs=0.005)
