"""ROS 2 camera and pose source over DDS (cyclonedds), without a ROS installation.

Frames: optical RDF images, base_link FLU, odom with z up (REP-103, REP-105). TF is not read: the mount is in the config.
Header stamps are the system clock; each is mapped to the monotonic clock by the offset between the two, measured on arrival.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from uav_recon.config import Ros2Config
from uav_recon.interfaces import Clock
from uav_recon.sensors.stream_format import StreamError
from uav_recon.types.camera import Frame, ImuSample, Intrinsics
from uav_recon.types.frames import ByteArray, Float32Array
from uav_recon.types.pose import Pose, StampedPose

_log = logging.getLogger(__name__)
_METRES_PER_UNIT = 0.001  # 16UC1 is in millimetres (REP-118)
_OLDEST_S = 5.0  #: reject: a message whose stamp is older: it comes from another clock (simulated time, device, other host)
_FUTURE_S = 0.05  #: reject: a message stamped later than the system clock by this
_PAIR_S = 0.02  #: reject: a depth image without a colour image stamped this near
_KEPT_IMAGES = 4  # of each kind, until the other kind arrives
_VARIANCE = np.array([1e-4] * 3 + [1e-5] * 3)  # where a message gives none
_DEPTH = 16  # messages that a reader keeps between two polls
_IMU_DEPTH = 512


class Ros2Error(StreamError):
    """Raised if ROS 2 cannot be read; the text is one line and gives the remedy."""


def _messages() -> Any:
    try:
        from uav_recon.sensors import ros2_messages
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("cyclonedds"):
            raise
        raise Ros2Error("cyclonedds is not installed: pip install uav-recon[ros2]") from None
    return ros2_messages


class StampMapping:
    """Maps header stamps to the monotonic clock.

    refused: number of stamps of another clock. The first of them is logged with its age.
    """

    def __init__(self, topic: str, clock: Clock, system_s: Callable[[], float] = time.time) -> None:
        self._topic = topic
        self._clock = clock
        self._system_s = system_s
        self.refused = 0

    def monotonic_s(self, stamp: Any) -> float | None:
        """Return the stamp on the monotonic clock, None if it is of another clock."""
        age_s: float = self._system_s() - (stamp.sec + stamp.nanosec * 1e-9)
        if -_FUTURE_S <= age_s <= _OLDEST_S:
            return self._clock.now_s() - age_s
        self.refused += 1
        if self.refused == 1:
            _log.error(
                "ros2: %s: stamp is %.3f s old by the system clock, allowed %g to %g s: the publisher uses another clock",
                self._topic, age_s, -_FUTURE_S, _OLDEST_S,
            )  # fmt: skip
        return None


class _Topics:
    """Readers of one DDS participant."""

    def __init__(self, config: Ros2Config) -> None:
        from cyclonedds.core import DDSException
        from cyclonedds.domain import DomainParticipant

        self._config = config
        try:
            self._participant = DomainParticipant(config.domain)
        except DDSException as error:
            raise Ros2Error(f"ros2.domain {config.domain}: no DDS participant ({' '.join(str(error).split())})") from None

    def reader(self, name: str, kind: Any, depth: int = _DEPTH) -> Callable[[], list[Any]]:
        """Return a function that takes the new messages of a topic, oldest first.

        It never blocks. name: as in ROS 2; kind: the class of its messages; depth: number of messages kept between two calls.
        """
        from cyclonedds.core import Policy, Qos
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        reliable = self._config.reliability == "reliable"
        qos = Qos(
            Policy.Reliability.Reliable(duration(milliseconds=100)) if reliable else Policy.Reliability.BestEffort,
            Policy.History.KeepLast(depth),
            Policy.Durability.Volatile,
            Policy.DataRepresentation(use_cdrv0_representation=True),
        )
        reader = DataReader(self._participant, Topic(self._participant, f"rt{name}", kind), qos=qos)

        def take() -> list[Any]:
            try:
                return [message for message in reader.take(depth) if isinstance(message, kind)]
            except ValueError as error:
                _log.error("ros2: %s: %s", name, error)
                return []

        return take


class Ros2Poses:
    """PoseSource protocol over nav_msgs/Odometry or geometry_msgs/PoseStamped.

    refused: number of poses with non-finite values, a quaternion that is not a rotation, or a stamp of another clock. A
    diagonal of the covariance that is zero or negative is unknown, and replaced by (1 cm)² and (0.2°)².
    Raises Ros2Error (one line) without cyclonedds or a DDS participant.
    """

    def __init__(self, config: Ros2Config, clock: Clock, system_s: Callable[[], float] = time.time) -> None:
        messages = _messages()
        self._odometry = config.pose_type == "odometry"
        kind = messages.Odometry if self._odometry else messages.PoseStamped
        self._take = _Topics(config).reader(config.pose_topic, kind)
        self._stamps = StampMapping(config.pose_topic, clock, system_s)
        self._malformed = 0

    @property
    def refused(self) -> int:
        """Number of rejected messages."""
        return self._malformed + self._stamps.refused

    def poses(self) -> list[StampedPose]:
        """Return the poses since the last call, oldest first."""
        found = (self._pose(message) for message in self._take())
        return [pose for pose in found if pose is not None]

    def _pose(self, message: Any) -> StampedPose | None:
        pose = message.pose.pose if self._odometry else message.pose
        position, turn = pose.position, pose.orientation
        numbers = (position.x, position.y, position.z, turn.w, turn.x, turn.y, turn.z)
        variance = _VARIANCE
        if self._odometry:
            told = np.array(message.pose.covariance)[::7]
            variance = np.where(np.isfinite(told) & (told > 0.0), told, _VARIANCE)
        if not all(map(math.isfinite, numbers)) or abs(math.hypot(*numbers[3:]) - 1.0) > 0.01:
            self._malformed += 1
            return None
        stamp_s = self._stamps.monotonic_s(message.header.stamp)
        if stamp_s is None:
            return None
        return StampedPose(stamp_s, Pose(np.array(numbers[3:]), np.array(numbers[:3])), np.zeros(3), np.diag(variance))


class Ros2Camera:
    """Camera protocol over two Image topics, their CameraInfo, and an Imu topic.

    The depth image is registered to the colour image and has its intrinsics. dropped_frames counts depth images without a
    colour image of the same instant, without CameraInfo, of an unknown encoding, or with a stamp of another clock.
    Raises Ros2Error (one line) without cyclonedds or a DDS participant.
    """

    def __init__(
        self, config: Ros2Config, clock: Clock, depth_min_m: float = 0.3, depth_max_m: float = 6.0,
        system_s: Callable[[], float] = time.time,
    ) -> None:  # fmt: skip
        messages = _messages()
        topics = _Topics(config)
        self._depth_range_m = (depth_min_m, depth_max_m)
        self._take_depth = topics.reader(config.depth_topic, messages.Image)
        self._take_rgb = topics.reader(config.rgb_topic, messages.Image)
        self._take_info = topics.reader(config.info_topic, messages.CameraInfo)
        self._take_imu = topics.reader(config.imu_topic, messages.Imu, _IMU_DEPTH) if config.imu_topic else list
        self._stamps = StampMapping(config.depth_topic, clock, system_s)
        self._imu_stamps = StampMapping(config.imu_topic or "", clock, system_s)
        self._info: Intrinsics | None = None
        self._colours: list[Any] = []
        self._depths: list[Any] = []
        self._before_s = -math.inf
        self._sequence = 0
        self._said = ""
        self.dropped_frames = 0

    def poll(self) -> Frame | None:
        """Return the newest frame whose colour has arrived, once, else None."""
        for info in self._take_info():
            self._read_info(info)
        self._colours = [*self._colours, *self._take_rgb()][-_KEPT_IMAGES:]
        self._depths += self._take_depth()
        for n in reversed(range(len(self._depths))):
            depth = self._depths[n]
            colour = min(self._colours, key=lambda image: abs(_apart_s(image, depth)), default=None)
            if colour is not None and abs(_apart_s(colour, depth)) <= _PAIR_S:
                self.dropped_frames += n
                del self._depths[: n + 1]
                return self._frame(depth, colour)
        if len(self._depths) > _KEPT_IMAGES:
            self.dropped_frames += len(self._depths) - _KEPT_IMAGES
            del self._depths[:-_KEPT_IMAGES]
            self._say(f"no colour image within {_PAIR_S:g} s of a depth image")
        return None

    def imu(self) -> list[ImuSample]:
        """Return the inertial samples since the last call, oldest first."""
        out = []
        for message in self._take_imu():
            rate, force = message.angular_velocity, message.linear_acceleration
            stamp_s = self._imu_stamps.monotonic_s(message.header.stamp)
            if stamp_s is not None:
                out.append(ImuSample(stamp_s, np.array([rate.x, rate.y, rate.z]), np.array([force.x, force.y, force.z])))
        return out

    def close(self) -> None:
        """Do nothing: the participant ends with the object."""

    def _read_info(self, info: Any) -> None:
        fx, fy, cx, cy = info.k[0], info.k[4], info.k[2], info.k[5]
        tree = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": info.width, "height": info.height}
        try:
            self._info = Intrinsics.from_tree(tree)
        except (ValueError, KeyError, TypeError) as error:
            self._say(str(error))

    def _frame(self, depth: Any, colour: Any) -> Frame | None:
        stamp_s = self._stamps.monotonic_s(depth.header.stamp)
        try:
            metres, rgb = _metres(depth, *self._depth_range_m), _rgb(colour)
            lens = self._info
            if lens is None or {metres.shape, rgb.shape[:2]} != {(lens.height, lens.width)}:
                size = "none" if lens is None else f"{lens.width}x{lens.height}"
                shapes = f"depth {depth.width}x{depth.height}, colour {colour.width}x{colour.height}"
                raise ValueError(f"{shapes}, CameraInfo {size}: want three equal sizes")
        except ValueError as error:
            self._say(str(error))
            self.dropped_frames += 1
            return None
        if stamp_s is None or stamp_s <= self._before_s:
            self.dropped_frames += 1
            return None
        self._before_s = stamp_s
        self._sequence += 1
        return Frame(stamp_s, self._sequence, metres, lens, rgb, lens, Pose.identity())

    def _say(self, message: str) -> None:
        """Log a message, unless it is the same as the last one."""
        if message != self._said:
            self._said = message
            _log.error("ros2: %s", message)


def _apart_s(first: Any, second: Any) -> float:
    """Return the stamp of the first message minus that of the second, in seconds."""
    a, b = first.header.stamp, second.header.stamp
    return float((a.sec - b.sec) + (a.nanosec - b.nanosec) * 1e-9)


def _rows(image: Any, dtype: str, channels: int) -> Any:
    """Return the pixels (H, W * channels). Raises ValueError if the data are too short for them."""
    kind = np.dtype(dtype).newbyteorder(">" if image.is_bigendian else "<")
    row_bytes = image.width * channels * kind.itemsize
    if image.step < row_bytes or len(image.data) < image.height * image.step:
        raise ValueError(f"image {image.width}x{image.height} {image.encoding}: {len(image.data)} bytes, step {image.step}")
    rows = np.asarray(image.data, np.uint8)[: image.height * image.step].reshape(image.height, image.step)[:, :row_bytes]
    return np.ascontiguousarray(rows).view(kind)


def _metres(image: Any, depth_min_m: float, depth_max_m: float) -> Float32Array:
    """Return depth (H, W) in metres, NaN where there is none or it is outside the range."""
    if image.encoding not in ("16UC1", "mono16", "32FC1"):
        raise ValueError(f"depth encoding {image.encoding!r}: want 16UC1 or 32FC1")
    floating = image.encoding == "32FC1"
    raw = _rows(image, "f4" if floating else "u2", 1).astype(np.float32)
    metres = raw if floating else raw * np.float32(_METRES_PER_UNIT)
    with np.errstate(invalid="ignore"):
        valid = (metres > 0.0) & (metres >= depth_min_m - 1e-6) & (metres <= depth_max_m + 1e-6)
    return np.where(valid, metres, np.float32(np.nan)).astype(np.float32)


def _rgb(image: Any) -> ByteArray:
    """Return colour (H, W, 3) in the order red, green, blue."""
    if image.encoding not in ("rgb8", "bgr8"):
        raise ValueError(f"colour encoding {image.encoding!r}: want rgb8 or bgr8")
    pixels: ByteArray = _rows(image, "u1", 3).reshape(image.height, image.width, 3)
    return pixels if image.encoding == "rgb8" else pixels[..., ::-1]
