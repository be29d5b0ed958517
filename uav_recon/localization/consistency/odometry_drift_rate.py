"""Drift rate of odom against the seen surfaces, kept apart from the errors of the camera.

It is summed over seconds, because one comparison shows too little of a slow drift.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from uav_recon.localization.calibration.calibration_filter import COLOUR_DELAY, DRIFT, GEOMETRY, SIZE, CalibrationFilter
from uav_recon.localization.consistency.feature_tracking import FeatureTracker, TrackedPoints
from uav_recon.localization.consistency.planar_patches import (
    REACH_M,
    REACH_SHARE,
    error_rows,
    normal_equations,
    patches,
    weight_at,
)
from uav_recon.types.camera import Frame
from uav_recon.types.camera_calibration import CameraMotion
from uav_recon.types.frames import AnyArray, FloatArray

# the camera moves faster in flight or in a hand; after this time below both it stands at rest
_REST_MPS = 0.15  #: internal: a faster camera moves
_REST_RADPS = 0.15  #: internal: ... or one that turns faster
_REST_S = 5.0  #: internal: time without motion after which the camera rests
_LONGEST_STEP_S = 0.5  #: internal: a longer pause between frames counts as this
_SETTLES_S = 3.0  #: land: no drift is measured for this time after odom begins: it settles
_EVERY_S = 1.0  #: internal: interval of stored views
_UNDONE = 3  #: internal: seconds of comparisons that are taken back when odom was wrong
_MEMORY_S = 3.0  #: internal: max. age of stored views: while the camera turns, some of them stay in view
_FEWEST = 40  #: land: min. patches that both views see, for a comparison to count
_WITHIN_SHARE = 0.6  #: land: min. share of them within reach: beside a person it is 70 %
_POINT_WEIGHT = 2.0  # weight of tracked points against patches: a point measures both image directions
#: land: odom surely drifts by more; honest flights with camera errors: at most 0.0022 m/s, a drift of 0.05 m/s: 0.027
_VALID_DRIFT_MPS = 0.01
#: land: share of a drift that is being corrected by which it may differ from the one that depth shows: it changes
_CORRECTED_SHARE = 0.5
#: internal: share of the drift that depth shows by which one that is known from elsewhere may differ, to be the same
_CONFIRMED_SHARE = 0.7
_SURE_S = 3.0  #: land: ... for this time: a hard manoeuvre shows more for a second
_SURE_SIGMAS = 2.0  #: land: ... beyond this many standard deviations, which contain what the camera's errors may explain
_YOUNGEST_S = 0.3  #: land: min. age of tracked points that count
_FEWEST_POINTS = 10  #: land: min. number of them
_POINTS_WITHIN_SHARE = 0.5  #: land: min. share of them within reach


class _View(NamedTuple):
    stamp_s: float
    patches: AnyArray
    rows: AnyArray  # (N, 9), their error_rows


class DriftRateEstimator:
    """Compares each frame with views of the last seconds, for drift and camera errors.

    The normal equations of all patches of stored views, and of all points tracked through the images, enter one filter. Not
    thread-safe.
    """

    def __init__(self, calibration: CalibrationFilter | None = None) -> None:
        self.calibration = calibration or CalibrationFilter()
        self._stamp_s = -math.inf
        self._since_s = math.inf
        self._valid_s = math.inf
        self._moved_s = -math.inf
        self._views: deque[_View] = deque()
        self._flow = FeatureTracker()
        self._known: deque[tuple[float, FloatArray, FloatArray]] = deque(maxlen=_UNDONE + 1)  # of the calibration, each second

    def undo(self) -> None:
        """Forget all views, and what the newest seconds have said of the camera: odom was wrong."""
        if self._known:
            _, state, covariance = self._known[0]
            self.calibration.state, self.calibration.covariance = state.copy(), covariance.copy()
        self._known.clear()
        self.forget()

    def forget(self) -> None:
        """Forget all views after a jump of odom: none of them was seen in the new odom."""
        self._views.clear()
        self._flow.forget()
        self.calibration.forget_drift()
        self._since_s = self._valid_s = math.inf

    def update(self, frame: Frame, motion: CameraMotion, corrected_mps: FloatArray | None = None) -> None:
        """Compare an accepted frame with the stored views. Once per frame, about 1 ms; never blocks.

        motion: in odom as the source gives it. corrected_mps (3,): drift of odom that is corrected, None for none.
        """
        step_s = min(max(frame.stamp_s - self._stamp_s, 0.0), _LONGEST_STEP_S)
        self._stamp_s = frame.stamp_s
        self._since_s = min(self._since_s, frame.stamp_s)
        if not self._known or frame.stamp_s - self._known[-1][0] >= _EVERY_S:
            self._known.append((frame.stamp_s, self.calibration.state.copy(), self.calibration.covariance.copy()))
        if float(np.linalg.norm(motion.velocity_mps)) > _REST_MPS or float(np.linalg.norm(motion.rate_radps)) > _REST_RADPS:
            self._moved_s = frame.stamp_s
        self.calibration.predict(step_s, at_rest=self.at_rest)
        information, weighted = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
        self._add_patches(frame, motion, information, weighted)
        if self._settled:
            self._add_points(self._flow.update(frame, motion), information, weighted)
        self.calibration.update(step_s * information, step_s * weighted)
        if self._excess(corrected_mps) <= 1.0:
            self._valid_s = frame.stamp_s

    def hold_valid(self, stamp_s: float) -> None:
        """Take odom as valid up to an instant.

        Another comparison, over seconds, has shown that it does not drift.
        """
        self._valid_s = max(self._valid_s, stamp_s)

    @property
    def drifts(self) -> bool:
        """True if odom surely drifts, and has for a while."""
        return self._stamp_s - self._valid_s >= _SURE_S

    @property
    def at_rest(self) -> bool:
        """True if the camera has not moved for a while: on the ground, or before its first motion."""
        return self._stamp_s - self._moved_s > _REST_S

    @property
    def velocity_mps(self) -> FloatArray:
        """Velocity (3,) of odom against the surfaces."""
        return self.calibration.drift_mps

    @property
    def excess(self) -> float:
        """Drift rate that is sure, as a multiple of the limit for valid odom.

        Above 1 odom drifts.
        """
        return self.calibration.drift_at_least_mps(_SURE_SIGMAS) / _VALID_DRIFT_MPS

    def confirms(self, known_mps: FloatArray) -> bool:
        """Return True if odom surely drifts, and by a velocity (3,) that is known from elsewhere."""
        off_mps = float(np.linalg.norm(self.velocity_mps - known_mps))
        return self.excess > 1.0 and off_mps < _CONFIRMED_SHARE * float(np.linalg.norm(self.velocity_mps))

    def _excess(self, corrected_mps: FloatArray | None) -> float:
        """Return the drift rate that is sure beside what is corrected, as a multiple of its limit."""
        if corrected_mps is None or not corrected_mps.any():
            return self.excess
        left_mps = self.velocity_mps - corrected_mps
        speed_mps = float(np.linalg.norm(left_mps))
        spread = self.calibration.covariance[DRIFT, DRIFT]
        sigma_mps = math.sqrt(float(left_mps @ spread @ left_mps)) / max(speed_mps, 1e-9)
        limit_mps = _VALID_DRIFT_MPS + _CORRECTED_SHARE * float(np.linalg.norm(corrected_mps))
        return max(speed_mps - _SURE_SIGMAS * sigma_mps, 0.0) / limit_mps

    @property
    def _settled(self) -> bool:
        return self._stamp_s >= self._since_s + _SETTLES_S

    def _add_patches(self, frame: Frame, motion: CameraMotion, information: FloatArray, weighted: FloatArray) -> None:
        camera, pose = frame.depth_intrinsics.pinhole_px(), motion.odom_from_depth
        seen = frame.depth_m, camera, pose.rotation(), pose.translation_m
        moving = motion.velocity_mps, motion.rate_radps
        while self._views and frame.stamp_s - self._views[0].stamp_s > _MEMORY_S:
            self._views.popleft()
        for view in self._views:
            age_s, expected = frame.stamp_s - view.stamp_s, self.calibration.state[:GEOMETRY]
            count, within, held, moved = normal_equations(view.patches, view.rows, *seen, *moving, age_s, expected)
            if count >= _FEWEST and within >= _WITHIN_SHARE * count:
                information[:GEOMETRY, :GEOMETRY] += held / count
                weighted[:GEOMETRY] += moved / count
        if self._settled and (not self._views or frame.stamp_s - self._views[-1].stamp_s >= _EVERY_S):
            found = patches(*seen)
            self._views.append(_View(frame.stamp_s, found, error_rows(found, *seen[2:], *moving)))

    def _add_points(self, seen: TrackedPoints | None, information: FloatArray, weighted: FloatArray) -> None:
        if seen is None:
            return
        rows = np.zeros((*seen.off_m.shape, SIZE))
        rows[..., DRIFT] = seen.along * seen.age_s[:, None, None]
        rows[..., COLOUR_DELAY:] = seen.rows
        left_m = np.abs(seen.off_m - rows @ self.calibration.state).max(axis=1)
        old = seen.age_s >= _YOUNGEST_S
        fits = old & (left_m <= REACH_M + REACH_SHARE * seen.range_m)
        count = int(fits.sum())
        if count < max(_FEWEST_POINTS, _POINTS_WITHIN_SHARE * int(old.sum())):
            return
        rows, weight = rows[fits], _POINT_WEIGHT / count * weight_at(seen.range_m[fits])
        information += np.einsum("nai,naj,n->ij", rows, rows, weight)
        weighted += np.einsum("nai,na,n->i", rows, seen.off_m[fits], weight)
