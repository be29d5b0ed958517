"""ROS 2 over real DDS: the publisher is another process, on the loopback interface."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import TypeVar

import numpy as np
import pytest

from uav_recon.clock import ManualClock, MonotonicClock
from uav_recon.config import Ros2Config
from uav_recon.sensors.ros2 import Ros2Camera, Ros2Error, Ros2Poses, StampMapping

T = TypeVar("T")
PUBLISHER = Path(__file__).with_name("ros2_publisher.py")
LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces><AllowMulticast>false</AllowMulticast>"
    "</General><Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address='127.0.0.1'/></Peers></Discovery>"
    "</Domain></CycloneDDS>"
)
DOMAIN = 61 + os.getpid() % 100
TOPICS = Ros2Config(
    domain=DOMAIN, depth_topic="/depth", rgb_topic="/rgb", info_topic="/info", imu_topic="/imu", pose_topic="/odom"
)


@contextmanager
def publisher(qos: str = "reliable", offset_s: float = 0.0, encodings: str = "16UC1,rgb8") -> Iterator[None]:
    words = [sys.executable, str(PUBLISHER), str(DOMAIN), qos, str(offset_s), encodings]
    with subprocess.Popen(words, stdin=subprocess.PIPE) as process:
        try:
            yield
        finally:
            assert process.stdin is not None
            process.stdin.close()
            assert process.wait(20) == 0


def wait_for(read: Callable[[], T]) -> T:
    """Poll another process until it is heard."""
    end_s = time.monotonic() + 30.0
    while time.monotonic() < end_s:
        if found := read():
            return found
        time.sleep(0.01)
    pytest.fail("nothing was heard in 30 s")


@pytest.fixture(autouse=True)
def _loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)


@pytest.mark.parametrize(("kind", "topic"), [("odometry", "/odom"), ("pose", "/pose")])
@pytest.mark.parametrize("qos", ["reliable", "best_effort"])
def test_a_pose_of_another_process_arrives_with_its_stamp(qos: str, kind: str, topic: str) -> None:
    config = TOPICS.model_copy(update={"pose_type": kind, "pose_topic": topic, "reliability": qos})
    poses = Ros2Poses(config, MonotonicClock())
    with publisher(qos):
        heard = wait_for(poses.poses)
        pose, now_s = heard[-1], time.monotonic()
    np.testing.assert_allclose(pose.odom_from_body.translation_m, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(pose.odom_from_body.quat_wxyz, [0.8, 0.0, 0.0, 0.6])
    assert -0.01 < now_s - pose.stamp_s < 2.0
    assert pose.covariance[0, 0] == pytest.approx(4e-4 if kind == "odometry" else 1e-4)
    assert poses.refused == 0


@pytest.mark.parametrize("encodings", ["16UC1,rgb8", "32FC1,bgr8"])
def test_a_frame_and_the_imu_of_another_process_arrive(encodings: str) -> None:
    camera = Ros2Camera(TOPICS, MonotonicClock(), depth_max_m=2.05)
    with publisher(encodings=encodings):
        frame = wait_for(camera.poll)
        sample = wait_for(camera.imu)[-1]
        after = wait_for(camera.poll)
    assert frame is not None
    assert after is not None
    assert after.stamp_s > frame.stamp_s
    np.testing.assert_allclose(frame.depth_m[:11, 3], 1.0 + 0.1 * np.arange(11), atol=1e-6)
    assert np.isnan(frame.depth_m[11]).all()  # beyond depth_max_m
    assert frame.rgb[5, 5].tolist() == [200, 0, 50]
    lens = frame.depth_intrinsics
    assert (lens.fx, lens.fy, lens.cx, lens.cy, lens.width, lens.height) == (20.0, 21.0, 7.5, 5.5, 16, 12)
    np.testing.assert_allclose(sample.specific_force_mps2, [0.1, 0.2, 9.81])
    np.testing.assert_allclose(sample.gyro_radps, [0.01, 0.02, 0.03])


def test_stamps_of_another_clock_are_refused_in_one_line(caplog: pytest.LogCaptureFixture) -> None:
    poses = Ros2Poses(TOPICS, MonotonicClock())
    with publisher(offset_s=-1000.0), caplog.at_level(logging.ERROR):
        wait_for(lambda: poses.poses() or poses.refused > 2)
    assert poses.poses() == []
    (record,) = caplog.records
    assert "/odom" in record.getMessage()
    assert "publisher uses another clock" in record.getMessage()


def test_a_stamp_keeps_its_age_when_the_clocks_differ() -> None:
    mapping = StampMapping("/odom", ManualClock(50.0), lambda: 1_700_000_000.25)
    assert mapping.monotonic_s(SimpleNamespace(sec=1_700_000_000, nanosec=0)) == pytest.approx(49.75)
    assert mapping.monotonic_s(SimpleNamespace(sec=1_700_000_001, nanosec=0)) is None
    assert mapping.monotonic_s(SimpleNamespace(sec=12, nanosec=0)) is None
    assert mapping.refused == 2


def _image(n: int, encoding: str, data: bytes, step: int) -> SimpleNamespace:
    header = SimpleNamespace(stamp=SimpleNamespace(sec=1000, nanosec=n * 33_000_000))
    pixels = np.frombuffer(data, np.uint8)
    return SimpleNamespace(header=header, height=2, width=2, encoding=encoding, is_bigendian=0, step=step, data=pixels)


def test_colour_that_always_arrives_after_the_next_depth_is_still_paired() -> None:
    clock = ManualClock(50.0)
    camera = Ros2Camera(TOPICS, clock, system_s=lambda: 1000.0 + clock.now_s() - 50.0)
    lens = SimpleNamespace(k=[2.0, 0.0, 0.5, 0.0, 2.0, 0.5, 0.0, 0.0, 1.0], width=2, height=2)
    inbox: dict[str, list[SimpleNamespace]] = {"depth": [], "rgb": []}
    camera._take_info = lambda: [lens]
    camera._take_depth = lambda: [inbox["depth"].pop()] if inbox["depth"] else []
    camera._take_rgb = lambda: [inbox["rgb"].pop()] if inbox["rgb"] else []
    stamps = []
    for n in range(20):
        clock.advance_to(50.0 + 0.033 * n)
        inbox["depth"].append(_image(n, "16UC1", bytes([0, 4] * 4), 4))
        if n:
            inbox["rgb"].append(_image(n - 1, "rgb8", bytes(12), 6))
        if frame := camera.poll():
            stamps.append(frame.stamp_s)
    np.testing.assert_allclose(stamps, 50.0 + 0.033 * np.arange(19), atol=1e-6)
    assert camera.dropped_frames == 0


def test_depth_without_colour_is_dropped_and_reported(caplog: pytest.LogCaptureFixture) -> None:
    camera = Ros2Camera(TOPICS, ManualClock(50.0), system_s=lambda: 1000.5)
    camera._take_depth = lambda: [_image(1, "16UC1", bytes(8), 4)]
    assert [camera.poll() for _ in range(10)] == [None] * 10
    assert camera.dropped_frames == 6
    assert [record.getMessage() for record in caplog.records] == ["ros2: no colour image within 0.02 s of a depth image"]


def test_without_the_library_one_line_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    monkeypatch.setitem(sys.modules, "cyclonedds.idl", None)
    monkeypatch.delitem(sys.modules, "uav_recon.sensors.ros2_messages", raising=False)
    import uav_recon.sensors

    monkeypatch.delattr(uav_recon.sensors, "ros2_messages", raising=False)
    with pytest.raises(Ros2Error, match=r"pip install uav-recon\[ros2\]"):
        Ros2Poses(TOPICS, MonotonicClock())


@pytest.mark.parametrize("name", ["odom", "/odom/", "/2d", ""])
def test_a_wrong_topic_name_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="full topic name"):
        Ros2Config(pose_topic=name)
