"""Clearance around points of the map, and the check of trajectories against it."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, BoolArray, ByteArray, FloatArray
from uav_recon.types.maps import VoxelMap

ROOT = np.sqrt(np.arange(256, dtype=np.float64))
ROOT.setflags(write=False)
NO_FINE = np.zeros((0, 1, 1, 1), dtype=np.uint8), np.zeros((0, 3)), 1.0
FINE_STEP_M = 0.05
CHECK_STEP_M = 0.02  # a sample is checked when the body has moved this far since the last checked one
EXIT_LENGTH_M = (
    0.3  # the first part of the path, checked for MAX_CLEARANCE_LOSS_M only: the body must be able to leave a tight spot ...
)
MAX_ESCAPE_M = 2.0  # ... and may fly this far through free space below the clearance, until it first reaches it ...
MAX_CLEARANCE_LOSS_M = (
    0.03  # ... but its clearance never falls below that at its start minus map noise: the next motion starts there
)


class ClearanceMap(NamedTuple):
    """Map data for kernels, which take it as one argument.

    distance2: (nx, ny, nz) squared distances in voxels. height_weight: HeightMeasure.weight, the largest of all maps.
    frame: (10,) origin (3), lower (3) and upper corner (3) of the box that the body's centre stays in, and the clearance that
        counts at the box's border; metres.
    resolution_m: edge of a voxel.
    root: (256,) square root of each value of a byte.
    fine_distance2: (K, fx, fy, fz) squared distances in the fine maps, in their voxels.
    fine_frame: (K, 3) their origins, metres. fine_resolution_m: edge of their voxels.
    fine_credit_m: a fine map knows clearances better, so that this much less is enough; it is added to them.
    """

    distance2: ByteArray
    frame: FloatArray
    resolution_m: float
    root: FloatArray
    fine_distance2: ByteArray
    fine_frame: FloatArray
    fine_resolution_m: float
    fine_credit_m: float
    height_weight: float

    @staticmethod
    def of(
        voxels: VoxelMap, low_m: FloatArray, high_m: FloatArray, border_m: float, fine_credit_m: float = 0.0
    ) -> ClearanceMap:
        """Return the clearances of a map inside a box (infinite corners: no box)."""
        frame = np.array([*voxels.grid.origin_world_m, *low_m, *high_m, border_m], dtype=np.float64)
        fine, fine_frame, fine_resolution_m = NO_FINE
        if voxels.fine:
            fine = np.stack([one.distance2 for one in voxels.fine])
            fine_frame = np.stack([one.grid.origin_world_m for one in voxels.fine])
            fine_resolution_m = float(voxels.fine[0].grid.resolution_m)
        fine.setflags(write=False)
        return ClearanceMap(
            distance2=voxels.distance2, frame=frame, resolution_m=float(voxels.grid.resolution_m), root=ROOT,
            fine_distance2=fine, fine_frame=fine_frame, fine_resolution_m=fine_resolution_m, fine_credit_m=fine_credit_m,
            height_weight=max(one.heights.weight for one in (voxels, *voxels.fine)),
        )  # fmt: skip

    def is_finer_than_needed(self, vertex: FloatArray, clearance_m: float) -> bool:
        """Return True if a polyline (N, 3 or more) leads where only a fine map shows a clearance."""
        if not len(self.fine_frame):
            return False
        pieces = [np.linspace(a, b, 2 + int(np.linalg.norm(b - a) / FINE_STEP_M)) for a, b in itertools.pairwise(vertex[:, :3])]
        points = np.concatenate(pieces) if pieces else vertex[:, :3].copy()
        found_m = np.empty(len(points))
        coarse_clearances_at(self, points, found_m)
        return bool((found_m < clearance_m).any())


@kernel
def clearance_at(clearance_map: ClearanceMap, x: float, y: float, z: float) -> float:
    """Return the clearance of a point: metres to the nearest centre of a voxel not free.

    That of the whole map, or that of a fine map and its credit, whichever is more; see coarse_clearance_at().
    """
    clearance_m = coarse_clearance_at(clearance_map, x, y, z)
    for n in range(len(clearance_map.fine_frame)):
        fine_m = _fine_clearance(clearance_map, n, x, y, z)
        if fine_m > 0.0:
            clearance_m = max(clearance_m, fine_m + clearance_map.fine_credit_m)
    return float(clearance_m)


@kernel
def _fine_clearance(clearance_map: ClearanceMap, n: int, x: float, y: float, z: float) -> float:
    """Return the clearance of a point in the n-th fine map.

    It is 0 outside the map, and where it is not known free.
    """
    distance2, edge_m, root = clearance_map.fine_distance2[n], clearance_map.fine_resolution_m, clearance_map.root
    u = (x - clearance_map.fine_frame[n, 0]) / edge_m - 0.5
    v = (y - clearance_map.fine_frame[n, 1]) / edge_m - 0.5
    w = (z - clearance_map.fine_frame[n, 2]) / edge_m - 0.5
    i, j, k = math.floor(u), math.floor(v), math.floor(w)
    nx, ny, nz = distance2.shape
    if i < 0 or j < 0 or k < 0 or i + 1 >= nx or j + 1 >= ny or k + 1 >= nz:
        return 0.0
    f, g, h = u - i, v - j, w - k
    near = (1 - h) * root[distance2[i, j, k]] + h * root[distance2[i, j, k + 1]]
    left = (1 - h) * root[distance2[i, j + 1, k]] + h * root[distance2[i, j + 1, k + 1]]
    ahead = (1 - h) * root[distance2[i + 1, j, k]] + h * root[distance2[i + 1, j, k + 1]]
    far = (1 - h) * root[distance2[i + 1, j + 1, k]] + h * root[distance2[i + 1, j + 1, k + 1]]
    return float(((1 - f) * ((1 - g) * near + g * left) + f * ((1 - g) * ahead + g * far)) * edge_m)


@kernel
def coarse_clearance_at(clearance_map: ClearanceMap, x: float, y: float, z: float) -> float:
    """Return the clearance of a point in the whole map.

    That is the distance in metres to the nearest centre of a voxel not known free. It is 0 in such a voxel and outside the
    grid. Near a side of the box to stay in, it is at most the distance to that side plus the clearance at the box's border. The
    value is interpolated trilinearly between the eight voxel centres around the point. It is at least the value of the point's
    own voxel less half a voxel, so that every path through cells that the planner calls flyable remains flyable.
    """
    distance2, frame, resolution_m, root = (
        clearance_map.distance2,
        clearance_map.frame,
        clearance_map.resolution_m,
        clearance_map.root,
    )
    nx, ny, nz = distance2.shape
    u, v, w = (x - frame[0]) / resolution_m, (y - frame[1]) / resolution_m, (z - frame[2]) / resolution_m
    i, j, k = math.floor(u), math.floor(v), math.floor(w)
    if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
        return 0.0
    inside = min(x - frame[3], frame[6] - x, y - frame[4], frame[7] - y, z - frame[5], frame[8] - z) + frame[9]
    own = root[distance2[i, j, k]]
    if own == 0.0:
        return 0.0
    i, j, k = math.floor(u - 0.5), math.floor(v - 0.5), math.floor(w - 0.5)
    if i < 0 or j < 0 or k < 0 or i + 1 >= nx or j + 1 >= ny or k + 1 >= nz:
        return float(min((own - 0.5) * resolution_m, max(inside, 1e-6)))
    f, g, h = u - 0.5 - i, v - 0.5 - j, w - 0.5 - k
    near = (1 - h) * root[distance2[i, j, k]] + h * root[distance2[i, j, k + 1]]
    left = (1 - h) * root[distance2[i, j + 1, k]] + h * root[distance2[i, j + 1, k + 1]]
    ahead = (1 - h) * root[distance2[i + 1, j, k]] + h * root[distance2[i + 1, j, k + 1]]
    far = (1 - h) * root[distance2[i + 1, j + 1, k]] + h * root[distance2[i + 1, j + 1, k + 1]]
    between = (1 - f) * ((1 - g) * near + g * left) + f * ((1 - g) * ahead + g * far)
    return float(min(max(own - 0.5, between) * resolution_m, max(inside, 1e-6)))


@kernel
def coarse_clearances_at(clearance_map: ClearanceMap, points: AnyArray, out: AnyArray) -> None:
    """Fill ``out`` (N,) with coarse_clearance_at of each of the points (N, 3 or more)."""
    for n in range(len(points)):
        out[n] = coarse_clearance_at(clearance_map, points[n, 0], points[n, 1], points[n, 2])


@kernel
def clearances_at(clearance_map: ClearanceMap, points: AnyArray, out: AnyArray) -> None:
    """Fill ``out`` (N,) with clearance_at of each of the points (N, 3 or more)."""
    for n in range(len(points)):
        out[n] = clearance_at(clearance_map, points[n, 0], points[n, 1], points[n, 2])


@kernel
def free_distances(clearance_map: ClearanceMap, points: AnyArray, heading: AnyArray, min_m: float, way_m: AnyArray) -> None:
    """Shorten ``way_m`` to where the clearance along each heading is no longer above ``min_m``.

    way_m: (N,) metres from each point (N, 3 or more) along its heading (N, 3). A heading of zero length leaves its entry
    unchanged.
    """
    for n in range(len(points)):
        dx, dy, dz = heading[n, 0], heading[n, 1], heading[n, 2]
        flat, went_m = math.sqrt(dx * dx + dy * dy + dz * dz), 0.0
        share = flat / max(math.sqrt(dx * dx + dy * dy + clearance_map.height_weight * dz * dz), 1e-9)
        while flat > 1e-9 and went_m < way_m[n]:
            part = went_m / flat
            x, y, z = points[n, 0] + part * dx, points[n, 1] + part * dy, points[n, 2] + part * dz
            left_m = clearance_at(clearance_map, x, y, z) - min_m
            if left_m <= 0.0:
                way_m[n] = went_m
            went_m += max(share * left_m, 0.5 * clearance_map.resolution_m)


@kernel
def _blocked(clearance_map: ClearanceMap, points: AnyArray, first: int, min_m: float, out: AnyArray) -> int:
    """Mark blocked samples in ``out`` (N,) and return the first one, or -1.

    Which samples are checked depends on the whole trajectory and not on ``first``: a trajectory that was clear as a whole is
    clear from each of its samples on, while the map does not change. The exception is a trajectory out of a tight spot that
    loses clearance on its way; it may brake there.
    """
    reached, begun_m = False, np.inf
    travelled_m, since_m, found = 0.0, CHECK_STEP_M, -1
    for n in range(len(points)):
        if n > 0:
            dx, dy, dz = points[n, 0] - points[n - 1, 0], points[n, 1] - points[n - 1, 1], points[n, 2] - points[n - 1, 2]
            step_m = math.sqrt(dx * dx + dy * dy + dz * dz)
            since_m += step_m
            if n > first:
                travelled_m += step_m
        looks = since_m >= CHECK_STEP_M or n == len(points) - 1
        if looks:
            since_m = 0.0
        if n < first or not looks:
            continue
        here_m = clearance_at(clearance_map, points[n, 0], points[n, 1], points[n, 2])
        begun_m = here_m if begun_m == np.inf else begun_m
        enough = here_m >= min_m
        reached = reached or enough or travelled_m > MAX_ESCAPE_M
        deeper = here_m < min(begun_m, min_m) - MAX_CLEARANCE_LOSS_M
        if deeper or (travelled_m > EXIT_LENGTH_M and (here_m == 0.0 or (reached and not enough))):
            out[n] = True
            if found < 0:
                found = n
    return found


def blocked(clearance_map: ClearanceMap, points_m: FloatArray, first: int, min_m: float) -> BoolArray:
    """Return a mask (N,) of the blocked samples from ``first`` on.

    A sample is blocked if it is not known free, or has less clearance than ``min_m`` after an earlier sample had it, or has
    less clearance than sample ``first``. See EXIT_LENGTH_M, MAX_ESCAPE_M and MAX_CLEARANCE_LOSS_M for
    what a trajectory out of a tight spot may do.
    """
    out = np.zeros(len(points_m), dtype=np.bool_)
    _blocked(clearance_map, points_m, first, min_m, out)
    return out


def is_clear(clearance_map: ClearanceMap, points_m: FloatArray, first: int, min_m: float) -> bool:
    """Return True if no sample from ``first`` on is blocked."""
    return not blocked(clearance_map, points_m, first, min_m).any()
