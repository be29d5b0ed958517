"""Writer of a recording: an MCAP file with ROS 2 messages.

Foxglove and the ros2 tools open it.
Chunks are compressed and written whole: a file that is cut is readable up to its last whole chunk. Topics: /camera/depth/image
(16UC1, millimetres), /camera/colour/image/compressed (JPEG), their camera_info, /imu, /odom and /tf_static.
"""

from __future__ import annotations

from io import BufferedWriter
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from uav_recon.sensors.recordings.recording import RecordingError
from uav_recon.sensors.stream_format import CameraSpec, StreamHeader
from uav_recon.types.frames import AnyArray
from uav_recon.types.pose import Pose

DEPTH, COLOUR = "/camera/depth", "/camera/colour"
DEPTH_IMAGE, COLOUR_IMAGE = f"{DEPTH}/image", f"{COLOUR}/image/compressed"
IMU, ODOM, TF = "/imu", "/odom", "/tf_static"
DEPTH_FRAME, COLOUR_FRAME, BODY, WORLD = "depth_optical", "colour_optical", "body", "odom"
CHUNK_BYTES = 1 << 20
JPEG_QUALITY = 95


class McapWriter:
    """A recording being written.

    Raises RecordingError if the packages are missing, OSError if the file cannot be written.

    max_bytes: the file never grows beyond it by more than a frame; ``full`` is True then, and nothing more is written.
    body_from_depth: mount of the depth imager.
    """

    def __init__(self, path: Path, header: StreamHeader, body_from_depth: Pose, max_bytes: int) -> None:
        try:
            from mcap.writer import Writer
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise RecordingError(f"a recording needs the package {error.name}: pip install 'uav-recon[recordings]'") from None
        self._max_bytes = max_bytes
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._file: BufferedWriter = path.open("xb")
        self._writer: Any = Writer(self._file, chunk_size=CHUNK_BYTES)
        self._writer.start(profile="ros2", library="uav_recon")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._header, self._body_from_depth = header, body_from_depth
        self._described = False
        self._closed_bytes = 0
        self.frames = self.imu = self.poses = 0

    @property
    def size_bytes(self) -> int:
        """Size of the file. Up to a chunk is still in memory."""
        return self._closed_bytes if self._file.closed else self._file.tell()

    @property
    def full(self) -> bool:
        """True once the file has reached its limit."""
        return self.size_bytes >= self._max_bytes

    def write_frame(self, stamp_s: float, depth_mm: AnyArray, rgb: AnyArray) -> None:
        """Write a frame: depth_mm (H, W) uint16, rgb (h, w, 3) uint8."""
        if not self._described:
            self._describe(stamp_s)
        depth = self._message(
            "sensor_msgs/msg/Image", header=self._head(stamp_s, DEPTH_FRAME), height=depth_mm.shape[0], width=depth_mm.shape[1],
            encoding="16UC1", is_bigendian=0, step=2 * depth_mm.shape[1],
            data=np.frombuffer(np.ascontiguousarray(depth_mm, dtype="<u2").tobytes(), np.uint8),
        )  # fmt: skip
        bgr = np.ascontiguousarray(rgb[..., ::-1])
        _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        colour = self._message(
            "sensor_msgs/msg/CompressedImage", header=self._head(stamp_s, COLOUR_FRAME), format="jpeg",
            data=np.asarray(jpeg, np.uint8).reshape(-1),
        )  # fmt: skip
        self._write(DEPTH_IMAGE, depth, stamp_s)
        self._write(COLOUR_IMAGE, colour, stamp_s)
        self.frames += 1

    def write_imu(self, stamp_s: float, gyro_radps: AnyArray, specific_force_mps2: AnyArray) -> None:
        """Write an inertial sample in body FLU axes."""
        unknown = np.zeros(9)
        unknown[0] = -1.0  # by the convention of the message: no attitude
        message = self._message(
            "sensor_msgs/msg/Imu", header=self._head(stamp_s, BODY), orientation=self._rotation(Pose.identity()),
            orientation_covariance=unknown, angular_velocity=self._vector(gyro_radps),
            angular_velocity_covariance=np.zeros(9), linear_acceleration=self._vector(specific_force_mps2),
            linear_acceleration_covariance=np.zeros(9),
        )  # fmt: skip
        self._write(IMU, message, stamp_s)
        self.imu += 1

    def write_pose(self, stamp_s: float, odom_from_body: Pose, variance: AnyArray) -> None:
        """Write a pose of the body. variance: (6,) of position and rotation."""
        zero = self._vector(np.zeros(3))
        position = odom_from_body.translation_m
        pose = self._message(
            "geometry_msgs/msg/Pose", position=self._vector(position, "geometry_msgs/msg/Point"),
            orientation=self._rotation(odom_from_body),
        )  # fmt: skip
        message = self._message(
            "nav_msgs/msg/Odometry", header=self._head(stamp_s, WORLD), child_frame_id=BODY,
            pose=self._message(
                "geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.diag(np.asarray(variance, float)).reshape(-1)
            ),
            twist=self._message(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=self._message("geometry_msgs/msg/Twist", linear=zero, angular=zero), covariance=np.zeros(36),
            ),
        )  # fmt: skip
        self._write(ODOM, message, stamp_s)
        self.poses += 1

    def close(self) -> None:
        """Write the index and close the file."""
        self._writer.finish()
        self._closed_bytes = self._file.tell()
        self._file.close()

    def _describe(self, stamp_s: float) -> None:
        """Write intrinsics and mounts, once."""
        self._described = True
        header = self._header
        for topic, frame, spec in ((DEPTH, DEPTH_FRAME, header.depth), (COLOUR, COLOUR_FRAME, header.rgb)):
            self._write(f"{topic}/camera_info", self._camera_info(stamp_s, frame, spec), stamp_s)
        numbers = np.array(header.rgb_from_depth)
        mounts = (
            (BODY, DEPTH_FRAME, self._body_from_depth), (DEPTH_FRAME, COLOUR_FRAME, Pose(numbers[:4], numbers[4:]).inverse())
        )  # fmt: skip
        transforms = [
            self._message(
                "geometry_msgs/msg/TransformStamped", header=self._head(stamp_s, parent), child_frame_id=child,
                transform=self._message(
                    "geometry_msgs/msg/Transform", translation=self._vector(pose.translation_m), rotation=self._rotation(pose)
                ),
            )
            for parent, child, pose in mounts
        ]  # fmt: skip
        self._write(TF, self._message("tf2_msgs/msg/TFMessage", transforms=transforms), stamp_s)

    def _camera_info(self, stamp_s: float, frame: str, spec: CameraSpec) -> Any:
        k = np.array([spec.fx, 0.0, spec.cx, 0.0, spec.fy, spec.cy, 0.0, 0.0, 1.0])
        roi = self._message("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return self._message(
            "sensor_msgs/msg/CameraInfo", header=self._head(stamp_s, frame), height=spec.height, width=spec.width,
            distortion_model="plumb_bob", d=np.zeros(5), k=k, r=np.eye(3).reshape(-1),
            p=np.insert(k.reshape(3, 3), 3, 0.0, axis=1).reshape(-1), binning_x=0, binning_y=0, roi=roi,
        )  # fmt: skip

    def _message(self, kind: str, **fields: Any) -> Any:
        return self._store.types[kind](**fields)

    def _head(self, stamp_s: float, frame: str) -> Any:
        nanoseconds = round(stamp_s * 1e9)
        stamp = self._message("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return self._message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _vector(self, numbers: AnyArray, kind: str = "geometry_msgs/msg/Vector3") -> Any:
        x, y, z = (float(number) for number in numbers)
        return self._message(kind, x=x, y=y, z=z)

    def _rotation(self, pose: Pose) -> Any:
        w, x, y, z = pose.quat_wxyz.tolist()
        return self._message("geometry_msgs/msg/Quaternion", w=w, x=x, y=y, z=z)

    def _write(self, topic: str, message: Any, stamp_s: float) -> None:
        kind = str(message.__msgtype__)
        if topic not in self._channels:
            if kind not in self._schemas:
                text, _ = self._store.generate_msgdef(kind, ros_version=2)
                self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind])
        data, nanoseconds = bytes(self._store.serialize_cdr(message, kind)), round(stamp_s * 1e9)
        self._writer.add_message(self._channels[topic], nanoseconds, data, nanoseconds)
