"""Bags: the writer of `record`, and files that rosbags writes, a writer independent of ours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import zstandard
from recording_folders import (
    HEADER,
    MOUNT,
    RGB_FROM_DEPTH,
    SHAPE,
    K,
    depth_mm,
    large_rgb,
    rgb,
    world_from_optical,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from uav_recon.sensors.recordings.bag_messages import BagTopics
from uav_recon.sensors.recordings.detection import ReadOptions, open_recording
from uav_recon.sensors.recordings.mcap_writer import McapWriter
from uav_recon.sensors.recordings.recording import LEVEL_MOUNT, RecordingError
from uav_recon.types.pose import Pose

STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types


def record(path: Path, frames: int, max_bytes: int = 10**9) -> McapWriter:
    writer = McapWriter(path, HEADER, MOUNT, max_bytes)
    for number in range(frames):
        stamp_s = 5.0 + number / 15.0
        for sample in range(10):
            writer.write_imu(stamp_s + sample / 150.0, np.array([0.1, 0.2, 0.01 * number]), np.array([0.0, 0.5, 9.8]))
        writer.write_pose(stamp_s, Pose.from_matrix(world_from_optical(number)), np.full(6, 1e-4))
        writer.write_frame(stamp_s, depth_mm(number), large_rgb(number))
    return writer


def test_recording_is_read_as_it_was_written(tmp_path: Path) -> None:
    record(tmp_path / "r.mcap", 4).close()
    recording = open_recording(tmp_path / "r.mcap", ReadOptions())
    frames, poses, imu = list(recording.frames()), recording.poses(), recording.imu()
    assert (len(frames), len(poses), len(imu), recording.info.frames) == (4, 4, 40, 4)
    np.testing.assert_allclose(recording.info.body_from_depth.matrix(), MOUNT.matrix(), atol=1e-12)
    for number, (frame, pose) in enumerate(zip(frames, poses, strict=True)):
        assert frame.stamp_s == pytest.approx(5.0 + number / 15.0, abs=1e-8)
        np.testing.assert_allclose(frame.depth_m[1:], depth_mm(number)[1:] * 0.001, atol=1e-6)
        assert np.abs(frame.rgb.astype(int) - large_rgb(number)).max() <= 4  # JPEG
        np.testing.assert_allclose(frame.rgb_from_depth.matrix(), RGB_FROM_DEPTH.matrix(), atol=1e-12)
        np.testing.assert_allclose(pose.odom_from_body.matrix(), world_from_optical(number), atol=1e-12)
        assert (frame.rgb_intrinsics.fx, frame.rgb_intrinsics.width) == (70.0, 80)
    np.testing.assert_allclose(imu[-1].gyro_radps, (0.1, 0.2, 0.03), atol=1e-12)
    np.testing.assert_allclose(imu[-1].specific_force_mps2, (0.0, 0.5, 9.8), atol=1e-12)


def test_mcap_reader_of_the_field_opens_it(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    record(tmp_path / "r.mcap", 2).close()
    with (tmp_path / "r.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        names = {channel.topic for channel in summary.channels.values()}
        assert {"/imu", "/odom", "/tf_static", "/camera/depth/image", "/camera/colour/image/compressed"} <= names
        assert reader.get_header().profile == "ros2"
        assert len(list(reader.iter_messages())) == 2 * 13 + 3


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_cut_file_is_read_up_to_the_cut(tmp_path: Path, share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uav_recon.sensors.recordings.mcap_writer.CHUNK_BYTES", 5000)
    record(tmp_path / "r.mcap", 60).close()
    data = (tmp_path / "r.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(len(data) * share)])
    whole = [frame.stamp_s for frame in open_recording(tmp_path / "r.mcap", ReadOptions()).frames()]
    cut = [frame.stamp_s for frame in open_recording(tmp_path / "cut.mcap", ReadOptions()).frames()]
    assert cut == whole[: len(cut)]
    assert len(cut) > 60 * share * 0.7


def test_file_without_close_is_readable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uav_recon.sensors.recordings.mcap_writer.CHUNK_BYTES", 5000)
    writer = record(tmp_path / "r.mcap", 30)
    writer._file.flush()
    assert len(list(open_recording(tmp_path / "r.mcap", ReadOptions()).frames())) > 20
    writer.close()


def test_size_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uav_recon.sensors.recordings.mcap_writer.CHUNK_BYTES", 2000)
    writer = record(tmp_path / "r.mcap", 40, max_bytes=20000)
    assert writer.full
    writer.close()
    writer = record(tmp_path / "s.mcap", 1, max_bytes=10**8)
    assert not writer.full
    writer.close()


# -- bags of other programs --------------------------------------------------------------------------------------------


def head(stamp_s: float, frame: str) -> Any:
    time = T["builtin_interfaces/msg/Time"](sec=int(stamp_s), nanosec=round((stamp_s - int(stamp_s)) * 1e9))
    return T["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def image(stamp_s: float, pixels: np.ndarray, encoding: str, frame: str = "optical") -> Any:
    data = np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8)
    return T["sensor_msgs/msg/Image"](
        header=head(stamp_s, frame), height=pixels.shape[0], width=pixels.shape[1], encoding=encoding, is_bigendian=0,
        step=data.size // pixels.shape[0], data=data,
    )  # fmt: skip


def camera_info(frame: str = "optical", model: str = "plumb_bob", distortion: float = 0.0) -> Any:
    fx, fy, cx, cy = K
    roi = T["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return T["sensor_msgs/msg/CameraInfo"](
        header=head(1.0, frame), height=SHAPE[0], width=SHAPE[1], distortion_model=model,
        d=np.array([distortion, 0.0, 0.0, 0.0, 0.0]), k=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]),
        r=np.eye(3).reshape(-1), p=np.zeros(12), binning_x=0, binning_y=0, roi=roi,
    )  # fmt: skip


def pose_stamped(stamp_s: float, number: int) -> Any:
    pose = Pose.from_matrix(world_from_optical(number))
    (w, x, y, z), (tx, ty, tz) = pose.quat_wxyz.tolist(), pose.translation_m.tolist()
    return T["geometry_msgs/msg/PoseStamped"](
        header=head(stamp_s, "map"),
        pose=T["geometry_msgs/msg/Pose"](
            position=T["geometry_msgs/msg/Point"](x=tx, y=ty, z=tz),
            orientation=T["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        ),
    )


def bag(
    folder: Path, plugin: StoragePlugin, messages: list[tuple[str, float, Any]], mode: CompressionMode = CompressionMode.NONE
) -> Path:
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, stamp_s, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], round(stamp_s * 1e9), STORE.serialize_cdr(message, kind))
    return folder


def usual(frames: int = 3, depth: str = "16UC1", **info: Any) -> list[tuple[str, float, Any]]:
    out: list[tuple[str, float, Any]] = [
        ("/d/camera_info", 1.0, camera_info()), ("/c/camera_info", 1.0, camera_info(**info))
    ]  # fmt: skip
    for number in range(frames):
        stamp_s = 2.0 + number / 30.0
        pixels = depth_mm(number) if depth == "16UC1" else (depth_mm(number) * 0.001).astype(np.float32)
        out.append(("/d/image_raw", stamp_s, image(stamp_s, pixels, depth)))
        out.append(("/c/image_raw", stamp_s + 0.004, image(stamp_s + 0.004, rgb(number)[..., ::-1], "bgr8")))
        out.append(("/pose", stamp_s, pose_stamped(stamp_s, number)))
    return out


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("depth", ["16UC1", "32FC1"])
def test_foreign_bag(tmp_path: Path, plugin: StoragePlugin, depth: str) -> None:
    recording = open_recording(bag(tmp_path / "b", plugin, usual(depth=depth)), ReadOptions())
    frames = list(recording.frames())
    assert [frame.stamp_s for frame in frames] == pytest.approx([2.0, 2.0 + 1 / 30, 2.0 + 2 / 30], abs=1e-8)
    for number, frame in enumerate(frames):
        wanted = depth_mm(number) * 0.001
        np.testing.assert_allclose(frame.depth_m[1:], wanted[1:], atol=1e-6)
        assert np.isnan(frame.depth_m[0, :2]).all()
        np.testing.assert_array_equal(frame.rgb, rgb(number))
        pose = recording.poses()[number].odom_from_body @ recording.info.body_from_depth
        np.testing.assert_allclose(pose.matrix(), world_from_optical(number), atol=1e-9)


def test_pose_of_body_where_no_transform_tells(tmp_path: Path) -> None:
    folder = bag(tmp_path / "b", StoragePlugin.MCAP, usual())
    recording = open_recording(folder, ReadOptions(topics=BagTopics(pose_of="body")))
    np.testing.assert_allclose(recording.poses()[2].odom_from_body.matrix(), world_from_optical(2), atol=1e-9)
    np.testing.assert_allclose(recording.info.body_from_depth.matrix(), LEVEL_MOUNT.matrix())


def test_distorted_colour_is_undistorted(tmp_path: Path) -> None:
    rows, columns = np.indices(SHAPE)
    pattern = np.stack([4 * rows, 3 * columns, rows + columns], axis=-1).astype(np.uint8)
    messages = [
        (t, s, image(s, pattern, "rgb8") if t == "/c/image_raw" else m) for t, s, m in usual(distortion=-0.3)
    ]  # fmt: skip
    folder = bag(tmp_path / "b", StoragePlugin.MCAP, messages)
    frame = next(open_recording(folder, ReadOptions()).frames())
    k = np.array([[K[0], 0, K[2]], [0, K[1], K[3]], [0, 0, 1]])
    wanted = cv2.undistort(pattern, k, np.array([-0.3, 0, 0, 0, 0]))
    assert np.abs(frame.rgb.astype(int) - wanted.astype(int)).max() <= 2
    assert np.abs(frame.rgb.astype(int) - pattern).max() > 10


def without(messages: list[tuple[str, float, Any]], topic: str) -> list[tuple[str, float, Any]]:
    return [one for one in messages if one[0] != topic]


def test_wrong_bags_are_one_line(tmp_path: Path) -> None:
    twice = [*usual(), ("/d2/image", 2.0, image(2.0, depth_mm(0), "16UC1"))]
    cases = {
        "no depth image": (without(usual(), "/d/image_raw"), BagTopics()),
        "name one by --depth-topic: /d/image_raw, /d2/image": (twice, BagTopics()),
        "--depth-topic /x:": (usual(), BagTopics(depth="/x")),
        "no CameraInfo beside /d/image_raw": ([*without(usual(), "/d/camera_info"), ("/e/camera_info", 1.0, camera_info())],
                                              BagTopics()),
        "distortion model 'fisheye'": (usual(model="fisheye", distortion=0.1), BagTopics()),
        "/tf_static does not connect": (
            [(t, s, image(s, rgb(0), "rgb8", "elsewhere")) if t == "/c/image_raw" else (t, s, m) for t, s, m in usual()],
            BagTopics(),
        ),
    }  # fmt: skip
    for number, (said, (messages, topics)) in enumerate(cases.items()):
        folder = bag(tmp_path / str(number), StoragePlugin.SQLITE3, messages)
        with pytest.raises(RecordingError) as error:
            open_recording(folder, ReadOptions(topics=topics))
        assert said in str(error.value)
        assert "\n" not in str(error.value)


def test_sqlite_that_is_no_bag_is_one_line(tmp_path: Path) -> None:
    import sqlite3

    with sqlite3.connect(tmp_path / "x.db3") as database:
        database.execute("CREATE TABLE other (a)")
    with pytest.raises(RecordingError, match="no ROS 2 bag"):
        open_recording(tmp_path / "x.db3", ReadOptions())


def said_of(path: Path) -> str:
    with pytest.raises(RecordingError) as error:
        list(open_recording(path, ReadOptions()).frames())
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("broken", [0.0, float("nan")])
def test_a_first_pose_that_is_none_is_skipped_as_a_later_one(tmp_path: Path, broken: float) -> None:
    messages = usual()
    turn = messages[4][2].pose.orientation
    for name in "wxyz":
        object.__setattr__(turn, name, broken)
    recording = open_recording(bag(tmp_path / "b", StoragePlugin.MCAP, messages), ReadOptions())
    assert len(recording.poses()) == 2
    assert dict(recording.info.skipped) == {"poses that are not finite": 1}


def test_a_static_transform_that_is_none_is_one_line(tmp_path: Path) -> None:
    vector, turn = (
        T["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0),
        T["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=0.0),
    )
    zero = T["geometry_msgs/msg/TransformStamped"](
        header=head(1.0, "base"), child_frame_id="optical",
        transform=T["geometry_msgs/msg/Transform"](translation=vector, rotation=turn),
    )  # fmt: skip
    static = ("/tf_static", 1.0, T["tf2_msgs/msg/TFMessage"](transforms=[zero]))
    assert "/tf_static: 'optical' in 'base': pose is not finite" in said_of(
        bag(tmp_path / "b", StoragePlugin.MCAP, [static, *usual()])
    )


@pytest.mark.parametrize("name", ["run#1", "50%41", "a?b"])
@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_path_may_have_the_special_characters_of_an_address(tmp_path: Path, name: str, plugin: StoragePlugin) -> None:
    bag(tmp_path / "b", plugin, usual())
    (tmp_path / name).mkdir()
    (file,) = (path for path in (tmp_path / "b").iterdir() if path.suffix in (".db3", ".mcap"))
    assert len(list(open_recording(file.rename(tmp_path / name / file.name), ReadOptions()).frames())) == 3


def test_a_damaged_chunk_is_one_line_that_names_the_file(tmp_path: Path) -> None:
    record(tmp_path / "r.mcap", 8).close()
    data = bytearray((tmp_path / "r.mcap").read_bytes())
    at = data.index(b"\x28\xb5\x2f\xfd") + 200  # in a block of zstd
    data[at : at + 8] = bytes(8)
    (tmp_path / "r.mcap").write_bytes(data)
    assert said_of(tmp_path / "r.mcap").startswith(f"{tmp_path / 'r.mcap'}: damaged or cut (")


def test_a_bag_that_was_cut_before_its_messages_is_one_line(tmp_path: Path) -> None:
    (file,) = bag(tmp_path / "b", StoragePlugin.SQLITE3, usual(frames=20)).glob("*.db3")
    file.write_bytes(file.read_bytes()[:-50000])
    assert said_of(file) == f"{file}: damaged or cut (database disk image is malformed)"


@pytest.mark.parametrize(
    ("coefficients", "said"),
    [
        ([0.1, 0.2, 0.3], "d has 3 numbers; want one of 0, 4, 5, 8, 12, 14"),
        ([np.nan] * 5, "k or d has a number that is not finite"),
    ],
)
def test_a_lens_that_is_none_is_one_line(tmp_path: Path, coefficients: list[float], said: str) -> None:
    messages = usual()
    for _, _, info in messages[:2]:
        object.__setattr__(info, "d", np.array(coefficients))
    assert f"/d/camera_info: {said}" in said_of(bag(tmp_path / "b", StoragePlugin.MCAP, messages))


def test_an_empty_image_costs_its_frame_only(tmp_path: Path) -> None:
    empty = T["sensor_msgs/msg/CompressedImage"](header=head(2.0, "optical"), format="jpeg", data=np.zeros(0, np.uint8))
    only_empty = open_recording(
        bag(
            tmp_path / "empty", StoragePlugin.MCAP, [("/c/image_raw/compressed", 2.0, empty), *without(usual(), "/c/image_raw")]
        ),
        ReadOptions(),
    )
    assert len(list(only_empty.frames())) == 3, "a topic of empty images is not read"
    damaged = [
        (t, s, image(s, depth_mm(0), "16UC1") if t == "/d/image_raw" and round(s, 3) == 2.067 else m) for t, s, m in usual(6)
    ]
    for topic, _, message in damaged:
        if topic == "/d/image_raw" and round(message.header.stamp.nanosec * 1e-9, 3) == 0.067:
            object.__setattr__(message, "data", np.zeros(0, np.uint8))
    recording = open_recording(bag(tmp_path / "one", StoragePlugin.MCAP, damaged), ReadOptions())
    assert [frame.sequence for frame in recording.frames()] == [0, 1, 3, 4, 5]
    ((reason, count),) = recording.info.skipped
    assert ("0 bytes for 64 x 48 16UC1" in reason, count) == (True, 1)


@pytest.mark.parametrize("mode", [CompressionMode.MESSAGE, CompressionMode.FILE])
@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_bag_compressed_by_zstd_is_read(tmp_path: Path, plugin: StoragePlugin, mode: CompressionMode) -> None:
    folder = bag(tmp_path / "b", plugin, usual(), mode)
    recording = open_recording(folder, ReadOptions())
    assert len(list(recording.frames())) == len(list(recording.frames())) == len(recording.poses()) == 3
    (file,) = (path for path in folder.iterdir() if path.suffix != ".yaml")
    assert len(list(open_recording(file, ReadOptions()).frames())) == 3
    assert recording.info.remarks == ("the poses name no body: they count as those of the camera in optical axes (else "
                                      "--pose-of body)",)  # fmt: skip


def test_a_compressed_file_that_is_cut_or_holds_no_bag_is_one_line(tmp_path: Path) -> None:
    folder = bag(tmp_path / "b", StoragePlugin.SQLITE3, usual(), CompressionMode.FILE)
    (file,) = folder.glob("*.zstd")
    file.write_bytes(file.read_bytes()[:200])
    assert said_of(file).startswith(f"{file}: ")
    text = tmp_path / "notes.zstd"
    text.write_bytes(zstandard.ZstdCompressor().compress(b"a shopping list"))
    assert said_of(text) == f"{text}: is compressed by zstd, and holds no bag: it begins with b'a shoppi'"


# -- poses ---------------------------------------------------------------------------------------------------------------


def moved(stamp_s: float, number: int, parent: str, child: str) -> Any:
    pose = Pose.from_matrix(world_from_optical(number))
    (w, x, y, z), (tx, ty, tz) = pose.quat_wxyz.tolist(), pose.translation_m.tolist()
    return T["geometry_msgs/msg/TransformStamped"](
        header=head(stamp_s, parent), child_frame_id=child,
        transform=T["geometry_msgs/msg/Transform"](
            translation=T["geometry_msgs/msg/Vector3"](x=tx, y=ty, z=tz),
            rotation=T["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        ),
    )  # fmt: skip


def tf(topic: str, stamp_s: float, *transforms: Any) -> tuple[str, float, Any]:
    return topic, stamp_s, T["tf2_msgs/msg/TFMessage"](transforms=list(transforms))


def of_poses(convert: Any) -> list[tuple[str, float, Any]]:
    """Return the usual messages with other messages in place of the poses."""
    return [convert(s, number) if t == "/pose" else (t, s, m) for number, (t, s, m) in enumerate_poses(usual())]


def enumerate_poses(messages: list[tuple[str, float, Any]]) -> list[tuple[int, tuple[str, float, Any]]]:
    number, out = 0, []
    for one in messages:
        out.append((number, one))
        number += one[0] == "/pose"
    return out


def with_covariance(stamp_s: float, number: int) -> tuple[str, float, Any]:
    plain = pose_stamped(stamp_s, number)
    pose = T["geometry_msgs/msg/PoseWithCovariance"](pose=plain.pose, covariance=np.zeros(36))
    return "/amcl_pose", stamp_s, T["geometry_msgs/msg/PoseWithCovarianceStamped"](header=plain.header, pose=pose)


def test_poses_with_covariance_are_read(tmp_path: Path) -> None:
    recording = open_recording(bag(tmp_path / "b", StoragePlugin.MCAP, of_poses(with_covariance)), ReadOptions())
    assert len(recording.poses()) == 3
    pose = recording.poses()[2].odom_from_body @ recording.info.body_from_depth
    np.testing.assert_allclose(pose.matrix(), world_from_optical(2), atol=1e-9)


def test_transforms_of_tf_are_poses_where_they_move_the_camera(tmp_path: Path) -> None:
    static = tf("/tf_static", 1.0, moved(1.0, 3, "base", "optical"))
    messages = [static, *of_poses(lambda s, n: tf("/tf", s, moved(s, 0, "map", "odom"), moved(s, n, "odom", "base")))]
    recording = open_recording(bag(tmp_path / "b", StoragePlugin.MCAP, messages), ReadOptions())
    assert [pose.odom_from_body.translation_m[0] for pose in recording.poses()] == pytest.approx([0.0, 0.1, 0.2])
    np.testing.assert_allclose(recording.info.body_from_depth.matrix(), world_from_optical(3), atol=1e-9)
    assert recording.info.remarks == ()


@pytest.mark.parametrize("connected", [True, False])
def test_a_moving_mount_is_not_taken_for_poses(tmp_path: Path, connected: bool) -> None:
    """A gimbal below a body that moves: /tf has two moving frames, and neither is a pose of the camera in the world."""
    parent = "base" if connected else "other"
    messages = of_poses(lambda s, n: tf("/tf", s, moved(s, n, "odom", "base"), moved(s, n, parent, "optical")))
    recording = open_recording(bag(tmp_path / "b", StoragePlugin.MCAP, messages), ReadOptions())
    if connected:
        assert recording.poses() == []
        (line,) = recording.info.remarks
        assert line == "no poses are used; found and not read: /tf ('optical' in 'base', 'base' in 'odom')"
    else:
        assert len(recording.poses()) == 3


def test_poses_of_unknown_types_are_named(tmp_path: Path) -> None:
    """PX4's VehicleOdometry has no header and another clock."""
    definition = "uint64 timestamp\nfloat32[3] position\nfloat32[4] q\n"
    kind = "px4_msgs/msg/VehicleOdometry"
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(definition, kind))
    with Writer(tmp_path / "b", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        odometry = writer.add_connection("/fmu/out/vehicle_odometry", kind, typestore=store)
        message = store.types[kind](timestamp=1, position=np.zeros(3, np.float32), q=np.zeros(4, np.float32))
        writer.write(odometry, 1, store.serialize_cdr(message, kind))
        for topic, stamp_s, one in without(usual(1), "/pose"):
            connection = writer.add_connection(topic, one.__msgtype__, typestore=STORE)
            writer.write(connection, round(stamp_s * 1e9), STORE.serialize_cdr(one, one.__msgtype__))
    recording = open_recording(tmp_path / "b", ReadOptions())
    assert recording.poses() == []
    assert recording.info.remarks == (f"no poses are used; found and not read: /fmu/out/vehicle_odometry ({kind})",)


@pytest.mark.parametrize(
    ("pose_of", "line"),
    [
        ("camera", "they count as those of the camera in optical axes (else --pose-of body)"),
        ("body", "the camera counts as mounted level at the body's origin, looking along its x axis"),
    ],
)
def test_a_mount_that_is_assumed_is_said(tmp_path: Path, pose_of: str, line: str) -> None:
    def odometry(stamp_s: float, number: int) -> tuple[str, float, Any]:
        pose = T["geometry_msgs/msg/PoseWithCovariance"](pose=pose_stamped(stamp_s, number).pose, covariance=np.zeros(36))
        zero = T["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        twist = T["geometry_msgs/msg/TwistWithCovariance"](
            twist=T["geometry_msgs/msg/Twist"](linear=zero, angular=zero), covariance=np.zeros(36)
        )
        message = T["nav_msgs/msg/Odometry"](header=head(stamp_s, "odom"), child_frame_id="base", pose=pose, twist=twist)
        return "/odom", stamp_s, message

    folder = bag(tmp_path / "b", StoragePlugin.MCAP, of_poses(odometry))
    recording = open_recording(folder, ReadOptions(topics=BagTopics(pose_of=pose_of)))
    assert recording.info.remarks == (f"/tf_static does not connect 'base' with 'optical': {line}",)


def test_a_recording_of_this_program_has_nothing_to_remark(tmp_path: Path) -> None:
    record(tmp_path / "r.mcap", 4).close()
    recording = open_recording(tmp_path / "r.mcap", ReadOptions())
    assert len(list(recording.frames())) == 4
    assert (recording.info.remarks, recording.info.skipped) == ((), ())


def test_a_cut_mcap_is_said_to_be_cut(tmp_path: Path) -> None:
    record(tmp_path / "r.mcap", 30).close()
    data = (tmp_path / "r.mcap").read_bytes()
    (tmp_path / "r.mcap").write_bytes(data[: len(data) - 5])
    recording = open_recording(tmp_path / "r.mcap", ReadOptions())
    assert recording.info.remarks == ("the file is cut: it is read up to 6.933 s",)


def test_a_pose_topic_of_the_bag_goes_before_tf_and_a_filter(tmp_path: Path) -> None:
    extra = [with_covariance(2.0, 5)]
    extra += [tf("/tf", 2.0 + k / 30, moved(2.0 + k / 30, 9, "odom", "optical")) for k in range(3)]
    folder = bag(tmp_path / "b", StoragePlugin.MCAP, [*usual(), *extra])
    assert open_recording(folder, ReadOptions()).poses()[0].odom_from_body.translation_m[0] == pytest.approx(0.0)
    named = open_recording(folder, ReadOptions(topics=BagTopics(pose="/tf"))).poses()
    assert named[0].odom_from_body.translation_m[0] == pytest.approx(0.9)
