"""The pose source that the config names: `localization.source`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from uav_recon.app import camera_sources
from uav_recon.app.flight_channels import FlightChannels
from uav_recon.config import Config
from uav_recon.errors import UserError
from uav_recon.interfaces import Clock, DepthCamera, PoseSource
from uav_recon.sensors.stream_format import StreamError

if TYPE_CHECKING:  # the pilot's process imports no stage of perception
    from uav_recon.localization.calibration.camera_mount import Mount


@dataclass(frozen=True)
class SourceContext:
    """Objects that a pose source may use.

    They are the config, the channels, the clock, the camera, and the pose of the camera on the body.
    """

    config: Config
    channels: FlightChannels
    clock: Clock
    camera: DepthCamera
    mount: Mount


def open_poses(context: SourceContext) -> tuple[DepthCamera, PoseSource]:
    """Open the source of the poses. Returns the camera to read from now on, and the poses.

    A source that tracks the images returns a camera that shows it each frame. Raises UserError (one line) if the source cannot
    be opened.
    """
    try:
        return _OPENERS[context.config.localization.source](context)
    except StreamError as error:
        raise UserError(str(error)) from None


def _open_stream_poses(context: SourceContext) -> tuple[DepthCamera, PoseSource]:
    config = context.config
    if config.camera.source == "recorded":
        from uav_recon.sensors.recorded_camera import RecordedPoses

        folder, tilted = camera_sources.recording_folder(config), camera_sources.tilted_camera(config)
        return context.camera, RecordedPoses(folder, context.clock, tilted)
    from uav_recon.sensors.stream_camera import StreamPoses

    return context.camera, StreamPoses(camera_sources.stream_path(config))


def _open_slam(context: SourceContext) -> tuple[DepthCamera, PoseSource]:
    from uav_recon.localization.slam.slam_source import SlamSource
    from uav_recon.localization.slam.slam_tracker import SlamTracker, warm_up

    warm_up()
    source = SlamSource(context.camera, context.mount, SlamTracker(), now_s=context.clock.now_s)
    return source, source


def _open_ros2_poses(context: SourceContext) -> tuple[DepthCamera, PoseSource]:
    from uav_recon.sensors.ros2 import Ros2Poses

    return context.camera, Ros2Poses(context.config.ros2, context.clock)


def _open_autopilot_poses(context: SourceContext) -> tuple[DepthCamera, PoseSource]:
    from uav_recon.sensors.autopilot_poses import AutopilotPoses

    return context.camera, AutopilotPoses(context.channels.reported)


_OPENERS: dict[str, Callable[[SourceContext], tuple[DepthCamera, PoseSource]]] = {
    "stream": _open_stream_poses,
    "slam": _open_slam,
    "ros2": _open_ros2_poses,
    "autopilot": _open_autopilot_poses,
}
