"""Exposure: how each picture must be brightened so that all agree on the colour of what they see.

Another exposure is a factor on light, and a factor on (rgb + TOE) of an sRGB value. Factors are found from the mean logarithms
of small cells of surface, before a picture is learned; their mean over all pictures is one.
"""

from __future__ import annotations

import numpy as np

from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.keyframes.surfels import COLOUR, COLOURED, WHITENED, Surfels
from uav_recon.types.frames import BoolArray, FloatArray

GAIN_SIGMA = 0.3  # of a log gain: one EV is 0.29
CELL_SIGMA = 0.2  # two pictures of a cell show different parts of it ...
CELLS_WORTH = 0.5  # ... and its neighbours err alike
SCALE = 0.1  # a difference that counts half: what one view alone saw in a cell
MAX_LOG_GAIN = 1.0
FEWEST_RAYS, MAX_WHITE_SHARE = 1.5, 0.1  # of a cell whose mean colour is known
ROUNDS = 4
REVISITED = 3  # older views, for each new one


class ExposureCompensation:
    """Log gains (V, 3) of the views' colour channels."""

    def __init__(self, patches: Surfels) -> None:
        self._patches = patches
        self._turn = 0
        self.log_gain: FloatArray = np.zeros((0, 3))

    def meet(self, replay: RayBuffer) -> None:
        """Find the newest view's gain, then those of some older ones in turn. About 2 ms."""
        newest = len(self.log_gain)
        self.log_gain = np.concatenate([self.log_gain, np.zeros((1, 3))])
        self._learn(newest)
        for _ in range(min(REVISITED, newest)):
            self._turn = self._turn + 1 if self._turn + 1 < newest else 0
            self._learn(self._turn)
        self.log_gain -= self.log_gain.mean(axis=0)
        replay.views.gain[: newest + 1] = np.exp(self.log_gain)

    def keep(self, which: BoolArray) -> None:
        """Forget all views but some (V,), and whatever came after those."""
        self.log_gain, self._turn = self.log_gain[np.flatnonzero(which)], 0

    def _learn(self, view: int) -> None:
        """The log gain of a view that makes its cells as bright as other views see them, drawn to none."""
        beside, _ = self._patches.beside(view)
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
    """Mean of differences (N,), with Cauchy's weights, drawn to zero; those of white cells (N,) only say how much at most."""
    gain = float(np.median(darker)) if len(darker) else 0.0
    for _ in range(ROUNDS):
        weight = 1.0 / (1.0 + ((darker - gain) / SCALE) ** 2)
        weight[at_most & (darker > gain)] = 0.0
        information = CELLS_WORTH / CELL_SIGMA**2
        gain = information * float(weight @ darker) / (information * float(weight.sum()) + GAIN_SIGMA**-2)
    return float(np.clip(gain, -MAX_LOG_GAIN, MAX_LOG_GAIN))
