"""Conformance of a running camera stream: measured values against allowed ranges.

`observe` copies what a writer publishes, with the time of arrival; `judge` is a pure function of that copy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from uav_recon.interfaces import Clock
from uav_recon.sensors.stream_format import IMU, POSE, StreamHeader, StreamReader
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

_POLL_S = 0.002
_GRAVITY_MPS2 = 9.81
_UNITS_MIN_MM = 100.0  # a room in metres or in centimetres has a smaller median than this
_SUBSAMPLE = 8  # pixels between two that are compared from frame to frame


@dataclass(frozen=True)
class Finding:
    """One checked property.

    value and allowed: the value and its range, as text. good: the value lies in the range.
    """

    name: str
    value: str
    allowed: str
    good: bool


@dataclass
class StreamObservation:
    """Copy of everything that a stream showed in duration_s.

    frame_stamps_s, frame_ages_s: capture stamp, and age on arrival, of each frame seen. valid_shares: share of pixels with
    depth. median_mm: median of the valid depths. checksums: of a subsample of the depth pixels. imu (dtype IMU) and poses
    (dtype POSE): the records; imu_ages_s and pose_ages_s: their ages on arrival. lost_frames: sequence numbers never seen.
    """

    header: StreamHeader
    duration_s: float = 0.0
    frame_stamps_s: list[float] = field(default_factory=list)
    frame_ages_s: list[float] = field(default_factory=list)
    valid_shares: list[float] = field(default_factory=list)
    median_mm: list[float] = field(default_factory=list)
    checksums: list[int] = field(default_factory=list)
    lost_frames: int = 0
    imu: Any = field(default_factory=lambda: np.empty(0, IMU))
    imu_ages_s: list[float] = field(default_factory=list)
    poses: Any = field(default_factory=lambda: np.empty(0, POSE))
    pose_ages_s: list[float] = field(default_factory=list)


def observe(
    reader: StreamReader, clock: Clock, duration_s: float, progress: Callable[[float], None] = lambda _: None
) -> StreamObservation:
    """Watch a stream for duration_s; blocks.

    Records that were there before are ignored. progress: gets the elapsed time in seconds.
    """
    seen = StreamObservation(reader.header)
    newest = reader.frame()
    sequence = 0 if newest is None else newest.sequence
    imu_read, pose_read = reader.imu()[0], reader.poses()[0]
    start_s = clock.now_s()
    imu, poses = [seen.imu], [seen.poses]
    while (now_s := clock.now_s()) - start_s < duration_s:
        frame = reader.frame(sequence)
        if frame is not None:
            seen.lost_frames += frame.sequence - sequence - 1
            sequence = frame.sequence
            _add_frame(seen, frame.stamp_s, now_s, frame.depth_mm)
        imu_read, samples = reader.imu(imu_read)
        pose_read, records = reader.poses(pose_read)
        imu.append(samples)
        poses.append(records)
        seen.imu_ages_s += (now_s - samples["stamp_s"]).tolist()
        seen.pose_ages_s += (now_s - records["stamp_s"]).tolist()
        progress(now_s - start_s)
        clock.sleep_until(now_s + _POLL_S)
    seen.duration_s = clock.now_s() - start_s
    seen.imu, seen.poses = np.concatenate(imu), np.concatenate(poses)
    return seen


def _add_frame(seen: StreamObservation, stamp_s: float, now_s: float, depth_mm: Any) -> None:
    valid = depth_mm[depth_mm > 0]
    seen.frame_stamps_s.append(stamp_s)
    seen.frame_ages_s.append(now_s - stamp_s)
    seen.valid_shares.append(valid.size / depth_mm.size)
    seen.median_mm.append(float(np.median(valid)) if valid.size else math.nan)
    seen.checksums.append(hash(depth_mm[::_SUBSAMPLE, ::_SUBSAMPLE].tobytes()))


def judge(seen: StreamObservation) -> list[Finding]:
    """Return every finding: header, frames, IMU, poses. A stream without frames or poses fails."""
    found = [*_of_header(seen.header), *_of_frames(seen), *_of_imu(seen), *_of_poses(seen)]
    if len(seen.imu) and len(seen.poses):
        found.append(_gravity_of_poses(seen))
    return found


def _range(name: str, value: float, low: float, high: float, unit: str = "") -> Finding:
    """Return the finding of a number; nan is never in the range."""
    allowed = f"{low:g} to {high:g} {unit}" if math.isfinite(high) else f"at least {low:g} {unit}"
    return Finding(name, f"{value:.4g} {unit}".rstrip(), allowed.rstrip(), bool(low <= value <= high))


def _of_header(header: StreamHeader) -> list[Finding]:
    found = []
    for name, lens in (("depth", header.depth), ("rgb", header.rgb)):
        for axis, focal, size in (("x", lens.fx, lens.width), ("y", lens.fy, lens.height)):
            angle = math.degrees(2 * math.atan(size / 2 / focal)) if math.isfinite(focal) and focal > 0 else math.nan
            found.append(_range(f"{name} field of view {axis}", angle, 20.0, 150.0, "deg"))
        for axis, centre, size in (("x", lens.cx, lens.width), ("y", lens.cy, lens.height)):
            found.append(_range(f"{name} principal point c{axis} / size", centre / size, 0.35, 0.65))
    norm, apart_m = math.hypot(*header.rgb_from_depth[:4]), math.hypot(*header.rgb_from_depth[4:])
    found.append(_range("rgb_from_depth quaternion norm", norm, 0.99, 1.01))
    return [*found, _range("rgb_from_depth distance", apart_m, 0.0, 0.2, "m")]


def _of_frames(seen: StreamObservation) -> list[Finding]:
    stamps, rate_hz = np.array(seen.frame_stamps_s), len(seen.frame_stamps_s) / max(seen.duration_s, 1e-9)
    found = [_range("frame rate", rate_hz, 5.0, 120.0, "Hz")]
    if len(stamps) < 2:
        return found
    steps = np.diff(stamps)
    return [
        *found,
        _range("frame stamps: smallest step", float(steps.min()) * 1e3, 1.0, math.inf, "ms"),
        _range("frame stamps: largest gap", float(steps.max()), 0.0, 0.3, "s"),
        _range("frame age on arrival, median", float(np.median(seen.frame_ages_s)) * 1e3, 0.0, 200.0, "ms"),
        _range("frame age on arrival, smallest", min(seen.frame_ages_s) * 1e3, -10.0, math.inf, "ms"),
        _range("frames not seen by this check", seen.lost_frames / (seen.lost_frames + len(stamps)), 0.0, 0.2),
        _range("pixels with depth, median", float(np.median(seen.valid_shares)), 0.1, 1.0),
        _range("depth, median (unit: mm)", _median_mm(seen), _UNITS_MIN_MM, 20000.0, "mm"),
        _range("depth images that differ", len(set(seen.checksums)) / len(stamps), 0.5, 1.0),
    ]


def _median_mm(seen: StreamObservation) -> float:
    """Return the median over the frames that show anything, nan if none does."""
    shown = [value for value in seen.median_mm if not math.isnan(value)]
    return float(np.median(shown)) if shown else math.nan


def _of_imu(seen: StreamObservation) -> list[Finding]:
    if not len(seen.imu):
        return [Finding("IMU", "none", "may be absent: odometry then rests on the poses alone", True)]
    force, gyro = seen.imu["specific_force_mps2"], seen.imu["gyro_radps"]
    mean = force.mean(axis=0)
    norm = float(np.linalg.norm(mean))
    tilt = math.degrees(math.acos(np.clip(mean[2] / max(norm, 1e-9), -1.0, 1.0))) if math.isfinite(norm) else math.nan
    return [
        _range("IMU rate", len(seen.imu) / max(seen.duration_s, 1e-9), 50.0, 2000.0, "Hz"),
        _range("IMU age on arrival, median", float(np.median(seen.imu_ages_s)) * 1e3, -10.0, 100.0, "ms"),
        _range("IMU stamps: smallest step", _smallest_step_ms(seen.imu["stamp_s"]), 1e-3, math.inf, "ms"),
        _range("specific force, mean (at rest)", norm, _GRAVITY_MPS2 - 0.5, _GRAVITY_MPS2 + 0.5, "m/s2"),
        _range("specific force off body z, up (FLU, level)", tilt, 0.0, 25.0, "deg"),
        _range("angular rate, largest", float(np.abs(gyro).max()), 0.0, 10.0, "rad/s"),
        _range("IMU samples that differ", len(np.unique(force, axis=0)) / len(force), 0.1, 1.0),
    ]


def _of_poses(seen: StreamObservation) -> list[Finding]:
    poses = seen.poses
    found = [_range("pose rate", len(poses) / max(seen.duration_s, 1e-9), 5.0, 400.0, "Hz")]
    if not len(poses):
        return found
    norms = np.linalg.norm(poses["quat_wxyz"], axis=1)
    states = np.concatenate((poses["position_m"], poses["quat_wxyz"]), axis=1)
    jumps = np.linalg.norm(np.diff(poses["position_m"], axis=0), axis=1)
    kept = jumps[np.diff(poses["reset_counter"]) == 0]
    return [
        *found,
        _range("pose delay, median", float(np.median(seen.pose_ages_s)) * 1e3, 0.0, 300.0, "ms"),
        _range("pose delay, smallest", min(seen.pose_ages_s) * 1e3, -10.0, math.inf, "ms"),
        _range("pose stamps: smallest step", _smallest_step_ms(poses["stamp_s"]), 1e-3, math.inf, "ms"),
        _range("pose quaternion norm, farthest from 1", float(norms[np.argmax(np.abs(norms - 1.0))]), 0.99, 1.01),
        _range("pose variance, smallest", float(poses["variance"].min()), 0.0, math.inf),
        _range("pose quality, median", float(np.median(poses["quality"])), 1.0, 100.0),
        _range("position, largest step without a reset", float(kept.max(initial=0.0)), 0.0, 0.3, "m"),
        _range("poses that differ", len(np.unique(states, axis=0)) / len(states), 0.1, 1.0),
    ]


def _gravity_of_poses(seen: StreamObservation) -> Finding:
    """Return the angle between odom's z axis and the mean specific force in odom."""
    order = np.argsort(seen.imu["stamp_s"])
    stamps_s, force = seen.imu["stamp_s"][order], seen.imu["specific_force_mps2"][order]
    total: FloatArray = np.zeros(3)
    for record in seen.poses:
        near = min(int(np.searchsorted(stamps_s, record["stamp_s"])), len(stamps_s) - 1)
        try:
            total = total + Pose(record["quat_wxyz"], np.zeros(3)).rotation() @ force[near]
        except ValueError:
            continue  # a finding of its own: the norm of the quaternion
    norm = float(np.linalg.norm(total))
    angle = math.degrees(math.acos(np.clip(total[2] / norm, -1.0, 1.0))) if 0.0 < norm < math.inf else math.nan
    return _range("gravity of the IMU in odom, off z", angle, 0.0, 10.0, "deg")


def _smallest_step_ms(stamps_s: Any) -> float:
    return float(np.diff(stamps_s).min(initial=math.inf)) * 1e3
