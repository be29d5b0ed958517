"""The pose source that the config names: `localization.source`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from uav_recon.app import camera_sources
from uav_recon.app.flight_channels import FlightChannels
from uav_recon.config import Config
from uav_recon.errors import UserError
from uav_recon.interfaces import Clock, DepthCamera, Executor, PoseSource
from uav_recon.sensors.stream_format import StreamError
from uav_recon.types.pose import Pose

if TYPE_CHECKING:  # the pilot's process imports no stage of perception
    from uav_recon.localization.calibration.camera_mount import Mount
    from uav_recon.localization.slam.slam_tracker import SlamTracker
    from uav_recon.localization.slam.view_odometry import ViewOdometry


@dataclass(frozen=True)
class OpenedPoses:
    """An opened pose source.

    camera: to read from now on; one that tracks the images shows its tracker each frame. poses: of the source. view: odometry
    of the tracked images, None without a tracker.
    """

    camera: DepthCamera
    poses: PoseSource
    view: ViewOdometry | None = None


@dataclass(frozen=True)
class SourceContext:
    """Objects that a pose source may use.

    They are the config, the channels, the clock, the camera, and the pose of the camera on the body.
    writer: writes what the next flight reads; None if nothing is left to it.
    """

    config: Config
    channels: FlightChannels
    clock: Clock
    camera: DepthCamera
    mount: Mount
    writer: Executor | None = None


def open_poses(context: SourceContext) -> OpenedPoses:
    """Open the source of the poses. Raises UserError (one line) if it cannot be opened."""
    try:
        return _OPENERS[context.config.localization.source](context)
    except StreamError as error:
        raise UserError(str(error)) from None


def with_view(opened: OpenedPoses, context: SourceContext) -> OpenedPoses:
    """Return a source with a tracker of the images beside it, which checks its poses."""
    if opened.view is not None:
        return opened
    from uav_recon.localization.slam.slam_source import TrackedCamera

    view = _view(context, Pose.identity())
    return OpenedPoses(TrackedCamera(opened.camera, context.mount, view, now_s=context.clock.now_s), opened.poses, view)


def _view(context: SourceContext, world_from_tracker: Pose | None) -> ViewOdometry:
    """Return the odometry of the tracked images, with the file of its map."""
    from uav_recon.localization.slam.kept_map import KeptMap
    from uav_recon.localization.slam.view_odometry import ViewOdometry

    tracker, file = _tracker(context), context.config.localization.flown_map
    kept_map = KeptMap(file, lambda: tracker.surfaces, context.writer) if file and context.writer else None
    return ViewOdometry(tracker, world_from_tracker, kept_map)


def _tracker(context: SourceContext) -> SlamTracker:
    """Return a tracker with its kernels compiled; it takes optical flow if the vehicle has it."""
    from uav_recon.localization.flow.flow_samples import FlowGeometry
    from uav_recon.localization.slam.outside_motion import FlowMotion
    from uav_recon.localization.slam.slam_tracker import SlamTracker, warm_up

    warm_up()
    flow = context.config.flow
    if not flow.enabled:
        return SlamTracker()
    geometry = FlowGeometry(np.array(flow.position_body_m), np.array(flow.range_position_body_m))
    return SlamTracker(FlowMotion(geometry, context.channels.flow))


def _open_stream_poses(context: SourceContext) -> OpenedPoses:
    config = context.config
    if config.camera.source == "recorded":
        from uav_recon.sensors.recorded_camera import RecordedPoses

        folder, tilted = camera_sources.recording_folder(config), camera_sources.tilted_camera(config)
        return OpenedPoses(context.camera, RecordedPoses(folder, context.clock, tilted))
    from uav_recon.sensors.stream_camera import StreamPoses

    return OpenedPoses(context.camera, StreamPoses(camera_sources.stream_path(config)))


def _open_slam(context: SourceContext) -> OpenedPoses:
    from uav_recon.localization.slam.slam_source import SlamSource

    source = SlamSource(context.camera, context.mount, _view(context, None), now_s=context.clock.now_s)
    return OpenedPoses(source, source, source.odometry)


def _open_ros2_poses(context: SourceContext) -> OpenedPoses:
    from uav_recon.sensors.ros2 import Ros2Poses

    return OpenedPoses(context.camera, Ros2Poses(context.config.ros2, context.clock))


def _open_autopilot_poses(context: SourceContext) -> OpenedPoses:
    from uav_recon.sensors.autopilot_poses import AutopilotPoses

    return OpenedPoses(context.camera, AutopilotPoses(context.channels.reported))


_OPENERS: dict[str, Callable[[SourceContext], OpenedPoses]] = {
    "stream": _open_stream_poses,
    "slam": _open_slam,
    "ros2": _open_ros2_poses,
    "autopilot": _open_autopilot_poses,
}
