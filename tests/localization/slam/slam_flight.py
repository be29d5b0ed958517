"""A rendered flight for the tracker: a textured room, a D435i's images with noise, and a flying IMU with noise and bias."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from textured_room import BARE, RGB_FROM_DEPTH, ranges_m

from uav_recon.localization.slam.slam_tracker import SlamTracker
from uav_recon.localization.slam.tracking_monitor import TrackingFault
from uav_recon.types.camera import Frame, ImuSample, Intrinsics, body_from_camera
from uav_recon.types.frames import ByteArray, Float32Array, FloatArray
from uav_recon.types.pose import Pose, StampedPose

RATE_HZ = 15.0
SECONDS = 20.0
REST_S = 1.2  # on the pad
GRAVITY = np.array([0.0, 0.0, -9.80665])
GYRO_BIAS_RADPS = np.array([0.006, -0.004, 0.005])
FORCE_BIAS_MPS2 = np.array([0.08, -0.06, 0.1])
# standard deviation of a sample at 200 Hz: the density of a flying D435i times the root of half the rate
GYRO_NOISE_RADPS = 0.01
FORCE_NOISE_MPS2 = 0.7
ON_PAD = 0.03  # share of the noise with the motors off
LENS = Intrinsics.from_fov(212, 120, 1.52, 1.01)
RGB_LENS = Intrinsics.from_fov(212, 120, 1.20, 0.73)
BODY_FROM_DEPTH = body_from_camera(np.array([0.1, 0.0, 0.02]), math.radians(12.0))
ROOM_M = np.array([[-2.2, -1.8, -0.1], [2.6, 1.9, 2.4]])
CABINET_M = np.array([[1.5, 0.8, -0.1], [2.6, 1.5, 1.4]])
_TEXEL_M = 0.005
_TEXELS = 2048


@functools.cache
def _texture() -> FloatArray:
    """Brightness of blotches of 8 and 25 cm, and of small spots."""
    random, out = np.random.default_rng(11), np.zeros((_TEXELS, _TEXELS), np.float32)
    for cell_m, share in ((0.25, 0.3), (0.08, 0.4), (0.03, 0.3)):
        side = round(_TEXELS * _TEXEL_M / cell_m)
        out += share * cv2.resize(random.random((side, side)).astype(np.float32), out.shape, interpolation=cv2.INTER_CUBIC)
    return np.asarray(40.0 + 170.0 * out)


def body_at(t: float | FloatArray) -> tuple[FloatArray, Rotation]:
    """Return place (..., 3) and attitude of the body at times: at rest on the pad, then up to 0.6 m/s and 0.7 rad/s."""
    s = np.maximum(np.asarray(t, dtype=np.float64) - REST_S, 0.0)
    ease = s * s / (s + 1.5)  # starts at rest
    place = np.stack((0.9 * np.sin(0.55 * ease), 0.6 * (1.0 - np.cos(0.6 * ease)), 0.55 * (1.0 - np.cos(0.5 * ease))), axis=-1)
    yaw = 0.9 * np.sin(0.5 * ease) + 0.15 * ease
    tilt = np.stack((yaw, 0.06 * np.sin(0.9 * ease), 0.05 * np.sin(1.1 * ease)), axis=-1)
    return place, Rotation.from_euler("ZYX", tilt)


def truth(t: float) -> Pose:
    """Return the body's pose."""
    place, attitude = body_at(t)
    x, y, z, w = attitude.as_quat().tolist()
    return Pose(np.array([w, x, y, z]), place)


@functools.cache
def imu() -> tuple[ImuSample, ...]:
    """Return the inertial samples of the whole flight, 200 Hz, from 0.3 s before its first frame."""
    stamps, h, random = np.arange(-0.3, SECONDS + 0.1, 0.005), 1e-3, np.random.default_rng(5)
    (before, first), (place, attitude), (after, last) = body_at(stamps - h), body_at(stamps), body_at(stamps + h)
    rate = (first.inv() * last).as_rotvec() / (2 * h)
    force = attitude.inv().apply((after - 2 * place + before) / h**2 - GRAVITY)
    flying = np.where(stamps > REST_S, 1.0, ON_PAD)[:, None]
    rate = rate + GYRO_BIAS_RADPS + GYRO_NOISE_RADPS * flying * random.standard_normal(rate.shape)
    force = force + FORCE_BIAS_MPS2 + FORCE_NOISE_MPS2 * flying * random.standard_normal(force.shape)
    return tuple(ImuSample(t, w, f) for t, w, f in zip(stamps.tolist(), rate, force, strict=True))


