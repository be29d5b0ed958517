"""Messages of a ROS 2 bag as values: images, intrinsics, poses and static transforms."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from uav_recon.sensors.recordings.compressed_depth import DEPTH_ENCODINGS, decoded_depth, encoding_of, holds_depth
from uav_recon.sensors.recordings.image_decoding import rgb_of
from uav_recon.sensors.recordings.recording import MM, DamagedItemError, RecordingError
from uav_recon.types.camera import Intrinsics
from uav_recon.types.frames import AnyArray
from uav_recon.types.pose import Pose

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMU = "sensor_msgs/msg/Imu"
FILTERED_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped", FILTERED_POSE)
TF = "tf2_msgs/msg/TFMessage"
DEPTH, COLOUR = "depth", "colour"
_DISTORTED_SHARE = 1e-9  #: internal: smaller coefficients of a lens are none
_COEFFICIENTS = (0, 4, 5, 8, 12, 14)  #: internal: of the distortion models of OpenCV
_DEPTH_ENCODINGS = {"16UC1": np.uint16, "mono16": np.uint16, "32FC1": np.float32}
_CHANNELS = {"rgb8": (3, None), "bgr8": (3, cv2.COLOR_BGR2RGB), "rgba8": (4, cv2.COLOR_RGBA2RGB),
             "bgra8": (4, cv2.COLOR_BGRA2RGB), "mono8": (1, cv2.COLOR_GRAY2RGB)}  # fmt: skip


@dataclass(frozen=True)
class BagTopics:
    """Topics that the user names; None: the only one of a fitting type.

    pose_of: whose pose it is, where no transform tells.
    """

    depth: str | None = None
    colour: str | None = None
    pose: str | None = None
    imu: str | None = None
    pose_of: str = "camera"


def only_topic(path: Path, what: str, option: str, named: str | None, found: Iterable[str]) -> str | None:
    """Return the named topic, or the only one found, or None.

    Raises RecordingError for a wrong name or several topics.
    """
    topics = sorted(found)
    if named is not None:
        if named not in topics:
            raise RecordingError(f"{option} {named}: {path} has no such {what} topic; it has {', '.join(topics) or 'none'}")
        return named
    if len(topics) > 1:
        raise RecordingError(f"{path}: has several {what} topics, name one by {option}: {', '.join(topics)}")
    return topics[0] if topics else None


def image_use(message: Any) -> str | None:
    """Return DEPTH or COLOUR for an Image or CompressedImage, by its format.

    None for one that is neither.

    Depth as JPEG is neither: it has 8 bits a pixel.
    """
    if hasattr(message, "encoding"):
        return DEPTH if message.encoding in _DEPTH_ENCODINGS else COLOUR
    data = bytes(message.data)
    if holds_depth(message.format, data):
        return DEPTH
    return None if encoding_of(message.format) in DEPTH_ENCODINGS or not data else COLOUR


def metres_per_unit(message: Any) -> float:
    """Return the metres per unit of a depth image by its encoding.

    Float is in metres, 16 bits are millimetres.
    """
    encoding = message.encoding if hasattr(message, "encoding") else encoding_of(message.format)
    return 1.0 if encoding == "32FC1" else MM


def depth_image(message: Any, where: str) -> AnyArray:
    """Return the depth (H, W) of an image.

    It is uint16 raw, or float32 (in metres if it was compressed).

    Raises DamagedItemError, and RecordingError for an encoding that is not known.
    """
    if not hasattr(message, "encoding"):
        return decoded_depth(message.format, bytes(message.data), where)
    kind = _DEPTH_ENCODINGS.get(message.encoding)
    if kind is None:
        raise RecordingError(f"{where}: depth encoding {message.encoding!r}; want 16UC1 or 32FC1")
    return _pixels(message, np.dtype(kind), 1, where)[..., 0]


def rgb_image(message: Any, where: str) -> AnyArray:
    """Return the colour (h, w, 3) uint8 RGB of an image.

    Raises DamagedItemError, and RecordingError for an encoding that is not known.
    """
    if not hasattr(message, "encoding"):
        return rgb_of(bytes(message.data), f"{where}: format {message.format!r}")
    if message.encoding not in _CHANNELS:
        raise RecordingError(f"{where}: colour encoding {message.encoding!r}; want one of {', '.join(_CHANNELS)}")
    channels, code = _CHANNELS[message.encoding]
    pixels = _pixels(message, np.dtype(np.uint8), channels, where)
    return pixels if code is None else np.asarray(cv2.cvtColor(pixels, code))


def _pixels(message: Any, kind: np.dtype[Any], channels: int, where: str) -> AnyArray:
    data, row = np.asarray(message.data, dtype=np.uint8), message.width * channels * kind.itemsize
    if row == 0 or message.step < row or data.size < message.step * message.height:
        raise DamagedItemError(f"{where}: {data.size} bytes for {message.width} x {message.height} {message.encoding}")
    rows = np.ascontiguousarray(data[: message.step * message.height].reshape(message.height, message.step)[:, :row])
    pixels = rows.view(kind.newbyteorder(">" if message.is_bigendian else "<")).astype(kind, copy=False)
    return pixels.reshape(message.height, message.width, channels)


class Lens:
    """Intrinsics of a CameraInfo, and the correction of its distortion.

    Raises RecordingError for a distortion model that is not known, and for numbers that make no lens.
    """

    def __init__(self, info: Any, where: str) -> None:
        k, coefficients = np.asarray(info.k, dtype=np.float64).reshape(3, 3), np.asarray(info.d, dtype=np.float64)
        if not (np.isfinite(k).all() and np.isfinite(coefficients).all()):
            raise RecordingError(f"{where}: k or d has a number that is not finite")
        if coefficients.size not in _COEFFICIENTS:
            counts = ", ".join(map(str, _COEFFICIENTS))
            raise RecordingError(f"{where}: d has {coefficients.size} numbers; want one of {counts}")
        if not (k[0, 0] > 0 and k[1, 1] > 0):
            raise RecordingError(f"{where}: fx {k[0, 0]:g} and fy {k[1, 1]:g} must be positive")
        self.intrinsics = Intrinsics(
            float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), int(info.width), int(info.height)
        )
        self._maps: tuple[AnyArray, AnyArray] | None = None
        if coefficients.size and np.abs(coefficients).max() > _DISTORTED_SHARE:
            if info.distortion_model not in ("plumb_bob", "rational_polynomial"):
                raise RecordingError(
                    f"{where}: distortion model {info.distortion_model!r}; want plumb_bob, rational_polynomial or none"
                )
            size = (int(info.width), int(info.height))
            maps: Any = cv2.initUndistortRectifyMap(k, coefficients, np.eye(3), k, size, cv2.CV_32FC1)
            self._maps = maps[0], maps[1]

    def undistorted(self, image: AnyArray, where: str) -> AnyArray:
        """Return the image without distortion; depth keeps its values.

        Raises DamagedItemError for another size.
        """
        if image.shape[:2] != (self.intrinsics.height, self.intrinsics.width):
            found = f"{image.shape[1]} x {image.shape[0]}"
            raise DamagedItemError(
                f"{where}: is {found}, and its CameraInfo {self.intrinsics.width} x {self.intrinsics.height}"
            )
        if self._maps is None:
            return image
        colour = image.ndim == 3
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR if colour else cv2.INTER_NEAREST))


class StaticTransforms:
    """Transforms of /tf_static between any two connected frames."""

    def __init__(self) -> None:
        self._from: dict[str, dict[str, Pose]] = {}

    def add(self, message: Any, where: str) -> None:
        """Add the transforms of a TFMessage.

        Raises RecordingError for one that is no rigid transform.
        """
        for one in message.transforms:
            try:
                parent_from_child = pose_of(one.transform.translation, one.transform.rotation)
            except ValueError as error:
                raise RecordingError(f"{where}: {one.child_frame_id!r} in {one.header.frame_id!r}: {error}") from None
            parent, child = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
            self._from.setdefault(child, {})[parent] = parent_from_child
            self._from.setdefault(parent, {})[child] = parent_from_child.inverse()

    def between(self, target: str, source: str) -> Pose | None:
        """Return target_from_source, None if the two are not connected.

        A frame is connected with itself.
        """
        target, source = target.lstrip("/"), source.lstrip("/")
        reached, todo = {source: Pose.identity()}, deque([source])
        while todo:
            frame = todo.popleft()
            if frame == target:
                return reached[frame]
            for following, following_from_frame in self._from.get(frame, {}).items():
                if following not in reached:
                    reached[following] = following_from_frame @ reached[frame]
                    todo.append(following)
        return None


def pose_of(position: Any, rotation: Any) -> Pose:
    """Return the pose of a Point or Vector3 and a Quaternion. Raises ValueError if it is none."""
    return Pose(np.array([rotation.w, rotation.x, rotation.y, rotation.z]), np.array([position.x, position.y, position.z]))


def body_frame_of(message: Any) -> str:
    """Return the frame whose pose a message tells, or ''."""
    return str(getattr(message, "child_frame_id", ""))


def stamped_pose_of(message: Any) -> Pose:
    """Return the pose of a message of one of the types POSES.

    Raises ValueError for a pose that is not finite or has no rotation.
    """
    if hasattr(message, "transform"):
        return pose_of(message.transform.translation, message.transform.rotation)
    pose = getattr(message.pose, "pose", message.pose)  # with a covariance, it is one level deeper
    return pose_of(pose.position, pose.orientation)
