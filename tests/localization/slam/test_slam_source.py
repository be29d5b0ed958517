"""Source of poses: stamps, one pose for each accepted frame, and the mount's pose at the instant that is shown."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from slam_flight import BODY_FROM_DEPTH, RATE_HZ, covered, frame, imu, truth

from uav_recon.localization.slam.slam_source import SlamSource
from uav_recon.localization.slam.slam_tracker import SlamTracker
from uav_recon.localization.slam.view_odometry import ViewOdometry
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.pose import Pose


class Camera:
    """The frames of the flight, one with each poll, with their inertial samples."""

    def __init__(self, frames: list[Frame]) -> None:
        self.frames = frames
        self.closed = False
        self._read = 0
        self._samples = 0

    def poll(self) -> Frame | None:
        if self._read == len(self.frames):
            return None
        self._read += 1
        return self.frames[self._read - 1]

    def imu(self) -> list[ImuSample]:
        until_s = self.frames[min(self._read, len(self.frames) - 1)].stamp_s + 0.02
        begin = self._samples
        while self._samples < len(imu()) and imu()[self._samples].stamp_s <= until_s:
            self._samples += 1
        return list(imu()[begin : self._samples])

    def close(self) -> None:
        self.closed = True


class Mount:
    """A fixed mount that notes when it was asked; unknown at some instants."""

    def __init__(self, unknown: tuple[float, float] = (-2.0, -1.0)) -> None:
        self.asked: list[float] = []
        self._unknown = unknown

    def observe(self) -> None:
        raise AssertionError("the loop observes the mount, not the source")

    def body_from_depth(self, stamp_s: float) -> Pose | None:
        self.asked.append(stamp_s)
        return None if self._unknown[0] <= stamp_s <= self._unknown[1] else BODY_FROM_DEPTH

    @property
    def measured_until_s(self) -> float:
        return math.inf


class Delayed(SlamTracker):
    """A tracker that knows the delay already."""

    def __init__(self, delay_s: float) -> None:
        super().__init__()
        self._delay_s = delay_s

    @property
    def delay_s(self) -> float:
        return self._delay_s


def test_each_accepted_frame_has_one_pose_of_the_same_stamp() -> None:
    camera = Camera([frame(n) for n in range(60)])
    source = SlamSource(camera, Mount(), ViewOdometry(SlamTracker()))
    posed = 0
    for n in range(60):
        samples = source.imu()
        source.odometry.add_imu(samples)
        assert samples or n == 0
        seen = source.poll()
        assert seen is not None
        poses = source.poses()
        assert len(poses) <= 1
        for pose in poses:
            posed += 1
            assert pose.stamp_s == seen.stamp_s
            assert np.linalg.norm(pose.odom_from_body.translation_m - truth(pose.stamp_s).translation_m) < 0.03
    assert posed == 57
    assert source.poll() is None
    assert source.poses() == []


def test_the_inertial_samples_are_those_of_the_camera() -> None:
    camera, other = Camera([frame(n) for n in range(10)]), Camera([frame(n) for n in range(10)])
    source = SlamSource(camera, Mount(), ViewOdometry(SlamTracker()))
    for _ in range(10):
        assert [sample.stamp_s for sample in source.imu()] == [sample.stamp_s for sample in other.imu()]
        source.poll()
        other.poll()


def test_a_frame_is_passed_on_unchanged_but_for_its_stamp() -> None:
    frames = [dataclasses.replace(frame(n), sequence=100 + n) for n in range(8)]
    source = SlamSource(Camera(frames), Mount(), ViewOdometry(Delayed(0.025)))
    for true in frames:
        source.odometry.add_imu(source.imu())
        seen = source.poll()
        assert seen is not None
        assert seen.stamp_s == true.stamp_s - 0.025
        for field in dataclasses.fields(Frame):
            if field.name != "stamp_s":
                assert getattr(seen, field.name) is getattr(true, field.name), field.name
    poses = source.poses()
    assert [pose.stamp_s for pose in poses] == [true.stamp_s - 0.025 for true in frames[8 - len(poses) :]]
    assert len(poses) >= 4


def test_the_mount_is_asked_for_the_instant_that_a_frame_shows() -> None:
    mount = Mount()
    source = SlamSource(Camera([frame(n) for n in range(4)]), mount, ViewOdometry(Delayed(0.03)))
    for _ in range(5):
        source.odometry.add_imu(source.imu())
        source.poll()
    assert mount.asked == pytest.approx([n / RATE_HZ - 0.03 for n in range(4)])


def test_a_frame_of_an_unknown_mount_has_no_pose_and_is_passed_on() -> None:
    source = SlamSource(Camera([frame(n) for n in range(12)]), Mount(unknown=(0.45, 0.55)), ViewOdometry(SlamTracker()))
    stamps = []
    for _ in range(12):
        source.odometry.add_imu(source.imu())
        assert source.poll() is not None
        stamps += [pose.stamp_s for pose in source.poses()]
    assert len(stamps) >= 6
    assert not [stamp for stamp in stamps if 0.45 <= stamp <= 0.55]
    assert max(stamps) > 0.6


def test_a_frame_that_is_not_accepted_has_no_pose_and_is_passed_on() -> None:
    frames = [covered(frame(n)) if 40 <= n < 44 else frame(n) for n in range(50)]
    source = SlamSource(Camera(frames), Mount(), ViewOdometry(SlamTracker()))
    without = []
    for n in range(50):
        source.odometry.add_imu(source.imu())
        assert source.poll() is not None
        if not source.poses():
            without.append(n)
    assert set(range(40, 44)) <= set(without)
    assert 48 not in without


def test_the_camera_is_closed_with_the_source() -> None:
    camera = Camera([])
    SlamSource(camera, Mount(), ViewOdometry(SlamTracker())).close()
    assert camera.closed
