"""A known motion and what imperfect sensors say of it; attitude by scipy, nothing of the product but its values."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from uav_recon.types.camera import ImuSample
from uav_recon.types.pose import Pose, StampedPose

GRAVITY = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True)
class FigureEight:
    """0.8 m/s and 1 m/s² at most, heading turning at 45°/s; the body leans as a quadrotor must."""

    start_s: float = 100.0
    speed_mps: float = 0.8
    yaw_rate_radps: float = np.pi / 4

    def position(self, stamp_s: float) -> NDArray[np.float64]:
        a, w = self._shape()
        t = stamp_s - self.start_s
        return np.array([a * np.sin(w * t), 0.5 * a * np.sin(2 * w * t), 1.2 + 0.1 * np.sin(0.7 * w * t)])

    def velocity(self, stamp_s: float) -> NDArray[np.float64]:
        h = 1e-4
        out: NDArray[np.float64] = (self.position(stamp_s + h) - self.position(stamp_s - h)) / (2 * h)
        return out

    def acceleration(self, stamp_s: float) -> NDArray[np.float64]:
        h = 1e-3
        p = self.position
        out: NDArray[np.float64] = (p(stamp_s + h) - 2 * p(stamp_s) + p(stamp_s - h)) / h**2
        return out

    def attitude(self, stamp_s: float) -> Rotation:
        up = self.acceleration(stamp_s) - GRAVITY
        up /= np.linalg.norm(up)
        yaw = self.yaw_rate_radps * (stamp_s - self.start_s)
        left = np.cross(up, [np.cos(yaw), np.sin(yaw), 0.0])
        left /= np.linalg.norm(left)
        return Rotation.from_matrix(np.stack([np.cross(left, up), left, up], axis=1))

    def body_rate(self, stamp_s: float) -> NDArray[np.float64]:
        h = 1e-3
        out: NDArray[np.float64] = (self.attitude(stamp_s - h).inv() * self.attitude(stamp_s + h)).as_rotvec() / (2 * h)
        return out

    def pose(self, stamp_s: float) -> Pose:
        return Pose(self.attitude(stamp_s).as_quat(scalar_first=True), self.position(stamp_s))

    def _shape(self) -> tuple[float, float]:
        # x' = a w cos, y' = a w cos 2: speed at most a w sqrt(2); acceleration about 2 a w² = 1 m/s²
        aw = self.speed_mps / np.sqrt(2)
        w = 1.0 / (2 * aw) * 0.98
        return aw / w, w


@functools.cache
def perfect_imu(motion: FigureEight, k: int) -> ImuSample:
    """Sample k of an IMU without errors, at 200 Hz."""
    t = motion.start_s + k / 200
    return ImuSample(t, motion.body_rate(t), motion.attitude(t).inv().apply(motion.acceleration(t) - GRAVITY))


@functools.cache
def _perfect_pose(motion: FigureEight, k: int) -> tuple[float, Rotation, NDArray[np.float64]]:
    t = motion.start_s + 0.02 + k / 15
    return t, motion.attitude(t), motion.position(t)


@dataclass
class Event:
    """Something that arrives at an instant: an inertial sample or a pose."""

    arrival_s: float
    imu: ImuSample | None = None
    pose: StampedPose | None = None
    drift: NDArray[np.float64] | None = None  # slow part of the pose's error: position, then rotation vector


def events(motion: FigureEight, duration_s: float, seed: int, *, imu: bool = True) -> list[Event]:
    """200 Hz inertial samples with bias and noise; 15 Hz poses with drift and noise, 60 +- 20 ms late; by arrival."""
    rng = np.random.default_rng(seed)
    out: list[Event] = []
    gyro_bias = np.radians(rng.normal(0.0, 0.3, 3))
    force_bias = rng.normal(0.0, 0.05, 3)
    for k in range(int(duration_s * 200) if imu else 0):
        true = perfect_imu(motion, k)
        t, gyro = true.stamp_s, true.gyro_radps + gyro_bias + np.radians(rng.normal(0.0, 0.1, 3))
        force = true.specific_force_mps2 + force_bias + rng.normal(0.0, 0.05, 3)
        out.append(Event(t + 0.002, imu=ImuSample(t, gyro, force)))
    sigma = np.array([0.01] * 3 + [np.radians(0.3)] * 3)
    drift = sigma * rng.normal(size=6)
    keep = np.exp(-(1 / 15) / 20)  # Ornstein-Uhlenbeck with 20 s
    for k in range(int(duration_s * 15)):
        t, attitude, position = _perfect_pose(motion, k)
        drift = keep * drift + np.sqrt(1 - keep**2) * sigma * rng.normal(size=6)
        white = rng.normal(size=6) * np.array([0.002] * 3 + [np.radians(0.1)] * 3)
        error = drift + white
        turned = Rotation.from_rotvec(error[3:]) * attitude
        pose = Pose(turned.as_quat(scalar_first=True), position + error[:3])
        covariance = np.diag([1.04e-4] * 3 + [3e-5] * 3)  # drift and noise together, as sources claim it
        late_s = 0.06 + rng.uniform(-0.02, 0.02)
        out.append(Event(t + late_s, pose=StampedPose(t, pose, np.zeros(3), covariance), drift=drift.copy()))
    return sorted(out, key=lambda event: event.arrival_s)
