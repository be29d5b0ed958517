"""String pulling: shortens polylines in a padded voxel mask.

A polyline is open if each of its segments is (see ``segment_is_open``, also for ``open_samples``). String pulling keeps the
ends, keeps the polyline open and never makes it longer. Positions are in padded voxel units, lengths in voxels.
"""

from __future__ import annotations

import math

from uav_recon.geometry.jit import kernel
from uav_recon.planning.paths.segments import distance, segment_is_open
from uav_recon.types.frames import ByteArray, FloatArray

ROUNDS = 2
MIN_GAIN = 0.05  # voxels; smaller gains end the search
HALVINGS = 4
SLOPES = (0.17, 0.7)  # inward share of a sideways step


@kernel
def pull_taut(open_samples: ByteArray, points: FloatArray, count: int) -> int:
    """Shorten the open polyline points[:count] in place; return the new point count.

    Corners are removed, slid sideways, cut from both sides, and rounded off into two corners where the path bends around a
    thick obstacle.

    points: (M, 3); the new count is at most M.
    """
    count = _settle(open_samples, points, count)
    x = 1
    while x < count - 1:
        after = _round_off(open_samples, points, count, x)
        x += 1 + after - count
        count = after
    return _settle(open_samples, points, count)


@kernel
def _settle(open_samples: ByteArray, points: FloatArray, count: int) -> int:
    for _ in range(ROUNDS):
        count = _straighten(open_samples, points, count)
        gain = 0.0
        for x in range(1, count - 1):
            if x + 2 < count:
                gain += _slide(open_samples, points, x, x + 1)
            gain += (
                _slide(open_samples, points, x, x)
                + _cut(open_samples, points, x - 1, x, x + 1)
                + _cut(open_samples, points, x + 1, x, x - 1)
            )
        if gain < MIN_GAIN:
            break
    return count


@kernel
def _open(open_samples: ByteArray, points: FloatArray, a: int, x: float, y: float, z: float) -> bool:
    return segment_is_open(open_samples, points[a, 0], points[a, 1], points[a, 2], x, y, z)


@kernel
def _apart(points: FloatArray, a: int, x: float, y: float, z: float) -> float:
    return distance(points[a, 0], points[a, 1], points[a, 2], x, y, z)


@kernel
def _straighten(open_samples: ByteArray, points: FloatArray, count: int) -> int:
    """Remove corners whose neighbours see each other; return the new point count."""
    x = 1
    while x < count - 1:
        if _open(open_samples, points, x - 1, points[x + 1, 0], points[x + 1, 1], points[x + 1, 2]):
            for n in range(x, count - 1):
                points[n, 0], points[n, 1], points[n, 2] = points[n + 1, 0], points[n + 1, 1], points[n + 1, 2]
            count -= 1
            x = max(x - 1, 1)
        else:
            x += 1
    return count


@kernel
def _cut(open_samples: ByteArray, points: FloatArray, a: int, x: int, b: int) -> float:
    """Move corner ``x`` along its segment towards ``b`` while ``a`` sees it.

    Returns the length saved.
    """
    px, py, pz = points[x, 0], points[x, 1], points[x, 2]
    dx, dy, dz = points[b, 0] - px, points[b, 1] - py, points[b, 2] - pz
    seen, step = 0.0, 1.0
    for _ in range(HALVINGS):
        step /= 2
        t = seen + step
        qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
        # a corner must lie in the mask itself, and a piece of an open segment has its own samples to test
        is_open = open_samples[int(qx), int(qy), int(qz)] > 0 and _open(open_samples, points, a, qx, qy, qz)
        if is_open and _open(open_samples, points, b, qx, qy, qz):
            seen = t
    if seen == 0.0:
        return 0.0
    qx, qy, qz = px + seen * dx, py + seen * dy, pz + seen * dz
    points[x, 0], points[x, 1], points[x, 2] = qx, qy, qz
    return _apart(points, a, px, py, pz) + distance(px, py, pz, qx, qy, qz) - _apart(points, a, qx, qy, qz)


