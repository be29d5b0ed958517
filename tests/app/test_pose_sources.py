"""The sources of poses that a config may name, from the camera stream to the odometry."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from slam_flight import BODY_FROM_DEPTH, LENS, RATE_HZ, RGB_LENS, frame, imu, truth
from textured_room import RGB_FROM_DEPTH

from sitl.apps.kernel_compilation import flight_jobs
from uav_recon import config as configuration
from uav_recon.app import kernel_jobs, perception_factory, pose_sources
from uav_recon.app.flight_channels import FlightChannels, memory_channels
from uav_recon.clock import ManualClock
from uav_recon.config import Config, ConfigError
from uav_recon.localization.perception.perception import Perception
from uav_recon.sensors.stream_format import CameraSpec, StreamHeader, StreamWriter
from uav_recon.types.camera import Intrinsics

FLOWN = Path(__file__).parents[2] / "systemd" / "config.toml"
BEGIN_S = 100.0  # of the flight, on this machine's clock


def _config(folder: Path, source: str) -> Config:
    tree = configuration.load(FLOWN).model_dump(mode="json", exclude_none=True)
    tree["runtime"]["folder"] = str(folder)
    tree["camera"] |= {
        "source": "stream",
        "position_body_m": BODY_FROM_DEPTH.translation_m.tolist(),
        "pitch_down_deg": 12.0,
        "horizontal_fov_deg": math.degrees(1.52),
        "vertical_fov_deg": math.degrees(1.01),
    }
    tree["localization"] |= {"source": source, "origin": "source"}
    return configuration.parse(tree, "test")


def _spec(lens: Intrinsics) -> CameraSpec:
    return CameraSpec(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy)


class Stream:
    """The rendered flight as a camera writes it, without poses."""

    def __init__(self, path: Path) -> None:
        between = (*RGB_FROM_DEPTH.quat_wxyz.tolist(), *RGB_FROM_DEPTH.translation_m.tolist())
        self._writer = StreamWriter(path, StreamHeader(_spec(LENS), _spec(RGB_LENS), between))
        self._samples = 0

    def write(self, number: int) -> None:
        true = frame(number)
        while self._samples < len(imu()) and imu()[self._samples].stamp_s <= true.stamp_s + 0.02:
            sample = imu()[self._samples]
            self._writer.write_imu(BEGIN_S + sample.stamp_s, sample.gyro_radps, sample.specific_force_mps2)
            self._samples += 1
        depth_mm = np.nan_to_num(1000.0 * true.depth_m).astype(np.uint16)
        self._writer.write_frame(BEGIN_S + true.stamp_s, depth_mm, true.rgb)


def _perception(folder: Path, source: str) -> tuple[Perception, FlightChannels, ManualClock, Stream]:
    config, channels, clock = _config(folder, source), memory_channels(), ManualClock(BEGIN_S)
    stream = Stream(folder / config.camera.stream)
    return perception_factory.make_perception(config, channels, clock), channels, clock, stream


def _fly(perception: Perception, clock: ManualClock, stream: Stream, frames: int) -> None:
    for number in range(frames):
        stream.write(number)
        for later_s in (0.02, 0.05):
            clock.advance_to(BEGIN_S + number / RATE_HZ + later_s)
            perception.step()


def test_the_embedded_slam_gives_odometry_from_a_stream_without_poses(tmp_path: Path) -> None:
    perception, channels, clock, stream = _perception(tmp_path, "slam")
    _fly(perception, clock, stream, 60)
    odom, posed = channels.odom.latest(), channels.frames.latest()
    assert odom is not None
    assert odom.quality > 50
    off_m = odom.odom_from_body.translation_m - truth(odom.stamp_s - BEGIN_S).translation_m
    assert np.linalg.norm(off_m) < 0.06
    assert np.linalg.norm(truth(odom.stamp_s - BEGIN_S).translation_m) > 0.3
    assert posed is not None
    there = truth(posed.frame.stamp_s - BEGIN_S) @ BODY_FROM_DEPTH
    assert np.linalg.norm(posed.world_from_depth.translation_m - there.translation_m) < 0.06
    assert perception.published_frames > 50


def test_without_poses_in_the_stream_there_is_no_odometry(tmp_path: Path) -> None:
    perception, channels, clock, stream = _perception(tmp_path, "stream")
    _fly(perception, clock, stream, 20)
    assert channels.odom.latest() is None
    assert channels.frames.latest() is None


def test_an_unknown_source_is_one_line_that_names_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"localization\.source.*'stream', 'slam', 'ros2' or 'autopilot'") as failure:
        _config(tmp_path, "gps")
    assert "\n" not in str(failure.value)


def test_each_source_that_the_config_accepts_can_be_opened() -> None:
    accepted = configuration.LocalizationConfig.model_json_schema()["properties"]["source"]["enum"]
    assert set(accepted) == set(pose_sources._OPENERS)


def test_the_kernels_of_the_slam_are_compiled_for_every_source() -> None:
    assert kernel_jobs.SLAM in kernel_jobs.perception_jobs()
    assert kernel_jobs.SLAM in flight_jobs()
