"""Ray sampling: training points at depth-guided positions along rays and on the surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import fast_kernel
from uav_recon.mapping.neural.keyframes.ray_records import BEARING_UNIT, DEPTH_UNIT_M, NORMAL_UNIT
from uav_recon.mapping.neural.sdf_numba.network import TRUNCATION_M
from uav_recon.types.frames import AnyArray, BoolArray, Float32Array, IntArray

RAYS = 1024
# samples per ray: near the measured surface, and in the air in front of it
NEAR = 4
FREE = 3
SURFACE_POINTS = 384  # rays used for gradient and normal
COLOUR_POINTS = 1024  # maximum number of colour points
RECENT_VIEWS = 5
RECENT_SHARE = 0.3
NEAR_BEFORE_M = np.float32(0.10)
NEAR_BEHIND_M = np.float32(0.05)
NEAREST_FREE_M = np.float32(0.15)
JITTER_M = np.float32(0.015)
MIN_COSINE = np.float32(0.15)
TOE = np.float32(0.055)  # sRGB (IEC 61966-2-1) is a power law on (value + TOE): a change of exposure is a factor there
WHITE = 254  # a channel from this level may be saturated
POSE_SIGMA_M = np.float32(0.01)  # pose error in every measurement: a weight is its variance over the total variance ...
MIN_TRUST = np.float32(0.3)  # ... but at least this, so that walls measured from a distance are learned too

DISTANCE_FACTOR = np.float32(10.0)
FREE_FACTOR = np.float32(2.0)
COLOUR_FACTOR = np.float32(5.0)
EIKONAL_FACTOR = np.float32(0.1)
NORMAL_FACTOR = np.float32(0.1)

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)


class Views(NamedTuple):
    """Arrays of the rays and their views.

    records (M, 10) i16; first (V + 1,) i64: start of each view in records; rotation (V, 3, 3) f32 and position (V, 3) f32 of
    world_from_depth; inverse_depth_sigma (V,) f32: sigma of 1/z in 1/m; gain (V, 3) f32: factor on rgb + TOE that converts
    the view's colours to the mean exposure; stretch (V, 2) f32: factors on bearing and depth that remove the errors of the
    camera's focal length and depth scale.
    """

    records: AnyArray
    first: IntArray
    rotation: Float32Array
    position: Float32Array
    inverse_depth_sigma: Float32Array
    gain: Float32Array
    stretch: Float32Array


class NumbaBatch(NamedTuple):
    """Training points of one step; every weight includes its loss factor and the mean."""

    points: Float32Array
    target_m: Float32Array
    weight: Float32Array
    at_least: BoolArray
    at_least_rgb: BoolArray
    surface: Float32Array
    normal: Float32Array
    eikonal_weight: Float32Array
    normal_weight: Float32Array
    coloured: Float32Array
    rgb: Float32Array
    colour_weight: Float32Array
    colour_error: Float32Array


def make_batch() -> NumbaBatch:
    """Allocate a batch, which all steps reuse."""
    many, shape, colour = RAYS * (NEAR + FREE), SURFACE_POINTS, COLOUR_POINTS
    shapes: tuple[tuple[int, ...], ...] = (
        *((many, 3), (many,), (many,)),
        *((shape, 3), (shape, 3), (shape,), (shape,)),
        *((colour, 3), (colour, 3), (colour,), (colour,)),
    )
    points, target, weight, *others = (np.zeros(size, dtype=np.float32) for size in shapes)
    below, white = np.zeros(many, dtype=np.bool_), np.zeros((colour, 3), dtype=np.bool_)
    return NumbaBatch(points, target, weight, below, white, *others)


@fast_kernel
def uniform(state: AnyArray) -> np.float32:
    """Return the next number in [0, 1) of a splitmix64 stream; state (1,) uint64."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float32(np.int64(z >> np.uint64(40))) * np.float32(1.0 / 16777216.0)