def rendered(camera: Pose, seed: int) -> tuple[Float32Array, ByteArray]:
    """Return noisy depth (H, W) and colour (h, w, 3) of the room from a pose of the depth imager."""
    random, boxes = np.random.default_rng(seed), (CABINET_M,)
    depth = ranges_m(camera, LENS, ROOM_M, boxes)
    noisy: Float32Array = (1.0 / (1.0 / depth + 0.004 * random.standard_normal(depth.shape))).astype(np.float32)
    eye = camera @ RGB_FROM_DEPTH.inverse()
    far = ranges_m(eye, RGB_LENS, ROOM_M, boxes)
    x, y, z = np.moveaxis((far[..., None] * RGB_LENS.bearings()) @ eye.rotation().T + eye.translation_m, -1, 0)
    across, up = (x + 1.7 * y) / _TEXEL_M, (z + 0.6 * x - 0.4 * y) / _TEXEL_M
    u, v = (np.mod(axis, _TEXELS - 1).astype(np.float32) for axis in (across, up))
    grey = cv2.remap(_texture(), u, v, cv2.INTER_LINEAR) + 2.0 * random.standard_normal(far.shape)
    rgb: ByteArray = np.repeat(np.clip(grey, 0.0, 255.0).astype(np.uint8)[..., None], 3, axis=2)
    return noisy, rgb


@functools.cache
def frame(number: int, delay_s: float = 0.0) -> Frame:
    """Return a frame of the flight; it shows the body ``delay_s`` before its stamp."""
    t = number / RATE_HZ
    depth, rgb = rendered(truth(t - delay_s) @ BODY_FROM_DEPTH, number)
    return Frame(t, number, depth, LENS, rgb, RGB_LENS, RGB_FROM_DEPTH)


def covered(true: Frame) -> Frame:
    """Return a frame of a covered camera: no depth, black colour."""
    return replace(true, depth_m=np.full_like(true.depth_m, np.nan), rgb=np.zeros_like(true.rgb))


def colourless(true: Frame) -> Frame:
    """Return a frame of a camera without colour."""
    return replace(true, rgb=BARE)


def frames(seconds: float, change: Callable[[Frame], Frame] = lambda true: true, delay_s: float = 0.0) -> Iterator[Frame]:
    """Yield the frames of the flight's beginning, each as ``change`` returns it."""
    return (change(frame(n, delay_s)) for n in range(round(seconds * RATE_HZ)))


@dataclass(frozen=True, slots=True)
class Tracked:
    """The tracker's answer to one frame. error_m: of its pose, None without one."""

    stamp_s: float
    pose: StampedPose | None
    fault: TrackingFault | None
    error_m: float | None
    error_rad: float | None


def fly(tracker: SlamTracker, seen: Iterable[Frame], samples: tuple[ImuSample, ...] | None = None) -> list[Tracked]:
    """Track frames, with the inertial samples up to 20 ms after each. samples: instead of those of the flight."""
    answers, added = list[Tracked](), 0
    samples = imu() if samples is None else samples
    for each in seen:
        start = added
        while added < len(samples) and samples[added].stamp_s <= each.stamp_s + 0.02:
            added += 1
        tracker.add_imu(list(samples[start:added]))
        pose, error_m, error_rad = tracker.track(each, BODY_FROM_DEPTH), None, None
        if pose is not None:
            off = truth(pose.stamp_s).inverse() @ pose.odom_from_body
            error_m = float(np.linalg.norm(off.translation_m))
            error_rad = 2.0 * math.asin(min(1.0, float(np.linalg.norm(off.quat_wxyz[1:]))))
        answers.append(Tracked(each.stamp_s, pose, tracker.fault, error_m, error_rad))
    return answers


def ate_m(answers: Iterable[Tracked]) -> float:
    """Return the root of the mean squared error of the places; odom begins at the truth, so nothing is aligned."""
    return float(np.sqrt(np.mean([answer.error_m**2 for answer in answers if answer.error_m is not None])))
