"""Time-optimal parameterization of a spline within velocity and acceleration bounds.

The bounds hold for each coordinate. With s the curve's parameter and x = ds/dt squared, every bound is convex in
(x, d²s/dt²), so one pass back over the nodes finds the largest x from which the rest can still be flown, and one pass
forward takes the largest allowed value: Pham and Pham, "A new approach to time-optimal path parameterization based on
reachability analysis" (2018).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, FloatArray

PER_SPAN = 6  # nodes in each span
MAX_PACE = 10.0  # spans a second, max. pace: a band that does not move has a finite duration
FEEDFORWARD_OVERSHOOT_S = (
    0.46  # s, speed that an autopilot gains per acceleration setpoint that it keeps: below 1 / MPC_XY_VEL_P_ACC
)
HALVINGS = 16
TINY = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A spline at its M nodes.

    place, slope, bend: (M, 5) value, first and second derivative by span. along_m: (M,) length from the start in metres.
    """

    place: FloatArray
    slope: FloatArray
    bend: FloatArray
    along_m: FloatArray

    @staticmethod
    def of(control: FloatArray) -> Curve:
        """Return the nodes of a spline with control points (n + 3, 5)."""
        count = (len(control) - 3) * PER_SPAN + 1
        place, slope, bend, along_m = (np.empty((count, 5)), np.empty((count, 5)), np.empty((count, 5)), np.empty(count))
        _evaluate(control, place, slope, bend, along_m)
        return Curve(place, slope, bend, along_m)


