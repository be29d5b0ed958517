"""The way as an elastic band: control points of a uniform cubic B-spline in (x, y, z, yaw, camera pitch).

One span of the spline stands for about SPAN_S of flight at full pace, whichever of the five coordinates needs it, so turning
on the spot is a way like any other. The band starts as the polyline, which rounds each corner by some centimetres, and is
then relaxed: it takes the shape of least bending that keeps the room it has and passes each view within tolerance.
Bending energy after Terzopoulos and others, "Elastically deformable models" (1987), and Quinlan and Khatib (1993).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.motion.clearance import ROOT, ClearanceMap, room_at
from uav_recon.motion.yaw_policy import AT_VIEWS, YawPolicy
from uav_recon.types.frames import AnyArray, BoolArray, FloatArray, IntArray
from uav_recon.types.tasks import Viewpoint

SPAN_M = 0.15  # longest span of the spline in space ...
SPAN_S = 0.15  # ... and in time, at full speed
TENSION = 0.2  # of length against bending, per span
CALM = 0.3  # of turning at a view against bending
SWEEPS = 40
AHEAD = 1.6  # of each step of the relaxation: it overshoots, and converges sooner (Young 1954)
SETTLED = 5e-4  # metres and radians
SAME_M = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class PathCourse:
    """Vertices (V, 5) of the way from its start on; at which vertex each view (K,) stands; which of them are stops (V,)."""

    vertex: FloatArray
    view_vertex: IntArray
    stop: BoolArray

    @staticmethod
    def through(
        start: FloatArray, legs: Sequence[FloatArray], views: Sequence[Viewpoint], gaze: YawPolicy = AT_VIEWS
    ) -> PathCourse:
        """Through the waypoints of each leg (Ni, 3) to its view; yaw goes as ``gaze`` has it, or else the short way round."""
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
                vertices += list(gaze.along(np.array(way), begin, goal))
            reached.append(len(vertices) - 1)
        return PathCourse(np.array(vertices), np.array(reached, dtype=np.int64), np.zeros(len(vertices), dtype=np.bool_))

    def after(self, begin: FloatArray, stops: bool) -> PathCourse:
        """The same, reached from a place (5,) before it; ``stops``: to a stand where it began until now."""
        stop = np.concatenate(([False, stops], self.stop[1:]))
        return PathCourse(np.vstack([begin, self.vertex]), self.view_vertex + 1, stop)

    def with_stops(self, stop: BoolArray) -> PathCourse:
        """The same, each marked inner vertex (V,) three times over: the band goes exactly through it and comes to a stand."""
        stop = stop.copy()
        stop[[0, -1]] = False
        times = np.where(stop, 3, 1)
        middle = np.cumsum(times) - 1 - stop
        return PathCourse(np.repeat(self.vertex, times, axis=0), middle[self.view_vertex], np.repeat(stop, times))


@dataclass(frozen=True, slots=True, eq=False)
class ElasticBand:
    """control (n + 3, 5): a curve of n spans that begins at control[1] and ends at control[-2]; held (n + 3,): those that must
    stay; view_node (K,): the span at whose start each view is passed (n for the end)."""

    control: FloatArray
    view_node: IntArray
    held: BoolArray

    @staticmethod
    def along(course: PathCourse, span_rad: float, before: FloatArray | None) -> ElasticBand:
        """Even spans along each edge. before: place (5,) one span before the course, of a band that is entered in motion."""
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
        self, course: PathCourse, space: ClearanceMap, wanted_m: float, min_m: float, tolerance: tuple[float, float]
    ) -> ElasticBand:
        """The band pulled smooth. What has less than ``min_m`` of room does not move; nothing comes under ``wanted_m``, or
        under what it has. tolerance: metres and radians off each view but the last, which is met exactly."""
        control = self.control.copy()
        view = np.full(len(control), -1, dtype=np.int64)
        view[self.view_node + 1] = course.view_vertex
        _relax(
            control, self.held, view, course.vertex, tolerance[0], tolerance[1], space.distance2, space.frame,
            space.resolution_m, ROOT, wanted_m, min_m,
        )  # fmt: skip
        return ElasticBand(control, self.view_node, self.held)


@kernel
def mirror(control: AnyArray) -> None:
    """The outer control points, so that the curve ends at the second and the last but one, without bending there."""
    last = len(control) - 2
    for d in range(5):
        control[0, d] = 2 * control[1, d] - control[2, d]
        control[last + 1, d] = 2 * control[last, d] - control[last - 1, d]


@kernel
def min_clearance(
    control: AnyArray, i: int, distance2: AnyArray, frame: AnyArray, resolution_m: float, root: AnyArray, enough_m: float
) -> float:
    """Least room at the nodes and middles of spans that control point i bears on; stops at the first under ``enough_m``."""
    min_m = np.inf
    last = len(control) - 2
    for j in range(max(i - 1, 1), min(i + 1, last) + 1):
        x = (control[j - 1, 0] + 4 * control[j, 0] + control[j + 1, 0]) / 6
        y = (control[j - 1, 1] + 4 * control[j, 1] + control[j + 1, 1]) / 6
        z = (control[j - 1, 2] + 4 * control[j, 2] + control[j + 1, 2]) / 6
        min_m = min(min_m, room_at(distance2, frame, resolution_m, root, x, y, z))
        if min_m < enough_m:
            return min_m
    for j in range(max(i - 2, 1), min(i + 1, last - 1) + 1):
        x = (control[j - 1, 0] + 23 * (control[j, 0] + control[j + 1, 0]) + control[j + 2, 0]) / 48
        y = (control[j - 1, 1] + 23 * (control[j, 1] + control[j + 1, 1]) + control[j + 2, 1]) / 48
        z = (control[j - 1, 2] + 23 * (control[j, 2] + control[j + 1, 2]) + control[j + 2, 2]) / 48
        min_m = min(min_m, room_at(distance2, frame, resolution_m, root, x, y, z))
        if min_m < enough_m:
            return min_m
    return min_m


@kernel
def _off_view(control: AnyArray, j: int, target: AnyArray) -> float:
    """Distance of node j from a view's place."""
    x = (control[j - 1, 0] + 4 * control[j, 0] + control[j + 1, 0]) / 6 - target[0]
    y = (control[j - 1, 1] + 4 * control[j, 1] + control[j + 1, 1]) / 6 - target[1]
    z = (control[j - 1, 2] + 4 * control[j, 2] + control[j + 1, 2]) / 6 - target[2]
    return math.sqrt(x * x + y * y + z * z)


