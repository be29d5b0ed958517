"""A RealSense camera of librealsense's own software device: the real library, without hardware."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyrealsense2 as rs

from uav_recon.clock import InlineExecutor, ManualClock
from uav_recon.interfaces import Executor
from uav_recon.sensors.realsense import RealSenseCamera
from uav_recon.types.camera import Frame

Size = tuple[int, int, int]  # width, height, rate
USB3 = ((848, 480, 30), (480, 270, 30), (424, 240, 30), (424, 240, 15))
SCALE = 0.001
HARDWARE, SYSTEM, GLOBAL = (
    rs.timestamp_domain.hardware_clock, rs.timestamp_domain.system_time, rs.timestamp_domain.global_time,
)  # fmt: skip


class SoftwareRealSense:
    """A camera whose frames are made here. Stamps are in seconds on the clock that a domain stands for.

    wall_from_clock_s, device_from_clock_s: the other two clocks at the companion's time 0.
    """

    def __init__(
        self,
        clock: ManualClock,
        depth: Sequence[Size] = USB3,
        colour: Sequence[Size] = USB3,
        imu_hz: tuple[int, int] | None = (200, 100),
        usb: str = "3.2",
        firmware: str = "5.16.0.1",
        serial: str = "146322070000",
        controls: dict[Any, float] | None = None,
    ) -> None:
        self.clock = clock
        self.wall_from_clock_s, self.device_from_clock_s = 1.7e9, -90.0
        self.number = 0
        self.device = rs.software_device()
        for kind, text in (
            (rs.camera_info.name, "Intel RealSense D435I"), (rs.camera_info.serial_number, serial),
            (rs.camera_info.firmware_version, firmware), (rs.camera_info.usb_type_descriptor, usb),
        ):  # fmt: skip
            self.device.register_info(kind, text)
        self._stereo, self._rgb = self.device.add_sensor("Stereo Module"), self.device.add_sensor("RGB Camera")
        self._stereo.add_read_only_option(rs.option.depth_units, SCALE)
        self.depth = {size: self._stereo.add_video_stream(_video(rs.stream.depth, k, size)) for k, size in enumerate(depth)}
        self.colour = {size: self._rgb.add_video_stream(_video(rs.stream.color, 50 + k, size)) for k, size in enumerate(colour)}
        offset, same = rs.extrinsics(), rs.extrinsics()
        for extrinsics, x in ((offset, 0.015), (same, 0.0)):
            extrinsics.rotation, extrinsics.translation = np.eye(3).ravel().tolist(), [x, 0.0, 0.0]
        for profile in self.depth.values():
            for other in self.colour.values():
                profile.register_extrinsics_to(other, offset)
        for option, value in (controls or {}).items():
            limits = rs.option_range()
            limits.min, limits.max, limits.default, limits.step = 0.0, 10000.0, value, 1.0
            self._rgb.add_option(option, limits, True)
        self.has_imu = imu_hz is not None
        self._motion = self.device.add_sensor("Motion Module") if imu_hz else None
        if imu_hz and self._motion is not None:
            self._gyro = self._motion.add_motion_stream(_inertial(rs.stream.gyro, 90, imu_hz[0]))
            self._accel = self._motion.add_motion_stream(_inertial(rs.stream.accel, 91, imu_hz[1]))
            for profile in self.depth.values():
                self._gyro.register_extrinsics_to(profile, same)

    def stamp_s(self, domain: Any, taken_s: float) -> float:
        """Return the stamp of an instant of the companion's clock in a domain."""
        return taken_s + (self.device_from_clock_s if domain == HARDWARE else self.wall_from_clock_s)

    def send(
        self, size: Size, colour_size: Size, taken_s: float, domain: Any = HARDWARE, depth_mm: Any = 2000, colour: bool = True
    ) -> None:
        """Send a depth and a colour image that were taken at an instant of the companion's clock."""
        self.number += 1
        stamp_s = self.stamp_s(domain, taken_s)
        pixels = np.full((size[1], size[0]), depth_mm, np.uint16)
        image = np.full((colour_size[1], colour_size[0], 3), self.number % 200, np.uint8)
        self._stereo.on_video_frame(self._image(pixels, self.depth[size], stamp_s, domain))
        if colour:
            self._rgb.on_video_frame(self._image(image, self.colour[colour_size], stamp_s, domain))

    def send_motion(
        self, taken_s: float, domain: Any = HARDWARE, gyro: Sequence[float] = (0.1, 0.2, 0.3),
        force: Sequence[float] = (0.0, -9.81, 0.1),
    ) -> None:  # fmt: skip
        """Send a sample of the accelerometer and one of the gyro."""
        assert self._motion is not None
        for profile, data in ((self._accel, force), (self._gyro, gyro)):
            frame, vector = rs.software_motion_frame(), rs.vector()
            vector.x, vector.y, vector.z = data
            frame.data, frame.timestamp, frame.domain = vector, 1e3 * self.stamp_s(domain, taken_s), domain
            frame.frame_number, frame.profile = self.number, profile.as_motion_stream_profile()
            self._motion.on_motion_frame(frame)

    def set_emitter(self, on: bool) -> None:
        """Set the metadata of the following depth images."""
        self._stereo.set_metadata(rs.frame_metadata_value.frame_laser_power_mode, int(on))

    def _image(self, pixels: Any, profile: Any, stamp_s: float, domain: Any) -> Any:
        frame = rs.software_video_frame()
        frame.pixels, frame.bpp = pixels, pixels.dtype.itemsize * (3 if pixels.ndim == 3 else 1)
        frame.stride = pixels.shape[1] * frame.bpp
        frame.timestamp, frame.domain = 1e3 * stamp_s, domain
        frame.frame_number, frame.profile = self.number, profile.as_video_stream_profile()
        if pixels.ndim == 2:
            frame.depth_units = SCALE
        return frame


