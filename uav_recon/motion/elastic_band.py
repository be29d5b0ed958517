"""Elastic band: a path as a cubic B-spline in (x, y, z, yaw, camera pitch).

The B-spline is uniform. One span stands for about SPAN_S of flight at full speed, whichever of the five coordinates needs
it, so a turn on the spot is a path like any other. The band starts as the polyline, which rounds each corner by some
centimetres, and is then relaxed: it takes the shape of least bending that keeps its clearance and passes each view within
the tolerance.
Bending energy after Terzopoulos and others, "Elastically deformable models" (1987), and Quinlan and Khatib (1993).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.motion.clearance import ClearanceMap, clearance_at
from uav_recon.motion.sight_forecast import SightForecast
from uav_recon.motion.yaw_policy import AT_VIEWS, YawPolicy
from uav_recon.types.frames import AnyArray, BoolArray, FloatArray, IntArray
from uav_recon.types.tasks import Viewpoint

SPAN_M = 0.15  # longest span of the spline in space ...
SPAN_S = 0.15  # ... and in time, at full speed
TENSION = 0.2  # weight of length against bending, per span
VIEW_TURN_WEIGHT = 0.3  # weight of turning at a view against bending
SWEEPS = 40
OVER_RELAXATION = 1.6  # over-relaxation factor: overshooting steps converge sooner (Young 1954)
CONVERGED = 5e-4  # largest move of a converged band, metres and radians
SAME_M = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class PathCourse:
    """A path as vertices (V, 5) from its start, with its views and stops.

    view_vertex: (K,) vertex of each view. stop: (V,) marks the vertices at which the vehicle stops.
    """

    vertex: FloatArray
    view_vertex: IntArray
    stop: BoolArray

    @staticmethod
    def through(
        start: FloatArray, legs: Sequence[FloatArray], views: Sequence[Viewpoint], yaw_policy: YawPolicy = AT_VIEWS,
        forecast: SightForecast | None = None,
    ) -> PathCourse:  # fmt: skip
        """Return the course through the waypoints (Ni, 3) of each leg to its view.

        Yaw changes along a leg as ``yaw_policy`` defines, and on the spot by the smaller turn. forecast: at the start.
        """
        vertices, reached = [start], []
        for leg, view in zip(legs, views, strict=True):
            begin = vertices[-1]
            way = [begin[:3]]
            for point in (*leg, view.position_world):
                if np.abs(point - way[-1]).max() > SAME_M:
                    way.append(point)
            turn_rad = (view.yaw_rad - begin[3] + math.pi) % (2 * math.pi) - math.pi
            goal = np.array([*view.position_world, begin[3] + turn_rad, view.pitch_down_rad])
            if len(way) == 1:
                if np.abs(goal - begin).max() > SAME_M or len(vertices) == 1:
                    vertices.append(goal)
            else:
                leg_vertices, forecast = yaw_policy.along(np.array(way), begin, goal, forecast)
                vertices += list(leg_vertices)
            reached.append(len(vertices) - 1)
        return PathCourse(np.array(vertices), np.array(reached, dtype=np.int64), np.zeros(len(vertices), dtype=np.bool_))

    def with_start(self, begin: FloatArray, stops: bool) -> PathCourse:
        """Return the course with a start (5,) added before it.

        stops: True if the vehicle stops at the previous start.
        """
        stop = np.concatenate(([False, stops], self.stop[1:]))
        return PathCourse(np.vstack([begin, self.vertex]), self.view_vertex + 1, stop)

    def with_stops(self, stop: BoolArray) -> PathCourse:
        """Return the course with each marked inner vertex (V,) repeated three times.

        The band passes such a vertex exactly and stops there.
        """
        stop = stop.copy()
        stop[[0, -1]] = False
        times = np.where(stop, 3, 1)
        middle = np.cumsum(times) - 1 - stop
        return PathCourse(np.repeat(self.vertex, times, axis=0), middle[self.view_vertex], np.repeat(stop, times))


@dataclass(frozen=True, slots=True, eq=False)
class ElasticBand:
    """A curve of n spans with control points (n + 3, 5), from control[1] to control[-2].

    held: (n + 3,) marks control points that must not move. view_node: (K,) span at whose start each view is passed (n for the
    end).
    """

    control: FloatArray
    view_node: IntArray
    held: BoolArray

    @staticmethod
    def along(course: PathCourse, span_rad: float, before: FloatArray | None) -> ElasticBand:
        """Return the band with even spans along each edge of the course.

        span_rad: max. turn of one span. before: (5,) position one span before the course, for a band that is entered in motion.
        """
        step = np.abs(np.diff(course.vertex, axis=0))
        length_m = np.sqrt(np.sum(step[:, :3] ** 2, axis=1))
        wanted = np.maximum(length_m / SPAN_M, np.max(step[:, 3:], axis=1) / span_rad)
        pieces = np.maximum(np.ceil(wanted - 1e-9), 1.0).astype(np.int64)
        edge = np.repeat(np.arange(len(pieces)), pieces)
        node = np.concatenate(([0], np.cumsum(pieces)))
        share = ((np.arange(len(edge)) - node[edge] + 1.0) / pieces[edge])[:, None]
        inner = np.vstack([course.vertex[:1], course.vertex[edge] * (1.0 - share) + course.vertex[edge + 1] * share])
        if before is not None:
            inner, node = np.vstack([before, inner]), node + 1
        control = np.vstack([2 * inner[0] - inner[1], inner, 2 * inner[-1] - inner[-2]])
        held = np.zeros(len(control), dtype=np.bool_)
        held[node + 1] = course.stop
        held[[0, 1, -2, -1]] = True
        held[2] |= before is not None
        return ElasticBand(control, node[course.view_vertex], held)

    def relaxed(
        self, course: PathCourse, clearance_map: ClearanceMap, wanted_m: float, min_m: float, tolerance: tuple[float, float]
    ) -> ElasticBand:
        """Return the band smoothed by relaxation.

        A control point moves in space only if its clearance is then at least ``wanted_m``, or if its clearance was at least
        ``min_m`` and does not decrease. tolerance: metres and radians by which the band may miss each view but the last, which
        is met exactly.
        """
        control = self.control.copy()
        view = np.full(len(control), -1, dtype=np.int64)
        view[self.view_node + 1] = course.view_vertex
        _relax(control, self.held, view, course.vertex, tolerance[0], tolerance[1], clearance_map, wanted_m, min_m)
        return ElasticBand(control, self.view_node, self.held)


@kernel
def mirror(control: AnyArray) -> None:
    """Set the outer control points so that the curve ends without bending.

    It then begins at the second and ends at the last but one control point.
    """
    last = len(control) - 2
    for d in range(5):
        control[0, d] = 2 * control[1, d] - control[2, d]
        control[last + 1, d] = 2 * control[last, d] - control[last - 1, d]


@kernel
def min_clearance(control: AnyArray, i: int, clearance_map: ClearanceMap, enough_m: float) -> float:
    """Return the least clearance at the nodes and span middles that depend on control point i.

    Stops at the first value below ``enough_m`` and returns it.
    """
    min_m = np.inf
    last = len(control) - 2
    for j in range(max(i - 1, 1), min(i + 1, last) + 1):
        x = (control[j - 1, 0] + 4 * control[j, 0] + control[j + 1, 0]) / 6
        y = (control[j - 1, 1] + 4 * control[j, 1] + control[j + 1, 1]) / 6
        z = (control[j - 1, 2] + 4 * control[j, 2] + control[j + 1, 2]) / 6
        min_m = min(min_m, clearance_at(clearance_map, x, y, z))
        if min_m < enough_m:
            return min_m
    for j in range(max(i - 2, 1), min(i + 1, last - 1) + 1):
        x = (control[j - 1, 0] + 23 * (control[j, 0] + control[j + 1, 0]) + control[j + 2, 0]) / 48
        y = (control[j - 1, 1] + 23 * (control[j, 1] + control[j + 1, 1]) + control[j + 2, 1]) / 48
        z = (control[j - 1, 2] + 23 * (control[j, 2] + control[j + 1, 2]) + control[j + 2, 2]) / 48
        min_m = min(min_m, clearance_at(clearance_map, x, y, z))
        if min_m < enough_m:
            return min_m
    return min_m


@kernel
def _off_view(control: AnyArray, j: int, target: AnyArray) -> float:
    """Return the distance of node j from a view's position."""
    x = (control[j - 1, 0] + 4 * control[j, 0] + control[j + 1, 0]) / 6 - target[0]
    y = (control[j - 1, 1] + 4 * control[j, 1] + control[j + 1, 1]) / 6 - target[1]
    z = (control[j - 1, 2] + 4 * control[j, 2] + control[j + 1, 2]) / 6 - target[2]
    return math.sqrt(x * x + y * y + z * z)