@kernel
def _wanted_move(control: AnyArray, view: AnyArray, i: int, move: AnyArray) -> None:
    """Where control point i would go for the least energy, given its neighbours, and a bit beyond."""
    last = len(control) - 2
    before, after = 1.0 if i - 1 > 1 else 0.0, 1.0 if i + 1 < last else 0.0
    for d in range(5):
        back = control[i - 2, d] - 2 * control[i - 1, d] + control[i, d]
        here = control[i - 1, d] - 2 * control[i, d] + control[i + 1, d]
        on = control[i, d] - 2 * control[i + 1, d] + control[i + 2, d]
        pull = before * back - (2 + TENSION) * here + after * on
        stiff = before + 4 + after + 2 * TENSION
        if d > 2 and view[i - 1] >= 0:
            pull += CALM * (control[i, d] - control[i - 2, d])
            stiff += CALM
        if d > 2 and view[i + 1] >= 0:
            pull += CALM * (control[i, d] - control[i + 2, d])
            stiff += CALM
        move[d] = -AHEAD * pull / stiff


@kernel
def _turn_within(control: AnyArray, view: AnyArray, vertex: AnyArray, i: int, tolerance_rad: float, move: AnyArray) -> float:
    """Move yaw and pitch of control point i as far as the views allow; returns by how much."""
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
def _relax(
    control: AnyArray, held: AnyArray, view: AnyArray, vertex: AnyArray, tolerance_m: float, tolerance_rad: float,
    distance2: AnyArray, frame: AnyArray, resolution_m: float, root: AnyArray, wanted_m: float, min_m: float,
) -> None:  # fmt: skip
    """Gauss-Seidel on sum |c[j-1] - 2 c[j] + c[j+1]|² + TENSION sum |c[j+1] - c[j]|² + CALM sum of turning² at the views.

    A move that would cost room or leave a view is tried in part, then axis by axis (walls mostly lie along the axes).
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
            if move[0] ** 2 + move[1] ** 2 + move[2] ** 2 < (0.1 * SETTLED) ** 2:
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
                if sees and min_clearance(control, i, distance2, frame, resolution_m, root, wanted_m) >= wanted_m:
                    break
                has_m = min_clearance(control, i, distance2, frame, resolution_m, root, 0.0) if sees else 0.0
                for d in range(3):
                    control[i, d] = old[d]
                mirror(control)
                if not sees:
                    continue
                if had_m < 0.0:
                    had_m = min_clearance(control, i, distance2, frame, resolution_m, root, 0.0)
                if had_m >= min_m and has_m >= had_m:
                    for d in range(3):
                        share = (1.0, 0.5, 0.25)[attempt] if attempt < 3 else (1.0 if d == attempt - 3 else 0.0)
                        control[i, d] = old[d] + share * move[d]
                    mirror(control)
                    break
            for d in range(3):
                most = max(most, abs(control[i, d] - old[d]))
        if most < SETTLED:
            break
