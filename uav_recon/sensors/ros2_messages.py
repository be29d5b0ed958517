"""ROS 2 messages on DDS: fields of the .msg files, type names as ROS 2 mangles them.

Importing this module needs cyclonedds. Annotations are evaluated by it, so they are no strings here.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32

_CDR_LITTLE = 0x01  # second byte of the encapsulation header; ROS 2 on x86 and ARM sends no other order


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):  # type: ignore[misc, call-arg]
    """Seconds and nanoseconds of the publisher's system clock."""

    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):  # type: ignore[misc, call-arg]
    """Stamp and frame."""

    stamp: Time
    frame_id: str


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):  # type: ignore[misc, call-arg]
    """A position in metres."""

    x: float64
    y: float64
    z: float64


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):  # type: ignore[misc, call-arg]
    """A vector."""

    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):  # type: ignore[misc, call-arg]
    """A rotation; w is last."""

    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class PoseMessage(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):  # type: ignore[misc, call-arg]
    """Position and rotation."""

    position: Point
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):  # type: ignore[misc, call-arg]
    """A pose and its stamp."""

    header: Header
    pose: PoseMessage


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):  # type: ignore[misc, call-arg]
    """A pose and its covariance, 6 x 6 row by row: position, then rotation about fixed axes."""

    pose: PoseMessage
    covariance: array[float64, 36]


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):  # type: ignore[misc, call-arg]
    """Velocity and angular rate."""

    linear: Vector3
    angular: Vector3


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):  # type: ignore[misc, call-arg]
    """A twist and its covariance."""

    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):  # type: ignore[misc, call-arg]
    """A pose of child_frame_id in the header's frame, and the twist in child_frame_id."""

    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Imu(IdlStruct, typename="sensor_msgs::msg::dds_::Imu_"):  # type: ignore[misc, call-arg]
    """An inertial sample; linear_acceleration is the specific force."""

    header: Header
    orientation: Quaternion
    orientation_covariance: array[float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: array[float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: array[float64, 9]


@dataclass
class RegionOfInterest(IdlStruct, typename="sensor_msgs::msg::dds_::RegionOfInterest_"):  # type: ignore[misc, call-arg]
    """A window of the image."""

    x_offset: uint32
    y_offset: uint32
    height: uint32
    width: uint32
    do_rectify: bool


@dataclass
class CameraInfo(IdlStruct, typename="sensor_msgs::msg::dds_::CameraInfo_"):  # type: ignore[misc, call-arg]
    """Intrinsics; k is 3 x 3 row by row."""

    header: Header
    height: uint32
    width: uint32
    distortion_model: str
    d: sequence[float64]
    k: array[float64, 9]
    r: array[float64, 9]
    p: array[float64, 12]
    binning_x: uint32
    binning_y: uint32
    roi: RegionOfInterest


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):  # type: ignore[misc, call-arg]
    """An image; data is a list of bytes to write, and an array (N,) of uint8 once received."""

    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]

    @classmethod
    def deserialize(cls, data: bytes, has_header: bool = True, use_version_2: bool | None = None) -> Any:
        """Decode CDR without a Python object per pixel (30 ms for 640x480 otherwise).

        Raises ValueError for truncated data or big-endian order.
        """
        if len(data) < 4 or data[1] & 1 != _CDR_LITTLE:
            raise ValueError("image: not little-endian CDR")
        reader = _CdrReader(data[4:])
        stamp = Time(*np.frombuffer(reader.take(8), "<i4,<u4")[0].tolist())
        header = Header(stamp, reader.text())
        height, width, encoding = reader.uint32(), reader.uint32(), reader.text()
        big, step = reader.take(1)[0], reader.uint32()
        return cls(header, height, width, encoding, big, step, np.frombuffer(reader.take(reader.uint32()), np.uint8))


class _CdrReader:
    """Cursor over little-endian CDR."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def take(self, count: int) -> bytes:
        """Return the next bytes. Raises ValueError at the end."""
        if self._at + count > len(self._data):
            raise ValueError(f"image: {len(self._data)} bytes of CDR, want {self._at + count}")
        self._at += count
        return self._data[self._at - count : self._at]

    def uint32(self) -> int:
        """Return the next aligned number."""
        self._at += -self._at % 4
        return int.from_bytes(self.take(4), "little")

    def text(self) -> str:
        """Return the next string, without its final zero."""
        return self.take(self.uint32()).rstrip(b"\0").decode("utf-8", "replace")
