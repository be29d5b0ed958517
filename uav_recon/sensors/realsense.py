"""Intel RealSense depth cameras, live or from a recorder file (.db3), through librealsense.

librealsense puts pixel (0, 0) at the centre of the first pixel, as this project does (see its projection documentation), so
intrinsics are used unchanged. Its rotations are column-major. Inertial samples are in the axes of the camera and are rotated
to the body by the fixed mount.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np

from uav_recon.interfaces import Clock
from uav_recon.sensors.stream_camera import depth_lookup_table
from uav_recon.sensors.stream_format import StreamError
from uav_recon.types.camera import Frame, ImuSample, Intrinsics
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

_WINDOW_S = 10.0  # the clock offset follows 20 ppm of drift to 0.2 ms
_SETTLES_S = 0.5  # frames are dropped for this time after a change of the stamp clock (hazard C7)
_FIRST_FRAME_S = 5.0  # the default timeout of librealsense itself
_SILENCE_S = 1.5  # with RestartSec a restart is tried two seconds after the last frame (hazard C2)


class RealSenseError(StreamError):
    """Raised if there is no camera or it is gone; the text is one line and gives the remedy."""


def _library() -> Any:
    try:
        import pyrealsense2
    except ModuleNotFoundError:
        raise RealSenseError("pyrealsense2 is not installed: pip install uav-recon[realsense]") from None
    except ImportError as error:  # on Debian: apt install libusb-1.0-0
        raise RealSenseError(f"pyrealsense2 cannot be loaded ({error}): install that library") from None
    return pyrealsense2


def check_camera(playback: Path | None = None) -> None:
    """Check that a camera or recording can be opened.

    Raises RealSenseError without the library, the camera or the recording.
    """
    _settings(_library(), None, playback)


class ClockOffset:
    """Converts device stamps to the monotonic clock.

    The shortest delay between stamp and arrival in the last 10 to 20 s is taken as zero. The estimate starts again if the
    device clock was reset (more than ``reset_s`` off).
    """

    def __init__(self, reset_s: float = 1.0) -> None:
        self._reset_s = reset_s
        self._since_s = -math.inf
        self._older_s = self._newer_s = math.inf  # smallest difference in the last window and in this one

    def monotonic_s(self, stamp_s: float, arrival_s: float) -> float:
        """Return the stamp on the clock of the arrival; never later than the arrival."""
        difference_s = arrival_s - stamp_s
        known_s = min(self._older_s, self._newer_s)
        if abs(difference_s - known_s) > self._reset_s or arrival_s < self._since_s:
            self._older_s = math.inf
            self._newer_s = difference_s
            self._since_s = arrival_s
        elif arrival_s - self._since_s > _WINDOW_S:
            self._older_s = self._newer_s
            self._newer_s = difference_s
            self._since_s = arrival_s
        self._newer_s = min(self._newer_s, difference_s)
        return stamp_s + min(self._older_s, self._newer_s)


class RealSenseCamera:
    """Camera protocol over librealsense.

    Raises RealSenseError (one line) if there is no such camera, if it is disconnected, or if it is open but sends no frames,
    which librealsense does not report. serial: None selects the first camera found. playback: a .db3 file instead of a
    camera. body_from_depth: the fixed mount, only used to rotate inertial samples to body axes; without it there are none.
    dropped_frames counts frames that are not newer than the one before, have no colour image of the same time, or come less
    than half a second after a change of the stamp clock (that of the device, of this machine, or the machine clock as
    estimated by librealsense). Opening takes seconds; poll() and imu() never block.
    """

    def __init__(
        self,
        clock: Clock,
        serial: str | None = None,
        width: int = 424,
        height: int = 240,
        fps: int = 30,
        playback: Path | None = None,
        depth_min_m: float = 0.3,
        depth_max_m: float = 6.0,
        body_from_depth: Pose | None = None,
        wall_s: Callable[[], float] = time.time,
    ) -> None:
        self._rs = _library()
        self._clock = clock
        self._wall_s = wall_s
        self._offset = ClockOffset()
        self._live = playback is None
        self.dropped_frames = 0
        self._before_s = -math.inf
        self._pair_s = 0.6 / fps
        self._number = -1
        self._domain = cast("Any", None)
        self._settled_s = -math.inf
        # start of the silence (inf: never polled), and its limit
        self._silent_s = math.inf
        self._silence_limit_s = _FIRST_FRAME_S
        self._pipeline = self._rs.pipeline()
        settings = _settings(self._rs, serial, playback)
        if playback is None:
            settings.enable_stream(self._rs.stream.depth, width, height, self._rs.format.z16, fps)
            settings.enable_stream(self._rs.stream.color, width, height, self._rs.format.rgb8, fps)
        else:  # any recorded size
            settings.enable_stream(self._rs.stream.depth)
            settings.enable_stream(self._rs.stream.color)
        try:
            profile = self._pipeline.start(settings)
            self._name = f"RealSense {playback or profile.get_device().get_info(self._rs.camera_info.serial_number)}"
            depth = profile.get_stream(self._rs.stream.depth).as_video_stream_profile()
            rgb = profile.get_stream(self._rs.stream.color).as_video_stream_profile()
            self._metres_per_unit = float(profile.get_device().first_depth_sensor().get_depth_scale())
            self._depth_intrinsics = _intrinsics(depth.intrinsics)
            self._rgb_intrinsics = _intrinsics(rgb.intrinsics)
            self._rgb_from_depth = _pose(depth.get_extrinsics_to(rgb))
        except RuntimeError as error:
            raise RealSenseError(f"RealSense {serial or playback or ''}: {' '.join(str(error).split())}") from None
        if rgb.format() != self._rs.format.rgb8 or depth.format() != self._rs.format.z16:
            raise RealSenseError(f"RealSense {playback}: want z16 and rgb8, it has {depth.format()} and {rgb.format()}")
        self._table = depth_lookup_table(depth_min_m, depth_max_m, self._metres_per_unit)
        self._imu = None
        gyro = self._gyro(profile)
        if body_from_depth is not None and gyro is not None:
            self._imu = _Imu(
                self, _settings(self._rs, serial, playback), body_from_depth.rotation() @ _depth_from_imu(gyro, depth)
            )

    def poll(self) -> Frame | None:
        """Return the newest frame that was not returned yet, or None.

        Raises RealSenseError if the camera is disconnected or silent.
        """
        before = self._number
        frame = self._newest()
        if self._live:
            self._listen(heard=self._number != before)
        return frame

    def _newest(self) -> Frame | None:
        try:
            frames = self._pipeline.poll_for_frames()
        except RuntimeError as error:
            raise RealSenseError(f"{self._name}: {' '.join(str(error).split())}") from None
        if not frames:
            return None
        depth, rgb = frames.get_depth_frame(), frames.get_color_frame()
        if not depth or not rgb or depth.get_frame_number() == self._number:
            return None
        if abs(depth.get_timestamp() - rgb.get_timestamp()) > 1000.0 * self._pair_s:
            self.dropped_frames += 1
            return None
        self._number = int(depth.get_frame_number())
        settled = self._settled(depth.get_frame_timestamp_domain())
        stamp_s = self.stamp_s(depth)
        before_s = self._before_s
        self._before_s = stamp_s
        if stamp_s <= before_s or not settled:
            self.dropped_frames += 1
            return None
        return Frame(
            stamp_s,
            self._number,
            self._table[np.asanyarray(depth.get_data())],
            self._depth_intrinsics,
            np.asanyarray(rgb.get_data()),
            self._rgb_intrinsics,
            self._rgb_from_depth,
        )

    def imu(self) -> list[ImuSample]:
        """Return the inertial samples since the last call; none without an IMU."""
        return self._imu.samples() if self._imu else []

    def close(self) -> None:
        """Stop the streams."""
        if self._imu:
            self._imu.close()
        self._pipeline.stop()

    def stamp_s(self, frame: Any) -> float:
        """Return the capture time of a frame on the product's clock."""
        stamp_s, now_s = 0.001 * float(frame.get_timestamp()), self._clock.now_s()
        if self._live and frame.get_frame_timestamp_domain() != self._rs.timestamp_domain.hardware_clock:
            return stamp_s + now_s - self._wall_s()  # already on this machine's wall clock
        return self._offset.monotonic_s(stamp_s, now_s)

    def _listen(self, heard: bool) -> None:
        """Record if a live camera sent an image pair; raise RealSenseError after a long silence.

        The first silence starts at the first poll, because kernels may compile before it.
        """
        now_s = self._clock.now_s()
        if heard:
            self._silent_s = now_s
            self._silence_limit_s = _SILENCE_S
        self._silent_s = min(self._silent_s, now_s)
        if now_s - self._silent_s > self._silence_limit_s:
            raise RealSenseError(f"{self._name}: open, but no frame for {now_s - self._silent_s:.1f} s: reconnect it")

    def _settled(self, domain: Any) -> bool:
        """Return True if the stamp clock has not changed for half a second.

        The first clock counts as settled.
        """
        now_s = self._clock.now_s()
        if domain != self._domain:
            self._settled_s = now_s if self._domain is None else now_s + _SETTLES_S
            self._domain = domain
            self._offset = ClockOffset()
        return now_s >= self._settled_s

    def _gyro(self, profile: Any) -> Any:
        """Return the gyro's profile on the opened device; None without one."""
        sensors = [sensor for sensor in profile.get_device().query_sensors() if sensor.is_motion_sensor()]
        streams = [stream for sensor in sensors for stream in sensor.get_stream_profiles()]
        return next((stream for stream in streams if stream.stream_type() == self._rs.stream.gyro), None)


