"""The camera that the config names: `camera.source`."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from uav_recon.config import Config
from uav_recon.errors import EXIT_CONFIG, EXIT_FAILURE, UserError
from uav_recon.interfaces import Clock, DepthCamera
from uav_recon.sensors.corrected_camera import CorrectedCamera
from uav_recon.sensors.stream_format import StreamError
from uav_recon.types.camera import body_from_camera
from uav_recon.types.pose import Pose

CAMERA_WAIT_S = 240.0


def open_camera(config: Config, clock: Clock, stopped: Callable[[], bool] = lambda: False) -> DepthCamera:
    """Open the camera; a stream is waited for.

    Raises UserError (one line) if there is none; with exit code 0 if stopped() becomes true while it is waited for.
    """
    try:
        camera = _OPENERS[config.camera.source](config, clock, stopped)
    except StreamError as error:
        raise UserError(str(error), 0 if stopped() else EXIT_FAILURE) from None
    delay_s, scale = config.camera.delay_s, config.camera.depth_scale
    return CorrectedCamera(camera, delay_s, scale) if delay_s or scale else camera


def tilted_camera(config: Config) -> Pose:
    """Return body_from_depth of a fixed mount."""
    camera = config.camera
    turned = Pose.from_yaw(math.radians(camera.yaw_deg), np.array(camera.position_body_m))
    pitched = body_from_camera(np.zeros(3), math.radians(camera.pitch_down_deg))
    rolled = Pose.from_rotation_vector(np.array([0.0, 0.0, math.radians(camera.roll_deg)]), np.zeros(3))  # optical axes
    return turned @ pitched @ rolled


def mount_text(config: Config) -> str:
    """Return how the config mounts the camera, as text; another text is another mount.

    The source of the poses is in it: the embedded SLAM corrects the stamps of the frames itself.
    """
    camera = config.camera
    turns = f"{camera.pitch_down_deg:g} {camera.roll_deg:g} {camera.yaw_deg:g}"
    tilt = f"fixed {turns}" if camera.mount == "fixed" else "gimbal"
    return f"{tilt} {camera.position_body_m} {camera.delay_s:g} {camera.depth_scale:g} {config.localization.source}"


def stream_path(config: Config) -> Path:
    """Return the path of the camera stream."""
    return config.runtime.folder / config.camera.stream


def recording_folder(config: Config) -> Path:
    """Return the flight folder that is played back. Raises UserError if the config names none."""
    if config.camera.recording is None:
        raise UserError("camera.recording: must name a flight folder where camera.source is recorded", EXIT_CONFIG)
    return config.camera.recording


def _open_stream_camera(config: Config, clock: Clock, stopped: Callable[[], bool]) -> DepthCamera:
    from uav_recon.sensors.stream_camera import StreamCamera, open_stream

    open_stream(stream_path(config), clock, CAMERA_WAIT_S, stopped)
    return StreamCamera(stream_path(config), config.camera.depth_min_m, config.camera.depth_max_m)


def _open_recorded_camera(config: Config, clock: Clock, stopped: Callable[[], bool]) -> DepthCamera:
    from uav_recon.sensors.recorded_camera import RecordedCamera

    return RecordedCamera(recording_folder(config), clock, config.camera.depth_min_m, config.camera.depth_max_m)


def _open_realsense_camera(config: Config, clock: Clock, stopped: Callable[[], bool]) -> DepthCamera:
    from uav_recon.sensors.realsense import RealSenseCamera, check_camera
    from uav_recon.sensors.stream_camera import open_stream

    camera = config.camera
    check_camera(camera.recording)
    if config.localization.source == "stream":
        open_stream(stream_path(config), clock, CAMERA_WAIT_S, stopped)  # poses come through it
    body_from_depth = tilted_camera(config) if camera.mount == "fixed" else None
    return RealSenseCamera(
        clock, playback=camera.recording, depth_min_m=camera.depth_min_m, depth_max_m=camera.depth_max_m,
        body_from_depth=body_from_depth,
    )  # fmt: skip


def _open_ros2_camera(config: Config, clock: Clock, stopped: Callable[[], bool]) -> DepthCamera:
    from uav_recon.sensors.ros2 import Ros2Camera
    from uav_recon.sensors.stream_camera import open_stream

    if config.localization.source == "stream":
        open_stream(stream_path(config), clock, CAMERA_WAIT_S, stopped)  # poses come through it
    return Ros2Camera(config.ros2, clock, config.camera.depth_min_m, config.camera.depth_max_m)


_OPENERS: dict[str, Callable[[Config, Clock, Callable[[], bool]], DepthCamera]] = {
    "stream": _open_stream_camera,
    "realsense": _open_realsense_camera,
    "recorded": _open_recorded_camera,
    "ros2": _open_ros2_camera,
}