@kernel
def _wanted_move(control: AnyArray, view: AnyArray, i: int, move: AnyArray) -> None:
    """Compute the move of control point i to the least energy given its neighbours, times AHEAD."""
    last = len(control) - 2
    before, after = 1.0 if i - 1 > 1 else 0.0, 1.0 if i + 1 < last else 0.0
    for d in range(5):
        back = control[i - 2, d] - 2 * control[i - 1, d] + control[i, d]
        here = control[i - 1, d] - 2 * control[i, d] + control[i + 1, d]
        on = control[i, d] - 2 * control[i + 1, d] + control[i + 2, d]
        pull = before * back - (2 + TENSION) * here + after * on
        stiff = before + 4 + after + 2 * TENSION
        if d > 2 and view[i - 1] >= 0:
            pull += VIEW_TURN_WEIGHT * (control[i, d] - control[i - 2, d])
            stiff += VIEW_TURN_WEIGHT
        if d > 2 and view[i + 1] >= 0:
            pull += VIEW_TURN_WEIGHT * (control[i, d] - control[i + 2, d])
            stiff += VIEW_TURN_WEIGHT
        move[d] = -OVER_RELAXATION * pull / stiff


@kernel
def _turn_within(control: AnyArray, view: AnyArray, vertex: AnyArray, i: int, tolerance_rad: float, move: AnyArray) -> float:
    """Turn control point i within the views' tolerance; return the largest change of an angle.

    The angles are yaw and camera pitch.
    """
    most = 0.0
    for d in range(3, 5):
        for j in (i - 1, i + 1, i):
            if view[j] >= 0:
                weight = 4.0 / 6.0 if j == i else 1.0 / 6.0
                off = (control[j - 1, d] + 4 * control[j, d] + control[j + 1, d]) / 6 - vertex[view[j], d]
                low, high = (-tolerance_rad - off) / weight, (tolerance_rad - off) / weight
                if j != i:
                    low, high = min(low, 0.0), max(high, 0.0)
                move[d] = min(max(move[d], low), high)
        control[i, d] += move[d]
        most = max(most, abs(move[d]))
    return most


