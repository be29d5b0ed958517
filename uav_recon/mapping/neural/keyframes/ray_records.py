"""Ray records: 20 bytes per measured pixel, with depth and normal smoothed by a local plane.

A plane is exactly linear in inverse depth, and stereo noise is uniform and unbiased there. So both the normal and the
smoothed depth come from one least-squares fit of 1/z over a window that stops at depth edges.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import fast_kernel, kernel
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray, IntArray

COLUMNS = 10  # bearing x, y; depth; normal x, y, z (camera; 0 = none); r, g, b; has colour
BEARING_UNIT = 1e-4
DEPTH_UNIT_M = 2.5e-4
NORMAL_UNIT = 1 / 32767
DEPTH_NEAREST_M = 0.15
DEPTH_FARTHEST_M = 8.0
WINDOW = 4  # pixels in each direction
SIDE = 2 * WINDOW + 1
HOLE = np.float32(1e9)  # inverse depth of a pixel without a return: outside every gate
FEWEST = 20  # minimum number of pixels on the plane


def ray_records(frame: Frame, inverse_depth_sigma: float, most: int, random: np.random.Generator) -> tuple[AnyArray, AnyArray]:
    """Return records (N, COLUMNS) int16 of about ``most`` pixels, in random order.

    The second result is their depth as measured, (N,) uint16 in DEPTH_UNIT_M: smoothing rounds the inner corners of a room.

    inverse_depth_sigma: standard deviation of 1/z in 1/m (disparity noise over focal length times baseline).
    """
    k = frame.depth_intrinsics
    stride = pixel_stride(k, most)
    rows, columns = np.meshgrid(np.arange(0, k.height, stride), np.arange(0, k.width, stride), indexing="ij")
    rows = np.minimum(rows + random.integers(0, stride, rows.shape), k.height - 1).ravel()
    columns = np.minimum(columns + random.integers(0, stride, columns.shape), k.width - 1).ravel()
    order = random.permutation(rows.size)
    records, measured = np.zeros((rows.size, COLUMNS), dtype=np.int16), np.zeros(rows.size, dtype=np.uint16)
    count = _pack(
        frame.depth_m,
        k.pinhole_px(),
        rows[order],
        columns[order],
        inverse_depth_sigma,
        records,
        measured,
    )
    return records[:count], measured[:count]


def pixel_stride(lens: Intrinsics, most: int) -> int:
    """Return the pixel spacing for which about ``most`` rays cover the image."""
    return max(1, int(np.ceil(np.sqrt(lens.width * lens.height / most))))


def in_rows(records: AnyArray) -> AnyArray:
    """Return the records sorted by image row, so that spatial neighbours are adjacent in memory."""
    by_column = records[np.argsort(records[:, 0], kind="stable")]  # two fast sorts by 16 bits
    rows: AnyArray = by_column[np.argsort(by_column[:, 1], kind="stable")]
    return rows


@kernel
def _pack(
    depth_m: Float32Array, lens: FloatArray, rows: IntArray, columns: IntArray, sigma: float, records: AnyArray,
    measured: AnyArray,
) -> int:  # fmt: skip
    fx, fy, cx, cy = lens
    plane = np.zeros(3)
    inverse_depth = np.empty(depth_m.shape, dtype=np.float32)
    _invert(depth_m, inverse_depth)
    window, across, down = (np.empty(SIDE * SIDE, dtype=np.float32), np.empty(SIDE * SIDE, dtype=np.float32),
                            np.empty(SIDE * SIDE, dtype=np.float32))  # fmt: skip
    for p in range(SIDE * SIDE):
        across[p], down[p] = p % SIDE - WINDOW, p // SIDE - WINDOW
    count = 0
    for n in range(rows.shape[0]):
        v0, u0 = rows[n], columns[n]
        z = float(depth_m[v0, u0])
        if not (z >= DEPTH_NEAREST_M and z <= DEPTH_FARTHEST_M):
            continue
        inverse = 1.0 / z
        bx, by = (u0 - cx) / fx, (v0 - cy) / fy
        record, measured[count] = records[count], round(z / DEPTH_UNIT_M)
        count += 1
        _look_round(inverse_depth, v0, u0, window)
        if _fit_plane(window, across, down, inverse, sigma, plane):
            a, b, c = plane[0], plane[1], plane[2]
            if abs(c - inverse) < 3.0 * sigma + 0.002 * inverse:
                inverse = c
            nx, ny = a * fx, b * fy
            nz = c + a * (cx - u0) + b * (cy - v0)
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            record[3] = round(-nx / length / NORMAL_UNIT)
            record[4] = round(-ny / length / NORMAL_UNIT)
            record[5] = round(-nz / length / NORMAL_UNIT)
        z = min(1.0 / inverse, DEPTH_FARTHEST_M)
        record[0] = round(bx / BEARING_UNIT)
        record[1] = round(by / BEARING_UNIT)
        record[2] = round(z / DEPTH_UNIT_M)
    return count


@kernel
def _invert(depth_m: Float32Array, inverse: Float32Array) -> None:
    """Compute 1/z, and HOLE where nothing was measured."""
    for v in range(depth_m.shape[0]):
        for u in range(depth_m.shape[1]):
            z = depth_m[v, u]
            inverse[v, u] = np.float32(1.0) / z if z > DEPTH_NEAREST_M else HOLE


@fast_kernel
def _look_round(inverse: Float32Array, v0: int, u0: int, window: Float32Array) -> None:
    """Write the inverse depths around a pixel, less that of the pixel, to window (SIDE * SIDE,)."""
    height, width = inverse.shape
    own = inverse[v0, u0]
    for row in range(SIDE):
        v = v0 + row - WINDOW
        for column in range(SIDE):
            u = u0 + column - WINDOW
            inside = v >= 0 and u >= 0 and v < height and u < width
            window[row * SIDE + column] = inverse[np.uint64(v), np.uint64(u)] - own if inside else HOLE


@fast_kernel
def _fit_plane(
    window: Float32Array, across: Float32Array, down: Float32Array, own: float, sigma: float, plane: FloatArray
) -> bool:
    """Fit 1/z = a du + b dv + c twice, the second time to the inliers of the first.

    across, down: du, dv of the window.
    """
    a, b, c = np.float32(0.0), np.float32(0.0), np.float32(0.0)  # c less the pixel's own inverse depth
    for turn in range(2):
        gate = np.float32(3.0 * sigma + (0.08 if turn == 0 else 0.004) * own)
        n, su, sv, sy = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
        suu, suv, svv, suy, svy = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for p in range(SIDE * SIDE):
            y, du, dv = window[p], across[p], down[p]
            one = np.float32(1.0) if abs(y - (a * du + b * dv + c)) <= gate else np.float32(0.0)
            u, v = one * du, one * dv
            n += one
            su, sv, sy = su + u, sv + v, sy + one * y
            suu, suv, svv = suu + u * du, suv + u * dv, svv + v * dv
            suy, svy = suy + u * y, svy + v * y
        if n < FEWEST:
            return False
        mu, mv, my = su / n, sv / n, sy / n
        cuu, cuv, cvv = suu / n - mu * mu, suv / n - mu * mv, svv / n - mv * mv
        cuy, cvy = suy / n - mu * my, svy / n - mv * my
        determinant = cuu * cvv - cuv * cuv
        if determinant < 0.5:
            return False
        a, b = (cuy * cvv - cvy * cuv) / determinant, (cvy * cuu - cuy * cuv) / determinant
        c = my - a * mu - b * mv
    plane[0], plane[1], plane[2] = a, b, own + c
    return bool(own + c > 1.0 / (2.0 * DEPTH_FARTHEST_M))
