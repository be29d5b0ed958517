from __future__ import annotations

import dataclasses
import json
import os
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from other_user import user

from uav_recon.channels import (
    ChannelError,
    FileChannel,
    MemoryChannel,
    ReadOnlyFileChannel,
    create_file,
    decode,
    encode,
    layout_hash,
)
from uav_recon.types.camera import Frame, ImuSample, Intrinsics, PosedFrame
from uav_recon.types.maps import GridSpec, SurfaceElements, TriangleMesh, VoxelMap
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import NothingLeft, PlanMode, PlanRequest, Task, TaskKind, ViewPath, Viewpoint
from uav_recon.types.trajectory import Goal, Intent, Refusal, Setpoint, Trajectory
from uav_recon.types.vehicle import FlightPhase, MissionProgress, VehicleState

RNG = np.random.default_rng(11)
POSE = Pose(np.array([0.5, 0.5, -0.5, 0.5]), np.array([1.0, -2.0, 3.5]))
OPTICS = Intrinsics(20.0, 21.0, 3.5, 2.5, 8, 6)
FRAME = Frame(
    12.5, 7, RNG.random((6, 8)).astype(np.float32), OPTICS, RNG.integers(0, 255, (4, 5, 3), dtype=np.uint8), OPTICS, POSE
)
GRID = GridSpec(np.array([-1.0, 0.0, 0.5]), 0.1, (3, 4, 5))
VOXELS = VoxelMap.whole(
    GRID, RNG.integers(0, 3, (3, 4, 5)).astype(np.uint8), RNG.integers(0, 99, (3, 4, 5)).astype(np.uint8), 9, 1
)
SURFACE = SurfaceElements(RNG.random((5, 3)), RNG.random((5, 3)), RNG.random(5), 4)
VIEW = Viewpoint(np.array([1.0, 2.0, 3.0]), 0.3, 0.26)
TASK = Task(TaskKind.RECONSTRUCT, np.array([0.0, 1.0, 0.0]), VIEW, 17.5)
SETPOINT = Setpoint.hold(np.array([1.0, 2.0, 3.0]), 0.5, 0.1)
TRAJECTORY = Trajectory(
    4.0, 0.05, RNG.random((9, 3)), RNG.random((9, 3)), RNG.random((9, 3)), RNG.random(9), RNG.random(9), np.zeros(9),
    np.array([0.2]), 0, 3,
)  # fmt: skip

TEXT = Reason(ReasonCode.AUTOPILOT_TEXT, ("ä",))
LEFT = Reason(ReasonCode.FRONTIERS_LEFT, (14,), (Reason(ReasonCode.FRONTIERS_TOO_NARROW, (9,)), TEXT))

