"""Recording of librealsense: .db3, or .bag before version 2.57.

The first has messages of ROS 2, the second of ROS 1. Both hold the streams of one device below /device_0/sensor_N/. Depth is in
units of the device, stamps are in the metadata of each frame, gyro and accelerometer are apart. The camera has no body: it
counts as carried level, looking along its x axis.
"""

from __future__ import annotations

import re
import sqlite3
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from uav_recon.sensors.recordings.bag_messages import CAMERA_INFO, IMU, Lens, depth_image, rgb_image
from uav_recon.sensors.recordings.frame_pairing import paired
from uav_recon.sensors.recordings.recording import LEVEL_MOUNT, DepthUnit, RecordingError, RecordingInfo, require_increasing
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.pose import Pose, StampedPose

ROS1_MAGIC = b"#ROSBAG V2.0"
_STREAM = re.compile(r"/device_0/sensor_\d+/(Depth|Color|Gyro|Accel)_0/(.+)")
_MM = 0.001  # metres a unit of a device that does not tell
_NOT_CORRECTED = ("Inverse Brown Conrady", "Modified Brown Conrady", "F-Theta", "Kannala Brandt4")


@dataclass(frozen=True)
class _Message:
    """A message.

    Its stream (Depth, ...), the rest of its topic, its type, its instant in the file, and its bytes.
    """

    stream: str
    part: str
    kind: str
    file_ns: int
    data: bytes


@dataclass
class _Contents:
    """Result of the first pass. stamps_s: of the device, by stream and instant in the file."""

    infos: dict[str, Any] = field(default_factory=dict)
    stamps_s: dict[tuple[str, int], float] = field(default_factory=dict)
    clocks: dict[str, str] = field(default_factory=dict)
    poses: dict[str, Pose] = field(default_factory=dict)  # ref_from_stream
    images: dict[str, list[int]] = field(default_factory=dict)
    motion: dict[str, list[tuple[int, tuple[float, float, float]]]] = field(default_factory=dict)
    unit_m: float | None = None


