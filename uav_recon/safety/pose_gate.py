"""Pose gate: a jump, a turn or a stamp that no flight explains never reaches the autopilot.

The filter of localization has gates of its own. Neither relies on the other, so their limits are written twice on purpose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.types.pose import StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_MAX_AGE_S = 0.15  #: reject: an older pose: the autopilot's estimator would drop it, or take it for new
_FUTURE_S = 0.05  #: reject: a pose stamped later than the clock by this
_JUMP_M = 0.10  #: reject: a pose farther from the prediction than three sigma, but never for less than this: noise
_WIDEST_M = 0.30  #: reject: a pose farther from the prediction than this, whatever sigma is claimed
_TURN_RAD = math.radians(8.0)  #: reject: a turn between poses by more, beyond what twice the limit of the yaw rate explains
_PUSH_MPS2 = 1.0  #: reject: acceleration that a pose may show beyond its prediction, which does not know it
_FASTEST_MPS = 2.0  #: reject: a distance between poses that only a faster vehicle flies
_LARGEST_SI = 1e4  #: reject: a pose with a larger number in any unit, or NaN
_PATIENCE = 3  #: reject: after this many rejections in a row the track is lost, and a new one must be proved
_PROOF = 10  #: reject: a new track of fewer poses that agree
#: reject: a new track that agrees for less time; with the three poses before it is believed before pose_land_s ends the flight
_PROOF_S = 0.4
_GAP_S = 1.0  #: reject: a track that continues the accepted one after a longer time: it counts as a restart of odom


@dataclass(frozen=True, slots=True)
class PoseVerdict:
    """Result for a pose.

    good: accepted. again: it does not continue the last accepted one, because odom itself has jumped.
    """

    good: bool
    again: bool = False
    why: Reason | None = None


class PoseGate:
    """Checks each pose once, in the order in which they arrive. Never raises on numbers."""

    def __init__(self, max_yaw_rate_radps: float) -> None:
        self._max_yaw_rate_radps = 2.0 * max_yaw_rate_radps  # turning is checked at the setpoint; here for plausibility only
        self._accepted: StampedPose | None = None
        self._track: StampedPose | None = None  # the newest of a track that is not accepted yet
        self._agreed = 0
        self._since_s = 0.0
        self._refused = 0

    def judge(self, pose: StampedPose, now_s: float) -> PoseVerdict:
        """Accept a pose, or reject it with a reason."""
        last = self._accepted
        repeated = last is not None and pose.stamp_s <= last.stamp_s
        if fault := _unfit(pose, now_s) or (Reason(ReasonCode.POSE_REPEATED) if repeated else None):
            return self._refuse(fault)
        if last is None or pose.reset_counter != last.reset_counter:
            return self._accept(pose, again=last is not None)
        why = self._leap(last, pose)
        lost = self._refused >= _PATIENCE
        if why is None and not lost:
            return self._accept(pose, again=False)
        return self._prove(pose, why or Reason(ReasonCode.POSE_ON_TRIAL))

    def _prove(self, pose: StampedPose, why: Reason) -> PoseVerdict:
        """Check a pose that does not continue the accepted track.

        It begins or continues another track, which has to last.
        """
        track = self._track
        self._track = pose
        if track is None or pose.stamp_s <= track.stamp_s or self._leap(track, pose):
            self._agreed = 0
            self._since_s = pose.stamp_s
        self._agreed += 1
        if self._agreed >= _PROOF and pose.stamp_s - self._since_s >= _PROOF_S:
            return self._accept(pose, again=not self._continues(pose))
        return self._refuse(why)

    def _continues(self, pose: StampedPose) -> bool:
        """Return True if a proved track is on the way of the accepted one.

        Then poses between them were wrong, and odom has not jumped. The way reaches from the last place of the
        accepted track to where its last velocity leads: the vehicle may have braked.
        """
        last = self._accepted
        if last is None or pose.stamp_s - last.stamp_s > _GAP_S:
            return False
        way_m = last.velocity_odom_mps * (pose.stamp_s - last.stamp_s)
        off_m = pose.odom_from_body.translation_m - last.odom_from_body.translation_m
        share = np.clip(off_m @ way_m / max(float(way_m @ way_m), 1e-9), 0.0, 1.0)
        turn_rad = abs(math.remainder(pose.odom_from_body.yaw_rad() - last.odom_from_body.yaw_rad(), math.tau))
        return math.hypot(*(off_m - share * way_m).tolist()) <= _JUMP_M and turn_rad <= _TURN_RAD

    def _accept(self, pose: StampedPose, again: bool) -> PoseVerdict:
        self._accepted = pose
        self._track = None
        self._refused = 0
        return PoseVerdict(True, again)

    def _refuse(self, why: Reason) -> PoseVerdict:
        self._refused += 1
        return PoseVerdict(False, why=why)

    def _leap(self, last: StampedPose, pose: StampedPose) -> Reason | None:
        """Return the change between two poses that no flight explains, None for nothing."""
        dt_s = pose.stamp_s - last.stamp_s
        way = pose.odom_from_body.translation_m - last.odom_from_body.translation_m
        # a pose near the last one is no jump, whatever velocity that one had
        off_m = min(math.hypot(*(way - last.velocity_odom_mps * dt_s).tolist()), math.hypot(*way.tolist()))
        xx, yy, zz = pose.covariance.diagonal().tolist()[:3]
        sigma_m = math.sqrt(max((xx + yy + zz) / 3.0, 0.0))
        allowed_m = min(max(_JUMP_M, 3.0 * sigma_m), _WIDEST_M)
        if not off_m <= allowed_m + 0.5 * _PUSH_MPS2 * dt_s * dt_s:
            return Reason(ReasonCode.POSE_JUMP, (off_m,))
        if not (way_m := math.hypot(*way.tolist())) <= _FASTEST_MPS * dt_s + allowed_m:
            return Reason(ReasonCode.POSE_SPEED, (way_m, dt_s))
        turn_rad = abs(math.remainder(pose.odom_from_body.yaw_rad() - last.odom_from_body.yaw_rad(), math.tau))
        if not turn_rad <= _TURN_RAD + self._max_yaw_rate_radps * dt_s:
            return Reason(ReasonCode.POSE_TURN, (math.degrees(turn_rad),))
        return None


def _unfit(pose: StampedPose, now_s: float) -> Reason | None:
    """Return the fault of a pose by itself, None for nothing."""
    if not -_FUTURE_S <= now_s - pose.stamp_s <= _MAX_AGE_S:
        return Reason(ReasonCode.POSE_AGE, (now_s - pose.stamp_s,))
    if pose.velocity_odom_mps.shape != (3,) or pose.covariance.shape != (6, 6):
        return Reason(ReasonCode.POSE_MALFORMED)
    if not (
        np.abs(np.hstack((pose.odom_from_body.translation_m, pose.velocity_odom_mps, *pose.covariance))) <= _LARGEST_SI
    ).all():
        return Reason(ReasonCode.POSE_OUT_OF_RANGE)
    return None if pose.quality > 0 else Reason(ReasonCode.POSE_NO_QUALITY)