@kernel
def _evaluate(control: AnyArray, place: AnyArray, slope: AnyArray, bend: AnyArray, along_m: AnyArray) -> None:
    spans = len(control) - 3
    for n in range(len(place)):
        span = min(n // PER_SPAN, spans - 1)
        u = (n - span * PER_SPAN) / PER_SPAN
        for d in range(5):
            a, b, c, e = control[span, d], control[span + 1, d], control[span + 2, d], control[span + 3, d]
            before, here, after = a - 2 * b + c, b - 2 * c + e, c - a
            rise = here - before
            place[n, d] = (a + 4 * b + c) / 6 + u * (0.5 * after + u * (0.5 * before + u * rise / 6))
            slope[n, d] = 0.5 * after + u * (before + 0.5 * u * rise)
            bend[n, d] = before + u * rise
    along_m[0] = 0.0
    for n in range(1, len(place)):
        dx, dy, dz = place[n, 0] - place[n - 1, 0], place[n, 1] - place[n - 1, 1], place[n, 2] - place[n - 1, 2]
        along_m[n] = along_m[n - 1] + math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def _within(slope: float, bend: float, bound: float, x: float, low: float, high: float) -> tuple[float, float]:
    """Return the part of [low, high] where |bend x + slope u| <= bound.

    The interval is empty (low > high) if there is none.
    """
    if abs(slope) < 1e-9:
        return (low, high) if abs(bend) * x <= bound + 1e-9 else (1.0, -1.0)
    first, second = (-bound - bend * x) / slope, (bound - bend * x) / slope
    return max(low, min(first, second)), min(high, max(first, second))


@kernel
def _change(slope: AnyArray, bend: AnyArray, acceleration: float, yaw_acceleration: float, x: float) -> tuple[float, float]:
    """Return the least and greatest d²s/dt² at a node with x = (ds/dt)².

    The interval is empty (low > high) if x is too large.
    """
    a = slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2
    b = slope[0] * bend[0] + slope[1] * bend[1] + slope[2] * bend[2]
    c = bend[0] ** 2 + bend[1] ** 2 + bend[2] ** 2
    low, high = -1e9, 1e9
    if a < TINY:
        if c * x * x > acceleration**2:
            return 1.0, -1.0
    else:
        rest = a * acceleration**2 - max(a * c - b * b, 0.0) * x * x
        if rest < 0.0:
            return 1.0, -1.0
        half = math.sqrt(rest)
        low, high = (-b * x - half) / a, (-b * x + half) / a
    low, high = _within(slope[3], bend[3], yaw_acceleration, x, low, high)
    return _within(slope[4], bend[4], yaw_acceleration, x, low, high)


@kernel
def _reaches(
    slope: AnyArray, bend: AnyArray, acceleration: float, yaw_acceleration: float, x: float, width: float, max_x: float
) -> bool:
    """Return True if an allowed d²s/dt² brings x into [0, max_x] at the next node.

    If it is true for one x, it is true for all smaller ones.
    """
    least, most = _change(slope, bend, acceleration, yaw_acceleration, x)
    return least <= most and x + width * least <= max_x and x + width * most >= 0.0


@kernel
def _gain(slope: AnyArray, bend: AnyArray, max_speed_mps: float, x: float) -> float:
    """Return the greatest d²s/dt² (1/s²) within the speed limit.

    The limit is speed + FEEDFORWARD_OVERSHOOT_S * dv/dt <= max_speed_mps.
    """
    a = slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2
    if a < TINY or max_speed_mps == np.inf:
        return 1e9
    b = slope[0] * bend[0] + slope[1] * bend[1] + slope[2] * bend[2]
    flat = math.sqrt(a)
    gain_mps2 = (max_speed_mps - flat * math.sqrt(x)) / FEEDFORWARD_OVERSHOOT_S
    return float((gain_mps2 * flat - b * x) / a)


@kernel
def fastest(
    slope: AnyArray, bend: AnyArray, cap: AnyArray, max_speed_mps: AnyArray, max_acceleration_mps2: AnyArray,
    yaw_acceleration: float, first: float, x: AnyArray,
) -> bool:  # fmt: skip
    """Fill x (M,), the squared pace at each node: ``first`` at the first, 0 at the last.

    Returns False if ``first`` is too fast. max_speed_mps (M,): limit of the speed plus FEEDFORWARD_OVERSHOOT_S times the
    acceleration. max_acceleration_mps2 (M,): limit of the acceleration.
    """
    last = len(cap) - 1
    width = 2.0 / PER_SPAN
    x[last] = 0.0
    for n in range(last - 1, -1, -1):
        low, high = 0.0, cap[n]
        if not _reaches(slope[n], bend[n], max_acceleration_mps2[n], yaw_acceleration, high, width, x[n + 1]):
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                if _reaches(slope[n], bend[n], max_acceleration_mps2[n], yaw_acceleration, middle, width, x[n + 1]):
                    low = middle
                else:
                    high = middle
            high = low
        x[n] = high
    if first > x[0] * (1.0 + 1e-6):
        return False
    x[0] = first
    for n in range(last):
        least, most = _change(slope[n], bend[n], max_acceleration_mps2[n], yaw_acceleration, x[n])
        most = max(min(most, _gain(slope[n], bend[n], max_speed_mps[n], x[n])), least)
        x[n + 1] = min(x[n + 1], max(x[n] + width * most, 1e-9))
    x[last] = 0.0
    return True


@kernel
def node_times(x: AnyArray, times: AnyArray) -> None:
    """Fill ``times`` (M,) with the seconds at which each node is reached."""
    times[0] = 0.0
    for n in range(1, len(x)):
        times[n] = times[n - 1] + 2.0 / PER_SPAN / max(math.sqrt(x[n - 1]) + math.sqrt(x[n]), 1e-6)


@kernel
def sampled(control: AnyArray, x: AnyArray, times: AnyArray, step_s: float, out: AnyArray) -> None:
    """Fill ``out`` (N, 5) with the curve at each step from its first instant on.

    After the last instant it stays at its end.
    """
    spans = len(control) - 3
    node, last = 0, len(x) - 1
    for n in range(len(out)):
        now_s = n * step_s
        while node < last and now_s >= times[node + 1]:
            node += 1
        s = node / PER_SPAN
        if node < last:
            into_s, pace = now_s - times[node], math.sqrt(x[node])
            s += into_s * (pace + 0.25 * PER_SPAN * (x[node + 1] - x[node]) * into_s)
            s = min(s, (node + 1) / PER_SPAN)
        span = min(int(s), spans - 1)
        u = s - span
        for d in range(5):
            a, b, c, e = control[span, d], control[span + 1, d], control[span + 2, d], control[span + 3, d]
            before, here = a - 2 * b + c, b - 2 * c + e
            out[n, d] = (a + 4 * b + c) / 6 + u * (0.5 * (c - a) + u * (0.5 * before + u * (here - before) / 6))


@kernel
def smoothed(samples: AnyArray, box: int, out: AnyArray) -> None:
    """Apply two box averages of odd width to samples (N, D); out: (N - 2 box + 2, D).

    An average keeps every bound on its samples.
    """
    middle = np.empty((len(samples) - box + 1, samples.shape[1]))
    for source, target in ((samples, middle), (middle, out)):
        for d in range(samples.shape[1]):
            total = 0.0
            for n in range(box):
                total += source[n, d]
            target[0, d] = total / box
            for n in range(1, len(target)):
                total += source[n + box - 1, d] - source[n - 1, d]
                target[n, d] = total / box
