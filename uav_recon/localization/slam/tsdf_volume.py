"""Truncated signed distance field of the surfaces seen before, in blocks of voxels.

Curless and Levoy 1996, A Volumetric Method for Building Complex Models from Range Images.
Only blocks near a surface exist. An index volume gives the block at a place; the blocks themselves lie in a pool that grows.
A voxel holds the weighted mean of its distances to the planes through the measured points, positive in front of a surface.
A block holds the error of its place, too: that of the camera when the block was seen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.camera import Frame
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.pose import Pose

VOXEL_M = 0.05
TRUNCATION_M = 0.20
SIDE = 8  # voxels along an edge of a block
BLOCK_M = SIDE * VOXEL_M
# blocks along x, y and z: 51 x 51 x 12.8 m around the origin of odom
BLOCKS = (128, 128, 32)
ORIGIN_M = np.array([-0.5 * BLOCK_M * n for n in BLOCKS])
REACH_M = 4.5  # farther depth is too noisy to be fused
MAX_WEIGHT = 60.0  # in frames seen from near; a larger one would keep a wall where it was first seen
MIN_WEIGHT = 0.004  # a voxel with less is unknown: a grazing view from far away counts
# share of the variance of a view, less than which, and by at least how much, a block is known better than the view shows it
_BETTER_SHARE = 0.25
_ALIKE_M2 = 0.02**2
_STRIDE_PX = 4  # of the pixels that create blocks
_FIRST_BLOCKS = 1024
_UNIT_M2 = 1.0  # a depth of one metre, seen at a right angle, has weight one
_NONE = -1
# a field that grows along the ray by more was measured from the other side of a wall: inside, the nearer surface counts
_MIN_AWAY = 0.3
# a normal is measured between pixels this far apart: more where depth is noisier
_SPAN_PX = 2
_SPAN_PER_M = 1.5
_WIDEST_SPAN_PX = 8
_MIN_COS = 0.05  # a surface at a more grazing angle counts as this
# inverse depths that bend by more are those of two objects
_MAX_BEND_PER_M = 0.03
_MAX_BEND_SHARE = 0.05


class TsdfBlocks(NamedTuple):
    """Arrays of a volume, for kernels.

    block_index (BLOCKS): number of the block at a place, -1 for none. distance, weight (blocks, SIDE, SIDE, SIDE): in metres,
    and in frames. variance (blocks, 3): of the place of a block, m² along the axes of odom.
    """

    block_index: AnyArray
    distance: AnyArray
    weight: AnyArray
    variance: AnyArray


class TsdfVolume:
    """The field in odom. Not thread-safe.

    ``index``: block_index of TsdfBlocks. ``distance``, ``weight``, ``variance``: as there. ``count``: number of blocks in use.
    """

    def __init__(self) -> None:
        self.index = np.full(BLOCKS, _NONE, dtype=np.int32)
        self.distance = np.zeros((_FIRST_BLOCKS, SIDE, SIDE, SIDE), dtype=np.float32)
        self.weight = np.zeros_like(self.distance)
        self.variance = np.zeros((_FIRST_BLOCKS, 3))
        self.count = 0
        self._place = np.zeros((_FIRST_BLOCKS, 3), dtype=np.int32)
        self._touched = np.zeros(_FIRST_BLOCKS, dtype=np.int64)
        self._fusions = 0

    @property
    def blocks(self) -> TsdfBlocks:
        """The arrays as they are now; the next image may replace them."""
        return TsdfBlocks(block_index=self.index, distance=self.distance, weight=self.weight, variance=self.variance)

    def integrate(self, frame: Frame, odom_from_depth: Pose, variance: FloatArray) -> None:
        """Fuse a depth image; about 4 ms for 424x240.

        variance (3,): of the place of the camera, m² along the axes of odom. A block that is known much better stays as it is.
        """
        before = self.count
        self._fusions += 1
        camera, rotation, place_m = (
            frame.depth_intrinsics.pinhole_px(),
            odom_from_depth.rotation(),
            odom_from_depth.translation_m,
        )
        seen = frame.depth_m, camera, rotation, place_m
        while True:
            count = create_blocks(*seen, self.index, self._place, self._touched, self.count, self._fusions)
            self.count = min(count, len(self._place))
            if count <= len(self._place):
                break
            self._grow()
        self.variance[before : self.count] = variance
        better = self.variance[: self.count].max(axis=1) < _BETTER_SHARE * variance.max() - _ALIKE_M2
        blocks = np.flatnonzero((self._touched[: self.count] == self._fusions) & ~better)
        share = fuse_blocks(*seen, incidence(frame.depth_m, camera), blocks, self._place, self.distance, self.weight)
        self.variance[blocks] += share[:, None] * (variance - self.variance[blocks])

    def _grow(self) -> None:
        self._place = np.concatenate((self._place, np.zeros_like(self._place)))
        self._touched = np.concatenate((self._touched, np.zeros_like(self._touched)))
        self.distance = np.concatenate((self.distance, np.zeros_like(self.distance)))
        self.weight = np.concatenate((self.weight, np.zeros_like(self.weight)))
        self.variance = np.concatenate((self.variance, np.zeros_like(self.variance)))


@kernel
def create_blocks(
    depth_m: AnyArray,
    camera: AnyArray,
    rotation: AnyArray,
    place_m: AnyArray,
    index: AnyArray,
    block_place: AnyArray,
    touched: AnyArray,
    count: int,
    fusion: int,
) -> int:
    """Create the missing blocks near the surface of a depth image.

    All of the blocks there are marked with the number of the fusion.

    Returns the number of blocks that are needed; more than fit are not created.
    """
    height, width = depth_m.shape
    for v in range(_STRIDE_PX // 2, height, _STRIDE_PX):
        for u in range(_STRIDE_PX // 2, width, _STRIDE_PX):
            z = float(depth_m[v, u])
            if not 0.0 < z <= REACH_M:
                continue
            x, y = (u - camera[2]) / camera[0], (v - camera[3]) / camera[1]
            for step in range(-1, 2):
                deep = z + step * TRUNCATION_M
                i = _block_of(rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2], deep, place_m[0], ORIGIN_M[0])
                j = _block_of(rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2], deep, place_m[1], ORIGIN_M[1])
                k = _block_of(rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2], deep, place_m[2], ORIGIN_M[2])
                if not (0 <= i < index.shape[0] and 0 <= j < index.shape[1] and 0 <= k < index.shape[2]):
                    continue
                block = index[i, j, k]
                if block < 0:
                    block = count
                    count += 1
                    if block >= block_place.shape[0]:
                        continue
                    index[i, j, k] = block
                    block_place[block, 0], block_place[block, 1], block_place[block, 2] = i, j, k
                touched[block] = fusion
    return count


@kernel
def _block_of(direction: float, deep: float, place_m: float, origin_m: float) -> int:
    return int(np.floor((place_m + direction * deep - origin_m) / BLOCK_M))


@kernel
def incidence(depth_m: AnyArray, camera: AnyArray) -> AnyArray:
    """Return the distance to the plane through a pixel per metre along the axis, (H, W) float32.

    Zero where there is no plane: at edges, and without a return.
    """
    height, width = depth_m.shape
    out = np.zeros((height, width), np.float32)
    for v in range(_SPAN_PX, height - _SPAN_PX):
        for u in range(_SPAN_PX, width - _SPAN_PX):
            z = float(depth_m[v, u])
            if not 0.0 < z <= REACH_M:
                continue
            span = min(_SPAN_PX + int(_SPAN_PER_M * z), _WIDEST_SPAN_PX, u, v, width - 1 - u, height - 1 - v)
            # the inverse depth of a plane is a linear function of the direction: 1/z = a x + b y + c, and (a, b, c) its normal
            here = 1.0 / z
            left, right = _inverse(depth_m[v, u - span]), _inverse(depth_m[v, u + span])
            up, down = _inverse(depth_m[v - span, u]), _inverse(depth_m[v + span, u])
            most = _MAX_BEND_PER_M + _MAX_BEND_SHARE * here
            if not (abs(left + right - 2.0 * here) < most and abs(up + down - 2.0 * here) < most):  # not for NaN either
                continue
            x, y = (u - camera[2]) / camera[0], (v - camera[3]) / camera[1]
            a, b = (right - left) * camera[0] / (2 * span), (down - up) * camera[1] / (2 * span)
            c = here - a * x - b * y
            out[v, u] = max(here / np.sqrt(a * a + b * b + c * c), _MIN_COS)
    return out


@kernel
def _inverse(depth_m: float) -> float:
    """Return the inverse of a depth, NaN without a return."""
    return 1.0 / float(depth_m) if depth_m > 0.0 else np.nan


@kernel
def fuse_blocks(
    depth_m: AnyArray,
    camera: AnyArray,
    rotation: AnyArray,
    place_m: AnyArray,
    slope: AnyArray,
    blocks: AnyArray,
    block_place: AnyArray,
    distance: AnyArray,
    weight: AnyArray,
) -> AnyArray:
    """Fuse a depth image into the voxels of some blocks; return its share (N,) in each of them.

    slope: of incidence().
    """
    height, width = depth_m.shape
    share = np.zeros(blocks.shape[0])
    for number in range(blocks.shape[0]):
        block, added, whole = blocks[number], 0.0, 0.0
        corner0 = ORIGIN_M[0] + block_place[block, 0] * BLOCK_M + 0.5 * VOXEL_M - place_m[0]
        corner1 = ORIGIN_M[1] + block_place[block, 1] * BLOCK_M + 0.5 * VOXEL_M - place_m[1]
        corner2 = ORIGIN_M[2] + block_place[block, 2] * BLOCK_M + 0.5 * VOXEL_M - place_m[2]
        for i in range(SIDE):
            x = corner0 + i * VOXEL_M
            for j in range(SIDE):
                y = corner1 + j * VOXEL_M
                for k in range(SIDE):
                    z = corner2 + k * VOXEL_M
                    deep = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
                    if deep < 0.1:
                        continue
                    across = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
                    down = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
                    u = int(np.rint(across / deep * camera[0] + camera[2]))
                    v = int(np.rint(down / deep * camera[1] + camera[3]))
                    if not (0 <= u < width and 0 <= v < height):
                        continue
                    seen_m, along = float(depth_m[v, u]), float(slope[v, u])
                    off_m = along * (seen_m - deep)
                    if along <= 0.0 or not off_m >= -TRUNCATION_M:
                        continue
                    new = _UNIT_M2 * min(along, 1.0) / max(seen_m * seen_m, 0.25)
                    if off_m < -VOXEL_M:  # behind the surface: less, for another surface may be there
                        new *= (off_m + TRUNCATION_M) / (TRUNCATION_M - VOXEL_M)
                    old = _kept(distance[block], weight[block], i, j, k, x, y, z, off_m)
                    if old < 0.0:
                        continue
                    distance[block, i, j, k] = (old * distance[block, i, j, k] + new * min(off_m, TRUNCATION_M)) / (old + new)
                    weight[block, i, j, k] = min(old + new, MAX_WEIGHT)
                    added += new
                    whole += old + new
        share[number] = added / max(whole, MIN_WEIGHT)
    return share


@kernel
def _kept(distance: AnyArray, weight: AnyArray, i: int, j: int, k: int, x: float, y: float, z: float, off_m: float) -> float:
    """Return the weight that a voxel of a block keeps beside a new distance.

    off_m: the new distance, seen along (x, y, z). Negative: the new one does not count. What was measured from the other
    side of a wall is replaced by a larger distance, and stays beside a smaller one: between two surfaces the nearer one
    counts.
    """
    old = weight[i, j, k]
    if old <= 0.0 or _slope_along(distance, weight, i, j, k, x, y, z) <= _MIN_AWAY:
        return float(old)
    return 0.0 if off_m > distance[i, j, k] else -1.0


@kernel
def _slope_along(distance: AnyArray, weight: AnyArray, i: int, j: int, k: int, x: float, y: float, z: float) -> float:
    """Return the growth of the distances at a voxel along a direction (x, y, z).

    It is measured between the known neighbours in its block.
    """
    along, length = 0.0, np.sqrt(x * x + y * y + z * z)
    for axis in range(3):
        low = high = distance[i, j, k]
        steps = 0
        for side in range(-1, 2, 2):
            p, q, r = i + side * (axis == 0), j + side * (axis == 1), k + side * (axis == 2)
            if min(p, q, r) < 0 or max(p, q, r) >= SIDE or weight[p, q, r] <= 0.0:
                continue
            steps += 1
            if side < 0:
                low = distance[p, q, r]
            else:
                high = distance[p, q, r]
        if steps:
            along += (x, y, z)[axis] / length * (high - low) / (steps * VOXEL_M)
    return along


@kernel
def sample(point: AnyArray, index: AnyArray, distance: AnyArray, weight: AnyArray, out: AnyArray) -> bool:
    """Interpolate the field at a point (3,) in odom.

    out (5,): distance (m), gradient, and number of the block. Returns False where a voxel around the point is unknown.
    """
    x = (point[0] - ORIGIN_M[0]) / VOXEL_M - 0.5
    y = (point[1] - ORIGIN_M[1]) / VOXEL_M - 0.5
    z = (point[2] - ORIGIN_M[2]) / VOXEL_M - 0.5
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    last = SIDE - 1
    if i < 0 or j < 0 or k < 0:
        return False
    if (i + 1) // SIDE >= index.shape[0] or (j + 1) // SIDE >= index.shape[1] or (k + 1) // SIDE >= index.shape[2]:
        return False
    fx, fy, fz = x - i, y - j, z - k
    value, gx, gy, gz = 0.0, 0.0, 0.0, 0.0
    for a in range(2):
        wx = fx if a else 1.0 - fx
        for b in range(2):
            wy = fy if b else 1.0 - fy
            for c in range(2):
                wz = fz if c else 1.0 - fz
                block = index[(i + a) // SIDE, (j + b) // SIDE, (k + c) // SIDE]
                if block < 0:
                    return False
                p, q, r = (i + a) & last, (j + b) & last, (k + c) & last
                if weight[block, p, q, r] < MIN_WEIGHT:
                    return False
                d = distance[block, p, q, r]
                value += wx * wy * wz * d
                gx += (d if a else -d) * wy * wz
                gy += (d if b else -d) * wx * wz
                gz += (d if c else -d) * wx * wy
    out[0], out[1], out[2], out[3] = value, gx / VOXEL_M, gy / VOXEL_M, gz / VOXEL_M
    out[4] = index[i // SIDE, j // SIDE, k // SIDE]
    return True
