"""RGB-D-inertial tracker: the pose of each frame against a map of its own.

Depth is registered to the surfaces of keyframes, corners of the colour image to their landmarks, and both to the motion that
the inertial samples predict, in one Gauss-Newton problem. The errors of body and keyframes are estimated jointly, so a keyframe
that comes into view again corrects the drift since. A frame that is not accepted changes nothing: the inertial samples alone
carry the track on.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace

import numpy as np

from uav_recon.localization.repeated_image import FROZEN_S, RepeatedImage
from uav_recon.localization.slam.attitude_filter import AttitudeFilter, PredictedAttitude
from uav_recon.localization.slam.gyro_alignment import JITTER_S, GyroAlignment
from uav_recon.localization.slam.keyframe_map import KeyframeMap, no_keyframes
from uav_recon.localization.slam.landmarks import Landmarks
from uav_recon.localization.slam.motion_filter import MotionFilter, PredictedMotion
from uav_recon.localization.slam.outside_motion import NoOutsideMotion, OutsideMotion
from uav_recon.localization.slam.place_doubt import LONG_WAY_BACK_S, PlaceDoubt
from uav_recon.localization.slam.place_errors import Update
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.localization.slam.rest_detection import STILL_S
from uav_recon.localization.slam.rgbd_registration import (
    MotionPrior,
    Registration,
    confirm,
    register,
    search,
    uncertain,
)
from uav_recon.localization.slam.track_start import OdomAt, StartDetector
from uav_recon.localization.slam.tracking_monitor import TrackingFault, TrackingMonitor
from uav_recon.types.camera import Frame, ImuSample, Intrinsics, body_from_camera
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, PoseHealth, StampedPose

_BLIND_TURN_RADPS = math.radians(30.0)  # uncertainty of the turn rate without a gyro
_AT_REST = 1e-4**2 * np.eye(3)  # covariance of the attitude
_FIRST_SLOW_SIGMA = np.array([0.012, 0.006])  # delay of the colour image (s), share of its width
_SLOW_WALK = np.array([0.0005, 0.0002])  # per root second
_SLOW_FLOOR = np.array([0.001, 0.0005])
_CARRIED_FRAMES = 8  # frames in a row that must be accepted before an uncertain track counts as carried on
_MAP_FRAMES = 3  # frames in a row that must be accepted before the map grows again
_PROOF_FRAMES = 2  # frames that must be accepted after doubt until poses are given again
_VIEWLESS = (TrackingFault.FEW_POINTS, TrackingFault.FROZEN)  # frames that show nothing, which is no doubt of the track
_ACCEPTED = (None, TrackingFault.LOOSE, TrackingFault.DEPTH, TrackingFault.UNPROVEN)
_BRIEF_GAP_S = 0.5  #: reject: frames after a longer time without an accepted one raise doubt, whatever was wrong
_SEARCHED = (TrackingFault.FIT, TrackingFault.STEP, TrackingFault.TURN)
_SEARCH_SIGMAS = 3.0  # reach of the search, in standard deviations of the predicted place
_LEAST_SEARCH_M = 0.05
_MOST_SEARCH_M = 0.5
_SEARCH_EVERY = 3  # frames between searches of the map while the place is not sure
_AGREEING_SEARCHES = 3  # searches in a row that must find the same place
_OLD_SHARE = 0.25  # of the variance of the track, up to which a surface is one from before
_SAME_M = 0.04  # between two registrations of the same place
_ALIKE_SHARE = 0.95  # of the match of a place: if another reaches it, the view does not tell them apart
_UNSURE_M = 0.06  # standard deviation of a place that is not sure
#: reject: the frame before, if this one contradicts it, and surprises the track without it by less than this share of its own
_LESS_SURPRISED_SHARE = 0.5
_BETTER = 1.02  # share of inliers by which another place must be better
#: reject: after doubt, a frame with fewer of its depth points on known surfaces and fewer known landmarks than below
_PROOF_SHARE = 0.4
_PROOF_LANDMARKS = 20  #: reject: after doubt, a frame with fewer of the landmarks from before, and less known depth than above
_OUTSIDE_TURN_RAD = math.radians(0.3)
_OUTSIDE_HEADING_RAD = math.radians(3.0)  # of a heading: weak, so that the view decides where it can
_HEADING_SURPRISE = 25.0  # squared innovation of a heading, in standard deviations, beyond which it is not used
_POSITION_SIGMA_M = 0.01
_SCALE_SHARE = 0.01  # standard deviation of the depth scale: the whole map is as much too large
_PLACED_M = 0.01  # error of a surface or a landmark against the camera, from the errors of its calibration
_ROTATION_SIGMA_RAD = math.radians(0.3)
_STARTED_MOVING = _ROTATION_SIGMA_RAD**2 * np.eye(3)
_LAG_S = 1.0  # between the places of which the older one is that of the track


@dataclass(frozen=True, slots=True, eq=False)
class TrackedState:
    """The newest accepted frame.

    stamp_s: of the frame. odom_from_body. velocity_mps (3,) in odom.
    """

    stamp_s: float
    odom_from_body: Pose
    velocity_mps: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TrackerState:
    """The estimate at what the newest frame shows, accepted or not.

    stamp_s: of what the frame shows. motion: in odom, with the found error that is not released yet. odom_from_body: attitude;
    its translation has no meaning.
    """

    stamp_s: float
    motion: PredictedMotion
    odom_from_body: Pose


@dataclass(frozen=True, slots=True, eq=False)
class _WithoutFrame:
    """The track at an accepted frame, as if it had not been accepted.

    surprise: squared innovation of the frame's place, in standard deviations. moved_m (N, 3): by which the frame has corrected
    the places of the keyframes. update: that of their covariance.
    """

    state: TrackedState
    motion: MotionFilter
    attitude: AttitudeFilter
    surprise: float
    moved_m: FloatArray
    update: Update


class SlamTracker:
    """Tracks the camera. Not thread-safe; about 8 ms a frame of 424x240 on one core.

    It starts at rest: the first poses come once the inertial samples have shown where down is. ``fault``: why the newest frame
    was not accepted, None if it was.

    outside: another source of the body's motion, which the track follows where the view does not determine it.
    ``determined`` (3, 3): share of the newest place, in odom axes, that the view has determined and not the prediction.
    ``step_sigma_m``: standard deviation of the newest place against the track, in its worst direction.
    ``moved_outside_s``: instant to which the other source has last known the motion.
    """

    def __init__(self, outside: OutsideMotion | None = None) -> None:
        self._outside = outside or NoOutsideMotion()
        self.surfaces = KeyframeMap()
        self.gyro = GyroAlignment()
        self._outside.begin(self.gyro)
        self.fault: TrackingFault | None = None
        self.determined = np.eye(3)
        self.step_sigma_m = 0.0
        self.moved_outside_s = -math.inf
        self._begin = StartDetector()
        self._compared = no_keyframes(), Landmarks.none()  # keyframes of the newest frame, and their landmarks in it
        self._monitor = TrackingMonitor()
        self._state: TrackedState | None = None
        self._motion = MotionFilter(Pose.identity(), np.zeros(3))
        self._attitude = AttitudeFilter(Pose.identity(), _AT_REST)
        self._turned = self._attitude.predict(np.zeros(3), 0.0, np.zeros(3), 0.0)
        self._predicted = self._motion.predict(0.0, Pose.identity(), None)
        self._without_frame: _WithoutFrame | None = None  # the newest accepted one
        self._accepted_frames = 0
        self._doubt = PlaceDoubt()
        self._unproven = 0
        self._accepted_s = -math.inf
        self._images = RepeatedImage()
        self._slow = np.zeros(2)
        self._slow_covariance = np.diag(_FIRST_SLOW_SIGMA**2)
        self._lag_s = -math.inf
        self._frames = self._agreeing = 0
        self._moved_m = np.zeros(3)

    @property
    def delay_s(self) -> float:
        """Time from what a frame shows to its stamp."""
        return self.gyro.delay_s

    @property
    def state(self) -> TrackerState | None:
        """The estimate at the newest frame; None before the first."""
        if self._state is None:
            return None
        motion = self._motion.now_against_lag.shifted(self._doubt.unreleased_m)
        return TrackerState(self._state.stamp_s - self.delay_s, motion, self._attitude.odom_from_body)

    @property
    def sure(self) -> bool:
        """True if the newest accepted frame has shown the place.

        What is not released yet does not count.
        """
        return not self._doubt.unsure

    @property
    def accelerometer_used(self) -> bool:
        """True unless the images have contradicted the accelerometer."""
        return self._motion.accelerometer_used

    @accelerometer_used.setter
    def accelerometer_used(self, used: bool) -> None:
        self._motion.accelerometer_used = used

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Add inertial samples, oldest first."""
        self.gyro.add(samples)
        self._begin.add_imu(samples)

    def track(self, frame: Frame, body_from_depth: Pose, still: Frame | None = None) -> StampedPose | None:
        """Return the body's pose at what the frame shows; None if it is not known.

        still: the frame without the parts that move, if there are any.
        """
        view = PreparedView(frame if still is None else still)
        if self._state is None or self._begin.starts_again(frame.stamp_s, self._state.odom_from_body.translation_m):
            return self._start(view, body_from_depth)
        if not frame.stamp_s > self._state.stamp_s:
            self.fault = TrackingFault.STAMP
            return None
        repeats_s = self._images.repeats_s(frame.stamp_s, frame.depth_m)
        if 0.0 < repeats_s <= FROZEN_S and not self._begin.still(frame.stamp_s):
            self.fault = TrackingFault.REPEAT
            return None
        prior = self._predict(self._state, frame.stamp_s, body_from_depth)
        found = self._registered(view, prior)
        if self._rests(frame.stamp_s, found, prior):
            return self._stay(view, self._state, body_from_depth)
        found, prior = self._after_rest(view, found, prior, body_from_depth)
        frozen = repeats_s > FROZEN_S
        self.fault = TrackingFault.FROZEN if frozen else self._monitor.fault(found, prior)
        if self.fault in _SEARCHED:
            found, prior = self._without_frame_before(view, found, prior, body_from_depth)
        if self.fault in _SEARCHED and self.accelerometer_used:
            found, prior = self._without_accelerometer(view, self._state, found, prior, body_from_depth)
        if self.fault in _SEARCHED or (self._unproven and not frozen):
            found = self._search(view, found, prior)
            self.fault = self._monitor.fault(found, prior)
        if self.fault is None and self._unproven and not _proves(found):
            self.fault = TrackingFault.UNPROVEN
        if self.fault not in _ACCEPTED:
            self._coast(self._state, prior, frame.stamp_s, body_from_depth)
            return None
        found = self._search_map(view, found, prior)
        self._settle(view, found, prior, self._state, body_from_depth)
        return self._pose(frame.stamp_s, found)

    def _registered(self, view: PreparedView, prior: MotionPrior) -> Registration:
        """Return the registration of a view.

        Where the way to a keyframe is too uncertain, it counts only if landmarks and depth both confirm it, or depth fits
        nowhere else: alone, either may fit at a wrong place.
        """
        motion = np.concatenate((prior.rate_radps, prior.velocity_mps))
        keyframes, landmarks = self._compared = self.surfaces.near_view(view, prior.odom_from_depth, motion, self._slow)
        found, doubtful = register(view, keyframes, landmarks, prior), uncertain(keyframes, prior)
        if not doubtful.any() or found.confirmed(landmarks, doubtful):
            return found
        there = self._confirmed(view, found.odom_from_depth, prior) if found.determined else None
        if there is not None:
            return there
        if self._is_only_place(view, found, prior):
            return found
        return register(view, keyframes, landmarks, prior, doubted=True)

    def _confirmed(self, view: PreparedView, odom_from_depth: Pose, prior: MotionPrior) -> Registration | None:
        """Return the registration of a view from another pose.

        With the landmarks that it shows from there.
        None if these and depth do not both fit.
        """
        motion = np.concatenate((prior.rate_radps, prior.velocity_mps))
        compared = self.surfaces.near_view(view, odom_from_depth, motion, self._slow)
        found = confirm(view, *compared, prior, odom_from_depth.translation_m)
        self._compared = self._compared if found is None else compared
        return found

    def _is_only_place(self, view: PreparedView, registration: Registration, prior: MotionPrior) -> bool:
        """Return True if depth fits at the place of a registration, and nowhere else.

        Elsewhere means where the view may be.
        """
        if not registration.determined or _SEARCH_SIGMAS * math.sqrt(float(prior.variance.max())) > _MOST_SEARCH_M:
            return False
        other, next_best = search(view, self.surfaces, prior, _reach_m(prior))
        off_m = other.odom_from_depth.translation_m - registration.odom_from_depth.translation_m
        return next_best < _ALIKE_SHARE and float(np.linalg.norm(off_m)) < _SAME_M

    def _without_frame_before(
        self,
        view: PreparedView,
        registration: Registration,
        prior: MotionPrior,
        body_from_depth: Pose,
    ) -> tuple[Registration, MotionPrior]:
        """Register a frame again without the accepted frame before, which it contradicts.

        If it fits then, that frame is what was wrong, and the track goes on without it. Sets ``fault``.
        """
        without, stamp_s = self._without_frame, view.frame.stamp_s
        if without is None or stamp_s - without.state.stamp_s > _BRIEF_GAP_S:
            return registration, prior
        kept = self._state, self._motion, self._attitude, self._predicted, self._turned
        self._state, self._motion, self._attitude = without.state, without.motion, without.attitude
        self._motion.accelerometer_used = kept[1].accelerometer_used
        compared, count, self.surfaces.count = self._compared, self.surfaces.count, without.motion.errors.count
        without.motion.errors.undo(without.update)
        self.surfaces.move(-without.moved_m, without.motion.errors.variance)
        other = self._predict(without.state, stamp_s, body_from_depth)
        found = self._registered(view, other)
        fault = self._monitor.fault(found, other)
        if fault is None and found.surprise(other) < _LESS_SURPRISED_SHARE * without.surprise:
            self.fault, self._without_frame = None, None
            self.surfaces.keep(self.surfaces.count)
            return found, other
        without.motion.errors.redo(without.update)
        self.surfaces.move(without.moved_m, without.motion.errors.variance)
        self.surfaces.count, self._compared = count, compared
        self.surfaces.move(np.zeros((count, 3)), kept[1].errors.variance)
        self._state, self._motion, self._attitude, self._predicted, self._turned = kept
        return registration, prior

    def _without_accelerometer(
        self,
        view: PreparedView,
        state: TrackedState,
        registration: Registration,
        prior: MotionPrior,
        body_from_depth: Pose,
    ) -> tuple[Registration, MotionPrior]:
        """Register a frame that contradicts the predicted motion again, without the accelerometer.

        If it fits then, the accelerometer is what is wrong, and is left out. Sets ``fault``.
        """
        predicted, turned = self._predicted, self._turned
        self.accelerometer_used = False
        without = self._predict(state, view.frame.stamp_s, body_from_depth)
        found = register(view, *self._compared, without)
        fault = self._monitor.fault(found, without)
        if fault is None:
            self.fault = None
            return found, without
        self.accelerometer_used = True
        self._predicted, self._turned = predicted, turned
        return registration, prior

    def _search(self, view: PreparedView, registration: Registration, prior: MotionPrior) -> Registration:
        """Return the best registration from places around the predicted one.

        By corners, or by depth alone.
        """
        reach_m = _reach_m(prior)
        if reach_m.max() < _LEAST_SEARCH_M:
            return registration
        recognised = self._recognise(view, registration, prior)
        if recognised is not None:
            return recognised
        if _SEARCH_SIGMAS * math.sqrt(float(prior.variance.max())) > _MOST_SEARCH_M:
            return registration
        other, next_best = search(view, self.surfaces, prior, reach_m)
        better = other.determined and other.inliers > registration.inliers * _BETTER and next_best < _ALIKE_SHARE
        return other if better else registration

    def _search_map(self, view: PreparedView, registration: Registration, prior: MotionPrior) -> Registration:
        """Search the map from before while the track is not sure.

        Returns another place if several searches have found it.
        """
        self._frames += 1
        if registration.sigma_m < _UNSURE_M or self._frames % _SEARCH_EVERY:
            return registration
        recognised = self._recognise(view, registration, prior)
        if recognised is not None:
            return recognised
        other, next_best = search(view, self.surfaces, prior, _reach_m(prior), _OLD_SHARE * registration.sigma_m**2)
        if next_best > _ALIKE_SHARE or not other.determined:
            self._agreeing = 0
            return registration
        moved_m, before_m = other.moved_m[:3] - registration.moved_m[:3], self._moved_m
        agrees = self._agreeing and float(np.linalg.norm(moved_m - before_m)) < _SAME_M
        self._agreeing = self._agreeing + 1 if agrees else 1
        self._moved_m = moved_m
        if self._agreeing < _AGREEING_SEARCHES:
            return registration
        self._agreeing = 0
        return other

    def _recognise(self, view: PreparedView, registration: Registration, prior: MotionPrior) -> Registration | None:
        """Return the registration at a place from before; None if the view shows none.

        Its corners and depth must both show it.
        """
        most_variance = _OLD_SHARE * registration.sigma_m**2
        reach_m = _SEARCH_SIGMAS * registration.sigma_m
        pose = self.surfaces.recognise(view, registration.odom_from_depth, reach_m, most_variance)
        if pose is None:
            return None
        return self._confirmed(view, Pose(registration.odom_from_depth.quat_wxyz, pose.translation_m), prior)

    def _coast(self, state: TrackedState, prior: MotionPrior, stamp_s: float, body_from_depth: Pose) -> None:
        """Go on by the inertial samples alone: the frame is not accepted."""
        odom_from_body = prior.odom_from_depth @ body_from_depth.inverse()
        self._motion.coast(self._predicted)
        self._attitude.coast(self._turned)
        self._state = TrackedState(stamp_s, odom_from_body, self._motion.velocity_mps)
        brief_s = LONG_WAY_BACK_S if self._moved_outside(stamp_s) else _BRIEF_GAP_S
        if self.fault in _VIEWLESS and stamp_s - self._accepted_s <= brief_s:
            return
        self._accepted_frames = 0
        self._unproven = _PROOF_FRAMES

    def _moved_outside(self, stamp_s: float) -> bool:
        """Return True if the other source knows the motion, but for moments."""
        return stamp_s - self.delay_s - self.moved_outside_s < _BRIEF_GAP_S

    def restart(self, odom_at: OdomAt) -> None:
        """Forget the map and begin a new one at the next frame, where other odometry is by then.

        For a track that is lost beside a source of poses. odom_at: that odometry at an instant.
        """
        self._forget()
        self._begin.begin_at(odom_at)

    def _forget(self) -> None:
        """Forget the map and the track; what is known of the sensors stays."""
        self.surfaces, self._state, self._without_frame = KeyframeMap(), None, None
        self._doubt, self._unproven, self._lag_s = PlaceDoubt(), 0, -math.inf

    def _start(self, view: PreparedView, body_from_depth: Pose) -> StampedPose | None:
        start = self._begin.start(view.frame, self.delay_s, body_from_depth)
        if start is None:
            return None
        self._forget()
        self._state = TrackedState(view.frame.stamp_s, start.odom_from_body, start.velocity_mps)
        self._attitude = AttitudeFilter(start.odom_from_body, _STARTED_MOVING if start.rest is None else _AT_REST)
        if start.rest is None:
            self._motion.begin(start.odom_from_body.translation_m, start.velocity_mps)
        else:
            self.gyro.rest(start.rest.gyro_bias_radps)
            self._motion = MotionFilter(start.odom_from_body, start.rest.force_offset_mps2)
        self._accepted_frames = _CARRIED_FRAMES
        motion = np.concatenate((np.zeros(3), start.velocity_mps))
        self._add_to_map(view, start.odom_from_body @ body_from_depth, motion)
        return self._stamped(view.frame.stamp_s)

    def _rests(self, stamp_s: float, registration: Registration, prior: MotionPrior) -> bool:
        """Return True until inertial samples or images show that the body has moved once."""
        moved_m = np.linalg.norm(registration.odom_from_depth.translation_m - prior.odom_from_depth.translation_m)
        return self._begin.rests(stamp_s, registration.known * registration.fit, registration.landmarks, float(moved_m))

    def _stay(self, view: PreparedView, state: TrackedState, body_from_depth: Pose) -> StampedPose:
        """Take another frame of a body that rests: the view from the pad may be poor."""
        self._state = replace(state, stamp_s=view.frame.stamp_s)
        self._motion.rest()
        odom_from_depth = state.odom_from_body @ body_from_depth
        self._add_to_map(view, odom_from_depth, np.zeros(6))
        return self._stamped(view.frame.stamp_s)

    def _after_rest(
        self, view: PreparedView, registration: Registration, prior: MotionPrior, body_from_depth: Pose
    ) -> tuple[Registration, MotionPrior]:
        """Register the first frame of the flight again.

        The body has moved since it last rested for sure.
        """
        if self._state is None or not self._begin.launches:
            return registration, prior
        self._state = replace(self._state, stamp_s=self._state.stamp_s - STILL_S)
        prior = self._predict(self._state, view.frame.stamp_s, body_from_depth)
        return self._registered(view, prior), prior

    def _predict(self, state: TrackedState, stamp_s: float, body_from_depth: Pose) -> MotionPrior:
        """Return the predicted motion from the newest accepted frame."""
        step_s = stamp_s - state.stamp_s
        shown_s = state.stamp_s - self.delay_s, stamp_s - self.delay_s
        measured = self._outside.moved(*shown_s, state.odom_from_body)
        self.moved_outside_s = shown_s[1] if measured is not None else self.moved_outside_s
        moved = self._motion.predict(step_s, self._attitude.odom_from_body, self.gyro.track(state.stamp_s, stamp_s), measured)
        turned, rate = self.gyro.turn(state.stamp_s, stamp_s), self.gyro.rate(stamp_s)
        turn_sigma = drift_sigma = _BLIND_TURN_RADPS * step_s
        if turned is not None:
            turn_sigma = self.gyro.turn_sigma_rad(state.stamp_s, stamp_s)
            drift_sigma = self.gyro.drift_sigma_rad(state.stamp_s, stamp_s)
        elif (turned := self._outside.turned(*shown_s)) is not None:
            turn_sigma = drift_sigma = _OUTSIDE_TURN_RAD
        rate = np.zeros(3) if rate is None else rate
        turned = np.zeros(3) if turned is None else turned
        attitude = self._attitude.predict(turned, drift_sigma, rate, math.hypot(JITTER_S, self.gyro.delay_sigma_s))
        attitude = self._take_heading(attitude, stamp_s)
        self._predicted, self._turned = moved, attitude
        odom_from_body = Pose(attitude.odom_from_body.quat_wxyz, moved.place_m)
        rate_odom = odom_from_body.rotation() @ rate
        arm_m = odom_from_body.rotation() @ body_from_depth.translation_m
        velocity = moved.velocity_mps + np.cross(rate_odom, arm_m)
        return MotionPrior(
            odom_from_body @ body_from_depth, attitude.shown_covariance, self._motion.predicted_errors(moved), turn_sigma,
            rate_odom, velocity, self._slow, self._slow_covariance,
        )  # fmt: skip

    def _take_heading(self, predicted: PredictedAttitude, stamp_s: float) -> PredictedAttitude:
        """Return the predicted attitude with its heading corrected by that of the other source."""
        attitude = self._outside.attitude(stamp_s - self.delay_s)
        if attitude is None:
            return predicted
        off_rad = float((attitude @ predicted.odom_from_body.inverse()).rotation_vector()[2])
        variance = float(predicted.covariance[2, 2]) + _OUTSIDE_HEADING_RAD**2
        return predicted if off_rad**2 > _HEADING_SURPRISE * variance else predicted.with_heading(off_rad, variance)

    def _settle(
        self,
        view: PreparedView,
        registration: Registration,
        prior: MotionPrior,
        state: TrackedState,
        body_from_depth: Pose,
    ) -> None:
        """Take an accepted frame into motion, gyro, landmarks and map."""
        stamp_s = view.frame.stamp_s
        step_s = stamp_s - state.stamp_s
        odom_from_body = registration.odom_from_depth @ body_from_depth.inverse()
        numbers = registration.keyframes.number
        without = copy.copy(self._motion)
        moved_m, update = self._motion.update(self._predicted, numbers, registration.moved_m, registration.joint)
        self._without_frame = self._as_if_not(without, stamp_s, registration, prior, body_from_depth, moved_m, update)
        self.surfaces.move(moved_m, self._motion.errors.variance)
        unseen_m = odom_from_body.translation_m - self._predicted.place_m  # error of the time without a view
        self._doubt.found(unseen_m if self._doubt.unsure else registration.shift_m, step_s)
        self._attitude.update(self._turned, odom_from_body, registration.covariance[:3, :3])
        self.determined = registration.determined_share
        velocity = self._motion.velocity_mps
        between = state.odom_from_body.inverse() @ odom_from_body
        self.gyro.update(state.stamp_s, stamp_s, between.rotation_vector())
        self._slow = registration.slow
        grown = registration.slow_covariance + np.diag(_SLOW_WALK**2 * step_s)
        self._slow_covariance = grown + np.diag(np.maximum(_SLOW_FLOOR**2 - np.diagonal(grown), 0.0))
        self._state = TrackedState(stamp_s, odom_from_body, velocity)
        self._accepted_s = stamp_s
        self._accepted_frames = 0 if self.fault is TrackingFault.DEPTH else self._accepted_frames + 1
        # a track that has been carried on for long is uncertain, and its map says so
        carried = self.fault in (TrackingFault.LOOSE, TrackingFault.UNPROVEN) and self._accepted_frames >= _CARRIED_FRAMES
        self._unproven = max(self._unproven - 1, 0) if self.fault is None or carried else self._unproven
        motion = np.concatenate((prior.rate_radps, velocity))
        self.surfaces.remember(view, *self._compared, registration.odom_from_depth, motion, self._slow)
        if self.fault is not TrackingFault.DEPTH:
            self._add_to_map(view, registration.odom_from_depth, motion, registration.landmarks)
        if stamp_s - self._lag_s >= _LAG_S:
            self._motion.mark_lag()
            self._lag_s = stamp_s

    def _as_if_not(
        self,
        motion: MotionFilter,
        stamp_s: float,
        registration: Registration,
        prior: MotionPrior,
        body_from_depth: Pose,
        moved_m: FloatArray,
        update: Update,
    ) -> _WithoutFrame:
        """Return the track at an accepted frame, as if it were not.

        motion: before the frame. moved_m, update: as in _WithoutFrame.
        """
        attitude = copy.copy(self._attitude)
        motion.coast(self._predicted)
        attitude.coast(self._turned)
        state = TrackedState(stamp_s, prior.odom_from_depth @ body_from_depth.inverse(), motion.velocity_mps)
        return _WithoutFrame(state, motion, attitude, registration.surprise(prior), moved_m, update)

    def _add_to_map(self, view: PreparedView, odom_from_depth: Pose, motion: FloatArray, landmarks: int = 0) -> None:
        if self._accepted_frames < _MAP_FRAMES:
            return
        variance = np.diagonal(self._motion.errors.state)[:3] + _PLACED_M**2
        if self.surfaces.add(view, odom_from_depth, motion, self._slow, variance, landmarks):
            self._motion.add_keyframe(_PLACED_M)

    def _pose(self, stamp_s: float, registration: Registration) -> StampedPose | None:
        """Return the pose of a frame; None while it is not sure, or not yet again."""
        sigma_m, self.step_sigma_m = registration.sigma_m, registration.sigma_against_track_m
        self._doubt.judge(stamp_s, sigma_m, self.step_sigma_m)
        if self._state is not None and not (self._doubt.unsure or self._unproven or self._doubt.unreleased_m.any()):
            self._outside.show(stamp_s - self.delay_s, self._state.odom_from_body, self.step_sigma_m)
        if self._unproven or not self._doubt.allows(stamp_s, sigma_m, moved_outside=self._moved_outside(stamp_s)):
            self._doubt.drop()
            return None
        pose = replace(self._stamped(stamp_s, sigma_m), quality=self._doubt.quality(registration.quality, sigma_m))
        unsure = self._doubt.reason(sigma_m)
        return pose if unsure is None else replace(pose, health=PoseHealth.DEGRADED, health_reason=unsure)

    def _stamped(self, stamp_s: float, sigma_m: float = 0.0) -> StampedPose:
        assert self._state is not None
        unreleased_m = self._doubt.unreleased_m
        place_m2 = _POSITION_SIGMA_M**2 + sigma_m**2 + float(unreleased_m @ unreleased_m)
        state = self._state
        place_m2 += (_SCALE_SHARE * float(np.linalg.norm(state.odom_from_body.translation_m))) ** 2
        covariance = np.diag([place_m2] * 3 + [_ROTATION_SIGMA_RAD**2] * 3)
        shown = Pose(state.odom_from_body.quat_wxyz, state.odom_from_body.translation_m + unreleased_m)
        return StampedPose(stamp_s - self.delay_s, shown, state.velocity_mps, covariance)