class RealSenseFile:
    """Recording protocol over a file of librealsense. Raises RecordingError.

    The stamps are the device's if all streams have one clock, otherwise those of the file. skipped: what cannot be used.
    """

    def __init__(self, file: Path, depth_min_m: float, depth_max_m: float) -> None:
        self._file = file
        self._format = _format_of(file)
        self.skipped: Counter[str] = Counter()
        found = self._contents = self._read_contents()
        if "Depth" not in found.images:
            raise RecordingError(f"{file}: has no depth; it has {', '.join(sorted(found.infos)) or 'no image'}")
        self._unit = DepthUnit.of(found.unit_m or _MM, depth_min_m, depth_max_m)
        self._lenses = {name: self._lens(name) for name in found.images}
        self._one_clock = len(set(found.clocks.values())) == 1 and len(found.clocks) == len(found.images) + len(found.motion)
        if not self._one_clock:
            self.skipped["stamps of the device: the streams have several clocks"] += 1
        self._stamps_s = [self._stamp_s("Depth", file_ns) for file_ns in found.images["Depth"]]
        require_increasing(file, self._stamps_s)

    @property
    def info(self) -> RecordingInfo:
        """Return the head of the recording."""
        stamps_s, skipped = self._stamps_s, tuple(self.skipped.items())
        return RecordingInfo(
            "librealsense recording", len(stamps_s), stamps_s[0], stamps_s[-1], LEVEL_MOUNT, up_is_z=False, skipped=skipped
        )

    def frames(self, step: int = 1) -> Iterator[Frame]:
        """Yield every step-th depth image with its nearest colour image."""
        images = (one for one in self._format.messages(self._file) if one.part.startswith("image/data"))

        def stamp_s(one: _Message) -> float:
            return self._stamp_s(one.stream, one.file_ns)

        is_depth, is_colour = (lambda one: one.stream == "Depth"), (lambda one: one.stream == "Color")
        for number, depth, colour in paired(images, is_depth, is_colour, stamp_s, step, colour="Color" in self._lenses):
            yield self._frame(number, depth, colour)

    def poses(self) -> list[StampedPose]:
        """Return nothing: a camera has no poses."""
        return []

    def imu(self) -> list[ImuSample]:
        """Return the gyro's samples with the force at their stamps, in body axes."""
        gyro, accel = (self._motion(name) for name in ("Gyro", "Accel"))
        if gyro is None:
            return []
        stamps_s, rates = gyro
        forces = np.full(rates.shape, np.nan)
        if accel is not None:
            forces = np.stack([np.interp(stamps_s, accel[0], accel[1][:, axis]) for axis in range(3)], axis=1)
        return [ImuSample(*row) for row in zip(stamps_s.tolist(), rates, forces, strict=True)]

    def _motion(self, stream: str) -> tuple[FloatArray, FloatArray] | None:
        """Return stamps (N,), increasing, and values (N, 3) in body axes; None without any."""
        rows = self._contents.motion.get(stream, [])
        if not rows:
            return None
        stamps_s = np.array([self._stamp_s(stream, file_ns) for file_ns, _ in rows])
        depth_from_ref = self._contents.poses.get("Depth", Pose.identity()).inverse()
        between = depth_from_ref @ self._contents.poses.get(stream, depth_from_ref.inverse())
        turn = (LEVEL_MOUNT @ between).rotation()
        newer = np.concatenate(([True], stamps_s[1:] > np.maximum.accumulate(stamps_s)[:-1]))
        return stamps_s[newer], (np.array([value for _, value in rows]) @ turn.T)[newer]

    def _stamp_s(self, stream: str, file_ns: int) -> float:
        return self._contents.stamps_s[stream, file_ns] if self._one_clock else file_ns * 1e-9

    def _frame(self, number: int, depth: _Message, colour: _Message | None) -> Frame:
        stamp_s, lens = self._stamp_s("Depth", depth.file_ns), self._lenses["Depth"]
        raw = lens.undistorted(depth_image(self._format.image(depth), self._where("Depth")), self._where("Depth"))
        rgb_lens = self._lenses.get("Color", lens)
        rgb: AnyArray = np.zeros((rgb_lens.intrinsics.height, rgb_lens.intrinsics.width, 3), np.uint8)
        if colour is not None:
            where = self._where("Color")
            rgb = rgb_lens.undistorted(rgb_image(self._format.image(colour), where), where)
        poses = self._contents.poses
        rgb_from_depth = poses.get("Color", Pose.identity()).inverse() @ poses.get("Depth", Pose.identity())
        return Frame(stamp_s, number, self._unit.metres(raw), lens.intrinsics, rgb, rgb_lens.intrinsics, rgb_from_depth)

    def _lens(self, stream: str) -> Lens:
        info = self._contents.infos.get(stream)
        if info is None:
            raise RecordingError(f"{self._where(stream)}: has no intrinsics")
        if info.distortion_model in _NOT_CORRECTED and np.abs(info.d).max() > 0.0:
            self.skipped[f"lens distortion of {stream} ({info.distortion_model}), not corrected"] += 1
            info = SimpleNamespace(k=info.k, d=[], width=info.width, height=info.height, distortion_model="none")
        return Lens(info, self._where(stream))

    def _where(self, stream: str) -> str:
        return f"{self._file}: {stream}"

    def _read_contents(self) -> _Contents:
        found = _Contents()
        for message in self._format.messages(self._file):
            if message.part.startswith("image/data"):
                found.images.setdefault(message.stream, []).append(message.file_ns)
            elif message.kind == IMU:
                rate, force = self._format.imu(message)
                found.motion.setdefault(message.stream, []).append(
                    (message.file_ns, rate if message.stream == "Gyro" else force)
                )
            self._format.note(found, message)
        return found


class _Db3:
    """Messages of ROS 2 in SQLite."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS2_HUMBLE)

    def messages(self, file: Path) -> Iterator[_Message]:
        """Yield the messages of the streams in their order; a file that was cut ends there."""
        with closing(read_only(file)) as database:
            try:
                for topic, kind, file_ns, data in database.execute(
                    "SELECT topics.name, topics.type, messages.timestamp, messages.data FROM messages JOIN topics "
                    "ON topics.id = messages.topic_id ORDER BY messages.timestamp, messages.id"
                ):
                    if (match := _STREAM.fullmatch(topic)) is not None:
                        yield _Message(match[1], match[2], kind, file_ns, data)
            except sqlite3.DatabaseError:
                return

    def image(self, message: _Message) -> Any:
        """Return an image message."""
        return self._store.deserialize_cdr(message.data, message.kind)

    def imu(self, message: _Message) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return rate and force of an Imu message."""
        return _vectors(self.image(message))

    def note(self, found: _Contents, message: _Message) -> None:
        """Note intrinsics, extrinsics and metadata."""
        if message.kind == CAMERA_INFO and message.stream not in found.infos:
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


