"""Rigid transforms with one composition operator, and odometry values."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from uav_recon.types.frames import FloatArray, frozen
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rigid transform ``target_from_source``: p_target = R(quat) p_source + translation_m.

    quat_wxyz: (4,) Hamilton unit quaternion, normalised here. translation_m: (3,).
    Raises ValueError if a number is not finite or the quaternion has no direction.
    """

    quat_wxyz: FloatArray
    translation_m: FloatArray

    def __post_init__(self) -> None:
        quat = np.asarray(self.quat_wxyz, dtype=np.float64)
        translation = np.asarray(self.translation_m, dtype=np.float64)
        if quat.shape != (4,) or translation.shape != (3,):
            raise ValueError(f"pose wants quat_wxyz (4,) and translation_m (3,), got {quat.shape} and {translation.shape}")
        w, x, y, z = quat.tolist()
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        if not all(map(math.isfinite, (norm, *translation.tolist()))) or norm < 1e-9:
            raise ValueError(f"pose is not finite: quat_wxyz {quat}, translation_m {translation}")
        unit = quat / norm
        unit.setflags(write=False)
        object.__setattr__(self, "quat_wxyz", unit)
        object.__setattr__(self, "translation_m", frozen(translation))

    @staticmethod
    def identity() -> Pose:
        """Return the identity transform."""
        return Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))

    @staticmethod
    def from_rotation_vector(rotation_rad: FloatArray, translation_m: FloatArray) -> Pose:
        """Build from axis times angle (3,) and translation (3,)."""
        angle = float(np.linalg.norm(rotation_rad))
        if angle < 1e-12:
            half = 0.5 * np.asarray(rotation_rad, dtype=np.float64)
            return Pose(np.concatenate(([1.0], half)), translation_m)
        axis = np.asarray(rotation_rad, dtype=np.float64) / angle
        return Pose(np.concatenate(([np.cos(angle / 2)], np.sin(angle / 2) * axis)), translation_m)

    @staticmethod
    def from_yaw(yaw_rad: float, translation_m: FloatArray) -> Pose:
        """Build a level pose: rotation about z by ``yaw_rad``."""
        return Pose(np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)]), translation_m)

    @staticmethod
    def from_matrix(matrix: FloatArray) -> Pose:
        """Build from a 4x4 homogeneous matrix (Shepperd's method)."""
        r = np.asarray(matrix, dtype=np.float64)[:3, :3]
        candidates = np.array([np.trace(r), r[0, 0], r[1, 1], r[2, 2]])
        i = int(np.argmax(candidates))
        if i == 0:
            quat = np.array([1 + candidates[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
        else:
            a, b, c = i - 1, i % 3, (i + 1) % 3
            quat = np.zeros(4)
            quat[0] = r[c, b] - r[b, c]
            quat[1 + a] = 1 + r[a, a] - r[b, b] - r[c, c]
            quat[1 + b] = r[b, a] + r[a, b]
            quat[1 + c] = r[c, a] + r[a, c]
        return Pose(quat, np.asarray(matrix, dtype=np.float64)[:3, 3])

    def rotation(self) -> FloatArray:
        """Return the rotation matrix (3, 3)."""
        w, x, y, z = self.quat_wxyz.tolist()
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    def matrix(self) -> FloatArray:
        """Return the homogeneous matrix (4, 4)."""
        out = np.eye(4)
        out[:3, :3] = self.rotation()
        out[:3, 3] = self.translation_m
        return out

    def rotation_vector(self) -> FloatArray:
        """Return the rotation as axis times angle (3,), rad, for the smaller angle."""
        quat = self.quat_wxyz if self.quat_wxyz[0] >= 0.0 else -self.quat_wxyz
        length = float(np.linalg.norm(quat[1:]))
        scale = 2.0 if length < 1e-9 else 2.0 * math.atan2(length, float(quat[0])) / length
        return np.asarray(scale * quat[1:])

    def inverse(self) -> Pose:
        """Return source_from_target."""
        conjugate = self.quat_wxyz * np.array([1.0, -1.0, -1.0, -1.0])
        return Pose(conjugate, -self.rotation().T @ self.translation_m)

    def __matmul__(self, other: Pose) -> Pose:
        """Compose: a_from_b @ b_from_c = a_from_c."""
        aw, ax, ay, az = self.quat_wxyz.tolist()
        bw, bx, by, bz = other.quat_wxyz.tolist()
        quat = np.array(
            [
                aw * bw - ax * bx - ay * by - az * bz,
                aw * bx + ax * bw + ay * bz - az * by,
                aw * by - ax * bz + ay * bw + az * bx,
                aw * bz + ax * by - ay * bx + az * bw,
            ]
        )
        return Pose(quat, self.rotation() @ other.translation_m + self.translation_m)

    def apply(self, points: FloatArray) -> FloatArray:
        """Transform points (3,) or (N, 3) from the source frame into the target frame."""
        return points @ self.rotation().T + self.translation_m

    def yaw_rad(self) -> float:
        """Return the heading of the x axis about z, in (-pi, pi]."""
        w, x, y, z = self.quat_wxyz.tolist()
        return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


class PoseHealth(Enum):
    """Health of the odometry, and what it allows."""

    GOOD = "good"  # fly
    DEGRADED = "degraded"  # fly slowly
    LOST = "lost"  # hold position, and land if it lasts
    WRONG = "wrong"  # land: a hold by this odometry would drift


@dataclass(frozen=True, slots=True, eq=False)
class WorldFromOdom:
    """The correction of the pose source's map since the start (REP-105).

    Odom never jumps; world_from_odom does. epoch: number of corrections.
    """

    world_from_odom: Pose
    epoch: int = 0

    @staticmethod
    @functools.cache
    def start() -> WorldFromOdom:
        """Return the value before the first correction, when world and odom coincide."""
        return WorldFromOdom(Pose.identity())


@dataclass(frozen=True, slots=True, eq=False)
class StampedPose:
    """Odometry: pose and velocity of the body, and how reliable they are.

    velocity_odom_mps: (3,). covariance: (6, 6), position then rotation vector, m² and rad².
    quality: 0 (lost) to 100. reset_counter: +1 (mod 256) whenever odom itself jumps. map_epoch: of the maps that go with it.
    health_reason: why the health is no better, None for GOOD. correction: odom's pose in the world at this stamp.
    """

    stamp_s: float
    odom_from_body: Pose
    velocity_odom_mps: FloatArray
    covariance: FloatArray = field(default_factory=lambda: np.diag([1e-4] * 3 + [1e-5] * 3))
    quality: int = 100
    reset_counter: int = 0
    map_epoch: int = 0
    health: PoseHealth = PoseHealth.GOOD
    health_reason: Reason | None = None
    correction: WorldFromOdom = field(default_factory=WorldFromOdom.start)

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity_odom_mps", frozen(np.asarray(self.velocity_odom_mps, dtype=np.float64)))
        object.__setattr__(self, "covariance", frozen(np.asarray(self.covariance, dtype=np.float64)))

    def moved(self, target_from_odom: Pose) -> StampedPose:
        """Return the pose in another frame; a malformed covariance stays as it is."""
        turn = target_from_odom.rotation()
        both = np.kron(np.eye(2), turn)
        return replace(
            self,
            odom_from_body=target_from_odom @ self.odom_from_body,
            velocity_odom_mps=turn @ self.velocity_odom_mps,
            covariance=both @ self.covariance @ both.T if self.covariance.shape == (6, 6) else self.covariance,
        )

    @property
    def place_sigma_m(self) -> float:
        """Standard deviation of the position in its worst direction, m.

        NaN if the covariance is malformed.
        """
        if self.covariance.shape != (6, 6) or not np.isfinite(self.covariance[:3, :3]).all():
            return math.nan
        return math.sqrt(max(float(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]), 0.0))

    @property
    def unsure(self) -> Reason | None:
        """Reason why the source is uncertain of the place, None if it is not."""
        reason = self.health_reason if self.health is PoseHealth.DEGRADED else None
        return reason if reason is not None and reason.code is ReasonCode.PLACE_UNSURE else None


@dataclass(frozen=True, slots=True, eq=False)
class MapCorrection:
    """A new map frame, and the poses of past frames in it.

    The present pose is the same in the new frame.

    map_epoch: its number. stamp_s (N,): capture stamps of those frames; world_from_depth (N): their depth imagers' poses.
    """

    map_epoch: int
    stamp_s: FloatArray
    world_from_depth: tuple[Pose, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "stamp_s", frozen(np.asarray(self.stamp_s, dtype=np.float64)))
        if self.stamp_s.shape != (len(self.world_from_depth),):
            raise ValueError(f"{len(self.world_from_depth)} poses for stamps of shape {self.stamp_s.shape}")

    def poses(self) -> Iterator[tuple[float, Pose]]:
        """Return the stamp and the pose of each frame."""
        return zip(self.stamp_s.tolist(), self.world_from_depth, strict=True)
