"""Free-space carving: free the voxels in front of all returns within their image footprint."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.occupancy.depth_min_pooling import CELL, LARGEST_WINDOW, STRIP, PooledDepth
from uav_recon.mapping.occupancy.grid_camera import GridCamera
from uav_recon.mapping.occupancy.log_odds import CLEAR_STEPS, MIN_LOG_ODDS, NOISE_SIGMAS, add_log_odds
from uav_recon.types.frames import AnyArray, Float32Array, IntArray

VALID_SHARE = 0.75  # minimum share of the footprint with returns for a voxel to be freed
Axes = tuple[np.float32, np.float32, np.float32]
SIDES = 5  # left, right, top, bottom, and the nearest depth


class ProjectedVoxels(NamedTuple):
    """N voxels in the pooled image: depth in voxels, right and down in cells."""

    depth: Float32Array
    right: Float32Array
    down: Float32Array


@kernel
def view_box(camera: GridCamera, pixels: tuple[int, int], shape: tuple[int, int, int], box: IntArray) -> None:
    """Compute the voxel box (2, 3) around the view frustum, clipped to the grid; pixels (H, W)."""
    fx, fy, cx, cy = camera.pinhole_px
    rotation, origin, far = camera.rotation, camera.origin, camera.far_m / camera.resolution_m
    for axis in range(3):
        low = high = 0.0
        for u in (-0.5, pixels[1] - 0.5):
            for v in (-0.5, pixels[0] - 0.5):
                corner = rotation[axis, 0] * (u - cx) / fx + rotation[axis, 1] * (v - cy) / fy + rotation[axis, 2]
                low, high = min(low, corner), max(high, corner)
        low, high = max(low, -1.0) * far + origin[axis], min(high, 1.0) * far + origin[axis]
        box[0, axis] = min(max(int(np.floor(low)), 0), shape[axis])
        box[1, axis] = max(min(int(np.floor(high)) + 1, shape[axis]), box[0, axis])


@kernel
def _sides(pinhole_px: AnyArray, rotation: AnyArray, pixels: tuple[int, int], nearest: float) -> AnyArray:
    """Return the planes (SIDES, 4) float32 of the view frustum, in voxels from the camera.

    A point is inside where a·x + b·y + c·z + d >= 0.
    """
    fx, fy, cx, cy = pinhole_px
    sides = np.zeros((SIDES, 4), dtype=np.float32)
    for axis in range(3):
        x, y, z = rotation[axis, 0], rotation[axis, 1], rotation[axis, 2]
        sides[0, axis] = fx * x + (cx + 0.5) * z
        sides[1, axis] = (pixels[1] - 0.5 - cx) * z - fx * x
        sides[2, axis] = fy * y + (cy + 0.5) * z
        sides[3, axis] = (pixels[0] - 0.5 - cy) * z - fy * y
        sides[4, axis] = z
    for side in range(SIDES):  # keeps the divisions by c finite; a plane parallel to z then accepts or rejects a whole column
        if abs(sides[side, 2]) < 1e-6:
            sides[side, 2] = 1e-6
    sides[4, 3] = -nearest
    return sides


@kernel
def _spans(
    sides: AnyArray, start: Axes, far2: np.float32, height: int,
    first: AnyArray, last: AnyArray,
) -> None:  # fmt: skip
    """Compute the voxel span [first, last) in view for each z column of one x slice of the box.

    start: the centre of the first voxel of the first column, in voxels from the camera. far2: range squared, in voxels.
    """
    zero, top = np.float32(0.0), np.float32(height - 1)
    dx, dy, dz = start
    for j in range(first.size):
        y = dy + np.float32(np.int32(j))
        left = far2 - dx * dx - y * y
        half = np.sqrt(left if left > zero else zero)
        low, high = -half, half
        for side in range(SIDES):
            c = sides[side, 2]
            t = np.divide(-(sides[side, 0] * dx + sides[side, 1] * y + sides[side, 3]), c)
            low = t if (c > zero) & (t > low) else low
            high = t if (c < zero) & (t < high) else high
        low, high = low - dz, high - dz
        low = low if low > zero else zero
        high = high if high < top else top
        begin, end = np.int32(np.ceil(low)), np.int32(np.floor(high)) + np.int32(1)
        first[j] = begin
        last[j] = end if (left > zero) & (high >= low) else begin


@kernel
def _no_return_behind(
    pinhole_px: AnyArray, step: Axes, start: Axes, count: int, farthest_m: AnyArray, edge_m: np.float32, extent_m: np.float32
) -> bool:
    """Return True if a run of voxels has no return behind any of its voxels.

    Checks only the farthest return of the image strips that the run may cover.
    """
    along = np.float32(count - 1)
    z, end_z = start[2], start[2] + step[2] * along
    fu, nearest = np.float32(pinhole_px[0] / CELL), min(z, end_z)
    u, end_u = np.divide(start[0], z), np.divide(start[0] + step[0] * along, end_z)
    middle, half = np.float32((pinhole_px[2] + 0.5) / CELL), np.divide(np.float32(0.5), nearest)
    low, high = (min(u, end_u) - half) * fu + middle, (max(u, end_u) + half) * fu + middle
    farthest = np.float32(0.0)
    for strip in range(max(int(low), 0) // STRIP, min(int(max(high, np.float32(0.0))) // STRIP + 1, farthest_m.size)):
        farthest = max(farthest, farthest_m[strip])
    return bool(nearest * edge_m + extent_m >= farthest)


@kernel
def _project(pinhole_px: AnyArray, step: Axes, start: Axes, run: ProjectedVoxels) -> None:
    """Project a run of voxels along z into the pooled image.

    start and step: centre of the first voxel and offset to the next one, in voxels along the camera axes.
    """
    depth, right, down = run
    fu, fv = np.float32(pinhole_px[0] / CELL), np.float32(pinhole_px[1] / CELL)
    cu, cv = np.float32((pinhole_px[2] + 0.5) / CELL), np.float32((pinhole_px[3] + 0.5) / CELL)
    for n in range(depth.size):
        along = np.float32(np.int32(n))
        z = start[2] + step[2] * along
        inverse = np.divide(np.float32(1.0), z)
        depth[n] = z
        right[n] = (start[0] + step[0] * along) * (fu * inverse) + cu
        down[n] = (start[1] + step[1] * along) * (fv * inverse) + cv


@kernel
def _select_candidates(
    odds: AnyArray, held: AnyArray, index: int, run: ProjectedVoxels, finest: AnyArray, edge_m: np.float32,
    extent_m: np.float32, kept: AnyArray, kept_at: ProjectedVoxels, number: int,
) -> int:  # fmt: skip
    """Append the voxels of a run that are candidates for carving; returns the new number.

    A candidate is not yet at the lower clamp, has no hit, and lies in front of the depth at its centre pixel. Branch-free.
    """
    rows, columns = finest.shape
    depth, right, down = run
    kept_depth, kept_right, kept_down = kept_at
    last_row, last_column = np.int32(rows - 1), np.int32(columns - 1)
    for n in range(depth.size):
        z, u, v = depth[n], right[n], down[n]
        i, j = np.int32(v), np.int32(u)
        i, j = max(min(i, last_row), np.int32(0)), max(min(j, last_column), np.int32(0))
        kept[number], kept_depth[number], kept_right[number], kept_down[number] = index + n, z, u, v
        behind_m = finest[i, j] - z * edge_m
        number += int((odds[n] != MIN_LOG_ODDS) & (held[n] == 0) & (behind_m > extent_m))
    return number


@kernel
def _windows(pinhole_px: AnyArray, cells: tuple[int, int], voxels: ProjectedVoxels, window: AnyArray) -> None:
    """Compute the window of the pooled depth that covers each voxel's footprint.

    The minimum over a window takes four look-ups. window (3, N) int32: the index of the first look-up in (LEVELS, *cells),
    and the offsets right and down to the others.
    """
    fu, fv = np.float32(0.5 * pinhole_px[0] / CELL), np.float32(0.5 * pinhole_px[1] / CELL)
    zero, none, one = np.float32(0.0), np.int32(0), np.int32(1)
    rows, columns = np.int32(cells[0]), np.int32(cells[1])
    first, across, below = window[0], window[1], window[2]
    depth, right, down = voxels
    for n in range(depth.size):
        inverse = np.divide(np.float32(1.0), depth[n])
        u, v, ru, rv = right[n], down[n], fu * inverse, fv * inverse
        widest = np.int32(ru + ru if ru > rv else rv + rv) + one
        level = np.int32(widest >= 2) + np.int32(widest >= 4) + np.int32(widest >= 8)
        level += np.int32(widest >= 16) + np.int32(widest >= 32) + np.int32(widest >= 64)
        size = one << level
        u0, v0 = np.int32(u - ru if u > ru else zero), np.int32(v - rv if v > rv else zero)
        u1, v1 = np.int32(u + ru) + one, np.int32(v + rv) + one
        u0, v0 = u0 if u0 < columns else columns - one, v0 if v0 < rows else rows - one
        u1, v1 = u1 if u1 < columns else columns, v1 if v1 < rows else rows
        over, under = u1 - size - u0, v1 - size - v0
        first[n] = (level * rows + v0) * columns + u0
        across[n] = over if over > none else none
        below[n] = (under if under > none else none) * columns


@kernel
def _valid_share(valid: AnyArray, window: int, right: int, down: int) -> float:
    """Return the share of the pixels of a window (see _windows) that have a return."""
    rows, columns = valid.shape[0] - 1, valid.shape[1] - 1
    row = window // columns
    u0, v0, size = window - row * columns, row % rows, 1 << (row // rows)
    u1, v1 = min(u0 + right + size, columns), min(v0 + down // columns + size, rows)
    seen = valid[v1, u1] - valid[v0, u1] - valid[v1, u0] + valid[v0, u0]
    return float(seen / ((u1 - u0) * (v1 - v0) * CELL * CELL))


@kernel
def carve_free(  # noqa: C901, PLR0915
    pooled: PooledDepth, camera: GridCamera, pixels: tuple[int, int], doubtful: int, box: IntArray, shape: tuple[int, int, int],
    hits: AnyArray, odds: AnyArray, listed: IntArray,
) -> int:  # fmt: skip
    """Free the voxels of a box without hits that lie in front of all returns in their footprint.

    The footprint of a voxel is a square of its edge length that faces the camera. Every return in it must lie behind the
    centre of the voxel by more than half the voxel's extent along the view and by more than the noise. The noise is in
    disparity: the true depth for a measured d may be as small as 1 / (1 / d + sigmas * noise_per_m), noise_per_m = noise /
    (f * b). The observation adds CLEAR steps where the margin is more than twice that, else ``doubtful`` steps. Lists the
    flat indices of the voxels whose state may change and returns their number.
    """
    lowest_m, farthest_m, valid = pooled
    pinhole_px, rotation, origin, resolution_m = camera.pinhole_px, camera.rotation, camera.origin, camera.resolution_m
    levels, rows, columns = lowest_m.shape
    flat_m = lowest_m.reshape(levels * rows * columns)
    low_x, low_y, low_z = box[0]
    nx, ny, nz = box[1, 0] - low_x, box[1, 1] - low_y, box[1, 2] - low_z
    nearest = max(1.0, max(pinhole_px[0], pinhole_px[1]) / (CELL * LARGEST_WINDOW))
    sides = _sides(pinhole_px, rotation, pixels, nearest)
    far2 = np.float32((camera.far_m / resolution_m) ** 2)
    first, last = np.empty(ny, dtype=np.int32), np.empty(ny, dtype=np.int32)
    run_at, kept_at = np.empty((3, nz), dtype=np.float32), np.empty((3, ny * nz + 1), dtype=np.float32)
    kept_voxels = ProjectedVoxels(depth=kept_at[0], right=kept_at[1], down=kept_at[2])
    kept, window = np.empty(ny * nz + 1, dtype=np.int64), np.empty((3, ny * nz), dtype=np.int32)
    extent_m = np.float32(0.5 * resolution_m * (abs(rotation[0, 2]) + abs(rotation[1, 2]) + abs(rotation[2, 2])))
    edge_m, noise, two = np.float32(resolution_m), np.float32(NOISE_SIGMAS * camera.noise_per_m), np.float32(2.0)
    step = (np.float32(rotation[2, 0]), np.float32(rotation[2, 1]), np.float32(rotation[2, 2]))
    holes = valid[rows, columns] < pixels[0] * pixels[1]
    dy, dz = low_y + 0.5 - origin[1], low_z + 0.5 - origin[2]
    number = 0
    for i in range(nx):
        dx = low_x + i + 0.5 - origin[0]
        _spans(sides, (np.float32(dx), np.float32(dy), np.float32(dz)), far2, nz, first, last)
        some = 0
        for j in range(ny):
            begin, count = first[j], last[j] - first[j]
            if count <= 0:
                continue
            index = ((low_x + i) * shape[1] + low_y + j) * shape[2] + low_z + begin
            run = odds[index : index + count]
            settled = True
            for n in range(count):
                settled &= run[n] == MIN_LOG_ODDS
            if settled:
                continue
            y, z = dy + j, dz + begin
            start = (
                np.float32(rotation[0, 0] * dx + rotation[1, 0] * y + rotation[2, 0] * z),
                np.float32(rotation[0, 1] * dx + rotation[1, 1] * y + rotation[2, 1] * z),
                np.float32(rotation[0, 2] * dx + rotation[1, 2] * y + rotation[2, 2] * z),
            )
            if _no_return_behind(pinhole_px, step, start, count, farthest_m, edge_m, extent_m):
                continue
            projected = ProjectedVoxels(depth=run_at[0, :count], right=run_at[1, :count], down=run_at[2, :count])
            _project(pinhole_px, step, start, projected)
            some = _select_candidates(
                run, hits[(i * ny + j) * nz + begin :], index, projected, lowest_m[0], edge_m, extent_m, kept, kept_voxels, some
            )
        candidates = ProjectedVoxels(depth=kept_at[0, :some], right=kept_at[1, :some], down=kept_at[2, :some])
        _windows(pinhole_px, (rows, columns), candidates, window)
        for n in range(some):
            a, right_by, down_by = window[0, n], window[1, n], window[2, n]
            upper = min(flat_m[np.uint32(a)], flat_m[np.uint32(a + right_by)])
            lower = min(flat_m[np.uint32(a + down_by)], flat_m[np.uint32(a + right_by + down_by)])
            behind = min(upper, lower)
            gap = behind - kept_at[0, n] * edge_m
            if not (gap > extent_m and behind < np.float32(np.inf)):
                continue
            reach, doubt = gap * (np.float32(1.0) + noise * behind), noise * behind * behind
            if not reach > doubt:
                continue
            if holes and _valid_share(valid, a, right_by, down_by) < VALID_SHARE:
                continue
            sure = (gap > two * extent_m) & (reach > two * doubt)
            if add_log_odds(odds, kept[n], -CLEAR_STEPS if sure else -doubtful):
                listed[number] = kept[n]
                number += 1
    return number
