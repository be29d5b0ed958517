"""What earlier plans promised and what came of it: so that nothing is looked at for ever.

A frontier that a camera cannot settle (a ceiling corner, glass) stays a frontier after the view that should have settled it.
Each voxel that was promised and not delivered twice is exhausted and makes no more tasks. Surface keeps the sum of the cosines
under which tasks have looked at it: its uncertainty counts for less and less, so that reconstruction ends too.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.planning.candidate_view import CandidateView
from uav_recon.types.frames import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from uav_recon.types.maps import FREE, UNKNOWN, VoxelMap
from uav_recon.types.tasks import PlanRequest, TaskKind, ViewPath

MAX_LOOKS = 2  # in vain, then a frontier voxel is exhausted
HOPELESS_SHARE = 0.7  # of the promised voxels: if so many are left after a look, another will not settle them either
ARRIVED_M = 0.35  # a view counts as flown from here ...
ARRIVED_RAD = 0.4  # ... with this heading
WORTH_SHARE = 0.3  # of the promised frontier voxels: when fewer are left on the way there, the view is not flown to
STALLED_PLANS = 3  # plans in a row at the same place: whoever flies refuses the first view, so it counts as flown


class ViewHistory:
    """Memory of one flight, changed by the planner alone: settle() before a plan, promise() once it is flown.

    Grids have the map's shape and are forgotten when the map's frame changes (another epoch, origin or shape).

    looks_in_vain, exhausted: (nx, ny, nz) uint8, how often a frontier voxel was promised in vain, and 1 where that is enough.
    surface_looks: (nx, ny, nz) float32, sum of the cosines under which tasks have looked at the surface in a voxel.
    """

    looks_in_vain: ByteArray
    exhausted: ByteArray
    surface_looks: Float32Array
    _path: ViewPath | None
    _proposals: tuple[CandidateView, ...]
    _position: FloatArray
    _waiting: list[tuple[int, IntArray]]  # map revision and frontier voxels of views flown, not yet judged

    def __init__(self) -> None:
        self._forget((0, 0, 0), ())

    def settle(self, request: PlanRequest) -> IntArray:
        """Judge the views flown since the last plan against the map as it is now; flat indices (N,) newly exhausted."""
        self._keep_frame(request)
        voxels = request.voxels
        for proposal in self._newly_flown(request):
            if proposal.task.kind is TaskKind.EXPLORE:
                self._waiting.append((voxels.revision, proposal.promised))
            else:
                self.surface_looks.reshape(-1)[proposal.promised] += proposal.squareness.astype(np.float32)
        # a view is judged by a map newer than the arrival: the picture taken there may still be on its way
        due = [promised for revision, promised in self._waiting if revision < voxels.revision]
        self._waiting = [(revision, promised) for revision, promised in self._waiting if revision >= voxels.revision]
        self._position = np.array(request.position_world)
        newly: IntArray = np.concatenate([np.zeros(0, dtype=np.int64), *(self._in_vain(voxels, one) for one in due)])
        return newly

    def _in_vain(self, voxels: VoxelMap, promised: IntArray) -> IntArray:
        still = promised[_still_frontier(voxels.state, promised)]
        looks, exhausted = self.looks_in_vain.reshape(-1), self.exhausted.reshape(-1)
        hopeless = len(still) >= HOPELESS_SHARE * len(promised)
        looks[still] = np.minimum(looks[still], 255 - MAX_LOOKS) + (MAX_LOOKS if hopeless else 1)
        newly: IntArray = still[(looks[still] >= MAX_LOOKS) & (exhausted[still] == 0)]
        exhausted[newly] = 1
        return newly

    def promise(self, path: ViewPath, proposals: tuple[CandidateView, ...]) -> None:
        """Keep what the new path's views (same order) are to settle."""
        self._path, self._proposals = path, proposals

    def next_promised(self, position_world: FloatArray, yaw_rad: float) -> CandidateView | None:
        """What the next view of the promised path is to settle; None if there is no next view."""
        if self._path is None:
            return None
        passed = _views_passed(self._path, position_world, yaw_rad)
        return self._proposals[passed] if passed < len(self._proposals) else None

    @staticmethod
    def is_worth(voxels: VoxelMap, proposal: CandidateView) -> bool:
        """Whether a view would still settle anything: enough of its frontier is still one."""
        if proposal.task.kind is not TaskKind.EXPLORE:
            return True
        still = int(np.count_nonzero(_still_frontier(voxels.state, proposal.promised)))
        return still >= WORTH_SHARE * len(proposal.promised)

    def _keep_frame(self, request: PlanRequest) -> None:
        grid = request.voxels.grid
        frame = (request.voxels.map_epoch, grid.shape, grid.resolution_m, *grid.origin_world_m.tolist())
        if frame != self._frame:
            self._forget(grid.shape, frame)

    def _forget(self, shape: tuple[int, int, int], frame: tuple[object, ...]) -> None:
        self._frame = frame
        self.looks_in_vain, self.exhausted = np.zeros(shape, dtype=np.uint8), np.zeros(shape, dtype=np.uint8)
        self.surface_looks = np.zeros(shape, dtype=np.float32)
        self._path, self._proposals = None, ()
        self._position, self._stalls = np.zeros(3), 0
        self._waiting = []

    def _newly_flown(self, request: PlanRequest) -> tuple[CandidateView, ...]:
        if self._path is None:
            return ()
        flown = _views_passed(self._path, request.position_world, request.yaw_rad)
        stayed = float(np.linalg.norm(request.position_world - self._position)) < 0.1
        self._stalls = self._stalls + 1 if flown == 0 and stayed else 0
        if self._stalls >= STALLED_PLANS:
            self._stalls, flown = 0, 1
        return self._proposals[:flown]


