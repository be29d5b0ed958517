"""Late absolute poses and fast inertial samples into jump-free odometry at any recent instant.

The Kalman filter lives at the stamps of the poses, never at "now": each pose becomes a node at its own stamp, reached from
the node before it by the inertial track, and the present is the newest node carried on by the samples since. A pose that
comes out of order is put in its place and the nodes after it are computed again.

Position, velocity and an odom-frame acceleration offset are estimated per axis (filterpy); the offset takes up tilt
error and accelerometer bias, and without an IMU it IS the acceleration of a constant-acceleration model. Attitude is the
gyro's, pulled to the poses' by a small proportional gain, with the gyro's bias by an integral one (Mahony, Hamel and
Pflimlin 2008, eq. 32).
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, replace

import numpy as np
from filterpy.kalman import KalmanFilter

from uav_recon.localization.attitude import (
    GRAVITY_MPS2,
    InertialState,
    InertialTrack,
    Quaternion,
    Vector,
    conjugate,
    exponential,
    logarithm,
    multiply,
    normalised,
    rotate,
)
from uav_recon.types.camera import ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose

_H = np.hstack([np.eye(3), np.zeros((3, 6))])
_HISTORY_S = 2.0  # nodes kept for late poses and frames
_SAME_STAMP_S = 1e-4
_WHITE_SHARE = 0.15  # of a claimed variance: most of a pose's error drifts slowly, and is to be followed, not smoothed
_SMALLEST_VARIANCE_M2, _LARGEST_VARIANCE_M2 = 0.002**2, 0.03**2


@dataclass(frozen=True, slots=True)
class _Gains:
    """How far to trust what carries the state between poses."""

    acceleration: float  # m/s² per root Hz, white
    offset: float  # m/s² per root second, random walk of the acceleration offset
    attitude: float  # share of an attitude error taken off per pose
    rate: float  # share of an attitude error, per pose interval, taken off the rate
    quality: int  # of 100


_WITH_IMU = _Gains(acceleration=0.01, offset=0.03, attitude=0.08, rate=0.0016, quality=100)
_WITHOUT_IMU = _Gains(acceleration=0.1, offset=1.2, attitude=0.6, rate=0.25, quality=60)


@dataclass(frozen=True, slots=True)
class _Node:
    """Estimate at a pose's stamp. mean: (9,) position, velocity, acceleration offset in odom."""

    pose: StampedPose
    mean: FloatArray
    covariance: FloatArray
    odom_from_gyro: Quaternion
    inertial: bool
    count: int

    @property
    def stamp_s(self) -> float:
        return self.pose.stamp_s