def warm_up() -> None:
    """Compile every kernel of the tracker."""
    tracker, lens, level = SlamTracker(), Intrinsics.from_fov(64, 48, 1.5, 1.2), body_from_camera(np.zeros(3), 0.3)
    still = [ImuSample(0.01 * n, np.zeros(3), np.array([0.0, 0.0, 9.8])) for n in range(80)]
    depth_m = np.full((48, 64), 1.5, np.float32)
    pattern = np.kron(np.indices((12, 16)).sum(axis=0) % 2, np.ones((4, 4))).astype(np.uint8) * 200
    colour = np.repeat(pattern[..., None], 3, axis=2)
    tracker.add_imu(still)
    for n in range(4):
        depth_m = depth_m + np.float32(1e-3)
        view = PreparedView(Frame(0.7 + 0.03 * n, n, depth_m, lens, colour, lens, Pose.identity()))
        tracker.track(view.frame, level)
    assert tracker._state is not None
    prior, surfaces = tracker._predict(tracker._state, 0.82, level), tracker.surfaces
    search(view, surfaces, prior, np.full(3, _LEAST_SEARCH_M))
    shown = surfaces.near_view(view, prior.odom_from_depth, np.zeros(6), prior.slow)
    surfaces.remember(view, *shown, prior.odom_from_depth, np.zeros(6), prior.slow)


def _reach_m(prior: MotionPrior) -> FloatArray:
    """Return the reach (3,) of a search along each axis."""
    return np.minimum(_SEARCH_SIGMAS * np.sqrt(prior.variance), _MOST_SEARCH_M)


def _proves(registration: Registration) -> bool:
    """Return True if enough of the map from before the doubt is in view."""
    return registration.inliers >= _PROOF_SHARE * registration.points or registration.landmarks >= _PROOF_LANDMARKS
