"""Relocalization check: poses that do not continue the track are accepted once they agree.

They have to agree among themselves for long enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_recon.localization.fusion.filter_pose_gates import PoseMeasurement
from uav_recon.localization.fusion.imu_integration import conjugate, logarithm, multiply, rotate

_SLIP_M = 0.05  #: reject: poses of a new track that differ by more from the motion of the old one between them
_SLIP_MPS = 0.1  #: reject: ... beyond what the track itself drifts in more than _MAP_STEP_S
_SLIP_RAD = math.radians(3.0)  #: reject: the same for the attitude
_WIDER_M = 0.10  #: reject: the same without inertial samples, beyond what _SPEED_MPS explains
_WIDER_RAD = math.radians(8.0)  #: reject: the same for the attitude, beyond what _TURN_RADPS explains
_SPEED_MPS = 2.0  #: reject: no vehicle is faster
_TURN_RADPS = math.radians(90.0)  #: reject: no vehicle turns faster
_MAP_STEP_POSES = 4  #: reject: fewer agreeing poses in a row are no step of the source's map; for a track that was never lost
_MAP_STEP_S = 0.2  #: reject: nor do they within less than this time
#: reject: fewer poses in a row that agree do not end a loss: a wrong relocalization is worse than none (hazard B2)
_AFTER_LOSS_POSES = 12
_AFTER_LOSS_S = 1.0  #: reject: nor do they within less than this time


@dataclass(frozen=True, slots=True)
class ConsistencyRequirement:
    """Number of poses that must agree, and the min. time (s) that they span."""

    poses: int
    over_s: float


MAP_STEP = ConsistencyRequirement(_MAP_STEP_POSES, _MAP_STEP_S)
AFTER_LOSS = ConsistencyRequirement(_AFTER_LOSS_POSES, _AFTER_LOSS_S)


class RelocalizationCheck:
    """One run of such poses. A pose that does not agree with the one before it starts a new run."""

    def __init__(self) -> None:
        self._run: list[tuple[PoseMeasurement, PoseMeasurement]] = []  # the source's pose, and that of the track

    def __len__(self) -> int:
        return len(self._run)

    def clear(self) -> None:
        """End the run."""
        self._run.clear()

    def update(self, measurement: PoseMeasurement, track: PoseMeasurement, inertial: bool) -> None:
        """Add a pose, and the pose that the track alone predicts for its stamp.

        It has to agree with the pose before it and with the first of the run: a small difference from pose to pose is a wrong
        velocity.
        """
        if self._run and measurement.stamp_s <= self._run[-1][0].stamp_s:
            return
        pair = (measurement, track)
        if self._run and not (_agree(self._run[-1], pair, inertial) and _agree(self._run[0], pair, inertial)):
            self._run.clear()
        self._run.append((measurement, track))

    def satisfies(self, requirement: ConsistencyRequirement) -> bool:
        """Return True if the run meets the requirement."""
        return len(self._run) >= requirement.poses and self._run[-1][0].stamp_s - self._run[0][0].stamp_s >= requirement.over_s

    def velocity_mps(self) -> tuple[float, float, float]:
        """Return the mean velocity of the source over the run; zero for less than two poses."""
        if len(self._run) < 2:
            return (0.0, 0.0, 0.0)
        (first, _), (last, _) = self._run[0], self._run[-1]
        x, y, z = _difference(last, first)
        dt_s = last.stamp_s - first.stamp_s
        return (x / dt_s, y / dt_s, z / dt_s)


def _agree(
    before: tuple[PoseMeasurement, PoseMeasurement], after: tuple[PoseMeasurement, PoseMeasurement], inertial: bool
) -> bool:
    """Return True if the source moved as the track did or, without an IMU, as a vehicle can."""
    (said0, track0), (said1, track1) = before, after
    dt_s = said1.stamp_s - said0.stamp_s
    turn = multiply(conjugate(said0.odom_from_body), said1.odom_from_body)
    if not inertial:
        way_m = math.dist(said0.position_m, said1.position_m)
        near = math.hypot(*logarithm(turn)) <= _WIDER_RAD + _TURN_RADPS * dt_s
        return near and way_m <= _WIDER_M + _SPEED_MPS * dt_s
    moved = multiply(conjugate(track0.odom_from_body), track1.odom_from_body)
    slip_rad = math.hypot(*logarithm(multiply(conjugate(turn), moved)))
    way = rotate(conjugate(said0.odom_from_body), _difference(said1, said0))
    expected = rotate(conjugate(track0.odom_from_body), _difference(track1, track0))
    return slip_rad <= _SLIP_RAD and math.dist(way, expected) <= _SLIP_M + _SLIP_MPS * max(dt_s - _MAP_STEP_S, 0.0)


def _difference(a: PoseMeasurement, b: PoseMeasurement) -> tuple[float, float, float]:
    (ax, ay, az), (bx, by, bz) = a.position_m, b.position_m
    return (ax - bx, ay - by, az - bz)
