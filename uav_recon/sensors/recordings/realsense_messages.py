"""Messages of a librealsense recording.

.db3 with messages of ROS 2, .bag with messages of ROS 1.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from uav_recon.sensors.recordings.bag_contents import BagDecoder
from uav_recon.sensors.recordings.bag_messages import CAMERA_INFO, IMU
from uav_recon.sensors.recordings.bag_storage import BagStorage, RawMessage
from uav_recon.sensors.recordings.recording import DamagedItemError, RecordingError
from uav_recon.sensors.recordings.ros1_bag import Ros1Bag
from uav_recon.types.pose import Pose

_STREAM = re.compile(r"/device_0/sensor_\d+/(Depth|Color|Gyro|Accel)_0/(.+)")
_UNIT_TOPICS = ("/option/Depth_Units/value", "/Depth Units/value")
UNIT = "unit"  # the part of a message with the depth unit


@dataclass(frozen=True)
class StreamMessage:
    """A message: its stream (Depth, ...), and the rest of its topic."""

    stream: str
    part: str
    raw: RawMessage

    @property
    def kind(self) -> str:
        """Its type."""
        return self.raw.kind

    @property
    def file_ns(self) -> int:
        """Its instant in the file."""
        return self.raw.file_ns

    @property
    def is_image(self) -> bool:
        """True for an image, compressed or not."""
        return self.part.startswith("image/data")


@dataclass
class StreamContents:
    """Result of the first pass. stamps_s: of the device, by stream and instant in the file.

    images: instants in the file of each stream. motion: instants, and rates or forces (3,) of each stream. unit_m: metres a
    unit of depth, None if the file does not tell.
    """

    infos: dict[str, Any] = field(default_factory=dict)
    stamps_s: dict[tuple[str, int], float] = field(default_factory=dict)
    clocks: dict[str, str] = field(default_factory=dict)
    poses: dict[str, Pose] = field(default_factory=dict)  # ref_from_stream
    images: dict[str, list[int]] = field(default_factory=dict)
    motion: dict[str, list[tuple[int, tuple[float, float, float]]]] = field(default_factory=dict)
    unit_m: float | None = None

    def add_motion(self, message: StreamMessage, imu: Any) -> None:
        """Add an inertial sample: the rate of the stream Gyro, the force of the other."""
        vector = imu.angular_velocity if message.stream == "Gyro" else imu.linear_acceleration
        self.motion.setdefault(message.stream, []).append((message.file_ns, (vector.x, vector.y, vector.z)))


class StreamMessages(Protocol):
    """The messages of a recording."""

    @property
    def cut(self) -> bool:
        """True after a pass over a file that ends before its end, or was not closed."""
        ...

    def messages(self) -> Iterator[StreamMessage]:
        """Yield the messages of the streams in their order; a file that was cut ends there."""
        ...

    def image(self, message: StreamMessage) -> Any:
        """Return an image message. Raises DamagedItemError."""
        ...

    def note(self, found: StreamContents, message: StreamMessage) -> None:
        """Note intrinsics, extrinsics, metadata and inertial samples. Raises DamagedItemError."""
        ...


class Ros2Messages:
    """Messages of ROS 2 in SQLite."""

    def __init__(self, storage: BagStorage) -> None:
        self._storage, self._decode = storage, BagDecoder()

    @property
    def cut(self) -> bool:
        """See StreamMessages."""
        return self._storage.cut

    def messages(self) -> Iterator[StreamMessage]:
        """See StreamMessages."""
        for raw in self._storage.messages():
            if (match := _STREAM.fullmatch(raw.topic)) is not None:
                yield StreamMessage(match[1], match[2], raw)

    def image(self, message: StreamMessage) -> Any:
        """See StreamMessages."""
        return self._decode(message.raw)

    def note(self, found: StreamContents, message: StreamMessage) -> None:
        """See StreamMessages."""
        if message.kind == IMU:
            found.add_motion(message, self.image(message))
        elif message.kind == CAMERA_INFO and message.stream not in found.infos:
            found.infos[message.stream] = self.image(message)
        elif message.part.endswith("/metadata"):
            values = _values(self.image(message).data)
            found.clocks[message.stream] = _joined(found.clocks.get(message.stream), values.get("timestamp_domain", ""))
            found.stamps_s[message.stream, message.file_ns] = _number(values.get("timestamp")) / 1000.0
            if message.stream == "Depth" and _number(values.get("depth_units")) > 0.0:
                found.unit_m = _number(values["depth_units"])
        elif message.part.startswith("tf/"):
            values = _values(self.image(message).data)
            numbers = [_number(word) for name in ("rotation", "translation") for word in values.get(name, "").split(",")]
            if len(numbers) == 12:
                matrix = np.eye(4)
                matrix[:3, :3], matrix[:3, 3] = np.reshape(numbers[:9], (3, 3)).T, numbers[9:]
                found.poses[message.stream] = Pose.from_matrix(matrix).inverse()  # the file holds stream_from_ref, by columns


class Ros1Messages:
    """Messages of ROS 1."""

    def __init__(self, file: Path) -> None:
        try:
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise RecordingError(f"a bag needs the package {error.name}: pip install 'uav-recon[recordings]'") from None
        self._bag, self._store = Ros1Bag(file), get_typestore(Stores.ROS1_NOETIC)

    @property
    def cut(self) -> bool:
        """See StreamMessages."""
        return self._bag.cut

    def messages(self) -> Iterator[StreamMessage]:
        """See StreamMessages."""
        for raw in self._bag.messages():
            if raw.topic.endswith(_UNIT_TOPICS):
                yield StreamMessage("", UNIT, raw)
            elif (match := _STREAM.fullmatch(raw.topic)) is not None:
                yield StreamMessage(match[1], match[2], raw)

    def image(self, message: StreamMessage) -> Any:
        """See StreamMessages.

        Librealsense appends a number to depth images, which ROS does not know.
        """
        data, at = message.raw.data, 12
        try:
            _, at = _text(data, at)  # frame id
            height, width = struct.unpack_from("<II", data, at)
            encoding, at = _text(data, at + 8)
            big, step, size = struct.unpack_from("<BII", data, at)
            pixels = np.frombuffer(data, np.uint8, size, at + 9)
        except (struct.error, ValueError):
            raise DamagedItemError(f"{message.raw.topic}: an image of {len(data)} bytes cannot be decoded") from None
        return SimpleNamespace(height=height, width=width, encoding=encoding, is_bigendian=big, step=step, data=pixels)

    def note(self, found: StreamContents, message: StreamMessage) -> None:
        """See StreamMessages."""
        if message.part == UNIT:
            (found.unit_m,) = struct.unpack_from("<f", message.raw.data)
        elif message.kind == CAMERA_INFO:
            info = self._decoded(message)
            model = {"Brown Conrady": "plumb_bob"}.get(info.distortion_model, info.distortion_model)
            size = {"width": info.width, "height": info.height}
            found.infos[message.stream] = SimpleNamespace(k=info.K, d=info.D, distortion_model=model, **size)
        elif message.part.endswith("/metadata"):
            pair = self._decoded(message)
            if pair.key == "timestamp_domain":
                found.clocks[message.stream] = _joined(found.clocks.get(message.stream), pair.value)
        elif message.part.startswith("tf/"):
            tf = self._decoded(message)
            turn = np.array([tf.rotation.w, tf.rotation.x, tf.rotation.y, tf.rotation.z])
            shift = np.array([tf.translation.x, tf.translation.y, tf.translation.z])
            found.poses[message.stream] = Pose(turn, shift).inverse()  # the file holds stream_from_ref
        elif message.kind == IMU:
            found.add_motion(message, self._decoded(message))
        if message.is_image or message.kind == IMU:
            seconds, nanoseconds = struct.unpack_from("<II", message.raw.data, 4)  # of the header
            found.stamps_s[message.stream, message.file_ns] = seconds + nanoseconds * 1e-9

    def _decoded(self, message: StreamMessage) -> Any:
        try:
            return self._store.deserialize_ros1(message.raw.data, message.kind)
        except Exception as error:  # of many kinds, for damaged bytes
            raise DamagedItemError(f"{message.raw.topic}: cannot be decoded ({type(error).__name__})") from None


def _values(text: str) -> dict[str, str]:
    """Return the pairs of `name=value;name=value`."""
    return dict(pair.split("=", 1) for pair in text.split(";") if "=" in pair)


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return float("nan")


def _joined(before: str | None, now: str) -> str:
    """Return the clock of a stream, or both names if it changes."""
    return now if before in (None, now) else f"{before}, {now}"


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return a string of ROS 1 and the place behind it."""
    (length,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 4 + length].decode(errors="replace"), at + 4 + length