@kernel
def _still_frontier(state: ByteArray, voxels: IntArray) -> BoolArray:
    """Which of the voxels (N,), flat indices, are free beside an unknown one."""
    nx, ny, nz = state.shape
    out = np.zeros(len(voxels), dtype=np.bool_)
    for n in range(len(voxels)):
        i, j, k = voxels[n] // (ny * nz), voxels[n] // nz % ny, voxels[n] % nz
        if state[i, j, k] != FREE:
            continue
        beside = i > 0 and state[i - 1, j, k] == UNKNOWN
        beside = beside or (i + 1 < nx and state[i + 1, j, k] == UNKNOWN)
        beside = beside or (j > 0 and state[i, j - 1, k] == UNKNOWN)
        beside = beside or (j + 1 < ny and state[i, j + 1, k] == UNKNOWN)
        beside = beside or (k > 0 and state[i, j, k - 1] == UNKNOWN)
        out[n] = beside or (k + 1 < nz and state[i, j, k + 1] == UNKNOWN)
    return out


def warm_up() -> None:
    """Compile the kernel."""
    state = np.zeros((2, 2, 2), dtype=np.uint8)
    state.setflags(write=False)
    _still_frontier(state, np.zeros(1, dtype=np.int64))


def _views_passed(path: ViewPath, position_world: FloatArray, yaw_rad: float) -> int:
    """How many views lie behind the vehicle: up to the last one that it stands at, else by the nearest leg of the way."""
    at = [
        float(np.linalg.norm(view.position_world - position_world)) < ARRIVED_M
        and abs((view.yaw_rad - yaw_rad + np.pi) % (2 * np.pi) - np.pi) < ARRIVED_RAD
        for view in path.viewpoints
    ]
    if any(at):
        return len(at) - at[::-1].index(True)
    distances = [_distance_to(way, position_world) for way in path.waypoints_world]
    nearest = int(np.argmin(distances))
    return nearest if distances[nearest] < ARRIVED_M else 0


def _distance_to(way: FloatArray, point: FloatArray) -> float:
    if len(way) == 1:
        return float(np.linalg.norm(way[0] - point))
    step = np.diff(way, axis=0)
    along = np.clip(((point - way[:-1]) * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(way[:-1] + along[:, None] * step - point, axis=1).min())
