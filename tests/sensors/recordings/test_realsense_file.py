"""Recordings of librealsense: the bytes that two versions of the library itself wrote."""

from __future__ import annotations

import gzip
import sqlite3
from contextlib import closing
from pathlib import Path

import librealsense_writer as source
import numpy as np
import pytest
import zstandard
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.typesys import Stores, get_typestore

from uav_recon.sensors.recordings.detection import ReadOptions, open_recording
from uav_recon.sensors.recordings.recording import RecordingError
from uav_recon.types.pose import Pose

OLD = Path(__file__).with_name("librealsense_2.55.bag.gz")


@pytest.fixture(scope="module")
def db3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Written by the installed library."""
    path = tmp_path_factory.mktemp("realsense") / "x.db3"
    source.write(path)
    return path


@pytest.fixture(scope="module")
def raw_db3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Written by the installed library, without compression."""
    path = tmp_path_factory.mktemp("realsense") / "x.db3"
    source.write(path, compress=False)
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Written by librealsense 2.55.1."""
    path = tmp_path_factory.mktemp("realsense") / "x.bag"
    path.write_bytes(gzip.decompress(OLD.read_bytes()))
    return path


@pytest.mark.parametrize("version", ["db3", "raw_db3", "bag"])
def test_a_recording_is_read_as_the_camera_gave_it(version: str, request: pytest.FixtureRequest) -> None:
    recording = open_recording(request.getfixturevalue(version), ReadOptions())
    info, frames, imu = recording.info, list(recording.frames()), recording.imu()
    assert (info.kind, info.frames, info.up_is_z, info.skipped) == ("librealsense recording", source.FRAMES, False, ())
    assert recording.poses() == []
    rgb_from_depth = Pose.from_matrix(np.block([[source.ROTATION, np.array(source.TRANSLATION)[:, None]], [np.eye(4)[3:]]]))
    for number, frame in enumerate(frames):
        assert frame.stamp_s == pytest.approx(1.0 + 0.04 * number, abs=1e-9)  # the device's stamps, not those of the file
        assert np.isnan(frame.depth_m[:, :5]).all()
        assert frame.depth_m[12, 16] == pytest.approx(source.UNIT_M * (3000 + 2 * number), rel=1e-6)
        assert np.array_equal(frame.rgb, source.rgb_pixels(number))
        assert np.allclose(frame.rgb_from_depth.matrix(), rgb_from_depth.matrix(), atol=2e-6)
        lens = frame.depth_intrinsics
        assert (lens.fx, lens.fy, lens.cx, lens.cy, lens.width, lens.height) == (20.0, 21.0, 15.25, 11.75, 32, 24)
        assert (frame.rgb_intrinsics.fx, frame.rgb_intrinsics.width) == (33.0, 40)
    assert [sample.stamp_s for sample in imu] == pytest.approx([1.01, 1.05, 1.09, 1.13])
    assert np.allclose(imu[1].gyro_radps, (0.3, -0.1, -0.2))  # optical axes to a level body's
    assert np.allclose(imu[1].specific_force_mps2, (0.0, -0.125, 9.81))  # a quarter between the second and the third


@pytest.mark.parametrize("version", ["db3", "bag"])
def test_every_second_frame_has_its_own_colour(version: str, request: pytest.FixtureRequest) -> None:
    frames = list(open_recording(request.getfixturevalue(version), ReadOptions()).frames(step=2))
    assert [int(frame.rgb[0, 0, 1]) for frame in frames] == [0, 40]


def test_streams_with_several_clocks_have_the_stamps_of_the_file(db3: Path, tmp_path: Path) -> None:
    path = tmp_path / "clocks.db3"
    path.write_bytes(db3.read_bytes())
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET timestamp = 100 * timestamp")  # the writer sends all frames within milliseconds
        (topic,) = database.execute("SELECT id FROM topics WHERE name LIKE '%Color_0/image/metadata'").fetchone()
        for number, data in database.execute("SELECT id, data FROM messages WHERE topic_id = ?", (topic,)).fetchall():
            database.execute(
                "UPDATE messages SET data = ? WHERE id = ?", (data.replace(b"Hardware Clock", b"System Time   "), number)
            )
    recording = open_recording(path, ReadOptions())
    assert recording.info.skipped == (("stamps of the device: the streams have several clocks", 1),)
    assert recording.info.first_s < 0.9
    assert len(list(recording.frames())) == source.FRAMES


def test_a_file_without_depth_and_a_bag_that_was_cut_before_it_are_one_line(db3: Path, bag: Path, tmp_path: Path) -> None:
    colour = tmp_path / "colour.db3"
    colour.write_bytes(db3.read_bytes())
    with sqlite3.connect(colour) as database:
        database.execute(
            "DELETE FROM messages WHERE topic_id IN (SELECT id FROM topics WHERE name LIKE '%Depth_0/image/data%')"
        )
    cut = tmp_path / "cut.bag"
    cut.write_bytes(bag.read_bytes()[:5000])
    for path, fault in (
        (colour, "has no depth; it has Color, Depth"),
        (cut, "ROS 1 bag that is cut before its first message"),
    ):
        with pytest.raises(RecordingError, match=fault) as failure:
            open_recording(path, ReadOptions())
        assert "\n" not in str(failure.value)


def test_a_bag_that_was_not_closed_is_read_to_its_end_and_said(bag: Path, tmp_path: Path) -> None:
    """A recorder that is killed has written no index, and no place of it in the first record."""
    data = bytearray(bag.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(data[at : at + 8], "little")
    data[at : at + 8] = bytes(8)
    for name, content in (("open.bag", data[:index]), ("cut.bag", data[: index - 100])):
        (tmp_path / name).write_bytes(content)
    recording = open_recording(tmp_path / "open.bag", ReadOptions())
    assert len(list(recording.frames())) == source.FRAMES
    assert recording.info.remarks == ("the file is cut or was not closed: it is read up to 1.120 s",)
    assert len(recording.imu()) == source.FRAMES


@pytest.mark.parametrize("share", [0.5, 0.7, 0.9])
def test_a_bag_that_was_cut_is_read_up_to_the_cut(bag: Path, tmp_path: Path, share: float) -> None:
    whole = [frame.stamp_s for frame in open_recording(bag, ReadOptions()).frames()]
    data = bag.read_bytes()
    (tmp_path / "cut.bag").write_bytes(data[: int(share * len(data))])
    try:
        recording = open_recording(tmp_path / "cut.bag", ReadOptions())
    except RecordingError as error:
        assert "cut or was not closed" in str(error)
        return
    frames = [frame.stamp_s for frame in recording.frames()]
    assert frames == whole[: len(frames)]
    assert "the file is cut" in recording.info.remarks[0]


def test_a_db3_whose_messages_are_compressed_is_read(raw_db3: Path, tmp_path: Path) -> None:
    """As librealsense 2.58 writes it: zstd. Since its pull request 15556 the images are PNG, as in the fixture db3."""
    path = tmp_path / "c.db3"
    path.write_bytes(raw_db3.read_bytes())
    packer = zstandard.ZstdCompressor(level=1)
    with closing(sqlite3.connect(path)) as database, database:
        for number, data in database.execute("SELECT id, data FROM messages").fetchall():
            database.execute("UPDATE messages SET data = ? WHERE id = ?", (packer.compress(data), number))
    plain, packed = (list(open_recording(file, ReadOptions()).frames()) for file in (raw_db3, path))
    assert len(packed) == len(plain) == source.FRAMES
    for a, b in zip(plain, packed, strict=True):
        np.testing.assert_array_equal(a.depth_m, b.depth_m)
        np.testing.assert_array_equal(a.rgb, b.rgb)
        assert a.stamp_s == b.stamp_s


def test_a_bag_of_ros_1_by_others_is_one_line(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Bag1Writer(tmp_path / "other.bag") as writer:
        connection = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        message = store.types["std_msgs/msg/String"]("hello")
        writer.write(connection, 1, store.serialize_ros1(message, "std_msgs/msg/String"))
    with pytest.raises(RecordingError, match="librealsense did not write; convert it to ROS 2"):
        open_recording(tmp_path / "other.bag", ReadOptions())


def test_an_image_without_its_metadata_is_left_out_and_counted(db3: Path, tmp_path: Path) -> None:
    path = tmp_path / "run#1.db3"
    path.write_bytes(db3.read_bytes())
    with closing(sqlite3.connect(path)) as database, database:
        (topic,) = database.execute("SELECT id FROM topics WHERE name LIKE '%Depth_0/image/metadata'").fetchone()
        database.execute("DELETE FROM messages WHERE id = (SELECT MAX(id) FROM messages WHERE topic_id = ?)", (topic,))
    recording = open_recording(path, ReadOptions())
    assert len(list(recording.frames())) == source.FRAMES - 1
    assert recording.info.skipped == (("frames whose stamp is no number", 1),)
