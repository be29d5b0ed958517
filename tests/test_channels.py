from __future__ import annotations

import dataclasses
import json
import struct
import zlib
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from uav_recon.channels import FileChannel, MemoryChannel, decode, encode
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
    for channel in (memory, file):
        assert channel.latest() is None
        assert channel.sequence() == 0
        channel.publish(value)
        _same(value, channel.latest())
        assert channel.sequence() == 1


def _intent(stamp_s: float) -> Intent:
    return Intent(stamp_s, Goal.FLY, TRAJECTORY)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "intent.channel"


def _stamp(channel: FileChannel[Intent]) -> float | None:
    value = channel.latest()
    return None if value is None else value.stamp_s


def test_a_reader_sees_the_newest_value_of_another_process(path: Path) -> None:
    writer, reader = FileChannel(path, Intent), FileChannel(path, Intent)
    for k in range(5):
        writer.publish(_intent(k))
    assert _stamp(reader) == 4.0
    assert reader.sequence() == 5


def test_a_restarted_writer_continues_the_sequence(path: Path) -> None:
    FileChannel(path, Intent).publish(_intent(1.0))
    reader = FileChannel(path, Intent)
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


HEAD = struct.Struct("<8sqIIq")


def test_a_torn_record_gives_the_previous_value(path: Path) -> None:
    writer, reader = FileChannel(path, Intent), FileChannel(path, Intent)
    writer.publish(_intent(1.0))
    assert _stamp(reader) == 1.0
    writer.publish(_intent(2.0))
    _overwrite(path, HEAD.size - 8, struct.pack("<q", -1))  # as left by a writer that died during the write
    assert _stamp(reader) == 1.0
    assert _stamp(FileChannel(path, Intent)) is None
    writer.publish(_intent(3.0))
    assert _stamp(reader) == 3.0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: _overwrite(path, HEAD.size + 20, b"\xff\xff"),
        lambda path: _overwrite(path, 0, b"NOTMINE!"),
        lambda path: _overwrite(path, 16, struct.pack("<I", 1 << 31)),
        lambda path: _overwrite(path, 20, struct.pack("<I", 12345)),
    ],
    ids=["payload", "magic", "length", "crc"],
)
def test_a_damaged_record_gives_the_previous_value(path: Path, spoil: Callable[[Path], None]) -> None:
    writer, reader = FileChannel(path, Intent), FileChannel(path, Intent)
    writer.publish(_intent(1.0))
    assert _stamp(reader) == 1.0
    writer.publish(_intent(2.0))
    spoil(path)
    assert _stamp(reader) == 1.0


def test_a_symlink_in_the_runtime_folder_is_not_followed(path: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").write_bytes(b"precious")
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="symbolic link"):
        FileChannel(path, Intent)
    assert (tmp_path / "elsewhere").read_bytes() == b"precious"


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
    reader = FileChannel(path, kind)
    _overwrite(path, 0, HEAD.pack(b"UAVCHAN1", sequence, len(data), zlib.crc32(data), sequence) + data)
    assert reader.latest() is None
