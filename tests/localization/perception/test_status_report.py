from __future__ import annotations

from pathlib import Path

from test_frame_intake import Camera

from uav_recon.channels import MemoryChannel
from uav_recon.config import LocalizationConfig
from uav_recon.interfaces import PoseSource
from uav_recon.localization.calibration.camera_mount import FixedMount
from uav_recon.localization.calibration.kept_calibration import NoKeptCalibration
from uav_recon.localization.pad_origin import PadOrigin
from uav_recon.localization.perception.frame_intake import FrameIntake
from uav_recon.localization.perception.fused_odometry import FusedOdometry
from uav_recon.localization.perception.sensor_checks import SensorChecks
from uav_recon.localization.perception.status_report import StatusReport
from uav_recon.localization.slam.kept_map import NoKeptMap
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import VehicleState

CONFIG = LocalizationConfig()
EMPTY = Reason(ReasonCode.DEPTH_FRAME_EMPTY, (0.1,))


class NoPoses:
    """A pose source that is silent."""

    def poses(self) -> list[StampedPose]:
        return []


def status_of(poses: PoseSource, *remarks: Reason) -> PerceptionStatus:
    intake = FrameIntake(Camera(), 0.2)
    intake.drop(4.0, Reason(ReasonCode.DEPTH_FRAME_STAMP))
    intake.drop(5.0, EMPTY)
    odometry = FusedOdometry.of(CONFIG, FixedMount(Pose.identity()))
    report = StatusReport(poses, intake, odometry, SensorChecks(CONFIG), NoKeptCalibration(), NoKeptMap(), lambda: remarks)
    return report.status(6.0, published_frames=7)


def test_counts_the_newest_drop_and_the_remarks_of_the_camera_are_reported() -> None:
    status = status_of(NoPoses(), EMPTY)
    assert (status.stamp_s, status.frames, status.camera) == (6.0, 7, (EMPTY,))
    assert status.counts() == {"depth-frame-empty": 1, "depth-frame-stamp": 1}
    assert (status.newest, status.newest_s) == (EMPTY, 5.0)
    assert (status.origin, status.kept, status.correction, status.earlier_map) == (None, None, None, None)
    assert "delay_s" in {name for name, _, _ in status.calibration}


def test_a_pad_that_is_awaited_is_reported(tmp_path: Path) -> None:
    origin = status_of(PadOrigin(NoPoses(), MemoryChannel(VehicleState), tmp_path / "pad.json")).origin
    assert origin is not None
    assert origin.code is ReasonCode.PAD_AWAITED
