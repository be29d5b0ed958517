"""Correction of odom by a tracker that registers each frame to its own map.

A pose source may drift. The embedded SLAM runs beside it and sees the drift against the surfaces and corners seen before; where
the view does not determine the motion, it follows the source. What the errors of tracker and camera may explain is not
corrected: odom of an honest source stays as it is.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from uav_recon.config import LocalizationConfig
from uav_recon.localization.correction.offset_filter import OFFSET, RATE, YAW, OffsetFilter
from uav_recon.localization.correction.revisited_surfaces import RevisitedSurfaces, Wandered
from uav_recon.localization.flow.measured_motion import MeasuredMotion
from uav_recon.localization.slam import slam_tracker
from uav_recon.localization.slam.gyro_alignment import GyroAlignment
from uav_recon.localization.slam.outside_motion import OutsideMotion
from uav_recon.localization.slam.slam_tracker import SlamTracker
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose, WorldFromOdom
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

#: internal: an offset within this many standard deviations, which contain what tracker and camera may be off by, is left alone
_EXPLAINED_SIGMAS = 3.0
_CONFIRMED_SIGMAS = 1.5  #: internal: the same after depth has confirmed a drift: then the source is surely not honest
_CONFIRMED_S = 20.0  #: internal: time for which that holds
_SPEED_MPS = 0.3  #: brake: the correction of odom moves at most this fast: a vehicle follows it
_TURN_RADPS = math.radians(5.0)  #: brake: the correction of the heading turns at most this fast
_EVERY_S = 0.2  #: internal: interval between two comparisons of odom with the tracker
_TIMELY_S = 1.0  #: land: a drift that depth shows is known to the correction if its newest comparison is not older
_KEPT_S = 2.0  #: internal: past corrections are kept for this time, as odom is
_REPORTED_M = 0.02  #: internal: a smaller correction is not reported, unless it turns by more than _REPORTED_RAD
_REPORTED_RAD = math.radians(0.5)  #: internal: see _REPORTED_M
_STEP_M = 0.003  # standard deviation of a step of odom
_STEP_JITTER_S = 0.005  # the same of the time between its poses, against that between the frames
_STEP_DRIFT_MPS = 0.05
_SPEED_OVER_S = 0.3  #: internal: time over which the speed of the correction is measured


class OdometryCorrection(Protocol):
    """Corrects odom, for any recent instant.

    ``reason``: how much is corrected, None for nothing.
    """

    @property
    def reason(self) -> Reason | None:
        """The size of the correction, None for nothing."""
        ...

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Add inertial samples, oldest first. Does not block."""
        ...

    def add_frame(self, frame: Frame, body_from_depth: Pose) -> None:
        """Add a frame once odom knows its instant. May take 10 ms."""
        ...

    def advance(self, now_s: float, confirms: Callable[[FloatArray], bool]) -> None:
        """Move the correction towards what it shall be; called every step.

        confirms(drift_mps (3,)): whether depth surely shows this drift of odom, by another method.
        """
        ...

    def corrected(self, estimate: StampedPose) -> StampedPose:
        """Return odom at its stamp with the correction of that instant."""
        ...

    def registered(self, estimate: StampedPose) -> StampedPose:
        """Return odom as the tracker's map has it, whether it is corrected or not."""
        ...

    def drift_mps(self, now_s: float) -> FloatArray:
        """Return the drift (3,) of odom against that map, in odom axes; zero if none is known."""
        ...


