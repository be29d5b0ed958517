"""Hit integration: count the returns that end in each voxel and mark these voxels occupied."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.occupancy.grid_camera import GridCamera
from uav_recon.mapping.occupancy.log_odds import add_log_odds
from uav_recon.types.frames import AnyArray, Float32Array, IntArray

SOLID_SHARE = 0.15  # hits with less than this share of the pixels of a facing voxel are a speckle or a wire


class HitCounts(NamedTuple):
    """Returns of one frame by voxel.

    counts: (N + 1,) returns in each of the N voxels of the view's box in C order, then those outside it. touched: (H * W + 1,)
    indices in the box of the voxels with a return.
    """

    counts: NDArray[np.int32]
    touched: NDArray[np.int32]


@kernel
def count_hits(depth_m: Float32Array, camera: GridCamera, box: IntArray, hits: HitCounts) -> int:
    """Count the returns that end in each voxel of a box; returns the number of voxels hit.

    ``touched`` lists the voxels hit. depth_m: (H, W). box: (2, 3) voxels of the grid. hits.counts must be all zero; its last
    element is for pixels without a return or with a return outside the box. Branch-free, because the branches would be
    unpredictable.
    """
    fx, fy, cx, cy = camera.pinhole_px
    rotation, origin, resolution_m, counts, touched = (
        camera.rotation,
        camera.origin,
        camera.resolution_m,
        hits.counts,
        hits.touched,
    )
    width = depth_m.shape[1]
    near, far = np.float32(camera.near_m), np.float32(camera.far_m)
    far2, zero = far * far, np.float32(0.0)
    scale = 1.0 / resolution_m
    across_x, across_y = np.float32(rotation[0, 0] * scale / fx), np.float32(rotation[1, 0] * scale / fx)
    across_z = np.float32(rotation[2, 0] * scale / fx)
    ox, oy, oz = np.float32(origin[0] - box[0, 0]), np.float32(origin[1] - box[0, 1]), np.float32(origin[2] - box[0, 2])
    ny, nz = np.int32(box[1, 1] - box[0, 1]), np.int32(box[1, 2] - box[0, 2])
    nowhere = np.int32(box[1, 0] - box[0, 0]) * ny * nz
    end_x, end_y, end_z = np.float32(box[1, 0] - box[0, 0]), np.float32(ny), np.float32(nz)
    middle, per_pixel = np.float32(cx), np.float32(1.0 / fx)
    ends = np.empty(width, dtype=np.int32)
    counts[nowhere] = 1
    number = 0
    for v in range(depth_m.shape[0]):
        y = (v - cy) / fy
        ax = np.float32((rotation[0, 1] * y + rotation[0, 2]) * scale)
        ay = np.float32((rotation[1, 1] * y + rotation[1, 2]) * scale)
        az = np.float32((rotation[2, 1] * y + rotation[2, 2]) * scale)
        yy = np.float32(y * y + 1.0)
        row = depth_m[v]
        for u in range(width):
            depth = row[u]
            right = np.float32(np.int32(u)) - middle
            x = right * per_pixel
            gx, gy, gz = (
                ox + depth * (across_x * right + ax),
                oy + depth * (across_y * right + ay),
                oz + depth * (across_z * right + az),
            )
            seen = (depth >= near) & (depth <= far) & (depth * depth * (x * x + yy) <= far2)
            seen &= (gx >= zero) & (gy >= zero) & (gz >= zero) & (gx < end_x) & (gy < end_y) & (gz < end_z)
            gx, gy, gz = gx if seen else zero, gy if seen else zero, gz if seen else zero
            index = (np.int32(gx) * ny + np.int32(gy)) * nz + np.int32(gz)
            ends[u] = index if seen else nowhere
        for u in range(width):
            end = np.uint32(ends[u])
            count = counts[end]
            touched[number] = end
            number += int(count == 0)
            counts[end] = count + 1
    counts[nowhere] = 0
    return number


@kernel
def mark_occupied(
    hits: HitCounts, number: int, camera: GridCamera, box: IntArray, shape: tuple[int, int, int], odds: AnyArray,
    listed: IntArray, listing: int,
) -> int:  # fmt: skip
    """Add the log-odds of the voxels with returns and clear the hit counts.

    The weight is larger for solid hits with low depth noise. Appends the flat indices of the voxels whose state may change
    to listed[listing:]; returns the new length of the list.
    """
    counts, rotation, origin, resolution_m = hits.counts, camera.rotation, camera.origin, camera.resolution_m
    ny, nz = box[1, 1] - box[0, 1], box[1, 2] - box[0, 2]
    for n in range(number):
        end = hits.touched[n]
        i = end // (ny * nz)
        j = (end - i * ny * nz) // nz
        k = end - (i * ny + j) * nz
        i, j, k = i + box[0, 0], j + box[0, 1], k + box[0, 2]
        x, y, z = i + 0.5 - origin[0], j + 0.5 - origin[1], k + 0.5 - origin[2]
        depth = (rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z) * resolution_m
        facing = camera.pinhole_px[0] * resolution_m
        sigma_m = camera.noise_per_m * depth * depth
        weight = 1
        if counts[end] * depth * depth >= SOLID_SHARE * facing * facing:
            weight = 4 if sigma_m <= 0.25 * resolution_m else 2 if sigma_m <= 0.5 * resolution_m else 1
        counts[end] = 0
        index = (i * shape[1] + j) * shape[2] + k
        if add_log_odds(odds, index, weight):
            listed[listing] = index
            listing += 1
    return listing
