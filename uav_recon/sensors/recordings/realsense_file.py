"""Recording of librealsense: .db3, or .bag before version 2.57.

The first has messages of ROS 2, the second of ROS 1. Both hold the streams of one device below /device_0/sensor_N/. Depth is in
units of the device, stamps are in the metadata of each frame, gyro and accelerometer are apart. The camera has no body: it
counts as carried level, looking along its x axis.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from functools import partial
from types import SimpleNamespace

import numpy as np

from uav_recon.sensors.recordings.bag_messages import Lens, depth_image, rgb_image
from uav_recon.sensors.recordings.bag_storage import BagStorage
from uav_recon.sensors.recordings.damaged_frames import DamagedFrames
from uav_recon.sensors.recordings.frame_pairing import paired
from uav_recon.sensors.recordings.frame_stamps import used_frames
from uav_recon.sensors.recordings.realsense_messages import (
    Ros1Messages,
    Ros2Messages,
    StreamContents,
    StreamMessage,
    StreamMessages,
)
from uav_recon.sensors.recordings.recording import (
    LEVEL_MOUNT,
    MM,
    DamagedItemError,
    DepthUnit,
    RecordingError,
    RecordingInfo,
)
from uav_recon.sensors.recordings.ros1_bag import Ros1Bag
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.pose import Pose, StampedPose

_FIRST_MESSAGES = 100  # of a bag; librealsense begins with the description of the device
_NOT_CORRECTED = ("Inverse Brown Conrady", "Modified Brown Conrady", "F-Theta", "Kannala Brandt4")


class RealSenseFile:
    """Recording protocol over a file of librealsense. Raises RecordingError.

    The stamps are the device's if all streams have one clock, otherwise those of the file. metres_per_unit: of depth; None: as
    the file tells. skipped: what cannot be used.
    """

    def __init__(self, storage: BagStorage, metres_per_unit: float | None) -> None:
        file = self._file = storage.path
        self._messages: StreamMessages = Ros1Messages(storage.content) if storage.ros1 else Ros2Messages(storage)
        self.skipped: Counter[str] = Counter()
        self._damaged = DamagedFrames()
        found = self._contents = self._read_contents()
        if "Depth" not in found.images:
            cut = ", and is cut or was not closed" if self._messages.cut else ""
            raise RecordingError(f"{file}: has no depth{cut}; it has {', '.join(sorted(found.infos)) or 'no image'}")
        self._unit = DepthUnit(metres_per_unit or found.unit_m or MM)
        self._lenses = {name: self._lens(name) for name in found.images}
        clocks = {found.clocks.get(stream) for stream in (*found.images, *found.motion)}  # a cut may leave others without data
        self._one_clock = len(clocks) == 1 and None not in clocks
        if not self._one_clock:
            why = "a stream does not tell its clock" if None in clocks else "the streams have several clocks"
            self.skipped[f"stamps of the device: {why}"] += 1
        self._used = used_frames(file, [self._stamp_s("Depth", file_ns) for file_ns in found.images["Depth"]])
        self.skipped.update(self._used.skipped)
        cut = f"the file is cut or was not closed: it is read up to {self._used.stamps_s[-1]:.3f} s"
        self._remarks = (*self._used.remarks, *([cut] if self._messages.cut else []))

    @property
    def info(self) -> RecordingInfo:
        """Return the head of the recording."""
        stamps_s, skipped = self._used.stamps_s, (*self.skipped.items(), *self._damaged.counts())
        return RecordingInfo(
            "librealsense recording", len(stamps_s), stamps_s[0], stamps_s[-1], LEVEL_MOUNT, False, self._unit.metres_per_unit,
            skipped, self._remarks, self._used.is_part,
        )  # fmt: skip

    def frames(self, step: int = 1) -> Iterator[Frame]:
        """Yield every step-th depth image with its nearest colour image."""
        images = (one for one in self._messages.messages() if one.is_image)

        def stamp_s(one: StreamMessage) -> float:
            return self._stamp_s(one.stream, one.file_ns)

        def is_colour(one: StreamMessage) -> bool:
            return one.stream == "Color" and math.isfinite(stamp_s(one))

        order, has_colour = self._used.order[::step], "Color" in self._lenses
        pairs = paired(images, lambda one: one.stream == "Depth", is_colour, stamp_s, order, colour=has_colour)
        return self._damaged.readable((at * step, partial(self._frame, at * step, depth, rgb)) for at, depth, rgb in pairs)

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
        rows = [row for row, stamp_s in zip(rows, stamps_s, strict=True) if math.isfinite(stamp_s)]
        stamps_s = stamps_s[np.isfinite(stamps_s)]
        depth_from_ref = self._contents.poses.get("Depth", Pose.identity()).inverse()
        between = depth_from_ref @ self._contents.poses.get(stream, depth_from_ref.inverse())
        turn = (LEVEL_MOUNT @ between).rotation()
        newer = np.concatenate(([True], stamps_s[1:] > np.maximum.accumulate(stamps_s)[:-1]))
        return stamps_s[newer], (np.array([value for _, value in rows]) @ turn.T)[newer]

    def _stamp_s(self, stream: str, file_ns: int) -> float:
        """Return the stamp of a message; NaN if its metadata are missing."""
        return self._contents.stamps_s.get((stream, file_ns), math.nan) if self._one_clock else file_ns * 1e-9

    def _frame(self, number: int, depth: StreamMessage, colour: StreamMessage | None) -> Frame:
        stamp_s, lens = self._stamp_s("Depth", depth.file_ns), self._lenses["Depth"]
        raw = lens.undistorted(depth_image(self._messages.image(depth), self._where("Depth")), self._where("Depth"))
        rgb_lens = self._lenses.get("Color", lens)
        rgb: AnyArray = np.zeros((rgb_lens.intrinsics.height, rgb_lens.intrinsics.width, 3), np.uint8)
        if colour is not None:
            where = self._where("Color")
            rgb = rgb_lens.undistorted(rgb_image(self._messages.image(colour), where), where)
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

    def _read_contents(self) -> StreamContents:
        found = StreamContents()
        for message in self._messages.messages():
            if message.is_image:
                found.images.setdefault(message.stream, []).append(message.file_ns)
            try:
                self._messages.note(found, message)
            except DamagedItemError:
                self.skipped[f"messages of {message.stream} that cannot be decoded"] += 1
        return found


def is_realsense_file(storage: BagStorage) -> bool:
    """Return True if a file has the topics of librealsense.

    Raises RecordingError for another bag of ROS 1.
    """
    if storage.ros1:
        return _is_realsense_bag(storage)
    return any(topic.startswith("/device_0/sensor_") for topic, _ in storage.topics())


def _is_realsense_bag(storage: BagStorage) -> bool:
    bag = Ros1Bag(storage.content)
    topics = [message.topic for message in itertools.islice(bag.messages(), _FIRST_MESSAGES)]
    if any(topic.startswith("/device_0/") for topic in topics):
        return True
    if bag.cut and not topics:
        raise RecordingError(f"{storage.path}: a ROS 1 bag that is cut before its first message")
    raise RecordingError(f"{storage.path}: a ROS 1 bag that librealsense did not write; convert it to ROS 2: rosbags-convert")
