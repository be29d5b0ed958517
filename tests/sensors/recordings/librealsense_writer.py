"""A recording by librealsense itself, of a device in software. librealsense_2.55.bag.gz was written so by pyrealsense2 2.55.1.

Another version writes its own format: python librealsense_writer.py OUT.bag
"""

from __future__ import annotations

import gc
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyrealsense2 as rs
from scipy.spatial.transform import Rotation

FRAMES = 4
DEPTH = (32, 24, 20.0, 21.0, 15.25, 11.75)
RGB = (40, 30, 33.0, 34.0, 19.25, 14.5)
ROTATION = Rotation.from_euler("xyz", [0.01, -0.02, 0.03]).as_matrix()  # of rgb_from_depth
TRANSLATION = [0.015, 0.001, -0.002]
UNIT_M = 0.0005
BEGIN_MS = 1000.0
STEP_MS = 40.0


def depth_pixels(number: int) -> Any:
    pixels = np.full((DEPTH[1], DEPTH[0]), 3000 + 2 * number, np.uint16)  # 1.5 m
    pixels[:, :5] = 0
    return pixels


def rgb_pixels(number: int) -> Any:
    pixels = np.full((RGB[1], RGB[0], 3), 20 * number, np.uint8)
    pixels[..., 0] = 200
    return pixels


def write(path: Path, *, compress: bool = True) -> None:
    """Write frames 40 ms apart by their stamps; they reach the recorder at once."""
    device = rs.software_device()
    device.create_matcher(rs.matchers.dlr_c)
    stereo, colour, motion = (device.add_sensor(name) for name in ("Stereo Module", "RGB Camera", "Motion Module"))
    depth = stereo.add_video_stream(video_stream(rs.stream.depth, 0, rs.format.z16, 2, DEPTH))
    rgb = colour.add_video_stream(video_stream(rs.stream.color, 1, rs.format.rgb8, 3, RGB))
    gyro = motion.add_motion_stream(motion_stream(rs.stream.gyro, 2))
    accel = motion.add_motion_stream(motion_stream(rs.stream.accel, 3))
    stereo.add_read_only_option(rs.option.depth_units, UNIT_M)
    rgb_from_depth = rs.extrinsics()
    rgb_from_depth.rotation, rgb_from_depth.translation = ROTATION.T.ravel().tolist(), TRANSLATION  # by columns
    depth.register_extrinsics_to(rgb, rgb_from_depth)
    recorder = rs.recorder(str(path), device, compress)
    sensors = recorder.query_sensors()
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(lambda frame: None)
    for number in range(FRAMES):
        at_ms = BEGIN_MS + number * STEP_MS
        stereo.on_video_frame(_image(depth_pixels(number), depth, number, at_ms))
        colour.on_video_frame(_image(rgb_pixels(number), rgb, number, at_ms + 3.0))
        for profile, data, late_ms in ((accel, (0.1 * number, -9.81, 0.0), 0.0), (gyro, (0.1, 0.2, 0.3), 10.0)):
            frame, vector = rs.software_motion_frame(), rs.vector()
            vector.x, vector.y, vector.z = data
            frame.data, frame.timestamp, frame.domain = vector, at_ms + late_ms, rs.timestamp_domain.hardware_clock
            frame.frame_number, frame.profile = number + 1, profile.as_motion_stream_profile()
            motion.on_motion_frame(frame)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    del sensors, recorder
    gc.collect()


def video_stream(kind: Any, uid: int, fmt: Any, bpp: int, numbers: tuple[float, ...]) -> Any:
    intrinsics = rs.intrinsics()
    intrinsics.width, intrinsics.height = int(numbers[0]), int(numbers[1])
    intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = numbers[2:]
    intrinsics.model, intrinsics.coeffs = rs.distortion.none, [0.0] * 5
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.fmt, stream.bpp, stream.fps = kind, 0, uid, fmt, bpp, 30
    stream.width, stream.height, stream.intrinsics = intrinsics.width, intrinsics.height, intrinsics
    return stream


def motion_stream(kind: Any, uid: int, fps: int = 200) -> Any:
    stream = rs.motion_stream()
    stream.type, stream.index, stream.uid, stream.fmt, stream.fps = kind, 0, uid, rs.format.motion_xyz32f, fps
    stream.intrinsics = rs.motion_device_intrinsic()
    return stream


def _image(pixels: Any, profile: Any, number: int, at_ms: float) -> Any:
    frame = rs.software_video_frame()
    frame.pixels, frame.bpp = pixels, pixels.dtype.itemsize * (pixels.shape[2] if pixels.ndim == 3 else 1)
    frame.stride = pixels.shape[1] * frame.bpp
    frame.timestamp, frame.domain = at_ms, rs.timestamp_domain.hardware_clock
    frame.frame_number, frame.profile = number + 1, profile.as_video_stream_profile()
    if pixels.ndim == 2:
        frame.depth_units = UNIT_M
    return frame


if __name__ == "__main__":
    write(Path(sys.argv[1]))