class FusionFilter:
    """Fuses; costs 0.02 ms an inertial sample, 0.3 ms a pose, 0.06 ms an answer on one core.

    pose_lost_s: an answer farther than this after the newest pose has quality 0. ``rejected`` counts what was turned down,
    by reason: not finite, stamp, duplicate, quality, jump, turn.
    """

    def __init__(self, pose_lost_s: float = 0.5, jump_m: float = 0.5, turn_rad: float = 0.5, relock_s: float = 2.0) -> None:
        self.rejected: Counter[str] = Counter()
        self._lost_s, self._jump_m, self._turn_rad, self._relock_s = pose_lost_s, jump_m, turn_rad, relock_s
        self._track = InertialTrack()
        self._nodes: deque[_Node] = deque()
        self._refused: deque[StampedPose] = deque()  # a run of poses that agree with each other, but not with us
        self._gyro_bias: Vector = (0.0, 0.0, 0.0)
        self._coast_rate: Vector = (0.0, 0.0, 0.0)
        self._imu_since_s, self._imu_s = math.inf, -math.inf  # the newest unbroken run of inertial samples
        self._reset_counter, self._source_resets = 0, 0
        self._kalman = KalmanFilter(dim_x=9, dim_z=3)
        self._kalman.H = _H

    @property
    def newest_pose_s(self) -> float:
        """Stamp of the newest fused pose; -inf before the first."""
        return self._nodes[-1].stamp_s if self._nodes else -math.inf

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Take inertial samples, oldest first; what is not finite or not newer than the one before is counted and left out."""
        for sample in samples:
            stamp_s = sample.stamp_s
            gx, gy, gz = sample.gyro_radps.tolist()
            fx, fy, fz = sample.specific_force_mps2.tolist()
            if not math.isfinite(stamp_s + gx + gy + gz + fx + fy + fz) or max(abs(gx), abs(gy), abs(gz)) > 35.0:
                self.rejected["imu not finite"] += 1
                continue
            if stamp_s <= self._track.newest_s:
                self.rejected["imu stamp"] += 1
                continue
            if stamp_s - self._imu_s > 0.05:
                self._imu_since_s = stamp_s
            self._imu_s = stamp_s
            bx, by, bz = self._gyro_bias
            self._track.push(stamp_s, (gx - bx, gy - by, gz - bz), (fx, fy, fz))

    def add_pose(self, pose: StampedPose, now_s: float) -> bool:
        """Fuse an absolute pose at its own stamp; now_s bounds what stamps are believed. False if it was turned down."""
        reason = self._refusal(pose, now_s)
        if reason:
            self.rejected[reason] += 1
            return self._relock(pose) if reason in ("jump", "turn") else False
        self._refused.clear()
        if not self._nodes or pose.reset_counter != self._source_resets:
            return self._start(pose, jumped=bool(self._nodes))
        later: list[StampedPose] = []
        while self._nodes and self._nodes[-1].stamp_s > pose.stamp_s:
            later.insert(0, self._nodes.pop().pose)
        for item in (pose, *later):
            self._fuse(item)
        while self._nodes[-1].stamp_s - self._nodes[0].stamp_s > _HISTORY_S:
            self._nodes.popleft()
        return True

    def odom_at(self, stamp_s: float) -> StampedPose | None:
        """Where the body was (or is) at an instant; smooth between poses. None before the first pose or too long ago."""
        if not self._nodes or stamp_s < self._nodes[0].stamp_s:
            return None
        k = len(self._nodes) - 1
        while self._nodes[k].stamp_s > stamp_s:
            k -= 1
        node = self._nodes[k]
        base, here = self._track.at(node.stamp_s), self._track.at(stamp_s)
        if base is None or here is None:
            return None
        odom_from_gyro, mean = node.odom_from_gyro, self._carried(node, base, here)
        if k + 1 < len(self._nodes):  # bend the way from this node so that it ends at the next
            after = self._nodes[k + 1]
            there = self._track.at(after.stamp_s)
            share = (stamp_s - node.stamp_s) / (after.stamp_s - node.stamp_s)
            if there is not None:
                mean = mean + share * (after.mean[:6] - self._carried(node, base, there))
            x, y, z = logarithm(multiply(after.odom_from_gyro, conjugate(odom_from_gyro)))
            odom_from_gyro = multiply(exponential((share * x, share * y, share * z)), odom_from_gyro)
        covariance = np.zeros((6, 6))
        since_s = stamp_s - node.stamp_s
        spread = node.covariance[0, 0] + since_s**2 * node.covariance[3, 3]
        claimed = np.diagonal(node.pose.covariance)
        covariance[np.diag_indices(6)] = np.concatenate((np.maximum(spread, claimed[:3]), np.maximum(1e-7, claimed[3:])))
        return StampedPose(
            stamp_s,
            Pose(np.array(multiply(odom_from_gyro, here.gyro_from_body)), mean[:3]),
            mean[3:6],
            covariance,
            self._quality(node, stamp_s),
            self._reset_counter,
            node.pose.map_epoch,
        )

    def _quality(self, node: _Node, stamp_s: float) -> int:
        """Full up to 40 % of the time to lost, then falling to 0."""
        age_s = stamp_s - self.newest_pose_s
        share = min(1.0, max(0.0, (self._lost_s - age_s) / (0.6 * self._lost_s)))
        gains = _WITH_IMU if node.inertial else _WITHOUT_IMU
        return math.ceil(min(gains.quality, node.pose.quality) * share)

    def _carried(self, node: _Node, base: InertialState, here: InertialState) -> FloatArray:
        """Position and velocity (6,) of a node carried along the track."""
        dt = here.stamp_s - base.stamp_s
        step = _increment(node.odom_from_gyro, base, here)
        p, v, b = node.mean[:3], node.mean[3:6], node.mean[6:]
        return np.concatenate((p + v * dt + 0.5 * dt * dt * b + step[:3], v + dt * b + step[3:]))

    def _refusal(self, pose: StampedPose, now_s: float) -> str:
        """Why a pose may not enter, '' if it may."""
        if not (math.isfinite(pose.stamp_s) and np.isfinite(pose.covariance).all()):
            return "not finite"
        if pose.quality <= 0:
            return "quality"
        if not now_s - 1.0 <= pose.stamp_s <= now_s + 0.01:
            return "stamp"
        if not self._nodes:
            return "stamp" if len(self._track) and pose.stamp_s < self._track.oldest_s else ""
        if any(abs(node.stamp_s - pose.stamp_s) < _SAME_STAMP_S for node in self._nodes):
            return "duplicate"
        if pose.stamp_s < self._nodes[0].stamp_s:
            return "stamp"
        if pose.reset_counter != self._source_resets:
            return ""
        expected = self.odom_at(pose.stamp_s)
        if expected is None:
            return "stamp"
        if float(np.linalg.norm(pose.odom_from_body.translation_m - expected.odom_from_body.translation_m)) > self._jump_m:
            return "jump"
        turn = logarithm(multiply(_tuple(pose), conjugate(_tuple(expected))))
        return "turn" if math.hypot(*turn) > self._turn_rad else ""

    def _relock(self, pose: StampedPose) -> bool:
        """Long lost, and the source insists: begin again there, and say that odom jumped.

        Only after relock_s without a fused pose (the pilot has long begun to land then) and on a run of poses that agree.
        """
        if self._refused:
            last = self._refused[-1]
            moved_m = float(np.linalg.norm(pose.odom_from_body.translation_m - last.odom_from_body.translation_m))
            if moved_m > 0.1 + 2.0 * abs(pose.stamp_s - last.stamp_s):
                self._refused.clear()
        self._refused.append(pose)
        if len(self._refused) < 8 or pose.stamp_s - self.newest_pose_s < self._relock_s:
            return False
        self._refused.clear()
        return self._start(pose, jumped=True)

    def _start(self, pose: StampedPose, *, jumped: bool) -> bool:
        """Forget the past and stand at this pose."""
        if self._inertial(pose.stamp_s, pose.stamp_s) is False:
            self._coast_to(pose.stamp_s)
        base = self._track.at(pose.stamp_s)
        if base is None:
            self.rejected["stamp"] += 1
            return False
        self._nodes.clear()
        self._source_resets = pose.reset_counter
        self._reset_counter = (self._reset_counter + jumped) % 256
        mean = np.concatenate((pose.odom_from_body.translation_m, np.zeros(6)))
        covariance = np.diag([_variance(pose)] * 3 + [0.5**2] * 3 + [0.2**2] * 3)
        self._append(_Node(pose, mean, covariance, multiply(_tuple(pose), conjugate(base.gyro_from_body)), True, 1))
        return True

    def _inertial(self, start_s: float, end_s: float) -> bool:
        """Whether inertial samples cover the interval."""
        return self._imu_since_s <= start_s + 0.05 and self._imu_s >= end_s - 0.05

    def _coast_to(self, stamp_s: float) -> None:
        if stamp_s > self._track.newest_s:
            self._track.coast(stamp_s, self._coast_rate)

    def _append(self, node: _Node) -> None:
        self._nodes.append(node)
        self._track.hover_force_gyro = rotate(conjugate(node.odom_from_gyro), (0.0, 0.0, GRAVITY_MPS2))

    def _fuse(self, pose: StampedPose) -> None:
        """One step: carry the newest node to the pose's stamp, correct position, then attitude and rate."""
        node = self._nodes[-1]
        inertial = self._inertial(node.stamp_s, pose.stamp_s)
        gains = _WITH_IMU if inertial else _WITHOUT_IMU
        if not inertial:
            self._coast_to(pose.stamp_s)
        base, here = self._track.at(node.stamp_s), self._track.at(pose.stamp_s)
        if base is None or here is None:
            return  # cannot be: nodes are younger than the track
        if inertial != node.inertial:  # the offset means something else now
            node = replace(node, mean=np.concatenate((node.mean[:6], np.zeros(3))), covariance=_offset_unknown(node.covariance))
        mean, covariance = self._correct(node, pose, gains, base, here)

        predicted = multiply(node.odom_from_gyro, here.gyro_from_body)
        error = logarithm(multiply(_tuple(pose), conjugate(predicted)))
        gain = max(gains.attitude, 1.0 / (node.count + 1))  # an average while there are few poses
        pull = exponential((gain * error[0], gain * error[1], gain * error[2]))
        turned = rotate(conjugate(predicted), error)
        rate_gain = gains.rate / (here.stamp_s - base.stamp_s)
        if inertial:
            bx, by, bz = self._gyro_bias
            self._gyro_bias = (bx - rate_gain * turned[0], by - rate_gain * turned[1], bz - rate_gain * turned[2])
        else:
            rx, ry, rz = self._coast_rate
            self._coast_rate = (rx + rate_gain * turned[0], ry + rate_gain * turned[1], rz + rate_gain * turned[2])
            if pose.stamp_s >= self._track.newest_s:
                self._track.turn(self._coast_rate)
        odom_from_gyro = normalised(multiply(pull, node.odom_from_gyro))
        self._append(_Node(pose, mean, covariance, odom_from_gyro, inertial, node.count + 1))

    def _correct(
        self, node: _Node, pose: StampedPose, gains: _Gains, base: InertialState, here: InertialState
    ) -> tuple[FloatArray, FloatArray]:
        """Kalman step from a node to a pose: mean (9,) and covariance (9, 9) after it."""
        dt = here.stamp_s - base.stamp_s
        kalman = self._kalman
        kalman.x, kalman.P = node.mean, node.covariance
        control = np.concatenate((_increment(node.odom_from_gyro, base, here), np.zeros(3)))
        kalman.predict(u=control, B=np.eye(9), F=_transition(dt), Q=_process_noise(dt, gains))
        kalman.update(pose.odom_from_body.translation_m, R=np.eye(3) * _variance(pose))
        return kalman.x.copy(), kalman.P.copy()


