"""Which poses may enter the filter. Each answer is what a pose is rejected for, None for a pose that may."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from uav_recon.localization.imu_integration import Quaternion, Vector
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import StampedPose

_OLDEST_S, _FUTURE_S = 1.0, 0.01
_SAME_STAMP_S = 1e-4
_FARTHEST_M, _LARGEST_VARIANCE = 1e4, 1e4  # per number, m² or rad²: a source that says so much knows nothing
_STEP_M = 0.03  # a vehicle follows a step of its odometry at once
_PLAUSIBLE_NIS = 22.46  # 99.9 % of the innovations of six numbers (chi-square)


class PoseRejection(str, Enum):
    """What a pose or an inertial sample was rejected for; the filter counts by it."""

    NOT_FINITE = "not finite"
    OUT_OF_RANGE = "out of range"
    QUALITY = "quality"
    STAMP = "stamp"
    DUPLICATE = "duplicate"
    JUMP = "jump"
    TURN = "turn"
    SPEED = "speed"
    RESET = "reset"
    UNPROVEN = "unproven"  # the first after a loss
    IMU_NOT_FINITE = "imu not finite"
    IMU_FORCE = "imu force"
    IMU_STAMP = "imu stamp"


# What a source says against the track, or against itself.
CONTRADICTIONS = (PoseRejection.JUMP, PoseRejection.TURN, PoseRejection.SPEED)


@dataclass(frozen=True, slots=True)
class Sighting:
    """A pose of the source as plain numbers: odom_from_body as the filter's odom goes, and the value that it came in."""

    stamp_s: float
    position_m: Vector
    odom_from_body: Quaternion
    source: StampedPose


@dataclass(frozen=True, slots=True)
class PoseGates:
    """How far a pose may lie from where the track leads (HAZARDS, J_pos and J_yaw).

    Beyond jump_m AND ``sigmas`` standard deviations of the innovation it is refused, beyond farthest_m whatever these say; the
    same for the angle between the attitudes, and for its part that tilts the horizon, which both know. speed_mps: implied by
    the way from the pose before.
    """

    jump_m: float = 0.10
    farthest_m: float = 0.5
    turn_rad: float = math.radians(8.0)
    tilt_rad: float = math.radians(3.0)
    farthest_rad: float = math.radians(30.0)
    sigmas: float = 3.0
    speed_mps: float = 2.0

    def leap(self, residual: FloatArray, spread: FloatArray) -> PoseRejection | None:
        """residual: (6,) position, rotation vector. spread: (6, 6), its covariance."""
        place_m, place_sigma = _length_and_sigma(residual[:3], spread[:3, :3])
        if not place_m <= min(max(self.jump_m, self.sigmas * place_sigma), self.farthest_m):
            return PoseRejection.JUMP
        tilt_rad, tilt_sigma = _length_and_sigma(residual[3:5], spread[3:5, 3:5])
        if not tilt_rad <= max(self.tilt_rad, self.sigmas * tilt_sigma):
            return PoseRejection.TURN
        turn_rad, turn_sigma = _length_and_sigma(residual[3:], spread[3:, 3:])
        may = turn_rad <= min(max(self.turn_rad, self.sigmas * turn_sigma), self.farthest_rad)
        return None if may else PoseRejection.TURN

    def haste(self, before: Sighting, after: Sighting) -> PoseRejection | None:
        """Between two poses of the source, in either order."""
        way_m = math.dist(before.position_m, after.position_m)
        slow = way_m <= self.jump_m + self.speed_mps * abs(after.stamp_s - before.stamp_s)
        return None if slow else PoseRejection.SPEED


def pose_fault(pose: StampedPose, now_s: float) -> PoseRejection | None:
    """What is wrong with a pose by itself."""
    if pose.covariance.shape != (6, 6) or not (math.isfinite(pose.stamp_s) and np.isfinite(pose.covariance).all()):
        return PoseRejection.NOT_FINITE
    if np.abs(pose.odom_from_body.translation_m).max() > _FARTHEST_M or np.abs(pose.covariance).max() > _LARGEST_VARIANCE:
        return PoseRejection.OUT_OF_RANGE
    if pose.quality <= 0:
        return PoseRejection.QUALITY
    return None if now_s - _OLDEST_S <= pose.stamp_s <= now_s + _FUTURE_S else PoseRejection.STAMP


def same_stamp(a_s: float, b_s: float) -> bool:
    """Whether two stamps are one: the same pose again, or another one that claims its place."""
    return abs(a_s - b_s) < _SAME_STAMP_S


def normalized_innovation_squared(residual: FloatArray, spread: FloatArray) -> float:
    """Normalised innovation squared (NIS): chi-square of six where the filter knows how far to trust itself."""
    return float(residual @ np.linalg.solve(spread, residual))


def outlier_noise_scale(nis: float) -> float:
    """How many times the white noise of an implausible but possible pose counts: it pulls, it does not tear."""
    return max(1.0, nis / _PLAUSIBLE_NIS)


def max_step_noise_scale(residual: FloatArray, track_m2: float, white_m2: float) -> float:
    """How many times the white noise counts so that a pose moves odometry by at most _STEP_M; variances of track and pose."""
    share = track_m2 / (track_m2 + white_m2)
    steps = math.dist(residual[:3], (0.0, 0.0, 0.0)) / _STEP_M
    return track_m2 * (steps - 1.0) / white_m2 if share * steps > 1.0 else 1.0


def _length_and_sigma(vector: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Length of a vector, and the standard deviation along it."""
    length = math.sqrt(float(vector @ vector))
    return length, math.sqrt(max(float(vector @ covariance @ vector), 0.0)) / length if length > 0.0 else 0.0