@fast_kernel
def draw(state: AnyArray, views: Views, view_count: int, low: Float32Array, high: Float32Array, batch: NumbaBatch) -> int:  # noqa: PLR0915
    """Fill a batch from random rays; returns the number of coloured points.

    low, high (3,): the box.
    """
    recent = min(RECENT_VIEWS, view_count)
    per_ray = NEAR + FREE
    coloured = 0
    near_factor = DISTANCE_FACTOR / (TRUNCATION_M * TRUNCATION_M * np.float32(RAYS * NEAR))
    free_factor = FREE_FACTOR / (TRUNCATION_M * TRUNCATION_M * np.float32(RAYS * FREE))
    shape_factor, colour_factor = _ONE / np.float32(SURFACE_POINTS), COLOUR_FACTOR / np.float32(COLOUR_POINTS)
    for r in range(RAYS):
        if uniform(state) < RECENT_SHARE:
            view = view_count - 1 - int(uniform(state) * recent)
        else:
            view = int(uniform(state) * view_count)
        rays = views.first[view + 1] - views.first[view]
        record = views.records[views.first[view] + int(uniform(state) * rays)]
        rotation, position = views.rotation[view], views.position[view]
        wider, deeper = np.float32(BEARING_UNIT) * views.stretch[view, 0], np.float32(DEPTH_UNIT_M) * views.stretch[view, 1]
        bx, by = np.float32(record[0]) * wider, np.float32(record[1]) * wider
        length = np.sqrt(bx * bx + by * by + _ONE)
        z = np.float32(np.uint16(record[2])) * deeper
        reach = z * length
        sigma = z * z * views.inverse_depth_sigma[view]
        dx = (rotation[0, 0] * bx + rotation[0, 1] * by + rotation[0, 2]) / length
        dy = (rotation[1, 0] * bx + rotation[1, 1] * by + rotation[1, 2]) / length
        dz = (rotation[2, 0] * bx + rotation[2, 1] * by + rotation[2, 2]) / length
        a, b, c = (np.float32(record[3]) * np.float32(NORMAL_UNIT), np.float32(record[4]) * np.float32(NORMAL_UNIT),
                   np.float32(record[5]) * np.float32(NORMAL_UNIT))  # fmt: skip
        nx = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
        ny = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
        nz = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
        has_normal = a * a + b * b + c * c > np.float32(0.5)
        cosine = max(abs(dx * nx + dy * ny + dz * nz), MIN_COSINE) if has_normal else np.float32(0.7)
        trust = max(POSE_SIGMA_M * POSE_SIGMA_M / (POSE_SIGMA_M * POSE_SIGMA_M + sigma * sigma), MIN_TRUST)
        for n in range(per_ray):
            at = r * per_ray + n
            if n < NEAR:
                share = (np.float32(n) + uniform(state)) / np.float32(NEAR)
                t = reach - NEAR_BEFORE_M + share * (NEAR_BEFORE_M + NEAR_BEHIND_M)
                batch.target_m[at] = (reach - t) * cosine
                batch.weight[at] = trust * near_factor
                batch.at_least[at] = False
            else:
                share = (np.float32(n - NEAR) + uniform(state)) / np.float32(FREE)
                t = NEAREST_FREE_M + share * (reach - NEAR_BEFORE_M - NEAREST_FREE_M)
                batch.target_m[at] = min(TRUNCATION_M, max(_ZERO, reach - t - np.float32(2.0) * sigma) * cosine)
                batch.weight[at] = free_factor
                batch.at_least[at] = True
            x, y, w = position[0] + t * dx, position[1] + t * dy, position[2] + t * dz
            batch.points[at, 0], batch.points[at, 1], batch.points[at, 2] = x, y, w
            if not _inside(x, y, w, low, high) or t < NEAREST_FREE_M * np.float32(0.5):
                batch.weight[at] = _ZERO
        t = reach + (_ONE - np.float32(2.0) * uniform(state)) * JITTER_M
        x, y, w = position[0] + t * dx, position[1] + t * dy, position[2] + t * dz
        inside = _inside(x, y, w, low, high)
        if r < SURFACE_POINTS:
            batch.surface[r, 0], batch.surface[r, 1], batch.surface[r, 2] = x, y, w
            batch.normal[r, 0], batch.normal[r, 1], batch.normal[r, 2] = nx, ny, nz
            batch.eikonal_weight[r] = EIKONAL_FACTOR * shape_factor if inside else _ZERO
            batch.normal_weight[r] = NORMAL_FACTOR * shape_factor * trust if inside and has_normal else _ZERO
        if record[9] == 1 and inside and coloured < COLOUR_POINTS:
            batch.coloured[coloured, 0], batch.coloured[coloured, 1], batch.coloured[coloured, 2] = x, y, w
            for channel in range(3):
                value = np.float32(record[6 + channel]) * np.float32(1.0 / 255.0)
                batch.rgb[coloured, channel] = (value + TOE) * views.gain[view, channel] - TOE
                batch.at_least_rgb[coloured, channel] = record[6 + channel] >= WHITE
            batch.colour_weight[coloured] = colour_factor
            coloured += 1
    return coloured


@fast_kernel
def ray_points(views: Views, view: int, offsets_m: Float32Array, points: Float32Array, cosine: Float32Array,
               sigma_m: Float32Array, normal: Float32Array) -> None:  # fmt: skip
    """Compute a view's measured points in world: points (len(offsets), N, 3).

    One set of points per offset along the ray. Also computes the viewing cosine (N,), -1 without a normal, the depth sigma
    (N,) and the normal in world (N, 3).
    """
    rotation, position = views.rotation[view], views.position[view]
    for n in range(views.first[view + 1] - views.first[view]):
        record = views.records[views.first[view] + n]
        wider, deeper = np.float32(BEARING_UNIT) * views.stretch[view, 0], np.float32(DEPTH_UNIT_M) * views.stretch[view, 1]
        bx, by = np.float32(record[0]) * wider, np.float32(record[1]) * wider
        length = np.sqrt(bx * bx + by * by + _ONE)
        z = np.float32(np.uint16(record[2])) * deeper
        sigma_m[n] = z * z * views.inverse_depth_sigma[view]
        along = _ZERO
        for axis in range(3):
            d = (rotation[axis, 0] * bx + rotation[axis, 1] * by + rotation[axis, 2]) / length
            normal[n, axis] = (
                rotation[axis, 0] * np.float32(record[3])
                + rotation[axis, 1] * np.float32(record[4])
                + rotation[axis, 2] * np.float32(record[5])
            ) * np.float32(NORMAL_UNIT)
            along += d * normal[n, axis]
            for k in range(offsets_m.shape[0]):
                points[k, n, axis] = position[axis] + d * (z * length + offsets_m[k])
        has_normal = record[3] != 0 or record[4] != 0 or record[5] != 0
        cosine[n] = abs(along) if has_normal else -_ONE


@fast_kernel
def _inside(x: float, y: float, z: float, low: Float32Array, high: Float32Array) -> bool:
    return bool(x > low[0] and y > low[1] and z > low[2] and x < high[0] and y < high[1] and z < high[2])
