"""Odometry of a pose source that the view and the inertial sensors check.

It is fault detection, isolation and exclusion.

Three measurements of the motion: the poses of the source, the tracked images, the inertial samples. If source and view moved
differently, the one that the inertial samples contradict is left out; the view, which many points support, is kept where they
contradict neither. While the source is excluded, the view carries odometry on from before the fault. The source is used again
once it has moved as the view for a while; what lies between then goes into world_from_odom.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from uav_recon.localization.exclusion.motion_comparison import MotionComparison
from uav_recon.localization.exclusion.spike_filter import SpikeFilter
from uav_recon.localization.fusion.error_release import ErrorRelease
from uav_recon.localization.fusion.eskf import PoseNoise
from uav_recon.localization.fusion.filter_pose_gates import PoseRejection, pose_fault
from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.localization.fusion.inertial_check import InertialCheck
from uav_recon.localization.slam.view_odometry import ViewOdometry
from uav_recon.types.camera import ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_RESTS_S = 4.0  #: internal: time that the view has at first to begin at rest on the pad
_LOST_S = 1.0  #: internal: a view without a pose for longer begins again beside the source
_IN_A_ROW = 2  #: reject: number of comparisons in a row that must show a fault of the source
_RIGHT_SHARE = 0.6  #: reject: an excluded source until its ways differ by less, as a share of the limit ...
_RIGHT_S = 3.0  #: reject: ... for this time, which doubles with each exclusion
#: land: the view confirms a source whose way over the long window differs by less, as a share of its limit (0.15 m in 8 s)
_CONFIRMED_SHARE = 0.5
_MOST_EXCLUSIONS = 6  #: internal: exclusions up to which it doubles
#: reject: the source, if the ways differ by this share of the limit and the inertial samples contradict neither: honest ones
#: differ by up to 1.3, where the tracked images are off
_ALONE_SHARE = 2.0
#: reject: the view, if the inertial samples contradict it by this share of the limit, and ...
_ONE_SHARE = 0.4
_ONE_FACTOR = 2.0  #: reject: ... by this factor more than the source; and the source in the same way
#: reject: nothing but the accelerometer, if it contradicts the view by this share of the limit, and ...
_BOTH_SHARE = 0.5
_BOTH_FACTOR = 0.5  #: reject: ... by more than this share of its contradiction to the source
_CHECKED_S = 1.2  #: reject: no source, unless the view was compared with the inertial samples within this time
_LEFT_M = 0.05  #: retreat: while more than this of the error is not yet out of odometry, the place is uncertain
#: reject: no source for this time after a part of the view moved, and by nothing from before: it may move the track
_MOVED_S = 1.0
_ONSET_S = 0.6  #: internal: time before its detection at which a fault had not begun
_EVERYTHING: FloatArray = np.eye(3)


class CheckedOdometry:
    """Estimator with a pose source, and with the view in its place while that is excluded.

    Not thread-safe. view: in its tracker's frame. ``confirmed_s``: instant at which the view has last confirmed the source over
    the long window, -inf before.
    """

    def __init__(self, source: FusionFilter, view: ViewOdometry) -> None:
        self._source = source
        self._view = view
        self._comparison = MotionComparison()
        self._spikes = SpikeFilter()
        self._check = InertialCheck(view.tracker.gyro.at)
        self._source_resets = 0
        self._row = self._exclusions = 0
        self._judged_s = -math.inf  # newest comparison that was judged
        self.confirmed_s = -math.inf
        self._restarted_s = math.nan  # before the first call
        self._excluded = self._drifted = self._view_at_fault = False
        self._view_right_since_s = math.inf
        self._right_since_s = math.inf
        self._switched_s = math.inf
        self._odom_from_tracker = Pose.identity()
        self._release = ErrorRelease()
        self._resets = 0  # added to the counter of the view, while it is used
        self._last: StampedPose | None = None  # the newest pose of the source

    @property
    def newest_pose_s(self) -> float:
        """Stamp of the newest pose that is used; -inf before the first."""
        return self._view.newest_pose_s if self._excluded else self._source.newest_pose_s

    @property
    def source_excluded(self) -> bool:
        """True while the view is used in place of the source."""
        return self._excluded

    @property
    def rejected(self) -> Mapping[PoseRejection, int]:
        """Counts of rejected poses and inertial samples."""
        return self._source.rejected

    def add_imu(self, samples: list[ImuSample], now_s: float) -> None:
        """Add inertial samples, oldest first."""
        self._source.add_imu(samples, now_s)
        self._view.add_imu(samples, now_s)

    def add_pose(self, pose: StampedPose, now_s: float) -> bool:
        """Fuse a pose of the source at its own stamp.

        Return False if it is rejected, or the source excluded.
        """
        if pose_fault(pose, now_s) is None:
            self._compare_source(pose, now_s)
        if not self._excluded:
            return self._source.add_pose(pose, now_s)
        self._source.rejected[PoseRejection.EXCLUDED] += 1
        return False

    def add_view(self, now_s: float) -> None:
        """Compare what the view has shown since the last call."""
        pose = self._view.newest_pose
        self._restart_view(now_s)
        if pose is not None and self._comparison.add_second(pose.stamp_s, pose.odom_from_body, self._view.shown):
            self._judge(now_s)

    def _restart_view(self, now_s: float) -> None:
        """Let a view that is lost begin again beside a source that is right."""
        if math.isnan(self._restarted_s):
            self._restarted_s = now_s + _RESTS_S
        if self._excluded or now_s - max(self._view.newest_pose_s, self._restarted_s) < _LOST_S:
            return
        odom = self._source.odom_at(now_s)
        if odom is not None and odom.health is PoseHealth.GOOD:
            self._restarted_s = now_s
            self._view.restart(self._source.odom_at)
            self._comparison.forget()

    def odom_at(self, stamp_s: float) -> StampedPose | None:
        """Return the body's pose at an instant, None if it is not known."""
        if not self._excluded or stamp_s < self._switched_s:
            return self._source.odom_at(stamp_s)
        seen = self._view.odom_at(stamp_s)
        if seen is None:
            return None
        here, good = seen.moved(self._odom_from_tracker), seen.health is PoseHealth.GOOD
        pose, left_m = here.odom_from_body, self._release.left_m(stamp_s)
        off_m = float(np.linalg.norm(left_m))
        why = Reason(ReasonCode.PLACE_UNSURE, (off_m,)) if off_m > _LEFT_M else Reason(ReasonCode.SOURCE_EXCLUDED)
        return replace(
            here,
            odom_from_body=Pose(pose.quat_wxyz, pose.translation_m + left_m),
            reset_counter=(seen.reset_counter + self._resets) % 256,
            map_epoch=0 if self._last is None else self._last.map_epoch,
            health=PoseHealth.DEGRADED if good else seen.health,
            health_reason=why if good else seen.health_reason,
            correction=self._source.correction,
        )

    def _compare_source(self, pose: StampedPose, now_s: float) -> None:
        if pose.reset_counter != self._source_resets:  # the source says that it starts again
            self._source_resets = pose.reset_counter
            self._comparison.forget()
            self._check.forget()
            self._spikes.forget()
            self._row = 0
        self._last = pose
        for each in self._spikes.passed(pose):
            noise_m = math.sqrt(PoseNoise.claimed(each.covariance).position_m2)
            self._check.update(each.stamp_s, each.odom_from_body, _EVERYTHING, noise_m)
            if self._comparison.add_first(each.stamp_s, each.odom_from_body):
                self._judge(now_s)

    def _judge(self, now_s: float) -> None:
        """Exclude the source, or use it again, after a comparison."""
        excess, drift = self._comparison.excess, self._comparison.drift_excess
        self._source.exclude_accelerometer(self._accelerometer_at_fault and excess <= 1.0)
        if self._check.accelerometer.fault and not self._excluded:
            self._view.tracker.accelerometer_used = False
        if self._excluded:
            drifts = self._drifted and not drift < _RIGHT_SHARE
            right = excess < _RIGHT_SHARE and not drifts
            self._right_since_s = min(self._right_since_s, self._comparison.compared_s) if right else math.inf
            if self._comparison.compared_s - self._right_since_s >= _RIGHT_S * 2 ** (self._exclusions - 1):
                self._include(now_s)
            return
        if self._comparison.compared_s - self._view.moved_s <= _MOVED_S:
            self._row = 0
            self._comparison.forget()
            return
        self._judge_view(excess)
        if self._comparison.compared_s == self._judged_s:
            return
        self._judged_s = self._comparison.compared_s
        unchecked = self._view.newest_pose_s - self._view.check.judged_s > _CHECKED_S
        suspect = self._view_at_fault or self._inertial_at_fault or unchecked or not self._view.sure
        limit = 1.0 if _blamed(self._check, self._view.check) else _ALONE_SHARE
        self.confirmed_s = self._judged_s if drift < _CONFIRMED_SHARE and self._view.sure else self.confirmed_s
        apart = excess > limit or drift > 1.0
        self._row = self._row + 1 if apart and not suspect else 0
        if self._row >= _IN_A_ROW:
            self._drifted = not excess > limit
            self._exclude(now_s)

    @property
    def _accelerometer_at_fault(self) -> bool:
        return self._view.check.accelerometer.fault or self._check.accelerometer.fault

    @property
    def _inertial_at_fault(self) -> bool:
        """True if the inertial samples contradict the view and the source alike."""
        seen, said = self._view.check.accelerometer.excess, self._check.accelerometer.excess
        return seen > max(_BOTH_SHARE, _BOTH_FACTOR * said)

    def _judge_view(self, excess: float) -> None:
        """Judge the view: the inertial samples contradict it, or it has been right for a while."""
        compared_s = self._comparison.compared_s
        self._view_at_fault |= excess > 1.0 and _blamed(self._view.check, self._check)
        self._view_right_since_s = min(self._view_right_since_s, compared_s) if excess < _RIGHT_SHARE else math.inf
        self._view_at_fault &= compared_s - self._view_right_since_s < _RIGHT_S

    def _exclude(self, now_s: float) -> None:
        """Go on by the view, from where both were before the fault."""
        onset_s = self._comparison.compared_s - _ONSET_S
        before, there = self._source.odom_at(onset_s), self._view.odom_at(onset_s)
        shown, seen = self._source.odom_at(now_s), self._view.odom_at(now_s)
        if before is None or there is None or shown is None or seen is None:
            return
        self._odom_from_tracker = before.odom_from_body @ there.odom_from_body.inverse()
        here = self._odom_from_tracker @ seen.odom_from_body
        self._release.begin(now_s, shown.odom_from_body.translation_m - here.translation_m)
        self._resets = (shown.reset_counter - seen.reset_counter) % 256
        self._switched_s = now_s
        self._excluded, self._right_since_s, self._row = True, math.inf, 0
        self._exclusions = min(self._exclusions + 1, _MOST_EXCLUSIONS)

    def _include(self, now_s: float) -> None:
        """Use the source again, from where odometry is by the view."""
        pose = self._last
        odom = None if pose is None else self.odom_at(pose.stamp_s)
        if pose is None or odom is None or not self._source.rejoin(pose, odom):
            return
        self._excluded, self._row = False, 0
        self._comparison.forget()


def _blamed(one: InertialCheck, other: InertialCheck) -> bool:
    """Return True if the inertial samples contradict one track, and clearly less the other one."""
    return one.accelerometer.excess > max(_ONE_SHARE, _ONE_FACTOR * other.accelerometer.excess)
