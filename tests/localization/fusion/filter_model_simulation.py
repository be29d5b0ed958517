"""A world that is exactly what the filter believes: noise and random walks of its own densities, along a smooth flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from uav_recon.localization.fusion.eskf import Estimate
from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.localization.fusion.propagation_model import INERTIAL
from uav_recon.types.camera import ImuSample
from uav_recon.types.pose import Pose, StampedPose

F64 = NDArray[np.float64]
GRAVITY = np.array([0.0, 0.0, -9.80665])
IMU_HZ, POSE_HZ, LATE_S = 60, 15, 0.05
CLAIMED_M2, CLAIMED_RAD2 = 1.04e-4, 3e-5
WHITE, DRIFT_PER_S = 0.15, 0.85 * 2 / 20  # of a claimed variance: white, and what its drift wanders in a second
COVARIANCE = np.diag([CLAIMED_M2] * 3 + [CLAIMED_RAD2] * 3)


@dataclass
class Truth:
    """At each pose: in the source's own, drifting frame. odom_from_body: one rotation each; the rest (N, 3)."""

    stamps_s: F64
    position_m: F64
    velocity_mps: F64
    odom_from_body: Rotation
    gyro_bias: F64
    offset: F64


def fly(seed: int, seconds: float) -> tuple[FusionFilter, Truth, list[tuple[Estimate, float]]]:
    """One run: the filter after it, the truth at the poses, and what the filter held after each."""
    imu, poses, truth = _stream(np.random.default_rng(seed), seconds)
    fusion, held, sample = FusionFilter(), [], 0
    for pose in poses:
        arrival_s = pose.stamp_s + LATE_S
        until = int(np.searchsorted([s.stamp_s for s in imu], arrival_s))
        fusion.add_imu(imu[sample:until])
        sample = until
        assert fusion.add_pose(pose, arrival_s)
        assert fusion.newest
        held.append(fusion.newest)
    return fusion, truth, held


def error(estimate: Estimate, odom_from_body: Rotation, truth: Truth, k: int) -> F64:
    """(15,): what has to be put on the estimate to get the truth; odom_from_body: the estimated one."""
    turn = (truth.odom_from_body[k] * odom_from_body.inv()).as_rotvec()
    return np.concatenate(
        (
            truth.position_m[k] - estimate.position_m,
            truth.velocity_mps[k] - estimate.velocity_mps,
            turn,
            truth.gyro_bias[k] - estimate.gyro_bias_radps,
            truth.offset[k] - estimate.offset_mps2,
        )
    )


def _stream(rng: np.random.Generator, seconds: float) -> tuple[list[ImuSample], list[StampedPose], Truth]:
    n, dt = int(seconds * IMU_HZ) + 12, 1.0 / IMU_HZ
    root, every = float(np.sqrt(dt)), IMU_HZ // POSE_HZ
    t = np.linspace(0.0, (n - 1) * dt, n)
    position: F64 = np.stack([0.6 * np.sin(0.9 * t), 0.4 * np.sin(1.3 * t), 1.0 + 0.2 * np.cos(0.7 * t)], axis=1)
    velocity: F64 = np.stack([0.54 * np.cos(0.9 * t), 0.52 * np.cos(1.3 * t), -0.14 * np.sin(0.7 * t)], axis=1)
    acceleration = np.stack([-0.486 * np.sin(0.9 * t), -0.676 * np.sin(1.3 * t), -0.098 * np.cos(0.7 * t)], axis=1)
    euler = np.stack([0.5 * t, 0.1 * np.sin(t), 0.1 * np.cos(1.1 * t)], axis=1)
    true = Rotation.from_euler("ZYX", euler)
    rate = (true[:-1].inv() * true[1:]).as_rotvec() / dt  # mean over the step after each sample

    bias: F64 = 0.005 * rng.normal(size=3) + INERTIAL.bias_walk * root * rng.normal(size=(n, 3)).cumsum(axis=0)
    offset_body: F64 = 0.05 * rng.normal(size=3) + INERTIAL.offset_walk * root * rng.normal(size=(n, 3)).cumsum(axis=0)
    wander = float(np.sqrt(DRIFT_PER_S * CLAIMED_M2)) * root * rng.normal(size=(n, 3)).cumsum(axis=0)
    lean = float(np.sqrt(DRIFT_PER_S * CLAIMED_RAD2)) * root * rng.normal(size=(n, 3)).cumsum(axis=0)
    seen = Rotation.from_rotvec(lean) * true  # attitude in the source's frame

    at = 0.5 * (rate[1:] + rate[:-1])  # of the sample between two steps
    gyro = at + bias[1:-1] + INERTIAL.rate / root * rng.normal(size=at.shape)
    force = seen[1:-1].inv().apply(acceleration[1:-1] - GRAVITY) - offset_body[1:-1]
    force = force + INERTIAL.acceleration / root * rng.normal(size=force.shape)
    imu = [ImuSample(float(s), g, f) for s, g, f in zip(t[1:-1], gyro, force, strict=True)]

    k = np.arange(every, n - 12, every)
    white_m, white_rad = np.sqrt(WHITE * CLAIMED_M2), np.sqrt(WHITE * CLAIMED_RAD2)
    reported = (Rotation.from_rotvec(white_rad * rng.normal(size=(len(k), 3))) * seen[k]).as_quat(scalar_first=True)
    where = position[k] + wander[k] + white_m * rng.normal(size=(len(k), 3))
    poses = [StampedPose(float(s), Pose(q, p), np.zeros(3), COVARIANCE) for s, q, p in zip(t[k], reported, where, strict=True)]
    return imu, poses, Truth(t[k], position[k] + wander[k], velocity[k], seen[k], bias[k], seen[k].apply(offset_body[k]))
