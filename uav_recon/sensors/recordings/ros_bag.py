"""ROS 2 bag as a recording: MCAP or SQLite (.db3).

Recordings of `uav-recon record` are such bags.

A file that was cut, for example by a loss of power, is read up to the cut. Needs the packages mcap and rosbags (`pip install
uav-recon[recordings]`), not ROS.
"""

from __future__ import annotations

import sqlite3
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.sensors.recordings.bag_messages import (
    CAMERA_INFO,
    IMAGES,
    IMU,
    POSES,
    TF,
    BagTopics,
    Lens,
    StaticTransforms,
    body_frame_of,
    depth_image,
    is_depth,
    only_topic,
    rgb_image,
    stamped_pose_of,
)
from uav_recon.sensors.recordings.frame_pairing import paired
from uav_recon.sensors.recordings.realsense_file import ROS1_MAGIC, read_only
from uav_recon.sensors.recordings.recording import LEVEL_MOUNT, DepthUnit, RecordingError, RecordingInfo, require_increasing
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import AnyArray
from uav_recon.types.pose import Pose, StampedPose

MCAP_MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC = b"SQLite format 3\x00"


@dataclass(frozen=True)
class RawMessage:
    """A message of a bag: topic, type, and CDR bytes."""

    topic: str
    kind: str
    data: bytes

    def stamp_s(self) -> float:
        """Return the stamp of its header, which comes first in every type with a header."""
        seconds, nanoseconds = struct.unpack_from("<iI" if self.data[1] & 1 else ">iI", self.data, 4)
        return float(seconds + nanoseconds * 1e-9)


@dataclass
class _Contents:
    """Result of the first pass over a bag."""

    depth: set[str] = field(default_factory=set)
    colour: set[str] = field(default_factory=set)
    infos: dict[str, Any] = field(default_factory=dict)
    poses: dict[str, list[Any]] = field(default_factory=dict)
    imu: dict[str, list[Any]] = field(default_factory=dict)
    stamps_s: dict[str, list[float]] = field(default_factory=dict)
    frame_ids: dict[str, str] = field(default_factory=dict)
    transforms: StaticTransforms = field(default_factory=StaticTransforms)


