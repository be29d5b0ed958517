"""Factory of perception: opens the camera and the pose source."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from uav_recon.app import camera_sources, pose_sources
from uav_recon.app.flight_channels import FlightChannels
from uav_recon.clock import InlineExecutor
from uav_recon.config import Config
from uav_recon.interfaces import CameraRemarks, Clock, Executor, ExposureLocking
from uav_recon.types.vehicle import FlightPhase, VehicleState

if TYPE_CHECKING:  # each process imports only the stages that it runs
    from uav_recon.localization.calibration.camera_mount import Mount
    from uav_recon.localization.calibration.kept_calibration import KeptCalibration, NoKeptCalibration
    from uav_recon.localization.perception.perception import Perception

PAD_FILE = "pad_origin.json"  # in the runtime folder


def make_perception(
    config: Config,
    channels: FlightChannels,
    clock: Clock,
    stopped: Callable[[], bool] = lambda: False,
    compile_ahead: Callable[[], None] = lambda: None,
    writer: Executor | None = None,
) -> Perception:
    """Build the loop next to the camera. compile_ahead() is called once there is a camera.

    writer: writes the camera's errors and the tracker's map beside the loop; None: on the clock of a simulation.

    Raises UserError if there is no camera; with exit code 0 if stopped() becomes true while it waits for one.
    """
    camera, mount = camera_sources.open_camera(config, clock, stopped), _mount(config, channels)
    if isinstance(camera, ExposureLocking):
        camera.lock_exposure(lambda: _flight_is_near(channels.vehicle.latest()))
    remarks = camera.remarks if isinstance(camera, CameraRemarks) else tuple
    compile_ahead()
    writer = writer or InlineExecutor(clock)
    context = pose_sources.SourceContext(config, channels, clock, camera, mount, writer)
    opened = pose_sources.with_view(pose_sources.open_poses(context), context)
    poses = opened.poses
    if config.localization.origin == "pad" and config.camera.source != "recorded":
        from uav_recon.localization.pad_origin import PadOrigin

        heading_rad = math.radians(config.localization.pad_heading_deg)
        poses = PadOrigin(poses, channels.vehicle, config.runtime.folder / PAD_FILE, heading_rad=heading_rad)
    from uav_recon.localization.perception.perception import Perception

    kept = _kept_calibration(config, writer)
    return Perception(
        config.localization, opened.camera, poses, mount, channels, clock, view=opened.view, kept=kept, remarks=remarks
    )


def _mount(config: Config, channels: FlightChannels) -> Mount:
    from uav_recon.localization.calibration.camera_mount import FixedMount, GimbalMount

    if config.camera.mount == "fixed":
        return FixedMount(camera_sources.tilted_camera(config))
    return GimbalMount(np.array(config.camera.position_body_m), channels.vehicle)


def _kept_calibration(config: Config, writer: Executor) -> KeptCalibration | NoKeptCalibration:
    """Return the file of the camera's errors that the config names; writer writes it."""
    from uav_recon.localization.calibration.kept_calibration import KeptCalibration, NoKeptCalibration

    file = config.localization.calibration
    return KeptCalibration(file, camera_sources.mount_text(config), writer) if file else NoKeptCalibration()


def _flight_is_near(vehicle: VehicleState | None) -> bool:
    """Return True from the request to arm until the motors have stopped."""
    return vehicle is not None and (vehicle.armed or vehicle.phase is FlightPhase.ARMING)