@kernel
def _relax(  # noqa: C901, PLR0912
    control: AnyArray, held: AnyArray, view: AnyArray, vertex: AnyArray, tolerance_m: float, tolerance_rad: float,
    clearance_map: ClearanceMap, wanted_m: float, min_m: float,
) -> None:  # fmt: skip
    """Minimise the bending energy by Gauss-Seidel iteration.

    Energy: sum |c[j-1] - 2 c[j] + c[j+1]|² + TENSION sum |c[j+1] - c[j]|² + VIEW_TURN_WEIGHT sum of turning² at the views.
    A move that would lose clearance or leave a view is tried in part, then axis by axis (walls mostly lie along the axes).
    """
    last = len(control) - 2
    move, old = np.zeros(5), np.zeros(3)
    for _ in range(SWEEPS):
        most = 0.0
        for i in range(2, last):
            if held[i]:
                continue
            _wanted_move(control, view, i, move)
            most = max(most, _turn_within(control, view, vertex, i, tolerance_rad, move))
            mirror(control)
            if move[0] ** 2 + move[1] ** 2 + move[2] ** 2 < (0.1 * CONVERGED) ** 2:
                continue
            for d in range(3):
                old[d] = control[i, d]
            had_m = -1.0
            for attempt in range(6):
                for d in range(3):
                    share = (1.0, 0.5, 0.25)[attempt] if attempt < 3 else (1.0 if d == attempt - 3 else 0.0)
                    control[i, d] = old[d] + share * move[d]
                mirror(control)
                sees = True
                for j in range(i - 1, i + 2):
                    sees = sees and (view[j] < 0 or _off_view(control, j, vertex[view[j]]) <= tolerance_m)
                if sees and min_clearance(control, i, clearance_map, wanted_m) >= wanted_m:
                    break
                has_m = min_clearance(control, i, clearance_map, 0.0) if sees else 0.0
                for d in range(3):
                    control[i, d] = old[d]
                mirror(control)
                if not sees:
                    continue
                if had_m < 0.0:
                    had_m = min_clearance(control, i, clearance_map, 0.0)
                if had_m >= min_m and has_m >= had_m:
                    for d in range(3):
                        share = (1.0, 0.5, 0.25)[attempt] if attempt < 3 else (1.0 if d == attempt - 3 else 0.0)
                        control[i, d] = old[d] + share * move[d]
                    mirror(control)
                    break
            for d in range(3):
                most = max(most, abs(control[i, d] - old[d]))
        if most < CONVERGED:
            break