VALUES = [
    POSE,
    StampedPose(3.0, POSE, np.array([0.1, 0.2, 0.3]), np.eye(6), 80, 255, 2),
    OPTICS,
    FRAME,
    PosedFrame(FRAME, POSE, 3),
    PosedFrame(FRAME, POSE, 3, True, 0.0425),
    ImuSample(1.0, np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 9.8])),
    GRID,
    VOXELS,
    SURFACE,
    SurfaceElements(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), 0),
    TriangleMesh(RNG.random((4, 3)), np.array([[0, 1, 2], [1, 2, 3]]), np.zeros((4, 3), np.uint8), np.ones(4, np.float32)),
    VIEW,
    TASK,
    ViewPath((VIEW, VIEW), (RNG.random((3, 3)), RNG.random((1, 3))), PlanMode.MERGED, 5, 0, (TASK,), 0.01, 0.02),
    ViewPath((), (), PlanMode.EXPLORE, 5, 0, (), 0.01, 0.02, clearance_m=0.45),
    NothingLeft(LEFT, 0.1, 0.2),
    PlanRequest(VOXELS, SURFACE, np.zeros(3), 0.1, 60, np.ones(3)),
    PlanRequest(VOXELS, None, np.zeros(3), 0.1, 60),
    SETPOINT,
    TRAJECTORY,
    Intent(9.0, Goal.FLY, TRAJECTORY),
    Intent(9.0, Goal.FLY, dataclasses.replace(TRAJECTORY, clearance_m=0.45)),
    Intent(9.0, Goal.STANDBY),
    Intent(9.0, Goal.FLY, TRAJECTORY, Reason(ReasonCode.OPERATOR_LOST_RETURNING, (30.0,)), True),
    Refusal(Reason(ReasonCode.OUTSIDE_FENCE, (1.0, -2.5, 0.25)), SETPOINT),
    VehicleState(1.0, POSE, np.zeros(3), True, "OFFBOARD", FlightPhase.FLYING, float("nan"), False, float("nan"), -1, 3, None),
    VehicleState(1.0, POSE, np.zeros(3), True, "OFFBOARD", FlightPhase.FLYING, 0.5, False, 0.2, 4, 3, LEFT, 0.3, 9.5),
    MissionProgress(1.0, "SURVEY", "explore", 3, 60, 41.5, 12.25, 5, 2, 7, 0.75, None, False),
    MissionProgress(1.0, "SURVEY", "explore", 3, 60, 41.5, 12.25, 5, 2, 7, 0.75, None, False, np.ones(3), 0.0041, 0.0425),
]


def _same(a: Any, b: Any) -> None:
    if dataclasses.is_dataclass(a):
        assert type(a) is type(b)
        for field in dataclasses.fields(a):
            _same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        assert a.shape == b.shape
        np.testing.assert_array_equal(a, b)
        assert not b.flags.writeable
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for left, right in zip(a, b, strict=True):
            _same(left, right)
    elif isinstance(a, float):
        assert isinstance(b, float)
        np.testing.assert_equal(b, a)
    else:
        assert a == b
        assert type(a) is type(b) or isinstance(a, Enum)


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_every_value_is_decoded_unchanged(value: Any) -> None:
    _same(value, decode(encode(value), type(value)))


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_memory_and_file_channels_behave_the_same(value: Any, tmp_path: Path) -> None:
    memory, file = MemoryChannel(type(value)), FileChannel(tmp_path / "x.channel", type(value))
    readers = memory, file, ReadOnlyFileChannel(tmp_path / "x.channel", type(value))
    assert [reader.latest() for reader in readers] == [None] * 3
    assert [reader.sequence() for reader in readers] == [0] * 3
    memory.publish(value)
    file.publish(value)
    for reader in readers:
        _same(value, reader.latest())
        assert reader.sequence() == 1


def _intent(stamp_s: float) -> Intent:
    return Intent(stamp_s, Goal.FLY, TRAJECTORY)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "intent.channel"


def _stamp(channel: FileChannel[Intent] | ReadOnlyFileChannel[Intent]) -> float | None:
    value = channel.latest()
    return None if value is None else value.stamp_s


def test_a_reader_sees_the_newest_value_of_another_process(path: Path) -> None:
    writer, reader = FileChannel(path, Intent), ReadOnlyFileChannel(path, Intent)
    for k in range(5):
        writer.publish(_intent(k))
    assert _stamp(reader) == 4.0
    assert reader.sequence() == 5


def test_a_restarted_writer_continues_the_sequence(path: Path) -> None:
    FileChannel(path, Intent).publish(_intent(1.0))
    reader = ReadOnlyFileChannel(path, Intent)
    assert _stamp(reader) == 1.0
    FileChannel(path, Intent).publish(_intent(2.0))
    assert _stamp(reader) == 2.0
    assert reader.sequence() == 2


def test_a_value_that_does_not_fit_is_refused_and_the_old_one_stays(path: Path) -> None:
    channel = FileChannel(path, Intent, capacity_bytes=200)
    channel.publish(Intent(1.0, Goal.STANDBY))
    with pytest.raises(ValueError, match=r"intent\.channel: \d+ bytes do not fit in 200"):
        channel.publish(_intent(2.0))
    assert _stamp(FileChannel(path, Intent, capacity_bytes=200)) == 1.0