@kernel
def _slide(open_samples: ByteArray, points: FloatArray, first: int, last: int) -> float:
    """Move corners [first, last] together, sideways and inwards, while the path gets shorter.

    Returns the length saved. A surface stops a corner from moving straight inwards, but along the surface there may be a
    shorter path. Two corners at one edge block each other unless they move together.
    """
    ax, ay, az = points[first, 0], points[first, 1], points[first, 2]
    bx, by, bz = points[last, 0], points[last, 1], points[last, 2]
    back, on = _apart(points, first - 1, ax, ay, az), _apart(points, last + 1, bx, by, bz)
    if back < 0.1 or on < 0.1:
        return 0.0
    ux, uy, uz = (points[first - 1, 0] - ax) / back, (points[first - 1, 1] - ay) / back, (points[first - 1, 2] - az) / back
    vx, vy, vz = (points[last + 1, 0] - bx) / on, (points[last + 1, 1] - by) / on, (points[last + 1, 2] - bz) / on
    wx, wy, wz = ux + vx, uy + vy, uz + vz
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    inwards, sideways = math.sqrt(wx * wx + wy * wy + wz * wz), math.sqrt(nx * nx + ny * ny + nz * nz)
    if inwards < 1e-3 or sideways < 1e-3:
        return 0.0
    before = back + on
    for turn in range(2 * len(SLOPES)):
        a = SLOPES[turn // 2] / inwards
        b = math.sqrt(1.0 - SLOPES[turn // 2] ** 2) / sideways * (1 - 2 * (turn % 2))
        dx, dy, dz = a * wx + b * nx, a * wy + b * ny, a * wz + b * nz
        step = 2.0
        while step > 0.6:
            sx, sy, sz = step * dx, step * dy, step * dz
            to_back = _apart(points, first - 1, points[first, 0] + sx, points[first, 1] + sy, points[first, 2] + sz)
            to_on = _apart(points, last + 1, points[last, 0] + sx, points[last, 1] + sy, points[last, 2] + sz)
            if back + on - to_back - to_on > MIN_GAIN and _may_move(open_samples, points, first, last, sx, sy, sz):
                for x in range(first, last + 1):
                    points[x, 0], points[x, 1], points[x, 2] = points[x, 0] + sx, points[x, 1] + sy, points[x, 2] + sz
                back, on = to_back, to_on
            else:
                step /= 2.0
    return before - back - on


@kernel
def _may_move(open_samples: ByteArray, points: FloatArray, first: int, last: int, sx: float, sy: float, sz: float) -> bool:
    for x in range(first, last + 1):
        if open_samples[int(points[x, 0] + sx), int(points[x, 1] + sy), int(points[x, 2] + sz)] == 0:
            return False
    for x in range(first, last + 2):
        a, b = 1.0 if x > first else 0.0, 1.0 if x <= last else 0.0
        if not segment_is_open(
            open_samples, points[x - 1, 0] + a * sx, points[x - 1, 1] + a * sy, points[x - 1, 2] + a * sz,
            points[x, 0] + b * sx, points[x, 1] + b * sy, points[x, 2] + b * sz,
        ):  # fmt: skip
            return False
    return True


@kernel
def _round_off(open_samples: ByteArray, points: FloatArray, count: int, x: int) -> int:
    """Replace corner ``x`` by two corners where that is shorter; return the new point count."""
    px, py, pz = points[x, 0], points[x, 1], points[x, 2]
    back, on = _apart(points, x - 1, px, py, pz), _apart(points, x + 1, px, py, pz)
    if count >= len(points) or back < 1.0 or on < 1.0:
        return count
    ux, uy, uz = (points[x - 1, 0] - px) / back, (points[x - 1, 1] - py) / back, (points[x - 1, 2] - pz) / back
    vx, vy, vz = (points[x + 1, 0] - px) / on, (points[x + 1, 1] - py) / on, (points[x + 1, 2] - pz) / on
    seen, step = 0.0, 0.9 * min(back, on)
    ax, ay, az, bx, by, bz = px, py, pz, px, py, pz
    for _ in range(HALVINGS + 2):
        d = seen + step
        ex, ey, ez, fx, fy, fz = px + d * ux, py + d * uy, pz + d * uz, px + d * vx, py + d * vy, pz + d * vz
        is_open = open_samples[int(ex), int(ey), int(ez)] > 0 and open_samples[int(fx), int(fy), int(fz)] > 0
        meet = is_open and segment_is_open(open_samples, ex, ey, ez, fx, fy, fz)
        if meet and _open(open_samples, points, x - 1, ex, ey, ez) and _open(open_samples, points, x + 1, fx, fy, fz):
            seen, ax, ay, az, bx, by, bz = d, ex, ey, ez, fx, fy, fz
        step /= 2
    if seen * (2.0 - distance(ux, uy, uz, vx, vy, vz)) < MIN_GAIN:
        return count
    for n in range(count, x + 1, -1):
        points[n, 0], points[n, 1], points[n, 2] = points[n - 1, 0], points[n - 1, 1], points[n - 1, 2]
    points[x, 0], points[x, 1], points[x, 2] = ax, ay, az
    points[x + 1, 0], points[x + 1, 1], points[x + 1, 2] = bx, by, bz
    return count + 1
