"""Depth unit of a recording: told by the poses' motion, or by depth that no camera measures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console
from test_replay import SOURCE_FROM_WORLD, write_recording
from typer.testing import CliRunner

from uav_recon.app.depth_unit_check import depth_unit_remarks, pose_at
from uav_recon.app.recording_options import read_options
from uav_recon.app.recording_remarks import print_remarks
from uav_recon.cli.main import app
from uav_recon.errors import UserError
from uav_recon.sensors.recordings.bag_messages import BagTopics
from uav_recon.sensors.recordings.detection import ReadOptions, open_recording
from uav_recon.types.pose import Pose, StampedPose


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of a room of 5 x 4 x 2.4 m in millimetres, with true poses over 0.45 m of path."""
    folder = tmp_path_factory.mktemp("unit") / "r"
    write_recording(folder, SOURCE_FROM_WORLD)
    return folder


def remarks(folder: Path, unit_m: float | None = None) -> list[str]:
    return depth_unit_remarks(open_recording(folder, ReadOptions(metres_per_unit=unit_m)))


@pytest.mark.parametrize("unit_m", [None, 0.00098, 0.00102])
def test_depth_that_fits_the_poses_has_no_remark(room: Path, unit_m: float | None) -> None:
    assert remarks(room, unit_m) == []


@pytest.mark.parametrize(
    ("unit_m", "factor"),
    [
        (0.004, 0.25),  # an L515 as millimetres, the other way round
        (0.01, 0.1),  # a D405
        (0.0002, 5.0),  # a TUM folder in millimetres
        (0.0009, 1.11),
        (0.0011, 0.909),
    ],
)
def test_a_wrong_unit_is_named_by_the_motion_of_the_poses(room: Path, unit_m: float, factor: float) -> None:
    (line,) = remarks(room, unit_m)
    words = line.split()
    assert float(words[6]) == pytest.approx(factor, rel=0.02)
    assert line.endswith(f"of its unit: --depth-unit 0.001 (it was read with {unit_m:g})")
    assert remarks(room, 0.001) == []


def test_an_odd_scale_may_be_that_of_the_poses(room: Path) -> None:
    (line,) = remarks(room, 0.0014)
    assert line.endswith(" of its unit: --depth-unit 0.001 (it was read with 0.0014)")


def without_poses(room: Path, folder: Path, factor: float) -> Path:
    folder.mkdir()
    for file in room.glob("frame-00000*"):
        if "depth" in file.name:
            depth = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            assert depth is not None
            cv2.imwrite(str(folder / file.name), np.clip(np.asarray(depth) * factor, 0, 65534).astype(np.uint16))
        elif "color" in file.name:
            (folder / file.name).write_bytes(file.read_bytes())
    return folder


@pytest.mark.parametrize(
    ("factor", "line"),
    [
        (1.0, ""),
        (10.0, "100 % of the depth is beyond 6 m, and is not used: the median is "),
        (0.05, "nearer than 0.3 m, and is not used: the median is "),
        (0.0, "the depth images are empty: no pixel has a return"),
    ],
)
def test_depth_that_no_camera_measures_is_said_without_poses(room: Path, tmp_path: Path, factor: float, line: str) -> None:
    said = remarks(without_poses(room, tmp_path / "r", factor))
    assert (line in said[0]) if line else said == []


def test_the_pose_at_a_stamp_lies_between_its_neighbours() -> None:
    poses = [StampedPose(float(k) / 10, Pose.from_yaw(0.1 * k, np.array([k, 0.0, 0.0])), np.zeros(3)) for k in (0, 1, 2, 9)]
    between = pose_at(poses, 0.15)
    assert between is not None
    np.testing.assert_allclose(between.translation_m, (1.5, 0.0, 0.0))
    assert between.yaw_rad() == pytest.approx(0.15, abs=1e-4)
    assert [pose_at(poses, stamp_s) for stamp_s in (-0.1, 0.5, 1.0)] == [None, None, None]
    assert pose_at(poses, 0.9) is poses[3].odom_from_body


@pytest.mark.parametrize("unit_m", [0.0, 9e-6, 1.01, -0.001, float("nan"), float("inf")])
def test_a_unit_outside_the_range_is_one_line(unit_m: float) -> None:
    with pytest.raises(UserError, match=r"want 0\.00001 to 1 metres per unit of the depth images"):
        read_options((0.3, 6.0), None, BagTopics(), unit_m)
    for good_m in (1e-5, 1.0, None):
        assert read_options((0.3, 6.0), None, BagTopics(), good_m).metres_per_unit == good_m


@pytest.mark.parametrize(
    "command",
    [
        ("replay", "RECORDING", "--depth-unit", "7"),
        ("calibrate", "RECORDING", "--depth-unit", "7"),
        ("bench", "slam", "--recording", "RECORDING", "--depth-unit", "7"),
    ],
)
def test_each_command_that_reads_a_recording_has_the_option(room: Path, command: tuple[str, ...]) -> None:
    result = CliRunner().invoke(app, [str(room) if word == "RECORDING" else word for word in command])
    assert result.exit_code == 2
    assert "--depth-unit 7: want 0.00001 to 1 metres per unit of the depth images" in result.output


@pytest.mark.parametrize("command", [("calibrate", "--live"), ("bench", "slam")])
def test_the_option_wants_a_recording(command: tuple[str, ...]) -> None:
    result = CliRunner().invoke(app, [*command, "--depth-unit", "0.001"])
    assert result.exit_code == 2
    assert "--depth-unit: want" in result.output


def test_a_remark_is_one_line_of_output(capsys: pytest.CaptureFixture[str]) -> None:
    print_remarks(["depth [x] " + "y" * 200], Console(width=80))
    assert capsys.readouterr().out == "note: depth [x] " + "y" * 200 + "\n"
