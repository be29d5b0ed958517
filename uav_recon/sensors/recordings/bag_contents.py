"""First pass over a ROS 2 bag.

It finds topics, stamps, intrinsics, transforms, poses and inertial samples.
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from uav_recon.sensors.recordings.bag_messages import (
    CAMERA_INFO,
    DEPTH,
    IMAGES,
    IMU,
    POSES,
    TF,
    StaticTransforms,
    image_use,
    metres_per_unit,
)
from uav_recon.sensors.recordings.bag_storage import BagStorage, RawMessage
from uav_recon.sensors.recordings.recording import DamagedItemError, RecordingError

TF_TOPIC, TF_STATIC = "/tf", "tf_static"
_POSE_WORDS = ("odometry", "pose", "transform", "position", "path")  # in the names of types that may hold poses


class BagDecoder:
    """Decoder of messages of ROS 2. Raises RecordingError without the packages mcap and rosbags."""

    def __init__(self) -> None:
        try:
            import mcap.stream_reader  # noqa: F401 - read later
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise RecordingError(f"a ROS 2 bag needs the package {error.name}: pip install 'uav-recon[recordings]'") from None
        self._store = get_typestore(Stores.ROS2_HUMBLE)

    def __call__(self, message: RawMessage) -> Any:
        """Return the message as an object. Raises DamagedItemError."""
        try:
            return self._store.deserialize_cdr(message.data, message.kind)
        except Exception as error:  # of many kinds, for damaged bytes
            text = f"{message.topic}: {message.kind} of {len(message.data)} bytes cannot be decoded"
            raise DamagedItemError(f"{text} ({type(error).__name__})") from None


@dataclass
class BagContents:
    """Result of the first pass.

    stamps_s: of each image topic, in the order of the file; NaN for a message without a header. frame_ids: of each image topic.
    depth: metres per unit of each depth topic, as its encoding has them. moving: transforms of /tf, by parent and child.
    unused: topics that are not read, with their type. damaged: count of messages that cannot be decoded, by topic.
    """

    depth: dict[str, float] = field(default_factory=dict)
    colour: set[str] = field(default_factory=set)
    infos: dict[str, Any] = field(default_factory=dict)
    poses: dict[str, list[Any]] = field(default_factory=dict)
    imu: dict[str, list[Any]] = field(default_factory=dict)
    stamps_s: dict[str, list[float]] = field(default_factory=dict)
    frame_ids: dict[str, str] = field(default_factory=dict)
    transforms: StaticTransforms = field(default_factory=StaticTransforms)
    moving: dict[tuple[str, str], list[Any]] = field(default_factory=dict)
    unused: dict[str, str] = field(default_factory=dict)
    damaged: Counter[str] = field(default_factory=Counter)

    @staticmethod
    def read(storage: BagStorage, decode: BagDecoder) -> BagContents:
        """Read a bag. Raises RecordingError."""
        found = BagContents()
        note = _Notes(found, decode, str(storage.path))
        readers: dict[str, Callable[[RawMessage], None]] = {
            CAMERA_INFO: note.info, TF: note.transforms, IMU: note.imu,
            **dict.fromkeys(POSES, note.pose), **dict.fromkeys(IMAGES, note.image),
        }  # fmt: skip
        for message in storage.messages():
            try:
                readers.get(message.kind, note.other)(message)
            except DamagedItemError:
                found.damaged[message.topic] += 1
        return found

    def pose_of_depth(self, depth_frame: str) -> list[Any]:
        """Return the transforms of /tf that move the depth imager in a frame that stands still.

        Empty if it is not clear.

        The child is fixed to the depth imager, and the parent is no child itself, or is odom, which by REP-105 moves without
        jumps.
        """
        children = {child for _, child in self.moving}
        fitting = [
            messages
            for (parent, child), messages in self.moving.items()
            if (parent not in children or parent == "odom") and self.transforms.between(child, depth_frame) is not None
        ]
        return fitting[0] if len(fitting) == 1 else []

    def unused_poses(self) -> str:
        """Return the topics that may hold poses and are not read, as text; '' without any."""
        words = [f"{topic} ({kind})" for topic, kind in sorted(self.unused.items()) if _may_hold_poses(kind)]
        moves = ", ".join(f"{child!r} in {parent!r}" for parent, child in sorted(self.moving))
        return ", ".join([*words, *([f"{TF_TOPIC} ({moves})"] if moves else [])])


class _Notes:
    """Store for what is kept of each message."""

    def __init__(self, found: BagContents, decode: BagDecoder, path: str) -> None:
        self._found, self._decode, self._path = found, decode, path

    def info(self, message: RawMessage) -> None:
        if message.topic not in self._found.infos:
            self._found.infos[message.topic] = self._decode(message)

    def transforms(self, message: RawMessage) -> None:
        decoded = self._decode(message)
        if message.topic.endswith(TF_STATIC):
            self._found.transforms.add(decoded, f"{self._path}: {message.topic}")
            return
        for one in decoded.transforms:
            pair = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
            self._found.moving.setdefault(pair, []).append(one)

    def imu(self, message: RawMessage) -> None:
        self._found.imu.setdefault(message.topic, []).append(self._decode(message))

    def pose(self, message: RawMessage) -> None:
        self._found.poses.setdefault(message.topic, []).append(self._decode(message))

    def image(self, message: RawMessage) -> None:
        """Note the stamp of an image; the first that can be decoded tells what its topic holds."""
        topic, found = message.topic, self._found
        found.stamps_s.setdefault(topic, []).append(stamp_s_of(message))
        if topic in found.frame_ids:
            return
        image = self._decode(message)
        use = image_use(image)
        if use is None:
            found.unused[topic] = f"{message.kind} of format {image.format!r}"
            return
        found.unused.pop(topic, None)
        found.frame_ids[topic] = image.header.frame_id
        if use == DEPTH:
            found.depth[topic] = metres_per_unit(image)
        else:
            found.colour.add(topic)

    def other(self, message: RawMessage) -> None:
        self._found.unused[message.topic] = message.kind


def stamp_s_of(message: RawMessage) -> float:
    """Return the stamp of a message's header; NaN if it has none."""
    try:
        return message.stamp_s()
    except (struct.error, IndexError):
        return math.nan


def _may_hold_poses(kind: str) -> bool:
    name = kind.rsplit("/", 1)[-1].lower()
    return any(word in name for word in _POSE_WORDS)
