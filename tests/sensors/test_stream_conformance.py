from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uav_recon.clock import ManualClock
from uav_recon.sensors.stream_conformance import StreamObservation, judge, observe
from uav_recon.sensors.stream_format import HEADER, IMU, POSE, CameraSpec, StreamHeader, StreamReader, StreamWriter

LENS = CameraSpec(32, 24, 20.0, 20.0, 15.5, 11.5)
GOOD_HEADER = StreamHeader(LENS, LENS, (1.0, 0.0, 0.0, 0.0, 0.015, 0.0, 0.0))
DOC = Path(__file__).parents[2] / "docs" / "camera-stream.md"


class SleepingClock(ManualClock):
    """A clock on which sleep passes at once."""

    def sleep_until(self, instant_s: float) -> None:
        self.advance_to(max(instant_s, self.now_s()))


class WritingClock(SleepingClock):
    """A clock that writes what is due whenever somebody sleeps on it: frames 30 Hz, IMU 200 Hz, poses 20 Hz."""

    def __init__(self, writer: StreamWriter) -> None:
        super().__init__(100.0)
        self._writer = writer
        self._next = {"frame": 100.0, "imu": 100.0, "pose": 100.0}
        self._rng = np.random.default_rng(1)

    def sleep_until(self, instant_s: float) -> None:
        super().sleep_until(instant_s)
        for name, step_s in (("frame", 1 / 30), ("imu", 0.005), ("pose", 0.05)):
            while self._next[name] <= self.now_s():
                self._write(name, self._next[name])
                self._next[name] += step_s

    def _write(self, name: str, stamp_s: float) -> None:
        noise = self._rng.normal(0.0, 0.01, 3)
        if name == "frame":
            depth = self._rng.integers(1900, 2100, (24, 32)).astype(np.uint16)
            self._writer.write_frame(stamp_s - 0.03, depth, np.zeros((24, 32, 3), np.uint8))
        elif name == "imu":
            self._writer.write_imu(stamp_s, noise, np.array([0.0, 0.0, 9.81]) + noise)
        else:
            self._writer.write_pose(stamp_s - 0.08, noise, np.array([1.0, 0.0, 0.0, 0.0]), np.full(6, 1e-4))


@pytest.fixture
def seen(tmp_path: Path) -> StreamObservation:
    path = tmp_path / "camera.stream"
    writer = StreamWriter(path, GOOD_HEADER)
    return observe(StreamReader(path), WritingClock(writer), 2.0)


def wrong(seen: StreamObservation) -> list[str]:
    return [finding.name for finding in judge(seen) if not finding.good]


def test_a_good_stream_has_no_wrong_finding(seen: StreamObservation) -> None:
    assert wrong(seen) == []
    assert len(judge(seen)) > 30
    assert len(seen.frame_stamps_s) == pytest.approx(60, abs=2)
    assert len(seen.imu) == pytest.approx(400, abs=4)
    assert np.median(seen.pose_ages_s) == pytest.approx(0.08, abs=0.01)
    assert seen.lost_frames == 0


def _scale_force(seen: StreamObservation) -> None:
    seen.imu["specific_force_mps2"] /= 9.81  # g instead of m/s2


def _gravity_instead_of_force(seen: StreamObservation) -> None:
    seen.imu["specific_force_mps2"] *= -1.0  # FRD, or gravity instead of specific force


def _optical_imu(seen: StreamObservation) -> None:
    seen.imu["specific_force_mps2"] = np.roll(seen.imu["specific_force_mps2"], 1, axis=1)  # z up became x


def _frozen_poses(seen: StreamObservation) -> None:
    seen.poses[:] = seen.poses[0]


def _long_quaternion(seen: StreamObservation) -> None:
    seen.poses["quat_wxyz"] *= 2.0


def _optical_poses(seen: StreamObservation) -> None:
    seen.poses["quat_wxyz"] = [0.5, -0.5, 0.5, -0.5]  # odom_from_optical instead of odom_from_body


def _jump(seen: StreamObservation) -> None:
    seen.poses["position_m"][20:] += 1.0


def _wall_clock(seen: StreamObservation) -> None:
    seen.frame_ages_s[:] = [age - 1.7e9 for age in seen.frame_ages_s]


def _metres(seen: StreamObservation) -> None:
    seen.median_mm[:] = [2.0] * len(seen.median_mm)


def _empty(seen: StreamObservation) -> None:
    seen.valid_shares[:] = [0.0] * len(seen.valid_shares)
    seen.median_mm[:] = [math.nan] * len(seen.median_mm)


def _frozen_depth(seen: StreamObservation) -> None:
    seen.checksums[:] = [1] * len(seen.checksums)


def _gap(seen: StreamObservation) -> None:
    seen.frame_stamps_s[30:] = [stamp_s + 1.0 for stamp_s in seen.frame_stamps_s[30:]]


def _lens_in_metres(seen: StreamObservation) -> None:
    seen.header = replace(GOOD_HEADER, depth=replace(LENS, fx=0.002, fy=0.002))


@pytest.mark.parametrize(
    ("change", "finding"),
    [
        (_scale_force, "specific force, mean (at rest)"),
        (_gravity_instead_of_force, "specific force off body z, up (FLU, level)"),
        (_optical_imu, "specific force off body z, up (FLU, level)"),
        (_frozen_poses, "poses that differ"),
        (_long_quaternion, "pose quaternion norm, farthest from 1"),
        (_optical_poses, "gravity of the IMU in odom, off z"),
        (_jump, "position, largest step without a reset"),
        (_wall_clock, "frame age on arrival, median"),
        (_metres, "depth, median (unit: mm)"),
        (_empty, "pixels with depth, median"),
        (_frozen_depth, "depth images that differ"),
        (_gap, "frame stamps: largest gap"),
        (_lens_in_metres, "depth field of view x"),
    ],
)
def test_each_mistake_of_a_writer_is_named(
    seen: StreamObservation, change: Callable[[StreamObservation], None], finding: str
) -> None:
    change(seen)
    assert finding in wrong(seen)


def test_a_dead_writer_has_no_rate(tmp_path: Path) -> None:
    path = tmp_path / "camera.stream"
    StreamWriter(path, GOOD_HEADER)
    assert wrong(observe(StreamReader(path), SleepingClock(), 1.0)) == ["frame rate", "pose rate"]


def test_the_page_gives_every_field_at_its_byte() -> None:
    page = DOC.read_text(encoding="utf-8")
    for record in (HEADER, IMU, POSE):
        assert record.fields is not None
        for name, (_, offset, *_) in record.fields.items():
            assert f"| {offset} | `{name}` |" in page, f"{name} at {offset}"
