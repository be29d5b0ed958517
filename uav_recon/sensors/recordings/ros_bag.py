"""ROS 2 bag as a recording: MCAP or SQLite (.db3), compressed or not.

Recordings of `uav-recon record` are such bags. Needs the packages mcap and rosbags (`pip install uav-recon[recordings]`), not
ROS.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from uav_recon.sensors.recordings.bag_contents import TF_TOPIC, BagContents, BagDecoder, stamp_s_of
from uav_recon.sensors.recordings.bag_messages import (
    FILTERED_POSE,
    BagTopics,
    Lens,
    body_frame_of,
    depth_image,
    only_topic,
    rgb_image,
    stamped_pose_of,
)
from uav_recon.sensors.recordings.bag_storage import BagStorage, RawMessage
from uav_recon.sensors.recordings.damaged_frames import DamagedFrames
from uav_recon.sensors.recordings.frame_pairing import paired
from uav_recon.sensors.recordings.frame_stamps import used_frames
from uav_recon.sensors.recordings.recording import LEVEL_MOUNT, DepthUnit, RecordingError, RecordingInfo
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import AnyArray
from uav_recon.types.pose import Pose, StampedPose


class RosBag:
    """Recording protocol over a bag. Raises RecordingError.

    metres_per_unit: of the depth images; None: as their encoding has them. skipped: counts of what cannot be used, by reason.
    """

    def __init__(self, storage: BagStorage, metres_per_unit: float | None, topics: BagTopics) -> None:
        file, self._storage = storage.path, storage
        self._file, self._decode, self._damaged = file, BagDecoder(), DamagedFrames()
        found = self._contents = BagContents.read(storage, self._decode)
        self._depth = self._depth_topic(topics.depth)
        self._colour = only_topic(file, "colour", "--colour-topic", topics.colour, found.colour)
        self._imu = only_topic(file, "IMU", "--imu-topic", topics.imu, found.imu)
        self._unit = DepthUnit(metres_per_unit or found.depth[self._depth])
        self._depth_lens = self._lens(self._depth)
        self._rgb_lens = self._lens(self._colour) if self._colour else self._depth_lens
        self._rgb_from_depth = self._between(self._colour, self._depth) if self._colour else Pose.identity()
        self._used = used_frames(file, found.stamps_s[self._depth])
        self.skipped: Counter[str] = Counter(self._used.skipped)
        self.skipped.update({f"messages of {topic} that cannot be decoded": n for topic, n in found.damaged.items()})
        cut = f"the file is cut: it is read up to {self._used.stamps_s[-1]:.3f} s"
        self._remarks = [*self._used.remarks, *([cut] if storage.cut else [])]
        self._poses, self._body_from_depth, self._body = self._placed(self._pose_messages(topics.pose), topics.pose_of)

    @property
    def info(self) -> RecordingInfo:
        """Return the head of the recording."""
        stamps_s, skipped = self._used.stamps_s, (*self.skipped.items(), *self._damaged.counts())
        return RecordingInfo(
            "ROS 2 bag", len(stamps_s), stamps_s[0], stamps_s[-1], self._body_from_depth, True, self._unit.metres_per_unit,
            skipped, tuple(self._remarks), self._used.is_part,
        )  # fmt: skip

    def frames(self, step: int = 1) -> Iterator[Frame]:
        """Yield every step-th depth image with its nearest colour image. Raises RecordingError."""
        is_depth, is_colour = (lambda one: one.topic == self._depth), self._is_colour
        order = self._used.order[::step]
        pairs = paired(self._storage.messages(), is_depth, is_colour, stamp_s_of, order, colour=self._colour is not None)
        return self._damaged.readable((at * step, partial(self._frame, at * step, depth, rgb)) for at, depth, rgb in pairs)

    def poses(self) -> list[StampedPose]:
        """Return the poses of the body."""
        return self._poses

    def imu(self) -> list[ImuSample]:
        """Return the inertial samples in body axes; empty if nothing tells how the IMU is mounted."""
        messages = self._contents.imu.get(self._imu or "", [])
        if not messages:
            return []
        body_from_imu = self._contents.transforms.between(self._body, messages[0].header.frame_id)
        if body_from_imu is None:
            self.skipped["imu samples without a transform to the body"] = len(messages)
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

    def _is_colour(self, message: RawMessage) -> bool:
        return message.topic == self._colour and np.isfinite(stamp_s_of(message))

    # -- topics ---------------------------------------------------------------------------------------------------------

    def _depth_topic(self, named: str | None) -> str:
        found = self._contents
        depth = only_topic(self._file, "depth", "--depth-topic", named, found.depth)
        if depth is not None:
            return depth
        images = [f"{topic} ({found.unused[topic]})" if topic in found.unused else topic for topic in sorted(found.stamps_s)]
        cut = ", and is cut" if self._storage.cut else ""
        raise RecordingError(
            f"{self._file}: has no depth image (16UC1 or 32FC1){cut}; it has {', '.join(images) or 'no image'}"
        )

    def _pose_messages(self, named: str | None) -> list[Any]:
        """Return the messages that tell the poses; a remark says what is not used.

        Of several kinds of topics the first is used: odometry and poses, poses with a covariance (of a filter), /tf.
        """
        found, depth_frame = self._contents, self._contents.frame_ids[self._depth]
        moves = found.pose_of_depth(depth_frame)
        topics = {**found.poses, **({TF_TOPIC: moves} if moves else {})}
        filtered = {topic for topic, messages in topics.items() if messages[0].__msgtype__ == FILTERED_POSE}
        kinds = set(found.poses) - filtered, filtered, set(topics)
        first = topics if named is not None else next((kind for kind in kinds if kind), set())
        topic = only_topic(self._file, "pose", "--pose-topic", named, first)
        if topic is None and (unused := found.unused_poses()):
            self._remarks.append(f"no poses are used; found and not read: {unused}")
        return topics.get(topic or "", [])

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

    def _placed(self, messages: list[Any], pose_of: str) -> tuple[list[StampedPose], Pose, str]:
        """Return the poses of the body, body_from_depth, and the name of the body's frame.

        A remark says what is assumed.
        """
        depth_frame = self._contents.frame_ids[self._depth]
        first = body_frame_of(messages[0]) if messages else ""
        body_from_depth = self._contents.transforms.between(first, depth_frame) if first else None
        if messages and body_from_depth is None:
            self._remarks.append(_assumed_mount(first, depth_frame, pose_of))
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


def _assumed_mount(frame: str, depth_frame: str, pose_of: str) -> str:
    """Return the line that says how the camera is mounted, where no transform does."""
    whose = f"/tf_static does not connect {frame!r} with {depth_frame!r}" if frame else "the poses name no body"
    if pose_of == "camera":
        return f"{whose}: they count as those of the camera in optical axes (else --pose-of body)"
    return f"{whose}: the camera counts as mounted level at the body's origin, looking along its x axis"


def _stamp_s(message: Any) -> float:
    return float(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9)