def _overwrite(path: Path, offset: int, data: bytes) -> None:
    with path.open("r+b") as file:
        file.seek(offset)
        file.write(data)


HEAD = struct.Struct("<8s8sqIIq")


def test_a_torn_record_gives_the_previous_value(path: Path) -> None:
    writer, reader = FileChannel(path, Intent), ReadOnlyFileChannel(path, Intent)
    writer.publish(_intent(1.0))
    assert _stamp(reader) == 1.0
    writer.publish(_intent(2.0))
    _overwrite(path, HEAD.size - 8, struct.pack("<q", -1))  # as left by a writer that died during the write
    assert _stamp(reader) == 1.0
    assert _stamp(ReadOnlyFileChannel(path, Intent)) is None
    writer.publish(_intent(3.0))
    assert _stamp(reader) == 3.0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: _overwrite(path, HEAD.size + 20, b"\xff\xff"),
        lambda path: _overwrite(path, 0, b"NOTMINE!"),
        lambda path: _overwrite(path, 24, struct.pack("<I", 1 << 31)),
        lambda path: _overwrite(path, 28, struct.pack("<I", 12345)),
        lambda path: _overwrite(path, 8, b"NOTMINE!"),
    ],
    ids=["payload", "format", "length", "crc", "layout"],
)
def test_a_damaged_record_gives_the_previous_value(path: Path, spoil: Callable[[Path], None]) -> None:
    writer, reader = FileChannel(path, Intent), ReadOnlyFileChannel(path, Intent)
    writer.publish(_intent(1.0))
    assert _stamp(reader) == 1.0
    writer.publish(_intent(2.0))
    spoil(path)
    assert _stamp(reader) == 1.0


