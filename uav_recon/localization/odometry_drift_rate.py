"""Drift rate of odom against the seen surfaces.

It is summed over seconds, because one comparison shows too little of a slow drift.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from uav_recon.localization.feature_tracking import FeatureTracker, TrackedPoints
from uav_recon.localization.planar_patches import REACH_M, REACH_SHARE, normal_equations, patches, weight_at
from uav_recon.types.camera import Frame
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.pose import Pose

_FADES_S = 2.5  # time constant: the weight of an observation falls by a factor e
_PRIOR_S3 = 0.5  # weight of the prior, which is zero drift: that of half of near patches in 1 s of a view 1 s old, ...
_DOUBT_S3 = 1.5  # ... and three times that before drift is reported: few observations of a direction may be noise
_LONGEST_STEP_S = 0.5  #: internal: a longer pause between frames counts as this
_SETTLES_S = 3.0  #: land: no drift is measured for this time after odom begins: it settles
_EVERY_S = 1.0  #: internal: interval of stored views
_MEMORY_S = 3.0  #: internal: max. age of stored views: while the camera turns, some of them stay in view
_FEWEST = 40  #: land: min. patches that both views see, for a comparison to count
_WITHIN_SHARE = 0.6  #: land: min. share of them within reach: beside a person it is 70 %
_POINT_WEIGHT = 2.0  # weight of tracked points against patches: a point measures both image directions
_VALID_DRIFT_MPS = 0.012  #: land: odom drifts along its path by more; valid: at most 0.010 m/s
_TILT_RAD = 0.020  #: land: added to it across the path: the speed times this tilt; measured: 0.011
_YOUNGEST_S = 0.3  #: land: min. age of tracked points that count
_FEWEST_POINTS = 10  #: land: min. number of them
_POINTS_WITHIN_SHARE = 0.5  #: land: min. share of them within reach


class _View(NamedTuple):
    stamp_s: float
    place_m: FloatArray
    patches: AnyArray


class DriftRateEstimator:
    """Least squares for the velocity (3,) of odom against the seen surfaces.

    All patches of stored views, and all points tracked through the images, are displaced by their age times this velocity.

    The normal equations are summed, not the solutions of single views. A direction that few patches face is reported once
    enough have been seen; until then the prior determines it. Not thread-safe.
    """

    def __init__(self) -> None:
        self._stamp_s = -math.inf
        self._views: deque[_View] = deque()
        self._flow = FeatureTracker()
        self.forget()

    def forget(self) -> None:
        """Forget all views after a jump of odom: none of them was seen in the new odom."""
        self._views.clear()
        self._flow.forget()
        self._held = np.zeros((3, 3))
        self._moved = np.zeros(3)
        self._flown = np.zeros(3)
        self._flown_s2 = 0.0
        self._since_s = math.inf

    def update(self, frame: Frame, odom_from_depth: Pose) -> None:
        """Compare an accepted frame with the stored views. Once per frame, about 1 ms; never blocks."""
        step_s = min(max(frame.stamp_s - self._stamp_s, 0.0), _LONGEST_STEP_S)
        fading = math.exp(-step_s / _FADES_S)
        self._stamp_s = frame.stamp_s
        self._held = fading * self._held
        self._moved = fading * self._moved
        self._flown = fading * self._flown
        self._flown_s2 = fading * self._flown_s2
        self._since_s = min(self._since_s, frame.stamp_s)
        velocity_mps = self.velocity_mps
        self._add_patches(frame, odom_from_depth, step_s, velocity_mps)
        if self._settled:
            self._add_points(self._flow.update(frame, odom_from_depth), step_s, velocity_mps)

    @property
    def velocity_mps(self) -> FloatArray:
        """Velocity (3,) of odom against the surfaces."""
        return self._solved(_PRIOR_S3)

    @property
    def excess(self) -> float:
        """Drift rate, with the stronger prior, as a multiple of the limit for valid odom.

        Above 1 odom drifts.
        """
        creep_mps, flown_mps = self._solved(_DOUBT_S3), self._flown / max(self._flown_s2, 1e-9)
        way = flown_mps / max(float(np.linalg.norm(flown_mps)), 1e-9)
        along_mps = float(creep_mps @ way)
        across_mps = float(np.linalg.norm(creep_mps - along_mps * way))
        max_lateral_mps = math.hypot(_VALID_DRIFT_MPS, _TILT_RAD * float(np.linalg.norm(flown_mps)))
        return math.hypot(along_mps / _VALID_DRIFT_MPS, across_mps / max_lateral_mps)

    def _solved(self, prior_s3: float) -> FloatArray:
        return np.asarray(np.linalg.solve(self._held + prior_s3 * np.eye(3), self._moved), dtype=np.float64)

    @property
    def _settled(self) -> bool:
        return self._stamp_s >= self._since_s + _SETTLES_S

    def _add_patches(self, frame: Frame, odom_from_depth: Pose, step_s: float, velocity_mps: FloatArray) -> None:
        camera = frame.depth_intrinsics.pinhole_px()
        seen = frame.depth_m, camera, odom_from_depth.rotation(), odom_from_depth.translation_m
        while self._views and frame.stamp_s - self._views[0].stamp_s > _MEMORY_S:
            self._views.popleft()
        for view in self._views:
            age_s = frame.stamp_s - view.stamp_s
            self._flown += step_s * age_s * (odom_from_depth.translation_m - view.place_m)
            self._flown_s2 += step_s * age_s**2
            count, within, held, moved = normal_equations(view.patches, *seen, age_s * velocity_mps)
            if count >= _FEWEST and within >= _WITHIN_SHARE * count:
                self._held += step_s * age_s**2 / count * held
                self._moved += step_s * age_s / count * moved
        if self._settled and (not self._views or frame.stamp_s - self._views[-1].stamp_s >= _EVERY_S):
            self._views.append(_View(frame.stamp_s, odom_from_depth.translation_m, patches(*seen)))

    def _add_points(self, seen: TrackedPoints | None, step_s: float, velocity_mps: FloatArray) -> None:
        if seen is None:
            return
        left_m = np.abs(seen.off_m - (seen.along @ velocity_mps) * seen.age_s[:, None]).max(axis=1)
        old = seen.age_s >= _YOUNGEST_S
        fits = old & (left_m <= REACH_M + REACH_SHARE * seen.range_m)
        count = int(fits.sum())
        if count < max(_FEWEST_POINTS, _POINTS_WITHIN_SHARE * int(old.sum())):
            return
        along, age_s, weight = seen.along[fits], seen.age_s[fits], weight_at(seen.range_m[fits])
        self._held += _POINT_WEIGHT * step_s / count * np.einsum("nai,naj,n->ij", along, along, weight * age_s**2)
        self._moved += _POINT_WEIGHT * step_s / count * np.einsum("nai,na,n->i", along, seen.off_m[fits], weight * age_s)
