"""Engines of others beside the camera stream: what they get, and what is written."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from uav_recon.clock import ManualClock
from uav_recon.sensors.stream_camera import StreamPoses
from uav_recon.sensors.stream_format import CameraSpec, StreamError, StreamHeader, StreamPoseWriter, StreamReader, StreamWriter
from uav_recon.trackers.engine import RgbdView, TrackedPose
from uav_recon.trackers.registered_depth import DepthRegistration
from uav_recon.trackers.tracker_process import TrackerProcess, level_attitude
from uav_recon.types.camera import Intrinsics, body_from_camera
from uav_recon.types.pose import Pose, StampedPose

DEPTH = CameraSpec(64, 48, 40.0, 40.0, 31.5, 23.5)
RGB = CameraSpec(96, 72, 80.0, 80.0, 47.5, 35.5)
RGB_FROM_DEPTH = Pose.from_rotation_vector(np.array([0.0, 0.01, 0.0]), np.array([0.015, 0.0, 0.0]))
BODY_FROM_DEPTH = body_from_camera(np.array([0.1, 0.0, 0.0]), math.radians(15.0))
ROLL = Pose.from_rotation_vector(np.array([math.radians(3.0), 0.0, 0.0]), np.zeros(3))  # of the body on its pad


def header() -> StreamHeader:
    numbers = [*RGB_FROM_DEPTH.quat_wxyz.tolist(), *RGB_FROM_DEPTH.translation_m.tolist()]
    return StreamHeader(DEPTH, RGB, (numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5], numbers[6]))


def body_at(number: int) -> Pose:
    """The true odom_from_body at a frame: it rolls on the pad, and moves."""
    return Pose.from_yaw(0.02 * number, np.array([0.05 * number, -0.02 * number, 0.0])) @ ROLL


class TruthEngine:
    """Knows the true motion; its world is the first view, or another one after lost_at."""

    def __init__(self, lost_at: int = 10**6) -> None:
        self.views: list[RgbdView] = []
        self.lost_at = lost_at

    def track(self, view: RgbdView) -> list[TrackedPose]:
        self.views.append(view)
        number = round(10 * (view.stamp_s - 100.0))
        world = int(number >= self.lost_at)
        body_from_rgb = BODY_FROM_DEPTH @ RGB_FROM_DEPTH.inverse()
        begin = body_at(self.lost_at if world else 6) @ body_from_rgb
        return [TrackedPose(view.stamp_s, begin.inverse() @ body_at(number) @ body_from_rgb, 80, world)]

    def close(self) -> None:
        pass


class Camera:
    def __init__(self, path: Path, imu: bool = True) -> None:
        self.path, self.imu = path, imu
        self.writer = StreamWriter(path, header())
        self.clock = ManualClock(100.0)

    def run(self, tracker: TrackerProcess, begin: int, end: int) -> None:
        for number in range(begin, end):
            for part in range(10):
                stamp_s = 100.0 + number / 10 + part / 100
                self.clock.advance_to(stamp_s)
                if self.imu:
                    self.writer.write_imu(stamp_s, np.zeros(3), ROLL.rotation().T @ np.array([0.0, 0.0, 9.81]))
                if part == 0:
                    depth_mm, rgb = np.full((48, 64), 2000, np.uint16), np.full((72, 96, 3), number, np.uint8)
                    self.writer.write_frame(stamp_s, depth_mm, rgb)
                tracker.step()


def poses_of(path: Path) -> list[StampedPose]:
    return StreamPoses(path).poses()


def test_poses_of_the_body_are_written_into_the_stream_of_the_camera(tmp_path: Path) -> None:
    camera, engine = Camera(tmp_path / "camera.stream"), TruthEngine()
    tracker = TrackerProcess(camera.path, engine, BODY_FROM_DEPTH, camera.clock)
    camera.run(tracker, 0, 30)
    poses = poses_of(camera.path)
    assert len(poses) == tracker.poses >= 23
    begin = round(10 * (poses[0].stamp_s - 100.0))
    odom_from_truth = body_at(begin) @ ROLL.inverse()  # odom begins at the first pose, with heading 0
    for pose in poses:
        true = odom_from_truth.inverse() @ body_at(round(10 * (pose.stamp_s - 100.0)))
        apart = true.inverse() @ pose.odom_from_body
        assert np.linalg.norm(apart.translation_m) < 1e-6
        assert np.linalg.norm(apart.rotation_vector()) < 1e-6
        assert (pose.quality, pose.reset_counter) == (80, 0)
    raw = StreamReader(camera.path).frame()
    assert raw is not None
    assert raw.sequence == 30  # the frames of the camera are untouched
    assert np.array_equal(engine.views[-1].rgb, raw.rgb)
    assert np.median(engine.views[-1].depth_m[20:50, 30:60]) == pytest.approx(2.0, abs=0.05)


def test_another_world_of_the_engine_continues_at_the_last_pose_and_counts_a_reset(tmp_path: Path) -> None:
    camera = Camera(tmp_path / "camera.stream")
    camera.run(TrackerProcess(camera.path, TruthEngine(lost_at=20), BODY_FROM_DEPTH, camera.clock), 0, 25)
    poses = poses_of(camera.path)
    steps_m = [
        float(np.linalg.norm(b.odom_from_body.translation_m - a.odom_from_body.translation_m)) for a, b in pairwise(poses)
    ]
    assert [pose.reset_counter for pose in poses[-6:]] == [0, 1, 1, 1, 1, 1]
    assert max(steps_m) < 0.06
    assert steps_m[-5] < 1e-6  # the motion of the lost frame is not known


def test_without_inertial_samples_the_body_is_level(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    camera = Camera(tmp_path / "camera.stream", imu=False)
    camera.run(TrackerProcess(camera.path, TruthEngine(), BODY_FROM_DEPTH, camera.clock), 0, 35)
    assert "no inertial samples" in caplog.text
    first = poses_of(camera.path)[0]
    assert first.stamp_s > 102.9
    assert np.linalg.norm(first.odom_from_body.rotation_vector()) < 1e-6


def test_no_pose_while_the_body_moves_at_the_start(tmp_path: Path) -> None:
    camera = Camera(tmp_path / "camera.stream", imu=False)
    tracker = TrackerProcess(camera.path, TruthEngine(), BODY_FROM_DEPTH, camera.clock)
    for number in range(100):
        camera.clock.advance_to(100.0 + number / 100)
        camera.writer.write_imu(camera.clock.now_s(), np.array([0.0, 0.0, 0.3]), np.array([0.0, 0.0, 9.81]))
        camera.writer.write_frame(camera.clock.now_s(), np.zeros((48, 64), np.uint16), np.zeros((72, 96, 3), np.uint8))
        tracker.step()
    assert poses_of(camera.path) == []


def test_it_follows_a_restarted_camera(tmp_path: Path) -> None:
    camera = Camera(tmp_path / "camera.stream")
    tracker = TrackerProcess(camera.path, TruthEngine(), BODY_FROM_DEPTH, camera.clock)
    camera.run(tracker, 0, 12)
    camera.writer = StreamWriter(camera.path, header())
    for number in range(120):
        camera.clock.advance_to(101.3 + number / 100)
        tracker.step()
    camera.run(tracker, 26, 30)
    assert [round(pose.stamp_s, 3) for pose in poses_of(camera.path)] == [102.6, 102.7, 102.8, 102.9]


def test_a_pose_writer_wants_a_stream(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("nothing")
    for name in ("text", "missing"):
        with pytest.raises(StreamError, match=str(tmp_path / name)):
            StreamPoseWriter(tmp_path / name)


@pytest.mark.parametrize("force", [(0.0, 0.0, 9.8), (1.0, -2.0, 9.5), (0.0, 5.0, 8.0)])
def test_the_attitude_at_rest_has_the_force_up_and_no_heading(force: tuple[float, float, float]) -> None:
    pose = level_attitude(np.array(force))
    up = pose.rotation() @ np.array(force)
    assert np.allclose(up[:2], 0.0, atol=1e-9)
    assert up[2] > 0.0
    assert abs(pose.yaw_rad()) < 1e-9


def test_depth_is_registered_to_a_colour_camera_beside_it() -> None:
    """Half of the depth image is a wall at 1 m, half one at 3 m; the colour camera sits 0.1 m to the right."""
    depth, rgb = Intrinsics(100.0, 100.0, 49.5, 49.5, 100, 100), Intrinsics(200.0, 200.0, 99.5, 99.5, 200, 200)
    rgb_from_depth = Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([-0.1, 0.0, 0.02]))
    image = np.full((100, 100), 3.0, dtype=np.float32)
    image[:, :50] = 1.0
    image[:10] = 0.0
    found = DepthRegistration(depth, rgb, rgb_from_depth).registered(image)
    assert found[100, 40] == pytest.approx(1.02, abs=1e-5)
    assert found[100, 150] == pytest.approx(3.02, abs=1e-5)
    edge = 99.5 + 200.0 * (-0.1 / 1.02)  # where the near wall ends: x = 0 in the depth camera
    assert found[100, math.floor(edge) - 2] == pytest.approx(1.02, abs=1e-5)
    assert found[5, 100] == 0.0
    assert found[100, 199] == 3.02 or found[100, 199] == 0.0
    same = DepthRegistration(depth, depth, Pose.identity())
    assert same.registered(image) is image
