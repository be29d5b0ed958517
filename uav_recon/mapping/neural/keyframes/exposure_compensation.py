"""Exposure compensation: brightness gains that make the colours of all images agree.

A change of exposure is a factor on light, and a factor on (rgb + TOE) of an sRGB value. The factors are estimated from the
mean logarithms of small surface cells before the image is used for training. Their mean over all images is one.
"""

from __future__ import annotations

import numpy as np

from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.keyframes.surfels import COLOUR, COLOURED, WHITENED, Surfels
from uav_recon.types.frames import BoolArray, FloatArray

GAIN_SIGMA = 0.3  # prior sigma of a log gain: one EV is 0.29
CELL_SIGMA = 0.2  # sigma of a cell: two images of it show different parts ...
CELLS_WORTH = 0.5  # ... weight of a cell, because errors of neighbouring cells are correlated
SCALE = 0.1  # a difference with half weight; reduces the effect of what only one view sees in a cell
MAX_LOG_GAIN = 1.0
# limits for a cell whose mean colour is valid
FEWEST_RAYS = 1.5
MAX_WHITE_SHARE = 0.1
ROUNDS = 4
REVISITED = 3  # older views updated per new view


class ExposureCompensation:
    """Log gains (V, 3) of the views' colour channels."""

    def __init__(self, patches: Surfels) -> None:
        self._patches = patches
        self._turn = 0
        self.log_gain: FloatArray = np.zeros((0, 3))

    def meet(self, replay: RayBuffer) -> None:
        """Estimate the gain of the newest view and update some older ones in turn. About 2 ms."""
        newest = len(self.log_gain)
        self.log_gain = np.concatenate([self.log_gain, np.zeros((1, 3))])
        self._learn(newest)
        for _ in range(min(REVISITED, newest)):
            self._turn = self._turn + 1 if self._turn + 1 < newest else 0
            self._learn(self._turn)
        self.log_gain -= self.log_gain.mean(axis=0)
        replay.views.gain[: newest + 1] = np.exp(self.log_gain)

    def keep(self, which: BoolArray) -> None:
        """Drop all views except those selected by a mask (V,).

        Views beyond the end of the mask are dropped too.
        """
        self.log_gain = self.log_gain[np.flatnonzero(which)]
        self._turn = 0

    def _learn(self, view: int) -> None:
        """Estimate the log gain of a view from the brightness of its cells in other views.

        The estimate has a prior of zero.
        """
        beside, _ = self._patches.overlapping_views(view)
        cell, whose, row = self._patches.of(beside[:1], beside)
        coloured = row[:, COLOURED] > FEWEST_RAYS
        cell, whose, row = cell[coloured], whose[coloured], row[coloured]
        distinct, number = np.unique(cell, return_inverse=True)
        mine = whose == view
        for channel in range(3):
            level, white = row[:, COLOUR][:, channel], row[:, WHITENED][:, channel] > MAX_WHITE_SHARE
            others = ~mine & ~white
            seen = np.bincount(number[others], minlength=len(distinct))
            sums = np.bincount(number[others], level[others] + self.log_gain[whose[others], channel], len(distinct))
            shared = mine & (seen[number] > 0)
            darker = (sums / np.maximum(seen, 1))[number[shared]] - level[shared]
            self.log_gain[view, channel] = _log_gain(darker, white[shared])


def _log_gain(darker: FloatArray, at_most: BoolArray) -> float:
    """Return the mean of differences (N,) with Cauchy weights and a prior of zero.

    A difference with at_most set (N,), of a saturated cell, is only an upper bound.
    """
    gain = float(np.median(darker)) if len(darker) else 0.0
    for _ in range(ROUNDS):
        weight = 1.0 / (1.0 + ((darker - gain) / SCALE) ** 2)
        weight[at_most & (darker > gain)] = 0.0
        information = CELLS_WORTH / CELL_SIGMA**2
        gain = information * float(weight @ darker) / (information * float(weight.sum()) + GAIN_SIGMA**-2)
    return float(np.clip(gain, -MAX_LOG_GAIN, MAX_LOG_GAIN))