class _Bag1:
    """Messages of ROS 1."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS1_NOETIC)

    def messages(self, file: Path) -> Iterator[_Message]:
        """Yield the messages of the streams in their order.

        Raises RecordingError for a file that was cut.
        """
        from rosbags.rosbag1 import Reader, ReaderError

        try:
            with Reader(file) as reader:
                for connection, file_ns, data in reader.messages():
                    unit = connection.topic.endswith("/option/Depth_Units/value") or connection.topic.endswith(
                        "/Depth Units/value"
                    )
                    if unit:
                        yield _Message("", "unit", connection.msgtype, file_ns, bytes(data))
                    elif (match := _STREAM.fullmatch(connection.topic)) is not None:
                        yield _Message(match[1], match[2], connection.msgtype, file_ns, bytes(data))
        except ReaderError as error:
            raise RecordingError(f"{file}: a ROS 1 bag that cannot be read, was it cut? ({error})") from None

    def image(self, message: _Message) -> Any:
        """Return an image message.

        librealsense appends a number to depth images, which ROS does not know.
        """
        at = 12
        _, at = _text(message.data, at)  # frame id
        height, width = struct.unpack_from("<II", message.data, at)
        encoding, at = _text(message.data, at + 8)
        big, step, size = struct.unpack_from("<BII", message.data, at)
        pixels = np.frombuffer(message.data, np.uint8, size, at + 9)
        return SimpleNamespace(height=height, width=width, encoding=encoding, is_bigendian=big, step=step, data=pixels)

    def imu(self, message: _Message) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return rate and force of an Imu message."""
        return _vectors(self._store.deserialize_ros1(message.data, message.kind))

    def note(self, found: _Contents, message: _Message) -> None:
        """Note intrinsics, extrinsics and metadata."""
        if message.part == "unit":
            (found.unit_m,) = struct.unpack_from("<f", message.data)
        elif message.kind == CAMERA_INFO:
            info: Any = self._store.deserialize_ros1(message.data, message.kind)
            model = {"Brown Conrady": "plumb_bob"}.get(info.distortion_model, info.distortion_model)
            size = {"width": info.width, "height": info.height}
            found.infos[message.stream] = SimpleNamespace(k=info.K, d=info.D, distortion_model=model, **size)
        elif message.part.endswith("/metadata"):
            pair: Any = self._store.deserialize_ros1(message.data, message.kind)
            if pair.key == "timestamp_domain":
                found.clocks[message.stream] = _joined(found.clocks.get(message.stream), pair.value)
        elif message.part.startswith("tf/"):
            tf: Any = self._store.deserialize_ros1(message.data, message.kind)
            turn = np.array([tf.rotation.w, tf.rotation.x, tf.rotation.y, tf.rotation.z])
            shift = np.array([tf.translation.x, tf.translation.y, tf.translation.z])
            found.poses[message.stream] = Pose(turn, shift).inverse()  # the file holds stream_from_ref
        if message.part.startswith("image/data") or message.kind == IMU:
            seconds, nanoseconds = struct.unpack_from("<II", message.data, 4)  # of the header
            found.stamps_s[message.stream, message.file_ns] = seconds + nanoseconds * 1e-9


def is_realsense_file(file: Path) -> bool:
    """Return True if a file has the topics of librealsense.

    Raises RecordingError for another bag of ROS 1.
    """
    with file.open("rb") as stream:
        ros1 = stream.read(len(ROS1_MAGIC)) == ROS1_MAGIC
    if ros1:
        if b"/device_0/" not in file.read_bytes():
            raise RecordingError(f"{file}: a ROS 1 bag that librealsense did not write; convert it to ROS 2: rosbags-convert")
        return True
    with closing(read_only(file)) as database:
        try:
            rows = database.execute("SELECT 1 FROM topics WHERE name LIKE '/device_0/sensor_%' LIMIT 1").fetchall()
        except sqlite3.DatabaseError:
            return False
    return bool(rows)


def read_only(file: Path) -> sqlite3.Connection:
    """Open an SQLite file for reading. Raises sqlite3.Error."""
    return sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)


def _format_of(file: Path) -> _Db3 | _Bag1:
    with file.open("rb") as stream:
        ros1 = stream.read(len(ROS1_MAGIC)) == ROS1_MAGIC
    try:
        return _Bag1() if ros1 else _Db3()
    except ImportError as error:
        raise RecordingError(f"a bag needs the package {error.name}: pip install 'uav-recon[recordings]'") from None


def _vectors(imu: Any) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    rate, force = imu.angular_velocity, imu.linear_acceleration
    return (rate.x, rate.y, rate.z), (force.x, force.y, force.z)


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
