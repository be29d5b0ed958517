"""Views of frontiers: a full spherical shell around each cluster, ray-cast gain (paper, section III-A).

A cell counts as seen when one of its UNKNOWN neighbours is in the frustum, in range, and reached through known-free voxels
alone: that neighbour is what a look from there decides.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.geometry.jit import kernel
from uav_recon.geometry.traversal import is_visible
from uav_recon.planning.camera import CameraGeometry, Sight, aim, in_view, sight
from uav_recon.planning.frontiers import FACES, Frontier
from uav_recon.planning.proposal import Proposal, Situation
from uav_recon.planning.shell import shell
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.tasks import Task, TaskKind, Viewpoint

__all__ = ["FrontierProposals", "FrontierViews", "explore_shell", "quality_steps", "shell"]

MIN_SEEN = 4  # cells: less is not worth a stop
PROBE_CELLS = 8  # cells tried from every candidate ...
FULL_VIEWS = 24  # ... and candidates that are then counted in full
COVERED_SHARE = 0.7  # of what its own view sees: a frontier that another view shows so well needs no stop of its own
TRAVEL_DISCOUNT_PER_M = 0.03  # of two views that see the same, the nearer one
BATCH = 40  # frontiers viewed at once, the nearest first
_FALLBACK_RADII_M = (0.5, 0.65)  # tight rooms
_FAR_RADII_M = (2.4, 3.0, 3.6, 4.2)  # a fixed mount sees high and low cells from afar only
# why a frontier has no view
FOUND, TOO_NARROW, OUT_OF_SIGHT, UNREACHABLE = range(4)
REASONS = {TOO_NARROW: "too narrow", OUT_OF_SIGHT: "out of the camera's sight", UNREACHABLE: "not reachable"}


def explore_shell(config: PlannerConfig, camera: CameraGeometry, resolution_m: float) -> FloatArray:
    """[d_r, d_f], nearer for tight rooms, farther for what is too high or too low for a fixed mount."""
    far = tuple(r for r in _FAR_RADII_M if config.shell_max_m < r < camera.range_m - 0.2)
    near = tuple(r for r in _FALLBACK_RADII_M if r < config.shell_min_m)
    return shell(camera, near + tuple(np.linspace(config.shell_min_m, config.shell_max_m, 4)) + far, resolution_m)


def quality_steps(config: PlannerConfig, resolution_m: float) -> FloatArray:
    """(d_r, d_f, 3 m) in voxels: where the quality of a view changes."""
    return np.array([config.shell_min_m, config.shell_max_m, 3.0]) / resolution_m


@kernel
def _quality(distance: float, steps: FloatArray) -> float:
    if distance < steps[0] - 1.0:
        return 0.8
    if distance <= steps[1] + 1.0:
        return 1.0
    return 0.9 if distance <= steps[2] else 0.9 * steps[2] / distance


@kernel
def _sees_cell(state: ByteArray, lens: FloatArray, line: Sight, cell: IntArray, bits: int, faces: IntArray) -> bool:
    for f in range(6):
        if bits & (1 << f):
            x, y, z = cell[0] + faces[f, 0] + 0.5, cell[1] + faces[f, 1] + 0.5, cell[2] + faces[f, 2] + 0.5
            if in_view(lens, line, x, y, z) and is_visible(state, line[0], line[1], line[2], x, y, z, 0.0):
                return True
    return False


@kernel
def _shows(
    state: ByteArray, lens: FloatArray, line: Sight, cells: IntArray, bits: ByteArray, faces: IntArray, share: float
) -> bool:
    """Tell whether a view shows at least a share of the cells; stops as soon as it cannot."""
    may_miss = int((1.0 - share) * len(cells))
    for n in range(len(cells)):
        if not _sees_cell(state, lens, line, cells[n], int(bits[n]), faces):
            may_miss -= 1
            if may_miss < 0:
                return False
    return True


@kernel
def _probe(
    state: ByteArray,
    reach: FloatArray,
    mask: ByteArray,
    lens: FloatArray,
    places: FloatArray,
    steps: FloatArray,
    centre: FloatArray,
    cells: IntArray,
    bits: ByteArray,
    faces: IntArray,
    reached: bool,
) -> tuple[FloatArray, int]:
    """Score each place by a few cells; also how many places are flyable. reached = False asks the unreachable ones."""
    scores = np.zeros(len(places))
    flyable = 0
    stride = max(1, len(cells) // PROBE_CELLS)
    for p in range(len(places)):
        i, j, k = int(places[p, 0]) + 1, int(places[p, 1]) + 1, int(places[p, 2]) + 1
        if places[p].min() < 0 or i >= mask.shape[0] or j >= mask.shape[1] or k >= mask.shape[2] or mask[i, j, k] == 0:
            continue
        flyable += 1
        if np.isfinite(reach[(i * mask.shape[1] + j) * mask.shape[2] + k]) != reached:
            continue
        x, y, z = places[p, 0], places[p, 1], places[p, 2]
        yaw, pitch = aim(lens, x, y, z, centre[0], centre[1], centre[2])
        line = sight(lens, places[p], yaw, pitch)
        count = 0
        for n in range(stride // 2, len(cells), stride):
            if _sees_cell(state, lens, line, cells[n], int(bits[n]), faces):
                count += 1
        distance = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)
        scores[p] = count * _quality(distance, steps)
    return scores, flyable


@kernel
def _best_view(
    state: ByteArray,
    reach: FloatArray,
    mask: ByteArray,
    lens: FloatArray,
    places: FloatArray,
    scores: FloatArray,
    steps: FloatArray,
    centre: FloatArray,
    cells: IntArray,
    bits: ByteArray,
    faces: IntArray,
    discount: float,
) -> tuple[int, float, float, BoolArray]:
    """Count the best places in full; index (-1: none), yaw, pitch and the cells seen."""
    best, best_yaw, best_pitch, best_score = -1, 0.0, 0.0, 0.0
    best_seen = np.zeros(len(cells), dtype=np.bool_)
    for p in np.argsort(-scores, kind="mergesort")[:FULL_VIEWS]:
        if scores[p] <= 0.0:
            break
        place = places[p]
        yaw, pitch = aim(lens, place[0], place[1], place[2], centre[0], centre[1], centre[2])
        distance = np.sqrt(((place - centre) ** 2).sum())
        path = reach[((int(place[0]) + 1) * mask.shape[1] + int(place[1]) + 1) * mask.shape[2] + int(place[2]) + 1]
        factor = _quality(distance, steps) / (1.0 + discount * path)
        if len(cells) * factor <= best_score:
            continue  # not even all cells would make it the best
        for turn in range(2):
            line = sight(lens, place, yaw, pitch)
            seen = np.zeros(len(cells), dtype=np.bool_)
            for n in range(len(cells)):
                seen[n] = _sees_cell(state, lens, line, cells[n], int(bits[n]), faces)
            score = seen.sum() * factor
            if score > best_score:
                best, best_yaw, best_pitch, best_score = p, yaw, pitch, score
                best_seen = seen
            if seen.all() or not seen.any():
                break
            if turn == 0:
                # the heading that has the seen cells in its middle: a mean of angles, so by their sum as vectors
                c, s = 0.0, 0.0
                for n in range(len(cells)):
                    if seen[n]:
                        bearing = np.arctan2(cells[n, 1] + 0.5 - place[1], cells[n, 0] + 0.5 - place[0])
                        c += np.cos(bearing)
                        s += np.sin(bearing)
                yaw = np.arctan2(s, c)
    return best, best_yaw, best_pitch, best_seen


@dataclass(frozen=True, slots=True, eq=False)
class FrontierProposals:
    """Tasks for frontiers; how many have no view, by reason; and how many farther ones were left for later."""

    proposals: list[Proposal]
    without_view: Counter[str]
    later: int


class FrontierViews:
    """Finds the best view of each frontier for one vehicle and camera."""

    def __init__(self, config: PlannerConfig, camera: CameraGeometry) -> None:
        self._config = config
        self._camera = camera

    def propose(self, situation: Situation, frontiers: tuple[Frontier, ...]) -> FrontierProposals:
        """Find views for the nearest frontiers, BATCH at a time, until a batch has given a task.

        The tour executes only the first few metres: far frontiers can wait until they are near.
        """
        grid = situation.voxels.grid
        lens = self._camera.lens(grid.resolution_m, self._camera.range_m)
        offsets = explore_shell(self._config, self._camera, grid.resolution_m)
        steps = quality_steps(self._config, grid.resolution_m)
        here = situation.space.centre(situation.exit_cells[-1:]) - 1.0
        centres = np.array([frontier.centre_voxels() for frontier in frontiers]).reshape(-1, 3)
        near_first = np.argsort(((centres - here) ** 2).sum(axis=1), kind="stable")
        proposals: list[Proposal] = []
        without: Counter[str] = Counter()
        for done, n in enumerate(near_first):
            if proposals and done % BATCH == 0:
                break
            places = np.concatenate([np.floor(centres[n] + offsets) + 0.5, here])
            found = self._propose_one(situation, frontiers[n], centres[n], places, lens, steps)
            if isinstance(found, Proposal):
                proposals.append(found)
            else:
                without[REASONS[found]] += 1
        return FrontierProposals(proposals, without, len(frontiers) - len(proposals) - without.total())

    def _propose_one(
        self,
        situation: Situation,
        frontier: Frontier,
        centre: FloatArray,
        places: FloatArray,
        lens: FloatArray,
        steps: FloatArray,
    ) -> Proposal | int:
        state, mask, reach = situation.voxels.state, situation.space.mask, situation.reach
        cells, bits = frontier.cells, frontier.faces
        scores, flyable = _probe(state, reach, mask, lens, places, steps, centre, cells, bits, FACES, True)
        if not flyable:
            return TOO_NARROW
        discount = TRAVEL_DISCOUNT_PER_M * situation.voxels.grid.resolution_m
        best, yaw, pitch, seen = _best_view(
            state, reach, mask, lens, places, scores, steps, centre, cells, bits, FACES, discount
        )
        if best < 0 or np.count_nonzero(seen) < MIN_SEEN:
            beyond, _ = _probe(state, reach, mask, lens, places, steps, centre, cells, bits, FACES, False)
            return UNREACHABLE if beyond.any() else OUT_OF_SIGHT
        grid = situation.voxels.grid
        cell = situation.space.flat(np.floor(places[best]).astype(np.int64) + 1)
        viewpoint = Viewpoint(grid.origin_world_m + places[best] * grid.resolution_m, yaw, pitch)
        task = Task(
            TaskKind.EXPLORE, grid.origin_world_m + centre * grid.resolution_m, viewpoint, float(np.count_nonzero(seen))
        )
        promised = np.ravel_multi_index(tuple(cells[seen].T), grid.shape).astype(np.int64)
        return Proposal(task, cell, promised, np.ones(len(promised)))

    def without_redundant(self, situation: Situation, proposals: list[Proposal], faces: ByteArray) -> list[Proposal]:
        """Leave out tasks whose cells a better view shows as well; that view then promises those too.

        faces: (nx, ny, nz) uint8 of unknown_faces().
        """
        grid = situation.voxels.grid
        lens = self._camera.lens(grid.resolution_m, self._camera.range_m)
        cells = [np.stack(np.unravel_index(proposal.promised, grid.shape), axis=-1) for proposal in proposals]
        bits = [faces.ravel()[proposal.promised] for proposal in proposals]
        kept: list[Proposal] = []
        left = sorted(range(len(proposals)), key=lambda n: (-proposals[n].task.gain, n))
        while left:
            best = proposals[left.pop(0)]
            view = best.task.viewpoint
            place = (view.position_world - grid.origin_world_m) / grid.resolution_m
            line = sight(lens, place, view.yaw_rad, view.pitch_down_rad)
            promised = [best.promised]
            for n in tuple(left):
                if _shows(situation.voxels.state, lens, line, cells[n], bits[n], FACES, COVERED_SHARE):
                    promised.append(proposals[n].promised)
                    left.remove(n)
            cells_promised = np.concatenate(promised)
            kept.append(replace(best, promised=cells_promised, squareness=np.ones(len(cells_promised))))
        return kept