def test_a_symlink_in_the_runtime_folder_is_not_followed(path: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").write_bytes(b"precious")
    path.symlink_to(tmp_path / "elsewhere")
    for variant in (FileChannel, ReadOnlyFileChannel):
        with pytest.raises(OSError, match="symbolic link"):
            variant(path, Intent)
    assert (tmp_path / "elsewhere").read_bytes() == b"precious"


@dataclasses.dataclass(frozen=True)
class Odometry:
    stamp_s: float
    speed_mps: float


def build(name: str, *fields: tuple[str, Any]) -> Any:
    """Return a value type of another build."""
    return dataclasses.make_dataclass(name, fields, frozen=True)


OTHER_BUILDS = {
    "unit": build("Odometry", ("stamp_s", float), ("speed_kmh", float)),
    "order": build("Odometry", ("speed_mps", float), ("stamp_s", float)),
    "type": build("Odometry", ("stamp_s", float), ("speed_mps", int)),
    "more": build("Odometry", ("stamp_s", float), ("speed_mps", float), ("quality", int)),
}


@pytest.mark.parametrize("name", OTHER_BUILDS)
def test_a_reader_of_another_build_is_refused(name: str, path: Path, caplog: pytest.LogCaptureFixture) -> None:
    FileChannel(path, OTHER_BUILDS[name]).publish(OTHER_BUILDS[name](*range(5)[: 3 if name == "more" else 2]))
    reader = ReadOnlyFileChannel(path, Odometry)
    found, wanted = (layout_hash(kind, 1 << 16).hex() for kind in (OTHER_BUILDS[name], Odometry))
    line = f"{path}: written by another build: layout {found}, want layout {wanted} in format b'UAVCHAN2'"
    with pytest.raises(ChannelError) as refused:
        reader.check()
    assert str(refused.value) == line
    for _ in range(3):
        assert reader.latest() is None
        assert reader.sequence() == 0
    assert caplog.messages == [line], "in a loop it is logged once"


def test_a_writer_of_another_build_is_not_read_and_ours_is_again(path: Path) -> None:
    FileChannel(path, Odometry).publish(Odometry(1.0, 2.0))
    reader = ReadOnlyFileChannel(path, Odometry)
    other = FileChannel(path, OTHER_BUILDS["unit"])
    assert reader.latest() is None, "the file has no value any more"
    other.publish(OTHER_BUILDS["unit"](2.0, 7.2))
    assert reader.latest() is None
    with pytest.raises(ChannelError):
        reader.check()
    ours = FileChannel(path, Odometry)
    reader.check()
    assert reader.latest() is None
    ours.publish(Odometry(3.0, 2.0))
    assert reader.latest() == Odometry(3.0, 2.0)
    assert reader.sequence() == 3


def test_another_capacity_and_another_file_format_are_refused(path: Path) -> None:
    FileChannel(path, Intent, capacity_bytes=200)
    with pytest.raises(ChannelError, match="written by another build: layout"):
        ReadOnlyFileChannel(path, Intent).check()
    _overwrite(path, 0, b"UAVCHAN1")
    with pytest.raises(ChannelError, match="written by another build: format b'UAVCHAN1', want layout"):
        ReadOnlyFileChannel(path, Intent).check()


def test_layouts_differ_in_enum_values_dtypes_and_nested_fields() -> None:
    array = {dtype: build("A", ("a", np.ndarray[Any, np.dtype[dtype]])) for dtype in (np.float32, np.float64)}  # type: ignore[valid-type]
    enums = [build("B", ("b", Enum("E", {"ON": value}))) for value in ("on", "yes")]
    nested = [build("C", ("c", tuple[kind, ...] | None)) for kind in (*array.values(), *enums)]  # type: ignore[valid-type]
    hashes = [layout_hash(kind, 64) for kind in (*KINDS, *array.values(), *enums, *nested)]
    assert len(set(hashes)) == len(hashes)
    assert layout_hash(build("A", ("a", np.ndarray[Any, np.dtype[np.float32]])), 64) == layout_hash(array[np.float32], 64)


def test_a_reader_that_is_first_waits_for_the_file_and_its_writer(path: Path) -> None:
    reader = ReadOnlyFileChannel(path, Intent)
    assert reader.latest() is None
    assert not path.exists(), "a reader creates nothing"
    create_file(path)
    reader.check()
    assert reader.latest() is None
    assert reader.sequence() == 0
    FileChannel(path, Intent).publish(_intent(1.0))
    assert _stamp(reader) == 1.0


def test_a_reader_cannot_change_the_file(path: Path) -> None:
    writer = FileChannel(path, Intent)
    writer.publish(_intent(1.0))
    reader, before = ReadOnlyFileChannel(path, Intent), path.read_bytes()
    with pytest.raises(PermissionError, match=r"intent\.channel: opened read-only"):
        reader.publish(_intent(2.0))
    assert reader._map is not None
    with pytest.raises(TypeError):
        reader._map[:8] = bytes(8)
    assert path.read_bytes() == before
    (mapping,) = [line for line in Path("/proc/self/maps").read_text().splitlines() if str(path) in line and " r--s " in line]
    assert mapping


@pytest.fixture
def flight_folder() -> Iterator[Path]:
    """Yield a folder of user and group 4001 like systemd's: mode 0750, files are made with umask 0077."""
    with tempfile.TemporaryDirectory() as name:  # other users may not enter tmp_path
        os.chown(name, 4001, 4001)
        Path(name).chmod(0o750)
        before = os.umask(0o077)
        yield Path(name)
        os.umask(before)


@pytest.mark.skipif(
    os.geteuid() != 0, reason="only root may become another user, as in CI; the modes are checked below without it"
)
def test_a_member_of_the_group_reads_and_anybody_else_does_not(flight_folder: Path) -> None:
    path = flight_folder / "intent.channel"
    with user(4001, 4001):
        writer = FileChannel(path, Intent)
        writer.publish(_intent(1.0))
    assert path.stat().st_mode & 0o777 == 0o640
    with user(4002, 4001):
        reader = ReadOnlyFileChannel(path, Intent)
        assert _stamp(reader) == 1.0
        with pytest.raises(PermissionError):
            FileChannel(path, Intent)
        with pytest.raises(PermissionError):
            path.unlink()
    flight_folder.chmod(0o755)
    with user(4002, 4002), pytest.raises(PermissionError):
        ReadOnlyFileChannel(path, Intent)
    writer.publish(_intent(2.0))
    assert _stamp(reader) == 2.0


def test_a_file_of_the_previous_build_becomes_readable_for_the_group(path: Path) -> None:
    path.write_bytes(b"UAVCHAN1" + bytes(100))
    path.chmod(0o600)
    create_file(path)
    assert path.stat().st_mode & 0o777 == 0o640
    with pytest.raises(ChannelError, match="UAVCHAN1"):
        ReadOnlyFileChannel(path, Intent).check()


KINDS: list[type[Any]] = sorted({type(value) for value in VALUES}, key=lambda kind: kind.__name__)
GENUINE = [encode(value) for value in VALUES]


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(KINDS), st.binary(max_size=300))
def test_no_bytes_crash_a_reader(kind: type[Any], data: bytes) -> None:
    try:
        decode(data, kind)
    except ValueError:
        return


