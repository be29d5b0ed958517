"""A RealSense device: what it is and offers, and a session with its running streams.

The sensors are opened one by one (sensor.open and start of librealsense) and not by its pipeline, which chooses among the
offers by itself. Frames and samples come by callbacks on threads of librealsense, which only store them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uav_recon.interfaces import Clock
from uav_recon.sensors.stamp_clock import StampDomain
from uav_recon.sensors.stream_format import StreamError
from uav_recon.sensors.stream_profiles import StreamChoice, StreamKind, StreamProfile, choose_streams
from uav_recon.types.camera import Intrinsics
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

_IMAGES = 8  # images of a stream that wait to be read: a quarter of a second
_SAMPLES = 4096  # inertial samples that wait to be read: several seconds

Devices = Callable[[], list[Any]]


class RealSenseError(StreamError):
    """Raised if there is no camera or it is gone; the text is one line and gives the remedy."""


def library() -> Any:
    """Return pyrealsense2. Raises RealSenseError if it is not installed, or cannot be loaded."""
    try:
        import pyrealsense2
    except ModuleNotFoundError:
        raise RealSenseError("pyrealsense2 is not installed: pip install uav-recon[realsense]") from None
    except ImportError as error:  # on Debian: apt install libusb-1.0-0
        raise RealSenseError(f"pyrealsense2 cannot be loaded ({error}): install that library") from None
    return pyrealsense2


def connected_devices() -> list[Any]:
    """Return the connected devices, by a new context.

    An old context may miss a device that was plugged in again. Blocks for up to a second. Raises RealSenseError if the bus
    cannot be listed.
    """
    rs = library()
    with device_errors("USB"):
        return list(rs.context().query_devices())


@contextmanager
def device_errors(name: str) -> Iterator[None]:
    """Turn an error of librealsense into a RealSenseError of one line.

    The line begins with the name.
    """
    try:
        yield
    except RuntimeError as error:
        raise RealSenseError(f"RealSense {name}: {one_line(error)}") from None


def find_device(devices: Devices, serial: str | None) -> Any:
    """Return the device of this serial number, or the first one.

    Raises RealSenseError (one line) without it.
    """
    rs = library()
    found = devices()
    serials = [_info(rs, device, rs.camera_info.serial_number) or "?" for device in found]
    for device, number in zip(found, serials, strict=True):
        if serial in (None, number):
            return device
    seen = ", ".join(serials) or "none"
    raise RealSenseError(f"RealSense camera {serial or 'of any serial'} is not connected (seen: {seen})")


def open_recording(path: Path) -> Any:
    """Return the device of a recording (.db3), played once in real time.

    Raises RealSenseError without it.
    """
    rs = library()
    if not path.is_file():
        raise RealSenseError(f"{path}: no such recording")
    try:
        playback = rs.context().load_device(str(path))
        playback.set_real_time(True)
    except RuntimeError as error:
        raise RealSenseError(f"{path}: {one_line(error)}") from None
    return playback


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """Description of a device by itself, as text; '' where it gives none.

    temperature_c: of its processor, None if not offered.
    """

    name: str
    serial: str
    firmware: str
    usb: str
    sdk: str
    temperature_c: float | None = None

    @property
    def usb2(self) -> bool:
        """True for a device that is connected by USB 2 or less."""
        return self.usb[:1] in ("1", "2")

    @staticmethod
    def of(device: Any) -> DeviceInfo:
        """Read the information from a device. It blocks for some milliseconds."""
        rs = library()
        info = rs.camera_info
        return DeviceInfo(
            name=_info(rs, device, info.name),
            serial=_info(rs, device, info.serial_number),
            firmware=_info(rs, device, info.firmware_version),
            usb=_info(rs, device, info.usb_type_descriptor),
            sdk=str(rs.__version__),
            temperature_c=_temperature_c(rs, device),
        )


def stream_offers(device: Any) -> tuple[list[StreamProfile], list[Any]]:
    """Return the streams that a device offers in the formats used here.

    The second list holds librealsense's profile of each, by its index.
    """
    rs = library()
    kinds = {
        (rs.stream.depth, rs.format.z16): StreamKind.DEPTH,
        (rs.stream.color, rs.format.rgb8): StreamKind.COLOUR,
        (rs.stream.gyro, rs.format.motion_xyz32f): StreamKind.GYRO,
        (rs.stream.accel, rs.format.motion_xyz32f): StreamKind.ACCEL,
    }
    offers: list[StreamProfile] = []
    profiles: list[Any] = []
    for number, sensor in enumerate(device.query_sensors()):
        for profile in sensor.get_stream_profiles():
            kind = kinds.get((profile.stream_type(), profile.format()))
            if kind is None:
                continue
            size = (0, 0)
            if kind in (StreamKind.DEPTH, StreamKind.COLOUR):
                video = profile.as_video_stream_profile()
                size = (video.width(), video.height())
            offers.append(StreamProfile(kind, profile.fps(), *size, index=len(profiles), sensor=number))
            profiles.append(profile)
    return offers, profiles


def recorded_streams(offers: list[StreamProfile], path: Path) -> StreamChoice:
    """Return the streams of a recording, of any size.

    Raises RealSenseError without depth (z16) and colour (rgb8).
    """
    first = {kind: next((offer for offer in offers if offer.kind is kind), None) for kind in StreamKind}
    depth, colour = first[StreamKind.DEPTH], first[StreamKind.COLOUR]
    if depth is None or colour is None:
        raise RealSenseError(f"RealSense {path}: want depth as z16 and colour as rgb8, it lacks one of them")
    gyro, accel = first[StreamKind.GYRO], first[StreamKind.ACCEL]
    both = gyro is not None and accel is not None
    return StreamChoice(depth, colour, gyro if both else None, accel if both else None, "as recorded")


class ImageArrival(NamedTuple):
    """An image of librealsense with its stamp.

    arrival_s, wall_s: its arrival on the companion's clock, and the same instant as system time.
    """

    image: Any
    number: int
    domain: StampDomain
    stamp_s: float
    arrival_s: float
    wall_s: float


class SampleArrival(NamedTuple):
    """An inertial sample in the sensor's axes, with the same times."""

    kind: StreamKind
    values: tuple[float, float, float]
    domain: StampDomain
    stamp_s: float
    arrival_s: float
    wall_s: float