class Rig:
    """A software camera and the product's driver on one manual clock; frames arrive 5 ms after they were taken."""

    def __init__(self, source: SoftwareRealSense, executor: Executor | None = None, **options: Any) -> None:
        self.source, self.clock = source, source.clock
        self.connected = True
        self.sends = True
        self.delay_s = 0.005
        self.domain: Any = HARDWARE
        self.lists = 0
        self.camera = RealSenseCamera(
            self.clock, wall_s=lambda: self.clock.now_s() + source.wall_from_clock_s, devices=self.devices,
            executor=executor or InlineExecutor(self.clock), **options,
        )  # fmt: skip
        choice = self.camera._choice
        self.size = (choice.depth.width, choice.depth.height, choice.depth.rate_hz)
        self.colour_size = (choice.colour.width, choice.colour.height, choice.colour.rate_hz)

    def devices(self) -> list[Any]:
        """List the connected devices, as a new context would."""
        self.lists += 1
        return [self.source.device] if self.connected else []

    def run(self, seconds: float, **sent: Any) -> list[tuple[float, Frame]]:
        """Send and poll frames at the camera's rate; returns each frame with the time of its poll."""
        out = []
        for _ in range(round(seconds * self.size[2])):
            self.clock.advance_to(self.clock.now_s() + 1 / self.size[2])
            if self.sends:
                self.source.send(self.size, self.colour_size, self.clock.now_s() - self.delay_s, self.domain, **sent)
            frame = self.camera.poll()
            if frame is not None:
                out.append((self.clock.now_s(), frame))
        return out


def _video(kind: Any, uid: int, size: Size) -> Any:
    width, height, rate = size
    intrinsics = rs.intrinsics()
    intrinsics.width, intrinsics.height, intrinsics.fx, intrinsics.fy = width, height, 0.5 * width, 0.5 * width
    intrinsics.ppx, intrinsics.ppy = (width - 1) / 2, (height - 1) / 2
    intrinsics.model, intrinsics.coeffs = rs.distortion.none, [0.0] * 5
    stream = rs.video_stream()
    depth = kind == rs.stream.depth
    stream.type, stream.index, stream.uid = kind, 0, uid
    stream.fmt, stream.bpp, stream.fps = (rs.format.z16 if depth else rs.format.rgb8), (2 if depth else 3), rate
    stream.width, stream.height, stream.intrinsics = width, height, intrinsics
    return stream


def _inertial(kind: Any, uid: int, rate: int) -> Any:
    stream = rs.motion_stream()
    stream.type, stream.index, stream.uid, stream.fmt, stream.fps = kind, 0, uid, rs.format.motion_xyz32f, rate
    stream.intrinsics = rs.motion_device_intrinsic()
    return stream
