from __future__ import annotations

import dataclasses
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
from other_user import user

from uav_recon.app.flight_channels import (
    MISSION_WRITES,
    PERCEPTION_WRITES,
    PILOT_WRITES,
    FlightChannels,
    file_channels,
    read_only_channels,
)
from uav_recon.channels import FileChannel, ReadOnlyFileChannel
from uav_recon.errors import EXIT_CONFIG, UserError
from uav_recon.types.pose import Pose, StampedPose

NAMES = [field.name for field in dataclasses.fields(FlightChannels)]
ODOMETRY = StampedPose(1.0, Pose.identity(), np.zeros(3))


@dataclasses.dataclass(frozen=True)
class OtherPose:
    """The value of another build."""

    stamp_ms: int


def test_each_channel_has_one_writing_process_and_the_others_map_it_read_only(tmp_path: Path) -> None:
    assert sorted([*PERCEPTION_WRITES, *PILOT_WRITES, *MISSION_WRITES]) == sorted(NAMES)
    for writes in (PERCEPTION_WRITES, PILOT_WRITES, MISSION_WRITES):
        channels = file_channels(tmp_path, writes)
        for name in NAMES:
            variant = FileChannel if name in writes else ReadOnlyFileChannel
            assert type(getattr(channels, name)) is variant, name
    assert {path.stat().st_mode & 0o777 for path in tmp_path.iterdir()} == {0o640}


def test_a_program_that_only_reads_creates_nothing_and_sees_what_comes(tmp_path: Path) -> None:
    reader = read_only_channels(tmp_path / "run")
    assert [getattr(reader, name).latest() for name in NAMES] == [None] * len(NAMES)
    assert not (tmp_path / "run").exists()
    file_channels(tmp_path / "run", PERCEPTION_WRITES).odom.publish(ODOMETRY)
    odom = reader.odom.latest()
    assert odom is not None
    assert odom.stamp_s == 1.0


def test_a_channel_of_another_build_refuses_a_reader_and_not_the_processes_of_a_flight(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    FileChannel(tmp_path / "odom.channel", OtherPose).publish(OtherPose(5))
    with pytest.raises(
        UserError, match=r"odom\.channel: written by another build: layout \w{16}, want layout \w{16}"
    ) as refused:
        read_only_channels(tmp_path)
    assert refused.value.code == EXIT_CONFIG
    mission = file_channels(tmp_path, MISSION_WRITES)  # perception may be restarted after it
    assert mission.odom.latest() is None
    assert caplog.messages == [str(refused.value)]
    file_channels(tmp_path, PERCEPTION_WRITES).odom.publish(ODOMETRY)
    assert mission.odom.latest() is not None
    read_only_channels(tmp_path)


@pytest.mark.parametrize("folder_mode", [0o750, 0o755])
def test_a_reader_that_is_not_in_the_group_is_refused_by_one_line(folder_mode: int) -> None:
    """Whether it may enter the folder or not. Only root can be that reader; anybody else checks the modes that refuse it."""
    with tempfile.TemporaryDirectory() as name:  # other users may not enter tmp_path
        folder = Path(name)
        file_channels(folder, PERCEPTION_WRITES).odom.publish(ODOMETRY)
        folder.chmod(folder_mode)
        assert {path.stat().st_mode & 0o777 for path in folder.iterdir()} == {0o640}
        if os.geteuid() != 0:
            return
        with user(4002, 4002), pytest.raises(UserError) as refused:
            read_only_channels(folder)
        with user(4002, 0):
            odom = read_only_channels(folder).odom.latest()
    assert str(refused.value) == f"{folder}/odom.channel: not allowed: be root, the user of the flight, or in its group"
    assert refused.value.code == EXIT_CONFIG
    assert odom is not None