class RealSenseSession:
    """The running streams of one device.

    Opening and close() take seconds and may block for ever if the USB bus hangs; everything else never blocks. Raises
    RealSenseError (one line) if the streams cannot be opened. ``depth``, ``colour`` and ``samples``: what has arrived and was
    not read yet, oldest first.
    """

    def __init__(
        self, device: Any, clock: Clock, wall_s: Callable[[], float], *, want_imu: bool, playback: Path | None = None
    ) -> None:
        self._rs = library()
        self._clock = clock
        self._wall_s = wall_s
        self._recorded = playback is not None
        self.depth: deque[ImageArrival] = deque(maxlen=_IMAGES)
        self.colour: deque[ImageArrival] = deque(maxlen=_IMAGES)
        self.samples: deque[SampleArrival] = deque(maxlen=_SAMPLES)
        self.info = DeviceInfo.of(device)
        self._device = device  # librealsense ends a device that nobody holds
        self._sensors = list(device.query_sensors())
        self._open: list[Any] = []
        offers, profiles = stream_offers(device)
        self.choice = choose_streams(offers, self.info.usb2) if playback is None else recorded_streams(offers, playback)
        try:
            self._read_calibration(profiles)
            self._start(profiles, want_imu)
        except RuntimeError as error:
            self.close()
            raise RealSenseError(f"RealSense {self.info.serial or playback or ''}: {one_line(error)}") from None

    def _read_calibration(self, profiles: list[Any]) -> None:
        choice = self.choice
        depth = profiles[choice.depth.index].as_video_stream_profile()
        colour = profiles[choice.colour.index].as_video_stream_profile()
        self.depth_intrinsics = _intrinsics(depth.intrinsics)
        self.colour_intrinsics = _intrinsics(colour.intrinsics)
        self.colour_from_depth = _pose(depth.get_extrinsics_to(colour))
        self.metres_per_unit = float(self._sensors[choice.depth.sensor].get_option(self._rs.option.depth_units))
        self.depth_from_imu = np.eye(3) if choice.gyro is None else _depth_from_imu(profiles[choice.gyro.index], depth)

    def _start(self, profiles: list[Any], want_imu: bool) -> None:
        choice = self.choice
        wanted = [choice.depth, choice.colour]
        self.has_imu = want_imu and choice.gyro is not None
        if want_imu and choice.gyro is not None and choice.accel is not None:
            wanted += [choice.gyro, choice.accel]
        for number, sensor in enumerate(self._sensors):
            chosen = [profiles[profile.index] for profile in wanted if profile.sensor == number]
            if chosen:
                sensor.open(chosen)
                self._open.append(sensor)
                sensor.start(self._take)

    @property
    def colour_sensor(self) -> Any:
        """The sensor of the colour stream, in librealsense's terms.

        None if it is that of depth as well.
        """
        choice = self.choice
        return self._sensors[choice.colour.sensor] if choice.colour.sensor != choice.depth.sensor else None

    def close(self) -> None:
        """Stop the streams. It may block for ever; an error of a device that is gone is dropped."""
        self.depth.clear()
        self.colour.clear()
        while self._open:
            sensor = self._open.pop()
            with suppress(RuntimeError):
                sensor.stop()
            with suppress(RuntimeError):
                sensor.close()

    def _take(self, frame: Any) -> None:
        """Store a frame; called on librealsense's thread, so it only copies."""
        now_s, wall_s = self._clock.now_s(), self._wall_s()
        stamp_s = 0.001 * float(frame.get_timestamp())
        domain = self._domain(frame.get_frame_timestamp_domain())
        kind = frame.get_profile().stream_type()
        if kind in (self._rs.stream.depth, self._rs.stream.color):
            queue = self.depth if kind == self._rs.stream.depth else self.colour
            queue.append(ImageArrival(frame, int(frame.get_frame_number()), domain, stamp_s, now_s, wall_s))
            return
        data = frame.as_motion_frame().get_motion_data()
        name = StreamKind.GYRO if kind == self._rs.stream.gyro else StreamKind.ACCEL
        self.samples.append(SampleArrival(name, (data.x, data.y, data.z), domain, stamp_s, now_s, wall_s))

    def _domain(self, domain: Any) -> StampDomain:
        """Return the domain of a stamp.

        Those of a recording are of another time, as those of any clock.
        """
        if self._recorded or domain == self._rs.timestamp_domain.hardware_clock:
            return StampDomain.HARDWARE
        return StampDomain.SYSTEM if domain == self._rs.timestamp_domain.system_time else StampDomain.GLOBAL


