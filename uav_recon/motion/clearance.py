"""How much room there is around a point of the map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, BoolArray, ByteArray, FloatArray
from uav_recon.types.maps import VoxelMap

ROOT = np.sqrt(np.arange(256, dtype=np.float64))
ROOT.setflags(write=False)
LOOK_M = 0.02  # a sample is looked up when the body has moved so far since the last one that was
LEAVING_M = 0.3  # so much of the way is hardly checked: the body must be able to leave a tight spot ...
ESCAPE_M = 2.0  # ... and may fly so far through free space without the clearance, until it has it once ...
LOSS_M = 0.03  # ... but never to less room than where it begins, by more than the map's noise: the next motion begins there


@dataclass(frozen=True, slots=True, eq=False)
class ClearanceMap:
    """What kernels need of a map: squared distances (nx, ny, nz) in voxels, and the frame.

    frame: (10,) origin (3), lower (3) and upper corner (3) of the box that the body's centre stays in, and the room that
    counts at the box's border; metres.
    """

    distance2: ByteArray
    frame: FloatArray
    resolution_m: float

    @staticmethod
    def of(voxels: VoxelMap, low_m: FloatArray, high_m: FloatArray, border_m: float) -> ClearanceMap:
        """The space of a map inside a box (infinite corners: no box)."""
        frame = np.array([*voxels.grid.origin_world_m, *low_m, *high_m, border_m], dtype=np.float64)
        return ClearanceMap(voxels.distance2, frame, float(voxels.grid.resolution_m))


@kernel
def room_at(distance2: AnyArray, frame: AnyArray, resolution_m: float, root: AnyArray, x: float, y: float, z: float) -> float:
    """Metres from a point to the nearest centre of a voxel that is not known free; 0 in such a voxel and outside the grid.

    Near a side of the box to stay in, what is left to it and the room at its border, if that is less.
    The trilinear one between the eight centres around it; at least the point's own voxel's less half a voxel, so that every
    way through cells that the planner calls flyable stays one.
    """
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
def rooms(distance2: AnyArray, frame: AnyArray, resolution_m: float, root: AnyArray, points: AnyArray, out: AnyArray) -> None:
    """room_at for many points (N, 3 or more)."""
    for n in range(len(points)):
        out[n] = room_at(distance2, frame, resolution_m, root, points[n, 0], points[n, 1], points[n, 2])


@kernel
def ways_ahead(
    distance2: AnyArray, frame: AnyArray, resolution_m: float, root: AnyArray, points: AnyArray, heading: AnyArray,
    min_m: float, way_m: AnyArray,
) -> None:  # fmt: skip
    """Shorten way_m (N,), metres from each point (N, 3 or more) along its heading (N, 3), to where there is no more room than
    ``min_m``. A heading of no length leads nowhere and is left.
    """
    for n in range(len(points)):
        dx, dy, dz = heading[n, 0], heading[n, 1], heading[n, 2]
        flat, went_m = math.sqrt(dx * dx + dy * dy + dz * dz), 0.0
        while flat > 1e-9 and went_m < way_m[n]:
            share = went_m / flat
            x, y, z = points[n, 0] + share * dx, points[n, 1] + share * dy, points[n, 2] + share * dz
            left_m = room_at(distance2, frame, resolution_m, root, x, y, z) - min_m
            if left_m <= 0.0:
                way_m[n] = went_m
            went_m += max(left_m, 0.5 * resolution_m)


@kernel
def _blocked(
    distance2: AnyArray, frame: AnyArray, resolution_m: float, root: AnyArray, points: AnyArray, first: int, min_m: float,
    out: AnyArray,
) -> int:  # fmt: skip
    """Mark blocked samples in ``out`` (N,) and return the first one, or -1.

    Which samples are looked up depends on the whole trajectory and not on ``first``: a motion that was clear as a whole is
    clear from each of its samples on, as long as the map stays as it is; but for one out of a tight spot that loses room on its
    way, which may brake there.
    """
    reached, begun_m = False, np.inf
    travelled_m, since_m, found = 0.0, LOOK_M, -1
    for n in range(len(points)):
        if n > 0:
            dx, dy, dz = points[n, 0] - points[n - 1, 0], points[n, 1] - points[n - 1, 1], points[n, 2] - points[n - 1, 2]
            step_m = math.sqrt(dx * dx + dy * dy + dz * dz)
            since_m += step_m
            if n > first:
                travelled_m += step_m
        looks = since_m >= LOOK_M or n == len(points) - 1
        if looks:
            since_m = 0.0
        if n < first or not looks:
            continue
        room_m = room_at(distance2, frame, resolution_m, root, points[n, 0], points[n, 1], points[n, 2])
        begun_m = room_m if begun_m == np.inf else begun_m
        enough = room_m >= min_m
        reached = reached or enough or travelled_m > ESCAPE_M
        deeper = room_m < min(begun_m, min_m) - LOSS_M
        if deeper or (travelled_m > LEAVING_M and (room_m == 0.0 or (reached and not enough))):
            out[n] = True
            if found < 0:
                found = n
    return found


def blocked(space: ClearanceMap, points_m: FloatArray, first: int, min_m: float) -> BoolArray:
    """Which samples (N,) from ``first`` on are not known free, or have less room than ``min_m`` after having had it, or than
    where it begins.
    """
    out = np.zeros(len(points_m), dtype=np.bool_)
    _blocked(space.distance2, space.frame, space.resolution_m, ROOT, points_m, first, min_m, out)
    return out


def is_clear(space: ClearanceMap, points_m: FloatArray, first: int, min_m: float) -> bool:
    """Whether no sample from ``first`` on is blocked."""
    return not blocked(space, points_m, first, min_m).any()
