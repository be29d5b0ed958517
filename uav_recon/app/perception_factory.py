"""Factory of perception: selects camera, poses and corrections."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from uav_recon.app import camera_sources, pose_sources
from uav_recon.app.flight_channels import FlightChannels
from uav_recon.clock import InlineExecutor
from uav_recon.config import Config
from uav_recon.interfaces import CameraRemarks, Clock, DepthCamera, Executor, ExposureLocking, PoseSource
from uav_recon.types.reason import Reason
from uav_recon.types.vehicle import FlightPhase, VehicleState

if TYPE_CHECKING:  # each process imports only the stages that it runs
    from uav_recon.localization.calibration.camera_mount import Mount
    from uav_recon.localization.consistency.depth_consistency import DepthConsistencyMonitor
    from uav_recon.localization.consistency.reconciled_consistency import ReconciledConsistency
    from uav_recon.localization.correction.odometry_correction import OdometryCorrection
    from uav_recon.localization.fusion.fusion_filter import FusionFilter
    from uav_recon.localization.perception.perception import Perception

PAD_FILE = "pad_origin.json"  # in the runtime folder
#: reject: after a longer silence, a pose of the embedded SLAM until more agree with it; a camera loses up to five frames, and
#: two more must fit after a doubt
SLAM_BRIDGED_S = 1.0


def make_perception(
    config: Config,
    wires: FlightChannels,
    clock: Clock,
    stopped: Callable[[], bool] = lambda: False,
    compile_ahead: Callable[[], None] = lambda: None,
    writer: Executor | None = None,
) -> Perception:
    """Build the loop next to the camera. compile_ahead() is called once there is a camera.

    writer: writes the camera's errors beside the loop; None: on the clock of a simulation.

    Raises UserError if there is no camera; with exit code 0 if stopped() becomes true while it waits for one.
    """
    from uav_recon.localization.calibration.camera_mount import FixedMount, GimbalMount
    from uav_recon.localization.pad_origin import PadOrigin

    camera = camera_sources.open_camera(config, clock, stopped)
    mount = (
        FixedMount(camera_sources.tilted_camera(config))
        if config.camera.mount == "fixed"
        else GimbalMount(np.array(config.camera.position_body_m), wires.vehicle)
    )
    if isinstance(camera, ExposureLocking):
        camera.lock_exposure(lambda: _flight_is_near(wires.vehicle.latest()))
    remarks = camera.remarks if isinstance(camera, CameraRemarks) else tuple
    compile_ahead()
    camera, poses = pose_sources.open_poses(pose_sources.SourceContext(config, wires, clock, camera, mount))
    pad = None
    if config.localization.origin == "pad" and config.camera.source != "recorded":
        heading_rad = math.radians(config.localization.pad_heading_deg)
        poses = pad = PadOrigin(poses, wires.vehicle, config.runtime.folder / PAD_FILE, heading_rad=heading_rad)
    return connect_perception(
        config, wires, clock, camera, poses, mount,
        origin=lambda: None if pad is None else pad.reason, remarks=remarks, writer=writer,
    )  # fmt: skip


def connect_perception(
    config: Config,
    wires: FlightChannels,
    clock: Clock,
    camera: DepthCamera,
    poses: PoseSource,
    mount: Mount,
    *,
    origin: Callable[[], Reason | None] = lambda: None,
    remarks: Callable[[], tuple[Reason, ...]] = tuple,
    writer: Executor | None = None,
) -> Perception:
    """Build the stages of perception on an open camera and an open pose source.

    origin: where the take-off pad is, if not at the pose source's origin. remarks: of the camera. writer: writes the kept
    calibration.
    """
    from uav_recon.localization.calibration.kept_calibration import KeptCalibration
    from uav_recon.localization.correction.odometry_correction import NoCorrection
    from uav_recon.localization.fusion.fusion_filter import FusionFilter
    from uav_recon.localization.perception.perception import Perception

    tracks = config.localization.source == "slam"  # the poses come from the frames themselves
    bridged_s = SLAM_BRIDGED_S if tracks else 0.0
    fusion = FusionFilter(pose_lost_s=config.localization.pose_lost_s, bridged_s=bridged_s)
    rate_hz, wait_s = config.localization.rate_hz, config.localization.frame_wait_s
    file = config.localization.calibration
    kept = KeptCalibration(file, camera_sources.mount_text(config), writer or InlineExecutor(clock)) if file else None
    return Perception(
        camera, poses, fusion, mount, wires.odom, wires.frames, wires.nearby, wires.perception, clock, rate_hz, wait_s,
        origin=origin, remarks=remarks, rates=wires.rates, kept=kept, consistency=_consistency(config),
        correction=_tracked_correction(fusion) if corrects_drift(config) else NoCorrection(),
    )  # fmt: skip


def _consistency(config: Config) -> DepthConsistencyMonitor | ReconciledConsistency:
    """Return the comparison of depth with earlier views.

    Poses that come from the frames themselves contain the errors of their mount.
    """
    from uav_recon.localization.consistency.depth_consistency import DepthConsistencyMonitor
    from uav_recon.localization.consistency.reconciled_consistency import ReconciledConsistency

    if corrects_drift(config):
        return ReconciledConsistency()
    return DepthConsistencyMonitor(corrects=config.localization.source != "slam")


def corrects_drift(config: Config) -> bool:
    """Return whether a tracker runs beside the pose source.

    The poses of the embedded SLAM are those of the tracker.
    """
    return config.localization.correct_drift and config.localization.source != "slam"


def _tracked_correction(fusion: FusionFilter) -> OdometryCorrection:
    from uav_recon.localization.correction.odometry_correction import TrackedCorrection
    from uav_recon.localization.slam import slam_tracker

    slam_tracker.warm_up()
    return TrackedCorrection(fusion.odom_at)


def _flight_is_near(vehicle: VehicleState | None) -> bool:
    """Return True from the request to arm until the motors have stopped."""
    return vehicle is not None and (vehicle.armed or vehicle.phase is FlightPhase.ARMING)
