"""Speed of this machine relative to the machine of the reference figures.

One fixed single-threaded job resembles voxel work and is the same machine code on every processor: an exact Euclidean
distance transform (SciPy, plain C). A function that a library dispatches by processor, such as a sort of NumPy, would not
do. Times measured here are divided by (time here / time there) before they are compared with a reference figure; the raw
time is always shown beside.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

# processor time of the job on the reference machine: a property of that machine, not of this project
REFERENCE_S = 0.0375


@dataclass(frozen=True, slots=True)
class MachineSpeed:
    """Median seconds of the job here, as wall-clock time and as processor time.

    On a busy machine the processor time is shorter than the wall-clock time.
    """

    wall_s: float
    cpu_s: float

    @property
    def slowdown(self) -> float:
        """Return time here / time there, the divisor of wall-clock times.

        Above 1 this machine is slower.
        """
        return self.wall_s / REFERENCE_S

    @property
    def cpu_slowdown(self) -> float:
        """Return the divisor of processor times."""
        return self.cpu_s / REFERENCE_S


def measure_machine_speed(runs: int = 7) -> MachineSpeed:
    """Run the job and return its median times. Takes about half a second."""
    occupied = np.random.default_rng(7).random((100, 100, 60)) < 0.02
    return _median(lambda: ndimage.distance_transform_edt(~occupied), runs)


def _median(job: Callable[[], object], runs: int) -> MachineSpeed:
    took_s = []
    for _ in range(runs):
        began_s, began_cpu_s = time.perf_counter(), time.thread_time()
        job()
        took_s.append((time.perf_counter() - began_s, time.thread_time() - began_cpu_s))
    wall_s, cpu_s = np.median(took_s, axis=0)
    return MachineSpeed(float(wall_s), float(cpu_s))