class ColourControls:
    """Exposure and white balance of a session's colour sensor, as ExposureControls.

    sensor: None if colour has no sensor of its own. Errors are RealSenseError.
    """

    def __init__(self, sensor: Any) -> None:
        self._sensor = sensor
        self._option = library().option

    def lock(self) -> tuple[float, float]:
        """Keep the present values.

        Some devices fall back to the last manual value when they are told to stop adapting: so the values are set as well.
        """
        option, sensor = self._option, self._sensor
        if sensor is None:
            raise RealSenseError("colour comes from the depth sensor, which has to adapt")
        automatic = (option.enable_auto_exposure, option.enable_auto_white_balance)
        try:
            if not all(sensor.supports(name) for name in automatic):
                raise RealSenseError("the colour camera has no such control")
            kept = {
                name: float(sensor.get_option(name))
                for name in (option.exposure, option.gain, option.white_balance)
                if sensor.supports(name)
            }
            for name in automatic:
                sensor.set_option(name, 0.0)
            for name, value in kept.items():
                sensor.set_option(name, value)
            if any(sensor.get_option(name) for name in automatic):
                raise RealSenseError("the colour camera stays automatic")
        except RuntimeError as error:
            raise RealSenseError(one_line(error)) from None
        return kept.get(option.exposure, np.nan), kept.get(option.white_balance, np.nan)

    def release(self) -> None:
        """Make both automatic again."""
        try:
            for name in (self._option.enable_auto_exposure, self._option.enable_auto_white_balance):
                if self._sensor is not None and self._sensor.supports(name):
                    self._sensor.set_option(name, 1.0)
        except RuntimeError as error:
            raise RealSenseError(one_line(error)) from None


def emitter_on(image: Any) -> bool | None:
    """Return whether the infrared emitter was on in a depth image.

    None if its metadata does not tell.
    """
    kind = library().frame_metadata_value.frame_laser_power_mode
    return bool(image.get_frame_metadata(kind)) if image.supports_frame_metadata(kind) else None


def one_line(error: Exception) -> str:
    """Return the text of an error in one line."""
    return " ".join(str(error).split())


def _info(rs: Any, device: Any, kind: Any) -> str:
    try:
        return str(device.get_info(kind)) if device.supports(kind) else ""
    except RuntimeError:  # it was unplugged in between
        return ""


def _temperature_c(rs: Any, device: Any) -> float | None:
    for sensor in device.query_sensors():
        with suppress(RuntimeError):  # read only while it streams on some models
            if sensor.supports(rs.option.asic_temperature):
                return float(sensor.get_option(rs.option.asic_temperature))
    return None


def _intrinsics(theirs: Any) -> Intrinsics:
    return Intrinsics(theirs.fx, theirs.fy, theirs.ppx, theirs.ppy, theirs.width, theirs.height)


def _depth_from_imu(gyro: Any, depth: Any) -> FloatArray:
    """Return the rotation (3, 3).

    librealsense returns samples in the axes of the depth imager, so unknown extrinsics mean identity.
    """
    try:
        return _pose(gyro.get_extrinsics_to(depth)).rotation()
    except RuntimeError:
        return np.eye(3)


def _pose(extrinsics: Any) -> Pose:
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(extrinsics.rotation).reshape(3, 3).T
    matrix[:3, 3] = extrinsics.translation
    return Pose.from_matrix(matrix)