def _tuple(pose: StampedPose) -> Quaternion:
    w, x, y, z = pose.odom_from_body.quat_wxyz.tolist()
    return (w, x, y, z)


def _variance(pose: StampedPose) -> float:
    """White part of the position variance, m², within reason."""
    claimed = _WHITE_SHARE * float(np.mean(np.diagonal(pose.covariance)[:3]))
    return min(max(claimed, _SMALLEST_VARIANCE_M2), _LARGEST_VARIANCE_M2)


def _increment(odom_from_gyro: Quaternion, base: InertialState, here: InertialState) -> FloatArray:
    """Change of position beyond v dt, and of velocity, (6,), by the track's integrals and gravity (see attitude.py)."""
    dt = here.stamp_s - base.stamp_s
    v0, v1, x0, x1 = base.velocity_integral, here.velocity_integral, base.position_integral, here.position_integral
    dv = rotate(odom_from_gyro, (v1[0] - v0[0], v1[1] - v0[1], v1[2] - v0[2]))
    dp = rotate(odom_from_gyro, (x1[0] - x0[0] - v0[0] * dt, x1[1] - x0[1] - v0[1] * dt, x1[2] - x0[2] - v0[2] * dt))
    fall = GRAVITY_MPS2 * dt
    return np.array([dp[0], dp[1], dp[2] - 0.5 * fall * dt, dv[0], dv[1], dv[2] - fall])


def _transition(dt: float) -> FloatArray:
    """Constant acceleration offset, three axes, (9, 9)."""
    return np.kron(np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]]), np.eye(3))


def _process_noise(dt: float, gains: _Gains) -> FloatArray:
    """White acceleration and a random walk of its offset, integrated over dt, (9, 9)."""
    a, b = gains.acceleration**2, gains.offset**2
    white = np.array([[dt**3 / 3, dt**2 / 2, 0.0], [dt**2 / 2, dt, 0.0], [0.0, 0.0, 0.0]])
    walk = np.array([[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]])
    noise: FloatArray = np.kron(a * white + b * walk, np.eye(3)).astype(np.float64)
    return noise


def _offset_unknown(covariance: FloatArray) -> FloatArray:
    """The covariance with the acceleration offset forgotten."""
    forgotten = covariance.copy()
    forgotten[6:, :] = forgotten[:, 6:] = 0.0
    forgotten[6:, 6:] = np.eye(3)
    return forgotten