class NoCorrection:
    """Odom as it is: of poses that come from the frames themselves."""

    reason: Reason | None = None

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Do nothing."""

    def add_frame(self, frame: Frame, body_from_depth: Pose) -> None:
        """Do nothing."""

    def advance(self, now_s: float, confirms: Callable[[FloatArray], bool]) -> None:
        """Do nothing."""

    def corrected(self, estimate: StampedPose) -> StampedPose:
        """Return odom as it is."""
        return estimate

    def registered(self, estimate: StampedPose) -> StampedPose:
        """Return odom as it is."""
        return estimate

    def drift_mps(self, now_s: float) -> FloatArray:
        """Return zero: nothing is known."""
        return np.zeros(3)


def corrects_drift(config: LocalizationConfig) -> bool:
    """Return whether a tracker runs beside the pose source.

    The poses of the embedded SLAM are those of the tracker.
    """
    return config.correct_drift and config.source != "slam"


def correction_of(config: LocalizationConfig, odom_at: Callable[[float], StampedPose | None]) -> OdometryCorrection:
    """Return the correction that a config asks for, with its kernels compiled.

    odom_at: odom without correction at an instant.
    """
    if not corrects_drift(config):
        return NoCorrection()
    slam_tracker.warm_up()
    return TrackedCorrection(odom_at)


class ReferenceTracker(Protocol):
    """Tracks frames against a map of its own.

    ``determined`` (3, 3): share of the newest place that the view has determined, in the tracker's axes.
    """

    determined: FloatArray

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Add inertial samples, oldest first."""
        ...

    def track(self, frame: Frame, body_from_depth: Pose) -> StampedPose | None:
        """Return the body's pose at what the frame shows; None if it is not known."""
        ...


class _Knot(NamedTuple):
    """The correction at an instant.

    shift_m (3,): of a body that is at pivot_m (3,) in odom. yaw_rad: of its heading.
    """

    stamp_s: float
    shift_m: FloatArray
    yaw_rad: float
    pivot_m: FloatArray

    @property
    def active(self) -> bool:
        """True if anything is corrected."""
        return bool(self.shift_m.any() or self.yaw_rad)

    def pose(self) -> Pose:
        """Return corrected_from_odom."""
        turn = Pose.from_yaw(self.yaw_rad, np.zeros(3))
        return Pose(turn.quat_wxyz, self.pivot_m + self.shift_m - turn.apply(self.pivot_m))

    def at(self, place_m: FloatArray) -> FloatArray:
        """Return the shift (3,) of a body at another place in odom."""
        return np.asarray(self.pose().apply(place_m) - place_m)


