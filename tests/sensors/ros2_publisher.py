"""Publish ROS 2 messages over DDS in a process of its own, until standard input closes."""

import sys
import threading
import time

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from uav_recon.sensors import ros2_messages as ros

PUBLISHED = (
    ("rt/odom", ros.Odometry),
    ("rt/pose", ros.PoseStamped),
    ("rt/depth", ros.Image),
    ("rt/rgb", ros.Image),
    ("rt/info", ros.CameraInfo),
    ("rt/imu", ros.Imu),
)


def wait_for_end(over: threading.Event) -> None:
    sys.stdin.read()
    over.set()


def main(domain: int, reliable: bool, offset_s: float, encodings: str) -> None:
    participant = DomainParticipant(domain)
    kind = Policy.Reliability.Reliable(duration(milliseconds=100)) if reliable else Policy.Reliability.BestEffort
    qos = Qos(kind, Policy.History.KeepLast(5), Policy.DataRepresentation(use_cdrv0_representation=True))
    odom, pose, depth, rgb, info, imu = (
        DataWriter(participant, Topic(participant, name, message), qos=qos) for name, message in PUBLISHED
    )
    over = threading.Event()
    threading.Thread(target=wait_for_end, args=(over,), daemon=True).start()
    depth_code, rgb_code = encodings.split(",")
    millimetres = (1000 + 100 * np.arange(12)[:, None] + np.zeros(16)).astype("<u2")
    padded = np.zeros((12, 80), np.uint8)  # rows longer than the pixels
    raw = millimetres if depth_code == "16UC1" else (millimetres / 1000).astype("<f4")
    row = raw.view(np.uint8).reshape(12, -1)
    padded[:, : row.shape[1]] = row
    colour = np.zeros((12, 16, 3), np.uint8)
    colour[..., 0], colour[..., 2] = 200, 50
    colour = colour if rgb_code == "rgb8" else colour[..., ::-1]
    while not over.wait(0.02):
        now_s = time.time() + offset_s
        header = ros.Header(ros.Time(int(now_s), int(now_s % 1 * 1e9)), "odd")
        where = ros.PoseMessage(ros.Point(1.0, 2.0, 3.0), ros.Quaternion(0.0, 0.0, 0.6, 0.8))
        still = ros.TwistWithCovariance(ros.Twist(ros.Vector3(0.0, 0.0, 0.0), ros.Vector3(0.0, 0.0, 0.0)), [0.0] * 36)
        odom.write(
            ros.Odometry(header, "base_link", ros.PoseWithCovariance(where, np.diag([4e-4] * 6).ravel().tolist()), still)
        )
        pose.write(ros.PoseStamped(header, where))
        k = [20.0, 0.0, 7.5, 0.0, 21.0, 5.5, 0.0, 0.0, 1.0]
        roi = ros.RegionOfInterest(0, 0, 0, 0, False)
        info.write(ros.CameraInfo(header, 12, 16, "plumb_bob", [0.0] * 5, k, [0.0] * 9, [0.0] * 12, 0, 0, roi))
        rgb.write(ros.Image(header, 12, 16, rgb_code, 0, 48, colour.tobytes()))
        depth.write(ros.Image(header, 12, 16, depth_code, 0, 80, padded.tobytes()))
        force = ros.Vector3(0.1, 0.2, 9.81)
        rate = ros.Vector3(0.01, 0.02, 0.03)
        imu.write(ros.Imu(header, ros.Quaternion(0.0, 0.0, 0.0, 1.0), [0.0] * 9, rate, [0.0] * 9, force, [0.0] * 9))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2] == "reliable", float(sys.argv[3]), sys.argv[4])
