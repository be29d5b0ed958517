"""Tracking monitor: whether a registered frame may be accepted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from uav_recon.localization.slam.rgbd_registration import MotionPrior, Registration

#: reject: a frame with depth in fewer points: it is covered, or before something too near or too far
_MIN_POINTS = 150
_MIN_FIT_SHARE = 0.55  #: reject: a frame with fewer of its known points on a known surface
_MIN_COVERAGE_SHARE = 0.15  #: reject: the same holds only if at least this share of its points is in known space
#: reject: a frame of which the depth does not fit, with fewer landmarks that do; with more it shows its pose, but no surface
_SHOWING_LANDMARKS = 40
_MAX_TURN_SIGMAS = 6.0  #: reject: a frame that turns by more of the predicted standard deviations against the gyro
_MAX_TURN_RAD = math.radians(0.8)  #: reject: the same, but never for less
#: reject: nor for less than this many standard deviations of the predicted attitude: it may have been off before
_MAX_ATTITUDE_SIGMAS = 3.0
_WHOLE_SHARE = 0.9  #: reject: nor, where this share of the points is in known space and fits there, for less than below
_MAX_WHOLE_TURN_RAD = math.radians(3.0)  #: reject: ... an attitude that had drifted comes back at once after a gap of frames
_MAX_STEP_SIGMAS = 5.0  #: reject: a frame that moves by more of the predicted standard deviations
_MAX_STEP_M = 0.06  #: reject: the same, but never for less
_LOOSE_M = 0.08  #: reject: a frame that leaves the place in a direction as uncertain as this
_LOOSE_RAD = math.radians(2.0)  #: reject: a frame that leaves a turn as uncertain as this


class TrackingFault(str, Enum):
    """Reason why a frame is not accepted, or not taken into the map (LOOSE, DEPTH)."""

    STAMP = "not newer"
    REPEAT = "repeats"
    FROZEN = "frozen"
    FEW_POINTS = "few points"
    FIT = "does not fit"
    DEPTH = "depth does not fit"
    TURN = "turn"
    STEP = "step"
    LOOSE = "loose"
    UNPROVEN = "unproven"


@dataclass(frozen=True, slots=True)
class TrackingMonitor:
    """Limits of one registered frame."""

    def fault(self, registration: Registration, prior: MotionPrior) -> TrackingFault | None:
        """Return why the frame is not accepted or not taken into the map, None if it is."""
        misfit = registration.coverage >= _MIN_COVERAGE_SHARE and registration.fit < _MIN_FIT_SHARE
        turned = (registration.odom_from_depth @ prior.odom_from_depth.inverse()).quat_wxyz
        turn_rad = 2.0 * math.atan2(float(np.linalg.norm(turned[1:])), abs(float(turned[0])))
        moved_m = registration.moved_m[:3] - registration.shift_m
        step_m = float(np.linalg.norm(moved_m))
        loose = (
            registration.sigma_against_track_m,
            np.sqrt(np.linalg.eigvalsh(registration.covariance[:3, :3])[-1]),
        )
        place_sigma_m = math.sqrt(float(np.linalg.eigvalsh(prior.step_covariance)[-1]))
        max_turn_rad = _max_turn_rad(registration, prior)
        checks = (
            (registration.points < _MIN_POINTS, TrackingFault.FEW_POINTS),
            (misfit and registration.landmarks < _SHOWING_LANDMARKS, TrackingFault.FIT),
            (turn_rad > max_turn_rad, TrackingFault.TURN),
            (step_m > max(_MAX_STEP_M, _MAX_STEP_SIGMAS * place_sigma_m), TrackingFault.STEP),
            (loose[0] > _LOOSE_M or loose[1] > _LOOSE_RAD, TrackingFault.LOOSE),
            (misfit, TrackingFault.DEPTH),
        )
        return next((fault for fails, fault in checks if fails), None)


def _max_turn_rad(registration: Registration, prior: MotionPrior) -> float:
    """Return by how much a frame may turn against the gyro."""
    whole = registration.coverage >= _WHOLE_SHARE and registration.fit >= _WHOLE_SHARE
    attitude_sigma_rad = math.sqrt(float(np.linalg.eigvalsh(prior.attitude_covariance)[-1]))
    return max(
        _MAX_WHOLE_TURN_RAD if whole else _MAX_TURN_RAD,
        _MAX_TURN_SIGMAS * prior.turn_sigma_rad,
        _MAX_ATTITUDE_SIGMAS * attitude_sigma_rad,
    )