class TrackedCorrection:
    """A tracker, and the correction that follows from its difference to odom.

    Not thread-safe; about 9 ms a frame. odom_at: odom without correction at an instant. make_tracker: of a tracker that asks
    for the motion by odom.
    """

    def __init__(
        self,
        odom_at: Callable[[float], StampedPose | None],
        make_tracker: Callable[[OutsideMotion], ReferenceTracker] = SlamTracker,
    ) -> None:
        self._odom_at = odom_at
        self._tracker = make_tracker(self)
        self._filter: OffsetFilter | None = None
        self._surfaces = RevisitedSurfaces()
        self._odom_from_tracker = Pose.identity()
        self._reset_counter = 0
        self._compared_s = self._confirmed_s = -math.inf
        self._knots: deque[_Knot] = deque([_Knot(-math.inf, np.zeros(3), 0.0, np.zeros(3))])

    @property
    def reason(self) -> Reason | None:
        """The size of the correction, None for nothing."""
        knot = self._knots[-1]
        shift_m = float(np.linalg.norm(knot.shift_m))
        if self._filter is None or (shift_m < _REPORTED_M and abs(knot.yaw_rad) < _REPORTED_RAD):
            return None
        sigma_m = math.sqrt(float(np.trace(self._filter.covariance[OFFSET, OFFSET])))
        return Reason(ReasonCode.ODOMETRY_CORRECTED, (shift_m, math.degrees(knot.yaw_rad), sigma_m))

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Add inertial samples, oldest first."""
        self._tracker.add_imu(samples)

    def add_frame(self, frame: Frame, body_from_depth: Pose) -> None:
        """Register a frame, and compare odom with it."""
        tracked = self._tracker.track(frame, body_from_depth)
        odom = None if tracked is None else self._valid_odom(tracked.stamp_s)
        if tracked is None or odom is None:
            return
        if self._filter is None or odom.reset_counter != self._reset_counter:
            self._begin(odom, tracked)
            return
        if tracked.stamp_s - self._compared_s < _EVERY_S:
            return
        there = self._odom_from_tracker @ tracked.odom_from_body
        turn = self._odom_from_tracker.rotation()
        self._filter.update(odom.odom_from_body, there, turn @ self._tracker.determined @ turn.T, tracked.stamp_s)
        wandered = Wandered(*self._filter.wander)
        then = self._surfaces.look(frame, there @ body_from_depth, self._filter.way_m, wandered)
        if then is not None:
            self._filter.revisit(*then)
        self._compared_s = tracked.stamp_s

    def advance(self, now_s: float, confirms: Callable[[FloatArray], bool]) -> None:
        """Move the correction towards the offset, as far as tracker and camera do not explain it."""
        knot = self._knots[-1]
        if self._filter is None or now_s <= knot.stamp_s:
            return
        if confirms(self.drift_mps(now_s)):
            self._confirmed_s = now_s
        shift_m, yaw_rad = self._wanted(now_s)
        if not (shift_m.any() or yaw_rad or knot.active):
            self._add_knot(_Knot(now_s, np.zeros(3), 0.0, np.zeros(3)))
            return
        odom = self._odom_at(now_s)
        if odom is None:
            return
        step_s = min(now_s - knot.stamp_s, _EVERY_S)
        place_m = odom.odom_from_body.translation_m
        before_m = knot.at(place_m)
        way_m = shift_m - before_m
        share = min(1.0, _SPEED_MPS * step_s / max(float(np.linalg.norm(way_m)), 1e-9))
        turn_rad = float(np.clip(yaw_rad - knot.yaw_rad, -_TURN_RADPS * step_s, _TURN_RADPS * step_s))
        self._add_knot(_Knot(now_s, before_m + share * way_m, knot.yaw_rad + turn_rad, place_m))

    def _add_knot(self, knot: _Knot) -> None:
        self._knots.append(knot)
        while len(self._knots) > 2 and self._knots[1].stamp_s < knot.stamp_s - _KEPT_S:
            self._knots.popleft()

    def corrected(self, estimate: StampedPose) -> StampedPose:
        """Return odom at its stamp with the correction of that instant."""
        knot = self._knot(estimate.stamp_s)
        if self._filter is None or not (knot.active or self._knots[-1].active):
            return estimate
        by = knot.pose()
        place_m, before = estimate.odom_from_body.translation_m, self._knot(estimate.stamp_s - _SPEED_OVER_S)
        speed_mps = np.zeros(3)
        if math.isfinite(before.stamp_s) and knot.stamp_s > before.stamp_s:
            speed_mps = (by.apply(place_m) - before.pose().apply(place_m)) / (knot.stamp_s - before.stamp_s)
        world = estimate.correction
        return replace(
            estimate,
            odom_from_body=by @ estimate.odom_from_body,
            velocity_odom_mps=by.rotation() @ estimate.velocity_odom_mps + speed_mps,
            correction=WorldFromOdom(world.world_from_odom @ by.inverse(), world.epoch),
        )

    def registered(self, estimate: StampedPose) -> StampedPose:
        """Return odom as the tracker's map has it, whether it is corrected or not."""
        if self._filter is None:
            return estimate
        place_m, state = estimate.odom_from_body.translation_m, self._filter.state
        shift_m = state[OFFSET] - self.drift_mps(estimate.stamp_s) * (estimate.stamp_s - self._compared_s)
        return replace(
            estimate,
            odom_from_body=_Knot(estimate.stamp_s, shift_m, float(state[YAW]), place_m).pose() @ estimate.odom_from_body,
        )

    def drift_mps(self, now_s: float) -> FloatArray:
        """Return the drift (3,) of odom against that map, in odom axes; zero if none is known."""
        if self._filter is None or now_s - self._compared_s > _TIMELY_S:
            return np.zeros(3)
        return -self._filter.state[RATE]

    def _knot(self, stamp_s: float) -> _Knot:
        return next((knot for knot in reversed(self._knots) if knot.stamp_s <= stamp_s), self._knots[0])

    def _wanted(self, now_s: float) -> tuple[FloatArray, float]:
        """Return shift (3,) and heading of the correction: the offset as far as it is sure."""
        assert self._filter is not None
        sigmas = _CONFIRMED_SIGMAS if now_s - self._confirmed_s < _CONFIRMED_S else _EXPLAINED_SIGMAS
        shift_m, spread = self._filter.state[OFFSET], self._filter.covariance
        surprise = self._filter.surprise
        yaw_rad = float(self._filter.state[YAW])
        return shift_m * _sure(surprise, sigmas), yaw_rad * _sure(yaw_rad**2 / max(float(spread[YAW, YAW]), 1e-12), sigmas)

    def _begin(self, odom: StampedPose, tracked: StampedPose) -> None:
        self._odom_from_tracker = odom.odom_from_body @ tracked.odom_from_body.inverse()
        self._filter = OffsetFilter(odom.odom_from_body, tracked.stamp_s)
        self._surfaces = RevisitedSurfaces()
        self._compared_s = tracked.stamp_s
        self._reset_counter = odom.reset_counter
        self._knots = deque([_Knot(-math.inf, np.zeros(3), 0.0, np.zeros(3))])

    def _valid_odom(self, stamp_s: float) -> StampedPose | None:
        odom = self._odom_at(stamp_s)
        return None if odom is None or odom.quality == 0 else odom

    def moved(self, from_s: float, to_s: float, odom_from_body: Pose) -> MeasuredMotion | None:
        """Return the way of the body between two instants, None if odom does not know it.

        odom_from_body: attitude at the first one, in the tracker's odom. A drift that is sure is taken out.
        """
        both = self._both(from_s, to_s)
        if both is None:
            return None
        before, moved = both[0].odom_from_body, both[0].odom_from_body.inverse() @ both[1].odom_from_body
        step_s = to_s - from_s
        drifted_m = self.drift_mps(to_s) * step_s * self._acts
        way_m = odom_from_body.rotation() @ (moved.translation_m - before.rotation().T @ drifted_m)
        speed_mps = float(np.linalg.norm(way_m)) / step_s
        sigma_m = math.hypot(_STEP_M, _STEP_JITTER_S * speed_mps, _STEP_DRIFT_MPS * step_s)
        return MeasuredMotion(way_m, sigma_m**2 * np.eye(3))

    def turned(self, from_s: float, to_s: float) -> FloatArray | None:
        """Return the turn (3,) of the body between two instants, None if odom does not know it."""
        both = self._both(from_s, to_s)
        return None if both is None else (both[0].odom_from_body.inverse() @ both[1].odom_from_body).rotation_vector()

    def _both(self, from_s: float, to_s: float) -> tuple[StampedPose, StampedPose] | None:
        """Return odom at two instants, None if it has begun again between them."""
        before, after = self._valid_odom(from_s), self._valid_odom(to_s)
        if before is None or after is None or before.reset_counter != after.reset_counter:
            return None
        return before, after

    def begin(self, gyro: GyroAlignment) -> None:
        """Do nothing: odom knows the turns of the body."""

    def show(self, stamp_s: float, odom_from_body: Pose, sigma_m: float) -> None:
        """Do nothing: odom is compared with the tracker in add_frame()."""

    @property
    def _acts(self) -> bool:
        """True if odom surely drifts."""
        return self._filter is not None and self._filter.surprise > _EXPLAINED_SIGMAS**2

    def attitude(self, stamp_s: float) -> Pose | None:
        """Return the attitude of the body in the tracker's odom, None if odom does not know it."""
        odom = self._valid_odom(stamp_s) if self._filter is not None else None
        if odom is None or odom.reset_counter != self._reset_counter:
            return None
        return self._odom_from_tracker.inverse() @ odom.odom_from_body


def _sure(surprise: float, sigmas: float) -> float:
    """Return the share of an offset of a squared surprise that is corrected."""
    return max(0.0, 1.0 - sigmas**2 / max(surprise, 1e-9))
