"""Narrow passages of one flight: found, looked at, measured, and opened where the body fits."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.candidate_view import CandidateView, PlanningContext
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.free_space.subvoxel_clearance import SIDES2
from uav_recon.planning.passages.passage_search import FoundPassage, PassageSearch
from uav_recon.planning.passages.widest_path import straightened, widest_path
from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import PlanRequest, Task, TaskKind, Viewpoint

SEARCH_EVERY = 4  # plans in motion from one search to the next; at rest every plan searches
SAME_M = 0.5  # two passages this near to each other are one
END_M = 0.15  # a path through a fine map ends this near to the ends of the passage
AROUND_M = 0.2  # what is wide enough around a way through is open too, so that small changes of the map do not part it
BESIDE_M = 0.3  # a path that crosses the middle of a passage this far beside the open way leads through it
LOOK_M = 1.3  # distance of a look from the middle of a passage
MOST_LOOK_M = 2.0  # ... at most
OFF_AXIS = 0.7  # metres of distance that a look from one radian beside the axis is worth less
MOST_LOOKS = 2  # looks at a passage that it takes to see that it is too narrow
SAME_LOOK_M = 0.6  # looks from nearer places than this show the same edges, so a second look is from farther aside ...
SAME_LOOK_WORSE_M = 1.0  # ... unless that is this much worse
LOOKED_M = 0.35  # a look counts as taken within this distance ...
LOOKED_RAD = 0.4  # ... and this difference in heading


@dataclass(slots=True)
class Passage:
    """One narrow passage.

    near_world, far_world: (3,) positions with the usual clearance before and behind it. voxels_behind: flyable voxels there.
    width_m: least width as measured in its fine map, 0 as long as that shows no way through. widest_m: the largest of these.
    needed_m: that for which it is open. path_world: (M, 3) the widest way through, empty if it is too narrow. opened: (N,) flat
    PADDED voxels around it. looked_from_world: positions of the looks taken. measured: corner in world and revision of the fine
    map that it was measured in.
    """

    near_world: FloatArray
    far_world: FloatArray
    voxels_behind: int
    width_m: float = 0.0
    widest_m: float = 0.0
    needed_m: float = 0.0
    path_world: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    opened: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    looked_from_world: list[FloatArray] = field(default_factory=list)
    measured: tuple[float, ...] = ()
    look: Viewpoint | None = None

    @property
    def middle_world(self) -> FloatArray:
        """The middle (3,) of the passage."""
        middle: FloatArray = (self.near_world + self.far_world) / 2
        return middle

    @property
    def is_open(self) -> bool:
        """True if the body fits through."""
        return bool(len(self.opened))


class Passages:
    """Finds passages, asks for fine maps of them, and opens those that are wide enough."""

    def __init__(self, usual: FlyableSpace, tight: FlyableSpace, needed_m: float, camera: CameraGeometry) -> None:
        """Start with none.

        usual: the planner's flyable space. tight: a space of the same grid with the clearance at which a way through is worth a
        look. needed_m: clearance that the body needs in a fine map.
        """
        self._usual = usual
        self._tight = tight
        self._needed_m = needed_m
        self._pitch_down_rad = min(max(0.0, camera.pitch_min_rad), camera.pitch_max_rad)
        self._search = PassageSearch()
        self._plans = 0
        self._known: list[Passage] = []
        self._map_epoch = 0
        self._height_m: float | None = None  # of the first plan: that of the take-off

    @property
    def places(self) -> tuple[FloatArray, ...]:
        """The middles (3,) of the passages, of which fine maps are wanted."""
        return tuple(one.middle_world for one in self._known)

    def update(self, request: PlanRequest) -> bool:
        """Search and measure; return True if what is open has changed.

        Then the flyable space must be updated. The usual space is up to date and the vehicle is located in it.
        """
        voxels, rests = request.voxels, not request.velocity_world_mps.any()
        if voxels.map_epoch != self._map_epoch:
            self._map_epoch = voxels.map_epoch
            self._known.clear()
        if self._height_m is None:
            self._height_m = float(request.position_world[2])
        self._count_looks(request)
        self._plans += 1
        if rests or self._plans % SEARCH_EVERY == 0:
            self._tight.update(voxels)
            if self._tight.locate_vehicle(request.position_world) is not None:
                for found in self._search.find(voxels, self._usual, self._tight, self._height_m):
                    self._remember(found)
        changed = [self._measure(one, voxels) for one in self._known]
        if any(changed):
            opened = np.unique(np.concatenate([one.opened for one in self._known]))
            self._usual.set_opened(opened)
            return True
        return False

    def looks(self, context: PlanningContext) -> list[CandidateView]:
        """Return views of the passages that are not open, from before them."""
        views = []
        for one in self._known:
            one.look = None
            if not one.is_open and len(one.looked_from_world) < MOST_LOOKS:
                view = self._view_of(one, context)
                if view is not None:
                    views.append(view)
                    one.look = view.task.viewpoint
        return views

    def too_narrow(self) -> list[Reason]:
        """Return a reason for each passage that was looked at and never open, the widest first.

        It gives the widest that was measured: later looks from other places may show less of an opening.
        """
        closed = [one for one in self._known if one.looked_from_world and 0.0 < one.widest_m < one.needed_m]
        closed.sort(key=lambda one: -one.widest_m)
        places = [(one.widest_m, one.needed_m, *one.middle_world[:2].tolist()) for one in closed]
        return [Reason(ReasonCode.PASSAGE_TOO_NARROW, values) for values in places]

    def along(self, leg_world: FloatArray) -> FloatArray:
        """Return a polyline (N, 3) in world that takes the widest way through each passage.

        Voxels are too coarse for where in a passage the body is.
        """
        for one in self._known:
            if one.is_open:
                leg_world = _through(one, leg_world)
        return leg_world

    def _remember(self, found: FoundPassage) -> None:
        ends = self._usual.world_from_padded(self._usual.cell_centres(found.cells[[0, -1]]))
        middle = ends.mean(axis=0)
        for one in self._known:
            if np.linalg.norm(one.middle_world - middle) < SAME_M:
                one.near_world, one.far_world, one.voxels_behind = ends[0], ends[1], found.voxels_behind
                one.measured = ()
                return
        self._known.append(Passage(ends[0], ends[1], found.voxels_behind))

    def _measure(self, passage: Passage, voxels: VoxelMap) -> bool:
        """Measure a passage in its fine map; return True if its way through has changed."""
        fine = _nearest_fine(voxels, passage.middle_world)
        if fine is None:  # what no map shows is closed
            changed = passage.is_open
            passage.opened, passage.path_world, passage.measured = passage.opened[:0], passage.path_world[:0], ()
            return changed
        measured = (*fine.grid.origin_world_m.tolist(), fine.revision)
        if measured == passage.measured:
            return False
        passage.measured = measured
        bounds_m = self._usual.world_from_padded(self._usual.clearance_box[:SIDES2].reshape(2, 3) + 1.0)
        path, clearance_m = widest_path(fine, passage.near_world, passage.far_world, END_M, heights_m=bounds_m[:, 2])
        passage.width_m = max(2.0 * clearance_m - fine.grid.resolution_m, 0.0)
        passage.widest_m = max(passage.widest_m, passage.width_m)
        passage.needed_m = 2.0 * self._needed_m - fine.grid.resolution_m
        opened, passage.path_world = np.zeros(0, dtype=np.int64), path[:0]
        if clearance_m >= self._needed_m:
            passage.path_world = straightened(fine, path, self._needed_m)
            wide = _around(fine, voxels.grid, path, self._needed_m)
            cells = np.floor(self._usual.padded_from_world(np.vstack([path, wide]))).astype(np.int64)
            opened = np.unique(np.ravel_multi_index(tuple(cells.T), self._usual.mask.shape))
        changed = not np.array_equal(opened, passage.opened)
        passage.opened = opened
        return changed

    def _count_looks(self, request: PlanRequest) -> None:
        for one in self._known:
            if one.look is not None and _at(one.look, request.position_world, request.yaw_rad):
                one.looked_from_world.append(one.look.position_world)
                one.look = None

    def _view_of(self, passage: Passage, context: PlanningContext) -> CandidateView | None:
        """Return the view of a passage from a reachable position, about in its axis."""
        space, middle = context.space, passage.middle_world
        axis = (passage.far_world - passage.near_world)[:2]
        axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
        at, reach = space.padded_from_world(middle), MOST_LOOK_M / space.grid.resolution_m
        low = np.clip(np.floor(at - reach), 1, space.reachable.shape).astype(np.int64)
        high = np.clip(np.floor(at + reach) + 1, 1, space.reachable.shape).astype(np.int64)
        cells = np.argwhere(space.reachable[low[0] : high[0], low[1] : high[1], low[2] : high[2]]) + low
        towards = middle - space.world_from_padded(cells + np.float64(0.5))
        away_m = np.linalg.norm(towards[:, :2], axis=1)
        off_rad = np.arccos(np.clip(towards[:, :2] @ axis / np.maximum(away_m, 1e-9), -1.0, 1.0))
        worse_m = np.abs(away_m - LOOK_M) + OFF_AXIS * off_rad + np.abs(towards[:, 2])
        for place_world in passage.looked_from_world:
            aside_m = np.linalg.norm(middle - towards - place_world, axis=1)
            worse_m += SAME_LOOK_WORSE_M * np.maximum(1.0 - aside_m / SAME_LOOK_M, 0.0)
        worse_m[(away_m > MOST_LOOK_M) | (off_rad > 1.0)] = np.inf
        for best in np.argsort(worse_m)[:20]:
            place = cells[best] + 0.5
            if not np.isfinite(worse_m[best]) or not context.is_clear(place):
                continue
            yaw_rad = float(np.arctan2(towards[best, 1], towards[best, 0]))
            viewpoint = Viewpoint(space.world_from_padded(place), yaw_rad, self._pitch_down_rad)
            task = Task(TaskKind.EXPLORE, middle, viewpoint, float(passage.voxels_behind))
            nothing = np.zeros(0, dtype=np.int64)
            return CandidateView(task, place, nothing, nothing.astype(np.float64))
        return None


def _through(passage: Passage, leg_world: FloatArray) -> FloatArray:
    """Return a polyline (N, 3) that passes through a passage on its path.

    It is unchanged if it does not lead from one side to the other.
    If it begins or ends within the passage, it joins the path beside that place.
    """
    middle, axis = passage.middle_world, passage.far_world - passage.near_world
    half_m = float(np.linalg.norm(axis)) / 2
    axis = axis / max(2 * half_m, 1e-9)
    along_m = (leg_world - middle) @ axis
    for n in np.flatnonzero(along_m[:-1] * along_m[1:] < 0.0):
        share = along_m[n] / (along_m[n] - along_m[n + 1])
        crossing = leg_world[n] + share * (leg_world[n + 1] - leg_world[n])
        if np.linalg.norm(crossing - middle) > AROUND_M + BESIDE_M:
            continue
        before = np.flatnonzero(np.abs(along_m[: n + 1]) > half_m)
        after = np.flatnonzero(np.abs(along_m[n + 1 :]) > half_m)
        first, last = (before[-1] if len(before) else 0), (n + 1 + after[0] if len(after) else len(leg_world) - 1)
        ends_m = np.clip(along_m[[first, last]], -half_m, half_m)
        way = _part(passage.path_world, (passage.path_world - middle) @ axis, ends_m)
        return np.vstack([leg_world[: first + 1], way, leg_world[last:]])
    return leg_world


def _part(path: FloatArray, along_m: FloatArray, ends_m: FloatArray) -> FloatArray:
    """Return the part (K, 3) of a path (M, 3) between two places along an axis.

    along_m: (M,) places of the path along the axis. ends_m: (2,) those of the part.
    """
    order = np.argsort(along_m, kind="stable")
    path, along_m = path[order], along_m[order]
    inner = along_m[(along_m > ends_m.min()) & (along_m < ends_m.max())]
    stations_m = np.concatenate([[ends_m.min()], inner, [ends_m.max()]])
    part = np.stack([np.interp(stations_m, along_m, path[:, k]) for k in range(3)], axis=1)
    return part if ends_m[0] < ends_m[1] else part[::-1]


def _around(fine: VoxelMap, coarse: GridSpec, path: FloatArray, needed_m: float) -> FloatArray:
    """Return the centres (N, 3) of the coarse voxels around a path that are wide enough.

    path: (M, 3) in world. The fine map shows at their centres that a line between two of them has the clearance.
    """
    low, high = coarse.index(path.min(axis=0) - AROUND_M), coarse.index(path.max(axis=0) + AROUND_M) + 1
    index = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1).reshape(-1, 3)
    centres = coarse.centre(index)
    inside = fine.grid.contains(fine.grid.index(centres))
    centres = centres[inside]
    distance2 = fine.distance2[tuple(fine.grid.index(centres).T)]
    wide: FloatArray = centres[distance2 >= ((needed_m + coarse.resolution_m / 2) / fine.grid.resolution_m) ** 2]
    return wide


def _nearest_fine(voxels: VoxelMap, place_world: FloatArray) -> VoxelMap | None:
    """Return the fine map whose centre is nearest to a position in it, None if there is none."""
    best, least_m = None, SAME_M
    for fine in voxels.fine:
        centre = fine.grid.origin_world_m + np.array(fine.grid.shape) * fine.grid.resolution_m / 2
        away_m = float(np.linalg.norm(centre - place_world))
        if away_m < least_m:
            best, least_m = fine, away_m
    return best


def _at(view: Viewpoint, position_world: FloatArray, yaw_rad: float) -> bool:
    turn_rad = abs((view.yaw_rad - yaw_rad + np.pi) % (2 * np.pi) - np.pi)
    return bool(np.linalg.norm(view.position_world - position_world) < LOOKED_M and turn_rad < LOOKED_RAD)


def warm_up() -> None:
    """Compile the kernels on two small rooms with a narrow opening between them."""
    grid = GridSpec(np.zeros(3), 0.1, (40, 24, 16))
    state, distance2 = np.full(grid.shape, FREE, dtype=np.uint8), np.full(grid.shape, 36, dtype=np.uint8)
    state[19:21], distance2[19:21] = OCCUPIED, 0
    state[19:21, 9:15], distance2[16:24, 9:15] = FREE, 9
    voxels = VoxelMap.whole(grid, state, distance2, 1)
    box = np.zeros(3, dtype=np.int64), np.array(grid.shape)
    usual, tight = FlyableSpace(grid, 0.4, *box), FlyableSpace(grid, 0.25, *box)
    camera = CameraGeometry(1.5, 1.0, np.zeros(3), -1.0, 1.0, 4.5)
    passages, position = Passages(usual, tight, 0.25, camera), np.array([0.8, 1.2, 0.8])
    for fine in ((), (voxels,)):
        seen = dataclasses.replace(voxels, fine=fine)
        usual.update(seen)
        usual.locate_vehicle(position)
        passages.update(PlanRequest(seen, None, position, 0.0, 1))
        if passages.places:
            straightened(voxels, np.array([[0.85, 1.15, 0.85], [1.05, 1.15, 0.85]]), 0.1)
            widest_path(voxels, passages.places[0], passages.places[0], 0.15, np.array([0.0, 1.6]))
