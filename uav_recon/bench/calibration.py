"""How fast this machine is beside the one on which the reference figures were taken.

Two fixed single-threaded jobs that resemble voxel work, an exact Euclidean distance transform and a sort. Times measured here
are divided by the geometric mean of time here / time there before they are compared with a reference figure.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

# medians of the two jobs on the reference machine: numbers of that machine, not of this project
REFERENCE_EDT_S, REFERENCE_SORT_S = 0.0375, 0.0045


@dataclass(frozen=True, slots=True)
class Calibration:
    """Median seconds of the two jobs here, and the factor to divide by: above 1 this machine is slower."""

    edt_s: float
    sort_s: float

    @property
    def factor(self) -> float:
        """Geometric mean of time here / time there."""
        return float(np.sqrt(self.edt_s / REFERENCE_EDT_S * self.sort_s / REFERENCE_SORT_S))


def calibrate(runs: int = 7) -> Calibration:
    """Run both jobs; about half a second."""
    rng = np.random.default_rng(7)
    occupied = rng.random((100, 100, 60)) < 0.02
    keys = rng.random(1_000_000)
    return Calibration(
        edt_s=_median_s(lambda: ndimage.distance_transform_edt(~occupied), runs),
        sort_s=_median_s(lambda: np.sort(keys), runs),
    )


def _median_s(job: Callable[[], object], runs: int) -> float:
    took_s = []
    for _ in range(runs):
        began_s = time.perf_counter()
        job()
        took_s.append(time.perf_counter() - began_s)
    return float(np.median(took_s))
