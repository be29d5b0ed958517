"""Cache of view searches: the best view of each frontier cluster and its dependencies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.rows import copy_row
from uav_recon.geometry.traversal import first_obstacle
from uav_recon.planning.camera_frustum import LineOfSight, in_view, sight
from uav_recon.planning.frontier.view_search import MAX_MOVE_TESTS, SearchScene, best_view
from uav_recon.planning.frontier.visibility_bound import Int32Array
from uav_recon.planning.frontier.visibility_rays import Scene
from uav_recon.planning.view_sampling import ViewShell
from uav_recon.types.frames import BoolArray, ByteArray, FloatArray, IntArray
from uav_recon.types.maps import VoxelMap

ROWS = 512  # cached results; the oldest are replaced first
MAX_BLOCKERS = 2048
SAMPLE_CELLS = 24  # sample of the cells of a view, tested to find out which other views show them
SAMPLE_POINTS = 6 * SAMPLE_CELLS


class ViewRows(NamedTuple):
    """Search results in R rows.

    shown: (R,) number of cells that the view shows, 0 = none.
    pose: (R, 5), see view_search.best_view(); also for tested_cells, blockers and box.
    counts: (R, 4) filled lengths of tested_cells and blockers, and the revisions of map and space at the search.
    points, first: (R, ...) targets() of a sample of the cells shown.
    samples: (R,) number of sampled cells.
    """

    shown: IntArray
    pose: FloatArray
    tested_cells: Int32Array
    blockers: Int32Array
    box: IntArray
    counts: IntArray
    points: FloatArray
    first: IntArray
    samples: IntArray


class ViewCache:
    """Search results by row, for one map and shell.

    row_of: row by the key of a cluster.
    rows: the results.
    shown_cells: by row, flat indices of the cells shown.
    used: (R,) number of the plan that last used the row.
    """

    def __init__(self, shell: ViewShell) -> None:
        self.shell = shell
        self.row_of: dict[int, int] = {}
        self.key = [0] * ROWS
        self.shown_cells = [np.zeros(0, dtype=np.int64)] * ROWS
        self.rows = ViewRows(
            shown=np.zeros(ROWS, dtype=np.int64),
            pose=np.zeros((ROWS, 5)),
            tested_cells=np.zeros((ROWS, len(shell.offsets) + MAX_MOVE_TESTS), dtype=np.int32),
            blockers=np.zeros((ROWS, MAX_BLOCKERS), dtype=np.int32),
            box=np.zeros((ROWS, 2, 4), dtype=np.int64),
            counts=np.zeros((ROWS, 4), dtype=np.int64),
            points=np.zeros((ROWS, SAMPLE_POINTS, 3)),
            first=np.zeros((ROWS, SAMPLE_CELLS + 1), dtype=np.int64),
            samples=np.zeros(ROWS, dtype=np.int64),
        )
        self.used = np.full(ROWS, -1, dtype=np.int64)
        self._next = 0

    def search(
        self,
        key: int,
        scene: SearchScene,
        faces: ByteArray,
        flat: IntArray,
        centre: FloatArray,
        revisions: tuple[int, int],
        plan: int,
    ) -> int:
        """Find the best view of a cluster and return its row.

        Rows used by ``plan`` are not replaced.

        faces: of the map.
        flat: (N,) cells of the cluster.
        centre: (3,) centre of the cluster, voxels.
        revisions: of the map and of the space.
        """
        while self.used[self._next] == plan:
            self._next = (self._next + 1) % ROWS
        row = self._next
        self._next = (self._next + 1) % ROWS
        if self.row_of.get(self.key[row]) == row:
            del self.row_of[self.key[row]]
        self.shown_cells[row] = _fill_row(row, scene, self.shell, faces, centre, flat, self.rows)
        self.rows.counts[row, 2:] = revisions
        self.key[row], self.row_of[key] = key, row
        return row

    def holds_cluster(self, row: int, key: int) -> bool:
        """Return True if a row holds the result of a cluster, and was not reused for another."""
        return row >= 0 and self.key[row] == key

    def remove(self, row: int) -> None:
        """Remove a result from the index."""
        self.row_of.pop(self.key[row], None)

    def valid_rows(
        self, keys: list[int], distance2: ByteArray, reachable: ByteArray, closed: IntArray, reachable_revision: IntArray
    ) -> list[int]:
        """Return the rows of the results of these clusters that are still valid; -1 for the others.

        closed: (tiles) revision of the map at which a voxel of the tile last stopped being free.
        reachable_revision: (tiles) revision of the space at which ``reachable`` last changed in the tile.
        """
        rows = np.array([self.row_of.get(key, -1) for key in keys], dtype=np.int64)
        _drop_invalid(rows, distance2.reshape(-1), reachable.reshape(-1), closed, reachable_revision, self.rows)
        held: list[int] = rows.tolist()
        return held

    def covering_views(self, rows: list[int], voxels: VoxelMap, lens: FloatArray, share: float) -> list[tuple[int, IntArray]]:
        """Return the rows of few views that together show a share of what each view shows.

        Those that add most cells come first. Each is given with the flat indices of the cells that it shows and none before it
        does.
        """
        places, samples = np.array(rows, dtype=np.int64), self.rows.samples[rows]
        owner = np.full((len(rows), max(1, int(samples.max()))), -1, dtype=np.int64)
        scene = (voxels.distance2.reshape(-1), voxels.grid.shape, lens, voxels.heights.weight)
        shows = _visibility(places, scene, self.rows, owner.shape[1])
        chosen = _greedy_cover(shows, samples, self.rows.shown[rows] / np.maximum(samples, 1), share, owner)
        owners, cells = [], [self.shown_cells[row] for row in rows]
        for n in range(len(rows)):
            ends = np.arange(samples[n] + 1) * len(cells[n]) // max(int(samples[n]), 1)
            # a sample stands for the cells up to the next
            owners.append(np.repeat(owner[n, : samples[n]], np.diff(ends)))
        by = np.concatenate(owners)
        order = np.argsort(by, kind="stable")
        borders = np.searchsorted(by[order], np.arange(len(rows) + 1))
        shown = np.concatenate(cells)[order]
        return [(rows[n], shown[borders[n] : borders[n + 1]]) for n in chosen.tolist()]


@kernel
def targets(faces: ByteArray, flat: IntArray) -> tuple[FloatArray, IntArray]:
    """Return the centres (M, 3), voxels, of the unknown neighbours of cells (N,), flat indices.

    The second result (N + 1,) is the start of each cell's neighbours.
    """
    _, ny, nz = faces.shape
    points = np.empty((6 * len(flat), 3))
    first = np.zeros(len(flat) + 1, dtype=np.int64)
    count = 0
    for n in range(len(flat)):
        i, j, k = flat[n] // (ny * nz), flat[n] // nz % ny, flat[n] % nz
        bits = int(faces[i, j, k])
        for face in range(6):
            if bits & (1 << face):
                step = 1.0 if face & 1 else -1.0
                points[count, 0] = i + 0.5 + (step if face < 2 else 0.0)
                points[count, 1] = j + 0.5 + (step if 2 <= face < 4 else 0.0)
                points[count, 2] = k + 0.5 + (step if face >= 4 else 0.0)
                count += 1
        first[n + 1] = count
    return points[:count].copy(), first


@kernel
def _fill_row(
    row: int, scene: SearchScene, shell: ViewShell, faces: ByteArray, centre: FloatArray, flat: IntArray, rows: ViewRows
) -> IntArray:
    """Fill a row and return the flat indices of the cells that the view shows."""
    own_points, own_first = targets(faces, flat)
    best, seen, tested, hidden, tiles = best_view(
        scene, shell, centre, own_points, own_first, rows.tested_cells[row], rows.blockers[row]
    )
    counts, box, samples, points = rows.counts, rows.box, rows.samples, rows.points
    copy_row(rows.pose, row, best)
    counts[row, 0], counts[row, 1] = tested, hidden
    for n in range(2):
        copy_row(box[row], n, tiles[n])
    cells = np.flatnonzero(seen)
    rows.shown[row] = len(cells)
    samples[row] = min(len(cells), SAMPLE_CELLS)
    filled = 0
    for n in range(samples[row]):
        cell = cells[n * len(cells) // samples[row]]
        for m in range(own_first[cell], own_first[cell + 1]):
            copy_row(points[row], filled, own_points[m])
            filled += 1
        rows.first[row, n + 1] = filled
    return flat[cells]


@kernel
def _drop_invalid(  # noqa: C901, PLR0912
    rows: IntArray,
    distance2: ByteArray,
    reachable: ByteArray,
    closed: IntArray,
    reachable_revision: IntArray,
    results: ViewRows,
) -> None:
    """Set to -1 the rows whose result would differ from a new call of best_view().

    A blocked line stays blocked while the first voxel that blocked it is not free. A clear line stays clear while no voxel
    in its box has stopped being free.
    """
    tested_cells, blockers, box, counts = results.tested_cells, results.blockers, results.box, results.counts
    for m in range(len(rows)):
        row = rows[m]
        if row < 0:
            continue
        valid, test_again = counts[row, 1] <= blockers.shape[1], False
        lines, places = box[row, 0], box[row, 1]
        for i in range(lines[0], lines[2] + 1):
            for j in range(lines[1], lines[3] + 1):
                valid = valid and closed[i, j] <= counts[row, 2]
        for i in range(places[0], places[2] + 1):
            for j in range(places[1], places[3] + 1):
                test_again = test_again or reachable_revision[i, j] > counts[row, 3]
        if valid:
            for n in range(counts[row, 1]):
                if distance2[np.uint64(blockers[row, n])] != 0:
                    valid = False
                    break
        if valid and test_again:
            for n in range(counts[row, 0]):
                at = tested_cells[row, n]
                if (reachable[np.uint64(at if at >= 0 else ~at)] != 0) != (at >= 0):
                    valid = False
                    break
        if not valid:
            rows[m] = -1


@kernel
def _visibility(rows: IntArray, scene: Scene, results: ViewRows, most: int) -> BoolArray:
    """Return a mask (N, N, most): the view of a row shows a sample of the cells of another.

    Of its own cells it shows all.
    """
    pose, points, first, samples = results.pose, results.points, results.first, results.samples
    shows = np.zeros((len(rows), len(rows), most), dtype=np.bool_)
    for n in range(len(rows)):
        line = sight(scene[2], pose[rows[n], :3], pose[rows[n], 3], pose[rows[n], 4])
        for other in range(len(rows)):
            row = rows[other]
            for cell in range(samples[row]):
                shows[n, other, cell] = n == other or _shows(scene, line, points[row], first[row, cell], first[row, cell + 1])
    return shows


@kernel
def _new_cells(shows: BoolArray, owner: IntArray, left: IntArray, cells: FloatArray) -> float:
    """Return the number of cells that a view shows and no chosen one does.

    left: (N,) samples of each row that are still to be shown; rows without any do not count. shows: (N, S). owner: (N, S)
    -1 = no chosen view shows it. cells: (N,) for which each sample of a row stands.
    """
    total = 0.0
    for other in range(len(left)):
        if left[other] > 0:
            for cell in range(owner.shape[1]):
                if shows[other, cell] and owner[other, cell] < 0:
                    total += cells[other]
    return total


@kernel
def _greedy_cover(shows: BoolArray, samples: IntArray, cells: FloatArray, share: float, owner: IntArray) -> IntArray:
    """Return the chosen views: each time the one that shows most cells that no chosen one shows.

    shows: see _visibility(). samples, cells: (N,) samples of each row, and cells for which each stands.
    owner: (N, S) filled with -1; output: the first chosen view that shows each sample.
    """
    chosen = np.empty(len(samples), dtype=np.int64)
    left = np.maximum(np.ceil(share * samples), 1.0).astype(np.int64)  # of each row: samples that are still to be shown
    count = 0
    while count < len(chosen):
        best, most_new_cells = -1, 0.0
        for n in range(len(samples)):
            new_cells = _new_cells(shows[n], owner, left, cells)
            if new_cells > most_new_cells:
                best, most_new_cells = n, new_cells
        if best < 0:
            break
        chosen[count] = best
        count += 1
        for other in range(len(samples)):
            for cell in range(owner.shape[1]):
                if shows[best, other, cell] and owner[other, cell] < 0:
                    owner[other, cell] = best
                    left[other] -= 1
    return chosen[:count].copy()


@kernel
def _shows(
    scene: Scene,
    line: LineOfSight,
    points: FloatArray,
    a: int,
    b: int,
) -> bool:
    distance2, shape, lens, weight = scene
    for m in range(a, b):
        x, y, z = points[m, 0], points[m, 1], points[m, 2]
        if in_view(lens, line, x, y, z) and (
            first_obstacle(distance2, shape[1], shape[2], x, y, z, line[0], line[1], line[2], weight) < 0
        ):
            return True
    return False