class RosBag:
    """Recording protocol over a bag. Raises RecordingError.

    skipped: counts of what cannot be used, by reason.
    """

    def __init__(self, file: Path, depth_min_m: float, depth_max_m: float, topics: BagTopics) -> None:
        self._file = file
        self._unit = DepthUnit.of(0.001, depth_min_m, depth_max_m)
        self._decode = _decoder()
        self.skipped: Counter[str] = Counter()
        found = self._contents = self._read_contents()
        depth = only_topic(file, "depth", "--depth-topic", topics.depth, found.depth)
        if depth is None:
            kinds = ", ".join(sorted(found.stamps_s)) or "no image"
            raise RecordingError(f"{file}: has no depth image (16UC1 or 32FC1); it has {kinds}")
        self._depth = depth
        self._colour = only_topic(file, "colour", "--colour-topic", topics.colour, found.colour)
        self._pose = only_topic(file, "pose", "--pose-topic", topics.pose, found.poses)
        self._imu = only_topic(file, "IMU", "--imu-topic", topics.imu, found.imu)
        self._depth_lens = self._lens(depth)
        self._rgb_lens = self._lens(self._colour) if self._colour else self._depth_lens
        self._rgb_from_depth = self._between(self._colour, depth) if self._colour else Pose.identity()
        self._stamps_s = found.stamps_s[depth]
        require_increasing(file, self._stamps_s)
        self._poses, self._body_from_depth, self._body = self._placed(topics.pose_of)

    @property
    def info(self) -> RecordingInfo:
        """Return the head of the recording."""
        stamps_s = self._stamps_s
        return RecordingInfo(
            "ROS 2 bag", len(stamps_s), stamps_s[0], stamps_s[-1], self._body_from_depth, True, tuple(self.skipped.items())
        )

    def frames(self, step: int = 1) -> Iterator[Frame]:
        """Yield every step-th depth image with its nearest colour image. Raises RecordingError."""
        is_depth, is_colour = (lambda one: one.topic == self._depth), (lambda one: one.topic == self._colour)
        pairs = paired(self._messages(), is_depth, is_colour, RawMessage.stamp_s, step, colour=self._colour is not None)
        for number, depth, colour in pairs:
            yield self._frame(number, depth, colour)

    def poses(self) -> list[StampedPose]:
        """Return the poses of the body."""
        return self._poses

    def imu(self) -> list[ImuSample]:
        """Return the inertial samples in body axes; empty if nothing tells how the IMU is mounted."""
        messages = self._contents.imu.get(self._imu or "", [])
        frame = messages[0].header.frame_id if messages else ""
        body_from_imu = self._contents.transforms.between(self._body, frame)
        if body_from_imu is None:
            self.skipped["imu samples without a transform to the body"] += len(messages)
            return []
        turn = body_from_imu.rotation()
        out = []
        for message in messages:
            rate, force = message.angular_velocity, message.linear_acceleration
            out.append(ImuSample(_stamp_s(message), turn @ (rate.x, rate.y, rate.z), turn @ (force.x, force.y, force.z)))
        return sorted(out, key=lambda sample: sample.stamp_s)

    def _frame(self, number: int, message: RawMessage, colour: RawMessage | None) -> Frame:
        stamp_s, where = message.stamp_s(), f"{self._file}: {self._depth}"
        raw = self._depth_lens.undistorted(depth_image(self._decode(message), where), where)
        rgb: AnyArray = np.zeros((self._rgb_lens.intrinsics.height, self._rgb_lens.intrinsics.width, 3), np.uint8)
        if colour is not None:
            where = f"{self._file}: {self._colour}"
            rgb = self._rgb_lens.undistorted(rgb_image(self._decode(colour), where), where)
        lens, rgb_lens = self._depth_lens.intrinsics, self._rgb_lens.intrinsics
        return Frame(stamp_s, number, self._unit.metres(raw), lens, rgb, rgb_lens, self._rgb_from_depth)

    # -- first pass -----------------------------------------------------------------------------------------------------

    def _read_contents(self) -> _Contents:
        found = _Contents()
        readers: dict[str, Callable[[RawMessage], None]] = {
            CAMERA_INFO: lambda one: self._note_info(found, one),
            TF: lambda one: self._note_transforms(found, one) if one.topic.endswith("tf_static") else None,
            IMU: lambda one: found.imu.setdefault(one.topic, []).append(self._decode(one)),
            **dict.fromkeys(POSES, lambda one: found.poses.setdefault(one.topic, []).append(self._decode(one))),
            **dict.fromkeys(IMAGES, lambda one: self._note_image(found, one)),
        }
        for message in self._messages():
            if (reader := readers.get(message.kind)) is not None:
                reader(message)
        return found

    def _note_info(self, found: _Contents, message: RawMessage) -> None:
        if message.topic not in found.infos:
            found.infos[message.topic] = self._decode(message)

    def _note_transforms(self, found: _Contents, message: RawMessage) -> None:
        found.transforms.add(self._decode(message), f"{self._file}: {message.topic}")

    def _note_image(self, found: _Contents, message: RawMessage) -> None:
        topic = message.topic
        if topic not in found.stamps_s:
            image = self._decode(message)
            (found.depth if is_depth(image, topic) else found.colour).add(topic)
            found.frame_ids[topic] = image.header.frame_id
        found.stamps_s.setdefault(topic, []).append(message.stamp_s())

    def _lens(self, topic: str) -> Lens:
        """Return the lens of an image topic: the CameraInfo beside it, or the only one."""
        infos = self._contents.infos
        folders = [topic.rsplit("/", depth)[0] for depth in (1, 2)]
        name = next((f"{folder}/camera_info" for folder in folders if f"{folder}/camera_info" in infos), None)
        if name is None and len(infos) == 1:
            name = next(iter(infos))
        if name is None:
            raise RecordingError(f"{self._file}: no CameraInfo beside {topic}; it has {', '.join(infos) or 'none'}")
        return Lens(infos[name], f"{self._file}: {name}")

    def _between(self, target: str, source: str) -> Pose:
        target_frame, source_frame = (self._contents.frame_ids[topic] for topic in (target, source))
        pose = self._contents.transforms.between(target_frame, source_frame)
        if pose is None:
            raise RecordingError(f"{self._file}: /tf_static does not connect {source_frame!r} with {target_frame!r}")
        return pose

    def _placed(self, pose_of: str) -> tuple[list[StampedPose], Pose, str]:
        """Return the poses of the body, body_from_depth, and the name of the body's frame."""
        messages, depth_frame = self._contents.poses.get(self._pose or "", []), self._contents.frame_ids[self._depth]
        first = body_frame_of(messages[0]) if messages else ""
        body_from_depth = self._contents.transforms.between(first, depth_frame) if first else None
        optical = first.lstrip("/") == depth_frame.lstrip("/") or (body_from_depth is None and pose_of == "camera")
        optical_from_body = LEVEL_MOUNT.inverse() if optical else Pose.identity()
        if optical or body_from_depth is None:
            body_from_depth = LEVEL_MOUNT
        out = []
        for message in messages:
            try:
                world_from_told = stamped_pose_of(message)
            except ValueError:
                self.skipped["poses that are not finite"] += 1
                continue
            out.append(StampedPose(_stamp_s(message), world_from_told @ optical_from_body, np.zeros(3)))
        return sorted(out, key=lambda pose: pose.stamp_s), body_from_depth, first

    def _messages(self) -> Iterator[RawMessage]:
        with self._file.open("rb") as file:
            sqlite = file.read(len(SQLITE_MAGIC)) == SQLITE_MAGIC
        yield from (_sqlite_messages if sqlite else _mcap_messages)(self._file)