@pytest.mark.parametrize("at", [0, 1, 2, 3, 4, 5, 6, 7, 9])
def test_null_is_not_accepted_for_a_number_or_an_array(at: int) -> None:
    tree = [5.0, [0, 1], 2, 3, 100, 0, 0, "good", None, [[4, 5], 0]]
    tree[at] = None
    with pytest.raises(ValueError, match="not a"):
        decode(_record(tree), StampedPose)


def _record(tree: list[Any]) -> bytes:
    genuine = encode(StampedPose(5.0, Pose.identity(), np.zeros(3)))
    (length,) = struct.unpack_from("<I", genuine)
    assert json.loads(genuine[4 : 4 + length]) == [5.0, [0, 1], 2, 3, 100, 0, 0, "good", None, [[4, 5], 0]]
    head = json.dumps(tree).encode()
    return struct.pack("<I", len(head)) + head + genuine[4 + length :]


def test_deep_nesting_is_refused() -> None:
    nested = b"[" * 50000
    with pytest.raises(ValueError, match="not a Intent"):
        decode(struct.pack("<I", len(nested)) + nested, Intent)


@settings(max_examples=500, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(KINDS), st.sampled_from(GENUINE), st.data())
def test_no_altered_record_crashes_a_reader(kind: type[Any], genuine: bytes, data: st.DataObject) -> None:
    bent = bytearray(genuine[: data.draw(st.integers(0, len(genuine)))] if data.draw(st.booleans()) else genuine)
    for _ in range(data.draw(st.integers(0, 4))):
        if bent:
            bent[data.draw(st.integers(0, min(len(bent) - 1, 400)))] = data.draw(st.integers(0, 255))
    try:
        decode(bytes(bent), kind)
    except ValueError:
        return


@settings(max_examples=100, deadline=None)
@given(kind=st.sampled_from(KINDS), data=st.binary(max_size=200), sequence=st.integers(-5, 5))
def test_no_hostile_writer_crashes_a_reader(
    tmp_path_factory: pytest.TempPathFactory, kind: type[Any], data: bytes, sequence: int
) -> None:
    """A record with a valid checksum and invalid content is read as None, without an exception."""
    path = tmp_path_factory.getbasetemp() / "hostile.channel"
    FileChannel(path, kind, capacity_bytes=300)
    reader = ReadOnlyFileChannel(path, kind, capacity_bytes=300)
    head = HEAD.pack(b"UAVCHAN2", layout_hash(kind, 300), sequence, len(data), zlib.crc32(data), sequence)
    _overwrite(path, 0, head + data)
    assert reader.latest() is None
