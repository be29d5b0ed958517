"""Kernels of the voxel map: what one depth frame says about each voxel, and how it adds up."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN

# Evidence in steps of log-odds. One frame never frees a voxel: two clear looks or four doubtful ones do. A solid hit
# at close range occupies at once, a thin or distant one after two frames. The clamps bound how long a change takes.
FREE_AT, OCCUPIED_AT = -4, 2
LOWEST, HIGHEST = -10, 12
LEVELS = 6  # sliding minima over 1, 2, 4 ... 32 cells
CELL = 2  # pixels per cell of the pooled depth
NOISE_SIGMAS = 2.5  # a surface is believed to lie no nearer than its depth less so many sigmas
VALID_SHARE = 0.75  # of the footprint must have a return before a voxel is freed
SOLID_SHARE = 0.15  # of the pixels that a facing voxel would catch make a hit solid; fewer are a speckle or a wire


@kernel
def pool(depth_m: AnyArray, near_m: float, lowest_m: AnyArray, valid: AnyArray) -> None:
    """Sliding minima lowest_m (LEVELS, h, w) float32 and the integral image valid (h + 1, w + 1) of pixels with a return."""
    height, width = depth_m.shape
    _, rows, columns = lowest_m.shape
    infinite = np.float32(np.inf)
    for i in range(rows):
        running = 0
        for j in range(columns):
            nearest = infinite
            for v in range(CELL * i, min(CELL * i + CELL, height)):
                for u in range(CELL * j, min(CELL * j + CELL, width)):
                    depth = depth_m[v, u]
                    if depth >= near_m and depth < infinite:
                        running += 1
                        nearest = min(nearest, depth)
            lowest_m[0, i, j] = nearest
            valid[i + 1, j + 1] = valid[i, j + 1] + running
    for level in range(1, LEVELS):
        half = 1 << (level - 1)
        for i in range(rows):
            upper = lowest_m[level - 1, i]
            lower = lowest_m[level - 1, min(i + half, rows - 1)]
            target = lowest_m[level, i]
            for j in range(columns - half):
                target[j] = min(upper[j], lower[j], upper[j + half], lower[j + half])
            for j in range(max(columns - half, 0), columns):
                target[j] = min(upper[j], lower[j])


@kernel
def count_hits(
    depth_m: AnyArray, camera: AnyArray, rotation: AnyArray, origin: AnyArray, near_m: float, far_m: float,
    resolution_m: float, shape: tuple[int, int, int], hits: AnyArray, depth_sum_m: AnyArray, touched: AnyArray,
) -> int:  # fmt: skip
    """Count the returns that end in each voxel; ``touched`` lists the flat indices, the number of them is returned."""
    fx, fy, cx, cy = camera
    nx, ny, nz = shape
    scale = 1.0 / resolution_m
    number = 0
    for v in range(depth_m.shape[0]):
        y = (v - cy) / fy
        ax = (rotation[0, 1] * y + rotation[0, 2]) * scale
        ay = (rotation[1, 1] * y + rotation[1, 2]) * scale
        az = (rotation[2, 1] * y + rotation[2, 2]) * scale
        for u in range(depth_m.shape[1]):
            depth = depth_m[v, u]
            if not (depth >= near_m and depth <= far_m):
                continue
            x = (u - cx) / fx
            if depth * depth * (x * x + y * y + 1.0) > far_m * far_m:
                continue
            i = int(np.floor(origin[0] + depth * (rotation[0, 0] * scale * x + ax)))
            j = int(np.floor(origin[1] + depth * (rotation[1, 0] * scale * x + ay)))
            k = int(np.floor(origin[2] + depth * (rotation[2, 0] * scale * x + az)))
            if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
                index = (i * ny + j) * nz + k
                if hits[index] == 0:
                    touched[number] = index
                    number += 1
                    depth_sum_m[index] = 0.0
                hits[index] += 1
                depth_sum_m[index] += depth
    return number


@kernel
def _add(odds: AnyArray, index: int, evidence: int) -> int:
    """Add evidence to a voxel; returns whether that changed its state (before the fence is applied)."""
    before = int(odds[index])
    after = min(max(before + evidence, LOWEST), HIGHEST)
    odds[index] = np.int8(after)
    return int((before <= FREE_AT) != (after <= FREE_AT) or (before >= OCCUPIED_AT) != (after >= OCCUPIED_AT))


@kernel
def free(
    lowest_m: AnyArray, valid: AnyArray, camera: AnyArray, rotation: AnyArray, origin: AnyArray, bounds: AnyArray,
    far_m: float, noise_per_m: float, resolution_m: float, shape: tuple[int, int, int], hits: AnyArray, odds: AnyArray,
) -> int:  # fmt: skip
    """Free the voxels in front of everything seen under their footprint. Returns how many changed state.

    The noise is in disparity: a depth d may truly be 1 / (1 / d + sigmas * noise_per_m), noise_per_m = noise / (f * b).
    """
    fx, fy, cx, cy = camera
    _, rows, columns = lowest_m.shape
    _, ny, nz = shape
    extent_m = 0.5 * resolution_m * (abs(rotation[0, 2]) + abs(rotation[1, 2]) + abs(rotation[2, 2]))
    changed = 0
    for i in range(bounds[0, 0], bounds[1, 0]):
        dx = (i + 0.5 - origin[0]) * resolution_m
        for j in range(bounds[0, 1], bounds[1, 1]):
            dy = (j + 0.5 - origin[1]) * resolution_m
            for k in range(bounds[0, 2], bounds[1, 2]):
                dz = (k + 0.5 - origin[2]) * resolution_m
                z = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
                if z < resolution_m or dx * dx + dy * dy + dz * dz > far_m * far_m:
                    continue
                inverse = 1.0 / (CELL * z)
                u = (rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz) * fx * inverse + (cx + 0.5) / CELL
                v = (rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz) * fy * inverse + (cy + 0.5) / CELL
                if not (u >= 0.0 and v >= 0.0 and u < columns and v < rows):
                    continue
                index = (i * ny + j) * nz + k
                if hits[index] != 0:
                    continue
                ru, rv = 0.5 * resolution_m * fx * inverse, 0.5 * resolution_m * fy * inverse
                u0, u1 = max(int(u - ru), 0), min(int(u + ru), columns - 1) + 1
                v0, v1 = max(int(v - rv), 0), min(int(v + rv), rows - 1) + 1
                level, size = 0, 1
                while level < LEVELS - 1 and 2 * size <= u1 - u0 and 2 * size <= v1 - v0:
                    level += 1
                    size *= 2
                nearest = lowest_m[level, v1 - size, u1 - size]
                row = v0
                while row < v1:
                    top = min(row, v1 - size)
                    column = u0
                    while column < u1:
                        nearest = min(nearest, lowest_m[level, top, min(column, u1 - size)])
                        column += size
                    row += size
                if not nearest < np.inf:
                    continue
                gap_m = nearest - z
                margin_m = max(extent_m, nearest - nearest / (1.0 + NOISE_SIGMAS * noise_per_m * nearest))
                if not gap_m > margin_m:
                    continue
                seen = valid[v1, u1] - valid[v0, u1] - valid[v1, u0] + valid[v0, u0]
                if seen < VALID_SHARE * (u1 - u0) * (v1 - v0) * CELL * CELL:
                    continue
                changed += _add(odds, index, -2 if gap_m > 2.0 * margin_m else -1)
    return changed


@kernel
def occupy(
    touched: AnyArray, number: int, focal: float, noise_per_m: float, resolution_m: float, hits: AnyArray,
    depth_sum_m: AnyArray, odds: AnyArray,
) -> int:  # fmt: skip
    """Mark the voxels with returns, the surer the more, and clear the counts. Returns how many changed state."""
    changed = 0
    for n in range(number):
        index = touched[n]
        depth = depth_sum_m[index] / hits[index]
        facing = focal * resolution_m / depth
        sigma_m = noise_per_m * depth * depth
        weight = 1
        if hits[index] >= SOLID_SHARE * facing * facing:
            weight = 4 if sigma_m <= 0.25 * resolution_m else 2 if sigma_m <= 0.5 * resolution_m else 1
        changed += _add(odds, index, weight)
        hits[index] = 0
    return changed


@kernel
def states(odds: AnyArray, fence: AnyArray, state: AnyArray) -> None:
    """Log-odds (nx, ny, nz) to states; outside the fence [fence[0], fence[1]) nothing is free."""
    nx, ny, nz = odds.shape
    for i in range(nx):
        for j in range(ny):
            inside = fence[0, 0] <= i < fence[1, 0] and fence[0, 1] <= j < fence[1, 1]
            for k in range(nz):
                value = odds[i, j, k]
                found = np.uint8(OCCUPIED) if value >= OCCUPIED_AT else np.uint8(UNKNOWN)
                if value <= FREE_AT and inside and fence[0, 2] <= k < fence[1, 2]:
                    found = np.uint8(FREE)
                state[i, j, k] = found
