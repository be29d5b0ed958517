"""Gates for the poses that may enter the filter.

Each gate returns the word under which a rejected pose is counted, None for an accepted one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from uav_recon.localization.fusion.imu_integration import Quaternion, Vector
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose

_OLDEST_S = 1.0  #: reject: an older pose of the source
_FUTURE_S = 0.01  #: reject: a pose of the source stamped later than the clock by this
_SAME_STAMP_S = 1e-4  #: reject: a pose whose stamp differs from another's by less: it is the same again
_FARTHEST_M = 1e4  #: reject: a pose farther from odom's origin on an axis
_LARGEST_VARIANCE_SI = 1e4  #: reject: a pose that claims a larger variance, in m² or rad²: its source knows nothing
_FROZEN_M = 0.02  #: reject: a pose equal to the one before, once the track has moved away from it by more
_FROZEN_RAD = math.radians(1.0)  #: reject: the same, turned by more
_STEP_M = 0.03  #: brake: no pose moves odometry by more at once: a vehicle follows such a step
#: reject: the weight of a pose falls above this: 99.9 % of the innovations of six elements (chi-square) are below
_PLAUSIBLE_NIS = 22.46


class PoseRejection(str, Enum):
    """Reason for the rejection of a pose or an inertial sample; the filter counts by it."""

    NOT_FINITE = "not finite"
    OUT_OF_RANGE = "out of range"
    QUALITY = "quality"
    STAMP = "stamp"
    DUPLICATE = "duplicate"
    FROZEN = "frozen"
    JUMP = "jump"
    TURN = "turn"
    SPEED = "speed"
    RESET = "reset"
    UNPROVEN = "unproven"  # the first after a loss
    EXCLUDED = "excluded"  # of a source that view and inertial sensors contradict
    IMU_NOT_FINITE = "imu not finite"
    IMU_FORCE = "imu force"
    IMU_STAMP = "imu stamp"
    IMU_FROZEN = "imu frozen"


# What a source says against the track, or against itself.
CONTRADICTIONS = (PoseRejection.JUMP, PoseRejection.TURN, PoseRejection.SPEED)


@dataclass(frozen=True, slots=True)
class PoseMeasurement:
    """A pose of the source as plain numbers.

    odom_from_body: in the filter's odom. source: the pose as it was received.
    """

    stamp_s: float
    position_m: Vector
    odom_from_body: Quaternion
    source: StampedPose


class FrozenPoseGate:
    """Notices poses that repeat although the track moves on.

    No tracker gives a pose twice to the last bit.
    """

    def __init__(self) -> None:
        self._last: Pose | None = None

    def repeats(self, pose: Pose, residual: FloatArray) -> bool:
        """Return True for a pose that is the one before again. residual: (6,), its innovation.

        Call it for each valid pose.
        """
        last, self._last = self._last, pose
        if last is None or not (
            np.array_equal(last.translation_m, pose.translation_m) and np.array_equal(last.quat_wxyz, pose.quat_wxyz)
        ):
            return False
        return math.hypot(*residual[:3].tolist()) > _FROZEN_M or math.hypot(*residual[3:].tolist()) > _FROZEN_RAD


@dataclass(frozen=True, slots=True)
class PoseGates:
    """Limits for the difference between a pose and the track.

    A pose beyond jump_m AND ``sigmas`` standard deviations of the innovation is rejected; beyond farthest_m it is always
    rejected. The same holds for the angle between the attitudes (turn_rad, farthest_rad), and for its part that tilts the
    horizon (tilt_rad), which both source and track know. speed_mps: limit of the speed implied by the previous pose.
    """

    jump_m: float = 0.10  #: reject: a pose farther from the track than sigmas, but never for less than this
    farthest_m: float = 0.5  #: reject: a pose farther from the track than this, whatever its covariance
    #: reject: an attitude farther from the track's than sigmas, but never for less than this
    turn_rad: float = math.radians(8.0)
    tilt_rad: float = math.radians(3.0)  #: reject: the same for its tilt of the horizon, which both source and track know
    farthest_rad: float = math.radians(30.0)  #: reject: an attitude farther from the track's than this, whatever its covariance
    sigmas: float = 3.0  #: reject: standard deviations of the innovation beyond which a pose does not fit the track
    speed_mps: float = 2.0  #: reject: a pose that the previous one reaches only by a higher speed

    def leap(self, residual: FloatArray, spread: FloatArray) -> PoseRejection | None:
        """Return the reason why a pose does not fit the track, None if it fits.

        residual: (6,) position, rotation vector. spread: (6, 6), its covariance.
        """
        place_m, place_sigma = _length_and_sigma(residual[:3], spread[:3, :3])
        if not place_m <= min(max(self.jump_m, self.sigmas * place_sigma), self.farthest_m):
            return PoseRejection.JUMP
        tilt_rad, tilt_sigma = _length_and_sigma(residual[3:5], spread[3:5, 3:5])
        if not tilt_rad <= max(self.tilt_rad, self.sigmas * tilt_sigma):
            return PoseRejection.TURN
        turn_rad, turn_sigma = _length_and_sigma(residual[3:], spread[3:, 3:])
        may = turn_rad <= min(max(self.turn_rad, self.sigmas * turn_sigma), self.farthest_rad)
        return None if may else PoseRejection.TURN

    def speed_fault(self, before: PoseMeasurement, after: PoseMeasurement) -> PoseRejection | None:
        """Return SPEED if two poses of the source, in either order, are too far apart, None if not."""
        way_m = math.dist(before.position_m, after.position_m)
        slow = way_m <= self.jump_m + self.speed_mps * abs(after.stamp_s - before.stamp_s)
        return None if slow else PoseRejection.SPEED


def pose_fault(pose: StampedPose, now_s: float) -> PoseRejection | None:
    """Return the fault of a pose by itself, None for nothing."""
    if pose.covariance.shape != (6, 6) or not (math.isfinite(pose.stamp_s) and np.isfinite(pose.covariance).all()):
        return PoseRejection.NOT_FINITE
    if np.abs(pose.odom_from_body.translation_m).max() > _FARTHEST_M or np.abs(pose.covariance).max() > _LARGEST_VARIANCE_SI:
        return PoseRejection.OUT_OF_RANGE
    if pose.quality <= 0:
        return PoseRejection.QUALITY
    return None if now_s - _OLDEST_S <= pose.stamp_s <= now_s + _FUTURE_S else PoseRejection.STAMP


def same_stamp(a_s: float, b_s: float) -> bool:
    """Return True if two stamps are equal: the same pose again, or another one in its place."""
    return abs(a_s - b_s) < _SAME_STAMP_S


def normalized_innovation_squared(residual: FloatArray, spread: FloatArray) -> float:
    """Return the normalized innovation squared (NIS).

    It is chi-square distributed with six degrees of freedom if the filter's covariance is right.
    """
    return float(residual @ np.linalg.solve(spread, residual))


def outlier_noise_scale(nis: float) -> float:
    """Return the factor on the white noise of an improbable but possible pose.

    The pose then corrects the state only weakly.
    """
    return max(1.0, nis / _PLAUSIBLE_NIS)


def max_step_noise_scale(residual: FloatArray, track_m2: float, white_m2: float) -> float:
    """Return the factor on the white noise with which a pose moves odometry by at most _STEP_M.

    track_m2, white_m2: variances of track and pose.
    """
    share = track_m2 / (track_m2 + white_m2)
    steps = math.dist(residual[:3], (0.0, 0.0, 0.0)) / _STEP_M
    return track_m2 * (steps - 1.0) / white_m2 if share * steps > 1.0 else 1.0


def _length_and_sigma(vector: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Return the length of a vector, and the standard deviation along it."""
    length = math.sqrt(float(vector @ vector))
    return length, math.sqrt(max(float(vector @ covariance @ vector), 0.0)) / length if length > 0.0 else 0.0
