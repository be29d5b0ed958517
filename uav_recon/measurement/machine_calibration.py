"""Speed of this machine relative to the machine of the reference figures.

Two fixed single-threaded jobs resemble voxel work: an exact Euclidean distance transform and a sort. Times measured here
are divided by the geometric mean of (time here / time there) before they are compared with a reference figure.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

# medians of the two jobs on the reference machine: properties of that machine, not of this project
REFERENCE_EDT_S = 0.0375
REFERENCE_SORT_S = 0.0045


@dataclass(frozen=True, slots=True)
class Calibration:
    """Median seconds of the two jobs here, as wall-clock time and as processor time.

    On a busy machine the processor time is shorter than the wall-clock time.
    """

    edt_s: float
    sort_s: float
    edt_cpu_s: float
    sort_cpu_s: float

    @property
    def factor(self) -> float:
        """Return the geometric mean of (time here / time there), the divisor of wall-clock times.

        Above 1 this machine is slower.
        """
        return _mean_ratio(self.edt_s, self.sort_s)

    @property
    def cpu_factor(self) -> float:
        """Return the divisor of processor times."""
        return _mean_ratio(self.edt_cpu_s, self.sort_cpu_s)


def calibrate(runs: int = 7) -> Calibration:
    """Run both jobs. Takes about half a second."""
    rng = np.random.default_rng(7)
    occupied = rng.random((100, 100, 60)) < 0.02
    keys = rng.random(1_000_000)
    edt_s, edt_cpu_s = _median_s(lambda: ndimage.distance_transform_edt(~occupied), runs)
    sort_s, sort_cpu_s = _median_s(lambda: np.sort(keys), runs)
    return Calibration(edt_s, sort_s, edt_cpu_s, sort_cpu_s)


def _mean_ratio(edt_s: float, sort_s: float) -> float:
    return float(np.sqrt(edt_s / REFERENCE_EDT_S * sort_s / REFERENCE_SORT_S))


def _median_s(job: Callable[[], object], runs: int) -> tuple[float, float]:
    took_s = []
    for _ in range(runs):
        began_s, began_cpu_s = time.perf_counter(), time.thread_time()
        job()
        took_s.append((time.perf_counter() - began_s, time.thread_time() - began_cpu_s))
    wall_s, cpu_s = np.median(took_s, axis=0)
    return float(wall_s), float(cpu_s)
