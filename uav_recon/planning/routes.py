"""Ways between the vehicle and the tasks, and what they cost in time (paper, section III-C, with turning added)."""

from __future__ import annotations

import numpy as np

from uav_recon.planning.proposal import Proposal, Situation
from uav_recon.planning.search import chain, departure, distances_from, length_of, line_is_open, pull
from uav_recon.types.frames import FloatArray, IntArray

LEAVING_TURN_SHARE = 0.25  # of the time to turn from a view's heading into the direction of flight: the camera should lead
BRAKING_MPS2 = 0.8  # changing the present velocity costs time too


class Routes:
    """Shortest pulled ways between node 0 (the vehicle) and nodes 1..N (the proposals' viewpoints).

    lengths_m: (N+1, N+1), symmetric. departures: (N+1, N+1, 3), unit directions in which the way from i to j leaves i, zero
    where it does not move. Ways are exact 26-connected paths on the flyable voxels, pulled straight; where the straight line
    is open it is the way.
    """

    def __init__(self, situation: Situation, position_world: FloatArray, proposals: list[Proposal]) -> None:
        self._space = situation.space
        self._ways: dict[tuple[int, int], FloatArray] = {}
        cells = np.array([situation.exit_cells[-1]] + [proposal.cell for proposal in proposals], dtype=np.int64)
        self._points = self._space.centre(cells)
        self._from_vehicle(situation, position_world, cells)
        for i in range(1, len(cells)):
            self._from_task(i, cells)
        self.lengths_m, self.departures = self._measure()

    def way_world(self, i: int, j: int) -> FloatArray:
        """Polyline (M, 3) in world from node i to node j, both ends included; one point if they are the same."""
        way = self._ways[(i, j)] if (i, j) in self._ways else self._ways[(j, i)][::-1]
        moved = np.concatenate(([True], np.any(np.abs(np.diff(way, axis=0)) > 1e-9, axis=1)))
        return np.ascontiguousarray(self._space.world(way[moved]))

    def _measure(self) -> tuple[FloatArray, FloatArray]:
        count = len(self._points)
        lengths_m, departures = np.zeros((count, count)), np.zeros((count, count, 3))
        for (i, j), way in self._ways.items():
            lengths_m[i, j] = lengths_m[j, i] = length_of(way) * self._space.grid.resolution_m
            departures[i, j], departures[j, i] = departure(way), departure(way[::-1])
        return lengths_m, departures

    def _from_vehicle(self, situation: Situation, position_world: FloatArray, cells: IntArray) -> None:
        position = self._space.padded(position_world)
        out = self._space.centre(situation.exit_cells[1:]) if len(situation.exit_cells) > 1 else np.zeros((0, 3))
        for j in range(1, len(cells)):
            way = self._space.centre(chain(situation.previous, int(cells[j])))
            if len(out):  # leaving forbidden space: cell by cell, then straight
                self._ways[(0, j)] = np.concatenate([position[None], out[:-1], pull(self._space.mask, way)])
            else:
                self._ways[(0, j)] = pull(self._space.mask, np.concatenate([position[None], way]))

    def _from_task(self, i: int, cells: IntArray) -> None:
        mask = self._space.mask
        blocked = []
        for j in range(i + 1, len(cells)):
            if line_is_open(mask, self._points[i], self._points[j]):
                self._ways[(i, j)] = self._points[[i, j]]
            else:
                blocked.append(j)
        if blocked:
            _, previous = distances_from(mask, int(cells[i]), cells[blocked], np.inf)
            for j in blocked:
                self._ways[(i, j)] = pull(mask, self._space.centre(chain(previous, int(cells[j]))))


def time_costs(
    routes: Routes,
    proposals: list[Proposal],
    yaw_rad: float,
    velocity_world_mps: FloatArray,
    speed_mps: float,
    yaw_rate_radps: float,
) -> FloatArray:
    """Seconds (N+1, N+1) from node to node, asymmetric: the longer of flying and turning, and what leaving costs.

    Leaving a view against its heading costs a share of that turn; leaving the vehicle's place costs the change of velocity.
    """
    yaws = np.array([yaw_rad] + [proposal.task.viewpoint.yaw_rad for proposal in proposals])
    departures = routes.departures
    turn = np.abs(_wrapped(yaws[None, :] - yaws[:, None]))
    bearing = np.arctan2(departures[:, :, 1], departures[:, :, 0])
    moves_flat = np.linalg.norm(departures[:, :, :2], axis=2) > 0.1
    leaving = np.where(moves_flat, np.abs(_wrapped(bearing - yaws[:, None])), 0.0)
    costs = np.maximum(routes.lengths_m / speed_mps, turn / yaw_rate_radps) + LEAVING_TURN_SHARE * leaving / yaw_rate_radps
    speed_now = float(np.linalg.norm(velocity_world_mps))
    costs[0] += (speed_now - departures[0] @ velocity_world_mps) / BRAKING_MPS2
    return np.asarray(costs, dtype=np.float64)


def _wrapped(angle_rad: FloatArray) -> FloatArray:
    return (angle_rad + np.pi) % (2 * np.pi) - np.pi
