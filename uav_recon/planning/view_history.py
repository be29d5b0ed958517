"""View history: outcomes of earlier views, so that no frontier or surface is viewed forever.

Some frontiers cannot be settled by a camera (a ceiling corner, glass) and remain after the view that should have settled
them. A voxel that was expected twice and is still a frontier is exhausted and generates no more tasks. For surface, the sum
of the cosines of all views is kept: each view reduces the weight of the uncertainty, so that reconstruction ends too.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.planning.candidate_view import CandidateView
from uav_recon.types.frames import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from uav_recon.types.maps import FREE, UNKNOWN, VoxelMap
from uav_recon.types.tasks import NextView, PlanRequest, TaskKind, ViewPath

MAX_FAILED_VIEWS = 2  # unsuccessful views after which a frontier voxel is exhausted
HOPELESS_SHARE = 0.7  # if this share of the expected voxels is left after a view, another view will not settle them either
ARRIVED_M = 0.35  # a view counts as flown within this distance ...
ARRIVED_RAD = 0.4  # ... and this heading difference
STILL_FRONTIER_SHARE = 0.3  # if a smaller share of the expected frontier voxels is left, the view is no longer flown to
# consecutive plans at the same position: the first view was refused by motion planning, so it counts as flown
STALLED_PLANS = 3
GIVEN_UP_COSINE_SUM = 3.0  # sum of cosines for which a view of surface counts whose motion is refused again


class ViewHistory:
    """The views of one flight and their outcomes.

    Only the planner changes it: evaluate_flown_views() before a plan, set_expected_views() when a path is accepted.

    Grids have the shape of the map and are cleared when the map's frame changes (another epoch, origin or shape).

    failed_views: (nx, ny, nz) uint8, number of unsuccessful views of a frontier voxel.
    exhausted: (nx, ny, nz) uint8, 1 where that number has reached its limit.
    surface_cosine_sums: (nx, ny, nz) float32, sum of the cosines under which tasks have seen the surface in a voxel.
    """

    failed_views: ByteArray
    exhausted: ByteArray
    surface_cosine_sums: Float32Array
    _path: ViewPath | None
    _proposals: tuple[CandidateView, ...]
    _position: FloatArray
    _waiting: list[tuple[int, IntArray]]  # map revision and frontier voxels of views flown and not yet evaluated
    _refused: list[FloatArray]  # positions of views to which a motion was refused
    _set_aside: list[FloatArray]  # those of them since the last flown view

    def __init__(self) -> None:
        self._reset((0, 0, 0), ())

    def evaluate_flown_views(self, request: PlanRequest) -> IntArray:
        """Evaluate the views flown since the last plan against the current map.

        A view that is given up counts as flown without a result. Returns the flat indices (N,) of voxels that became exhausted.
        """
        self._keep_frame(request)
        voxels = request.voxels
        flown = self._newly_flown(request)
        self._set_aside = [] if flown else self._set_aside
        given_up = None if request.next_view is NextView.KEPT else self._set_next_aside(request)
        for proposal in flown:
            if proposal.task.kind is TaskKind.EXPLORE:
                self._waiting.append((voxels.revision, proposal.expected_voxels))
            else:
                self.surface_cosine_sums.reshape(-1)[proposal.expected_voxels] += proposal.view_cosine.astype(np.float32)
        # a view is evaluated by a map newer than the arrival, because the image taken there may still be in processing
        due = [expected for revision, expected in self._waiting if revision < voxels.revision]
        self._waiting = [(revision, expected) for revision, expected in self._waiting if revision >= voxels.revision]
        self._position = np.array(request.position_world)
        newly: IntArray = np.concatenate([np.zeros(0, dtype=np.int64), *(self._count_failed(voxels, one) for one in due)])
        return newly if given_up is None else np.concatenate([newly, self._give_up(given_up)])

    def is_set_aside(self, proposal: CandidateView) -> bool:
        """Return True if a motion to about this position was refused since a view was flown."""
        return _among(proposal, self._set_aside)

    def _set_next_aside(self, request: PlanRequest) -> CandidateView | None:
        """Set the next view aside.

        Returns it if it is given up: it was left, or a motion to about its position was refused before.
        """
        following = self.next_expected_view(request.position_world, request.yaw_rad)
        self._path = None
        if following is None:
            return None
        given_up = request.next_view is NextView.LEFT or _among(following, self._refused)
        self._refused.append(following.task.viewpoint.position_world)
        self._set_aside.append(following.task.viewpoint.position_world)
        return following if given_up else None

    def _give_up(self, proposal: CandidateView) -> IntArray:
        """Count a view as flown without a result.

        Returns the flat indices (N,) of voxels that became exhausted.
        """
        if proposal.task.kind is not TaskKind.EXPLORE:
            self.surface_cosine_sums.reshape(-1)[proposal.expected_voxels] += GIVEN_UP_COSINE_SUM
            return np.zeros(0, dtype=np.int64)
        exhausted = self.exhausted.reshape(-1)
        newly: IntArray = np.unique(proposal.expected_voxels[exhausted[proposal.expected_voxels] == 0])
        self.failed_views.reshape(-1)[newly] = MAX_FAILED_VIEWS
        exhausted[newly] = 1
        return newly

    def _count_failed(self, voxels: VoxelMap, expected: IntArray) -> IntArray:
        still = expected[_still_frontier(voxels.state, expected)]
        failed_views, exhausted = self.failed_views.reshape(-1), self.exhausted.reshape(-1)
        hopeless = len(still) >= HOPELESS_SHARE * len(expected)
        failed_views[still] = np.minimum(failed_views[still], 255 - MAX_FAILED_VIEWS) + (MAX_FAILED_VIEWS if hopeless else 1)
        newly: IntArray = still[(failed_views[still] >= MAX_FAILED_VIEWS) & (exhausted[still] == 0)]
        exhausted[newly] = 1
        return newly

    def set_expected_views(self, path: ViewPath, proposals: tuple[CandidateView, ...]) -> None:
        """Store what the views of the new path (same order) should settle."""
        self._path = path
        self._proposals = proposals

    def next_expected_view(self, position_world: FloatArray, yaw_rad: float) -> CandidateView | None:
        """Return the next view of the accepted path, or None if there is none."""
        if self._path is None:
            return None
        passed = _views_passed(self._path, position_world, yaw_rad)
        return self._proposals[passed] if passed < len(self._proposals) else None

    @staticmethod
    def still_has_gain(voxels: VoxelMap, proposal: CandidateView) -> bool:
        """Return True if at least STILL_FRONTIER_SHARE of the frontier cells of a view still exist.

        A surface view is always worth it.
        """
        if proposal.task.kind is not TaskKind.EXPLORE:
            return True
        still = int(np.count_nonzero(_still_frontier(voxels.state, proposal.expected_voxels)))
        return still >= STILL_FRONTIER_SHARE * len(proposal.expected_voxels)

    def _keep_frame(self, request: PlanRequest) -> None:
        grid = request.voxels.grid
        frame = (request.voxels.map_epoch, grid.shape, grid.resolution_m, *grid.origin_world_m.tolist())
        if frame != self._frame:
            self._reset(grid.shape, frame)

    def _reset(self, shape: tuple[int, int, int], frame: tuple[object, ...]) -> None:
        self._frame = frame
        self.failed_views = np.zeros(shape, dtype=np.uint8)
        self.exhausted = np.zeros(shape, dtype=np.uint8)
        self.surface_cosine_sums = np.zeros(shape, dtype=np.float32)
        self._path = None
        self._proposals = ()
        self._position = np.zeros(3)
        self._stalls = 0
        self._waiting = []
        self._refused = []
        self._set_aside = []

    def _newly_flown(self, request: PlanRequest) -> tuple[CandidateView, ...]:
        if self._path is None:
            return ()
        flown = _views_passed(self._path, request.position_world, request.yaw_rad)
        stayed = float(np.linalg.norm(request.position_world - self._position)) < 0.1
        self._stalls = self._stalls + 1 if flown == 0 and stayed else 0
        if self._stalls >= STALLED_PLANS:
            self._stalls = 0
            flown = 1
        return self._proposals[:flown]


@kernel
def _still_frontier(state: ByteArray, voxels: IntArray) -> BoolArray:
    """Mark the voxels (N,), flat indices, that are free and have an unknown face neighbour."""
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


def _among(proposal: CandidateView, positions_world: list[FloatArray]) -> bool:
    """Return True if a view is taken from about one of some positions."""
    place_world = proposal.task.viewpoint.position_world
    return any(float(np.linalg.norm(place_world - one)) < ARRIVED_M for one in positions_world)


def warm_up() -> None:
    """Compile the kernel."""
    state = np.zeros((2, 2, 2), dtype=np.uint8)
    state.setflags(write=False)
    _still_frontier(state, np.zeros(1, dtype=np.int64))


def _views_passed(path: ViewPath, position_world: FloatArray, yaw_rad: float) -> int:
    """Return how many views are behind the vehicle.

    These are the views up to the last one at whose pose the vehicle is, or else up to the nearest leg of the path.
    """
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