class _Imu:
    """The motion streams, in a separate pipeline.

    The video pipeline would return only the newest sample.
    """

    def __init__(self, camera: RealSenseCamera, settings: Any, body_from_imu: FloatArray) -> None:
        self._camera = camera
        self._rs = camera._rs
        self._body_from_imu = body_from_imu
        self._queue: deque[tuple[bool, float, tuple[float, float, float]]] = deque(maxlen=4096)  # gyro?, stamp, data
        self._force: FloatArray | None = None
        settings.enable_stream(self._rs.stream.accel)
        settings.enable_stream(self._rs.stream.gyro)
        self._pipeline = self._rs.pipeline()
        try:
            self._pipeline.start(settings, self._take)
        except RuntimeError as error:
            raise RealSenseError(f"RealSense IMU: {' '.join(str(error).split())}") from None

    def _take(self, frame: Any) -> None:
        """Queue a sample; called on librealsense's thread, so it only copies."""
        motion = frame.as_motion_frame()
        if motion:
            data = motion.get_motion_data()
            gyro = motion.get_profile().stream_type() == self._rs.stream.gyro
            self._queue.append((gyro, self._camera.stamp_s(motion), (data.x, data.y, data.z)))

    def samples(self) -> list[ImuSample]:
        """Return one sample per gyro reading, with the newest specific force before it.

        The samples are in order of arrival. The lever arm is neglected.
        """
        out: list[ImuSample] = []
        while self._queue:
            gyro, stamp_s, data = self._queue.popleft()
            turned = self._body_from_imu @ np.array(data)
            if not gyro:
                self._force = turned
            elif self._force is not None:
                out.append(ImuSample(stamp_s, turned, self._force))
        return out

    def close(self) -> None:
        self._pipeline.stop()


def _settings(library: Any, serial: str | None, playback: Path | None) -> Any:
    settings = library.config()
    if playback is not None:
        if not playback.is_file():
            raise RealSenseError(f"{playback}: no such recording")
        settings.enable_device_from_file(str(playback), repeat_playback=False)
        return settings
    serials = [device.get_info(library.camera_info.serial_number) for device in library.context().query_devices()]
    if not serials or (serial is not None and serial not in serials):
        seen = ", ".join(serials) or "none"
        raise RealSenseError(f"RealSense camera {serial or 'of any serial'} is not connected (seen: {seen})")
    settings.enable_device(serial or serials[0])
    return settings


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
