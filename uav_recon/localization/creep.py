"""How fast odom creeps away from what is seen, summed over seconds: one look back tells too little of a slow drift."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from uav_recon.localization.patches import patches, pull
from uav_recon.types.camera import Intrinsics
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray
from uav_recon.types.pose import Pose

_FADES_S = 4.0  # what was seen counts e times less after so long
_PRIOR_S3 = 0.8  # for no creep at all: as much as 0.8 of the patches say in a second of a view that is a second old
_LONGEST_STEP_S = 0.5
_SETTLES_S = 3.0  # odom of its own accord, once it begins: views of then are not kept
_EVERY_S, _MEMORY_S = 1.0, 3.0  # of a camera that looks about, something is always left
_FEWEST, _WITHIN = 40, 0.6  # patches that both see, and the share of them that lies within reach: beside a person, 0.7


class _View(NamedTuple):
    stamp_s: float
    patches: AnyArray


class Creep:
    """Least squares for the velocity (3,) by which all patches of the past views lie off by the views' age times it.

    The normal equations are summed, not solutions of single views: a direction in which few patches look is told of once
    enough have, and until then by the prior. Not thread-safe.
    """

    def __init__(self) -> None:
        self._stamp_s = -math.inf
        self._views: deque[_View] = deque()
        self.forget()

    def forget(self) -> None:
        """Odom itself jumped: nothing was seen in the new one."""
        self._views.clear()
        self._held, self._moved = np.zeros((3, 3)), np.zeros(3)
        self._since_s = math.inf

    def hear(self, stamp_s: float, depth_m: Float32Array, lens: Intrinsics, odom_from_depth: Pose) -> None:
        """Look back from a picture that is believed. Once a picture, about 0.1 ms; it never blocks."""
        step_s = min(max(stamp_s - self._stamp_s, 0.0), _LONGEST_STEP_S)
        fading = math.exp(-step_s / _FADES_S)
        self._stamp_s, self._held, self._moved = stamp_s, fading * self._held, fading * self._moved
        self._since_s = min(self._since_s, stamp_s)
        camera = np.array([lens.fx, lens.fy, lens.cx, lens.cy])
        seen = depth_m, camera, odom_from_depth.rotation(), odom_from_depth.translation_m
        while self._views and stamp_s - self._views[0].stamp_s > _MEMORY_S:
            self._views.popleft()
        velocity_mps = self.velocity_mps
        for view in self._views:
            age_s = stamp_s - view.stamp_s
            count, within, held, moved = pull(view.patches, *seen, age_s * velocity_mps)
            if count >= _FEWEST and within >= _WITHIN * count:
                self._held += step_s * age_s**2 / count * held
                self._moved += step_s * age_s / count * moved
        settled = stamp_s >= self._since_s + _SETTLES_S
        if settled and (not self._views or stamp_s - self._views[-1].stamp_s >= _EVERY_S):
            self._views.append(_View(stamp_s, patches(*seen)))

    @property
    def velocity_mps(self) -> FloatArray:
        """Of odom against the surfaces, (3,)."""
        return np.asarray(np.linalg.solve(self._held + _PRIOR_S3 * np.eye(3), self._moved), dtype=np.float64)