def bag_file(path: Path) -> Path | None:
    """Return the bag at a path, or the only one in a folder; None if there is none.

    Raises RecordingError for several.
    """
    if path.is_dir():
        files = [entry for entry in sorted(path.iterdir()) if entry.suffix in (".mcap", ".db3", ".bag")]
        if len(files) > 1:
            names = ", ".join(file.name for file in files[:3])
            raise RecordingError(f"{path}: a bag of several files ({names}); name one of them, or merge them: ros2 bag convert")
        return files[0] if files else None
    with path.open("rb") as file:
        head = file.read(len(SQLITE_MAGIC))
    return path if head == SQLITE_MAGIC or head.startswith((MCAP_MAGIC, ROS1_MAGIC)) else None


def _mcap_messages(file: Path) -> Iterator[RawMessage]:
    from mcap.exceptions import McapError
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with file.open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    if channel.message_encoding == "cdr":
                        yield RawMessage(channel.topic, schemas[channel.schema_id].name, record.data)
        except (McapError, struct.error, ValueError, EOFError):
            return  # the file was cut here


def _sqlite_messages(file: Path) -> Iterator[RawMessage]:
    read = False
    with closing(read_only(file)) as database:
        try:
            rows = database.execute("SELECT topics.name, topics.type, messages.data FROM messages JOIN topics ON topics.id = "
                                    "messages.topic_id ORDER BY messages.timestamp, messages.id")  # fmt: skip
            for topic, kind, data in rows:
                read = True
                yield RawMessage(topic, kind, data)
        except sqlite3.OperationalError as error:
            raise RecordingError(f"{file}: an SQLite file, but no ROS 2 bag ({error})") from None
        except sqlite3.DatabaseError as error:
            if not read:
                raise RecordingError(f"{file}: damaged or cut ({error})") from None
            return  # the file was cut here


def _decoder() -> Callable[[RawMessage], Any]:
    try:
        import mcap.stream_reader  # noqa: F401 - read later
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise RecordingError(f"a ROS 2 bag needs the package {error.name}: pip install 'uav-recon[recordings]'") from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    return lambda message: store.deserialize_cdr(message.data, message.kind)


def _stamp_s(message: Any) -> float:
    return float(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9)
