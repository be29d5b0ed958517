"""Ground truth of a scene: surface and free space visible from poses the vehicle can reach.

It does not depend on any flight. It is computed once per scene, mount and camera from fixed seeds, and cached. Reachable
positions are a flood fill from the start on a 0.1 m grid of positions with 0.35 m clearance. 600 poses are drawn there,
and 100 others are held out as views for image comparison. A point is visible if it gives a depth return: in range, not at
grazing incidence and not occluded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sitl.camera import d435i
from sitl.geometry.point_grid import PointGrid
from sitl.geometry.transform import body_from_camera, inverse, rigid, world_from_body
from sitl.runtime.array_cache import Arrays, cached, key
from sitl.runtime.jit import kernel
from sitl.scene.mesh_sampling import area_weighted_samples, dense_points
from sitl.scene.rasterizer import Renderer, Rendering
from sitl.scene.scene import BODY_ABOVE_FLOOR_M, TAKEOFF_HEIGHT_M, Scene
from sitl.truth.line_of_sight import LineOfSight
from uav_recon.sensors.stream_format import CameraSpec

VERSION = 3
POSES = 600
HELD_OUT = 100
SAMPLES = 300_000
POSE_SEED = 20240317
HELD_OUT_SEED = 20240318
SAMPLE_SEED = 20240319
STEP_M = 0.10  # spacing of the reachable grid and size of the free cells
REACH_CLEARANCE_M = 0.35
LOWEST_M = 0.40  # minimum height of the vehicle's centre above the floor
GIMBAL_RAD = math.radians(60.0)
RAY_STRIDE_PX = 3
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


@dataclass(frozen=True)
class VisibleTruth:
    """Visible surface and free space, held-out views and reachable positions; world frame, m.

    points (N, 3): surface samples visible from at least one pose.
    free_seen (X, Y, Z) bool: cells of free_cell_m crossed by rays that ended on a surface in range; cell (0, 0, 0) has its
    lowest corner at free_origin_m (3,).
    views (100, 4, 4): held-out world_from_camera of the COLOUR camera, whose intrinsics are view_spec.
    positions (P, 3): reachable positions of the vehicle.
    """

    points: F32
    free_seen: NDArray[np.bool_]
    free_origin_m: F64
    free_cell_m: float
    views: F64
    view_spec: CameraSpec
    positions: F32


def load_visible_truth(
    scene: Scene,
    mount: str,
    camera: d435i.Model,
    cache_dir: Path,
    report: Callable[[int, int], None] = lambda done, total: None,
) -> VisibleTruth:
    """Return the visible truth of a scene from the cache, or compute it (blocks for 10 to 30 s).

    mount: "gimbal", or "fixed:DEG" for a camera tilted down by DEG degrees. A cache that cannot be read or written only
    costs time. Raises ValueError for an unknown mount.
    """
    pitch_rad = _fixed_pitch(mount)
    path = cache_dir / f"truth-{scene.name}-{_key(scene, mount, camera)}.npz"
    spec = d435i.stream_header(camera).rgb

    def arrays() -> Arrays:
        cut = _cut(scene, pitch_rad, camera, spec, report)
        return {name: getattr(cut, name) for name in _DIMENSIONS}

    return VisibleTruth(free_cell_m=STEP_M, view_spec=spec, **cached(path, _DIMENSIONS, arrays))


def _fixed_pitch(mount: str) -> float | None:
    """Return the tilt (rad, down) of a fixed mount, or None for a gimbal."""
    if mount == "gimbal":
        return None
    kind, _, degrees = mount.partition(":")
    if kind != "fixed":
        raise ValueError(f"mount {mount!r}: want 'gimbal' or 'fixed:DEG'")
    return math.radians(float(degrees or 15.0))


def _key(scene: Scene, mount: str, camera: str) -> str:
    parameters = (VERSION, mount, camera, POSES, HELD_OUT, SAMPLES, POSE_SEED, HELD_OUT_SEED, SAMPLE_SEED, STEP_M)
    words = repr((parameters, REACH_CLEARANCE_M, LOWEST_M, RAY_STRIDE_PX, d435i.RANGE_M, d435i.MOUNT_M))
    return key(scene.vertices, scene.faces, scene.fence_min, scene.fence_max, words)


_DIMENSIONS = {"points": 2, "free_seen": 3, "free_origin_m": 1, "views": 3, "positions": 2}


def reachable_positions(scene: Scene) -> F32:
    """Return the grid positions (P, 3) reachable from above the start with 0.35 m clearance."""
    bins = PointGrid(dense_points(scene.vertices, scene.faces, 0.02))
    low, high = _bounds(scene)
    low[:2] = STEP_M * np.round(low[:2] / STEP_M)  # puts a grid column exactly above the start
    low[2] = LOWEST_M - BODY_ABOVE_FLOOR_M
    count = np.maximum(np.floor((high - low) / STEP_M).astype(int) + 1, 1)
    axes = [low[i] + STEP_M * np.arange(count[i]) for i in range(3)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    clear = bins.distances(centres.reshape(-1, 3), 0.0, 0.0, REACH_CLEARANCE_M + STEP_M) >= REACH_CLEARANCE_M
    labels, _ = ndimage.label(clear.reshape(centres.shape[:3]))
    column = np.linalg.norm(centres[..., :2], axis=-1) < 0.5 * STEP_M
    candidates = np.argwhere(column & (labels > 0))
    if not len(candidates):
        return np.array([[0.0, 0.0, TAKEOFF_HEIGHT_M - BODY_ABOVE_FLOOR_M]], np.float32)
    heights = np.abs(centres[tuple(candidates.T)][:, 2] - (TAKEOFF_HEIGHT_M - BODY_ABOVE_FLOOR_M))
    start = labels[tuple(candidates[int(np.argmin(heights))])]
    return np.ascontiguousarray(centres[labels == start], np.float32)


def _bounds(scene: Scene) -> tuple[F64, F64]:
    """Return the lowest and highest corner (3,) of the fence cut by the mesh's bounding box.

    A fence may be far larger than the mesh.
    """
    low = np.maximum(scene.fence_min, scene.vertices.min(axis=0)).astype(np.float64)
    return low, np.minimum(scene.fence_max, scene.vertices.max(axis=0)).astype(np.float64)


def _draw(positions: F32, pitch_rad: float | None, count: int, seed: int) -> list[F64]:
    """Return random poses world_from_depth_camera (4, 4) at reachable positions."""
    rng = np.random.default_rng(seed)
    chosen = positions[rng.integers(len(positions), size=count)]
    yaw = rng.uniform(-math.pi, math.pi, count)
    gimbal = rng.uniform(-GIMBAL_RAD, GIMBAL_RAD, count)
    pitch = gimbal if pitch_rad is None else np.full(count, pitch_rad)
    mounts = [body_from_camera(d435i.MOUNT_M, float(p)) for p in pitch]
    return [world_from_body(chosen[i], float(yaw[i])) @ mounts[i] for i in range(count)]


def _cut(
    scene: Scene, pitch_rad: float | None, camera: d435i.Model, spec: CameraSpec, report: Callable[[int, int], None]
) -> VisibleTruth:
    positions = reachable_positions(scene)
    renderer = Renderer(scene.vertices, scene.faces, scene.rgb)
    samples, normals = area_weighted_samples(scene.vertices, scene.faces, SAMPLES, SAMPLE_SEED)
    sight, seen = LineOfSight(scene, samples, normals), np.zeros(len(samples), np.bool_)
    origin, high = _bounds(scene)
    cells = np.ceil((high - origin) / STEP_M - 1e-6).astype(int)
    free = np.zeros(tuple(np.maximum(cells, 1)), np.bool_)
    depth_spec = d435i.DEPTH_SPEC
    intrinsics = np.array([depth_spec.fx, depth_spec.fy, depth_spec.cx, depth_spec.cy])
    for number, world_from_camera in enumerate(_draw(positions, pitch_rad, POSES, POSE_SEED)):
        report(number, POSES)
        depth = _returned(renderer.render(world_from_camera, depth_spec, far_m=d435i.RANGE_M[1] + 1.0, colour=False))
        seen[sight.returns(np.flatnonzero(~seen), inverse(world_from_camera))] = True
        _carve(free, origin, STEP_M, depth, world_from_camera, intrinsics)
    tx, ty, tz = d435i.stream_header(camera).rgb_from_depth[4:]
    depth_from_rgb = inverse(rigid(np.eye(3), (tx, ty, tz)))
    views = np.array([pose @ depth_from_rgb for pose in _draw(positions, pitch_rad, HELD_OUT, HELD_OUT_SEED)])
    return VisibleTruth(samples[seen], free, origin, STEP_M, views, spec, positions)


def _returned(view: Rendering) -> F32:
    """Return the depth (H, W), m, with 0 at grazing incidence, where the camera gets no return."""
    depth: F32 = np.where(view.incidence_cos >= d435i.GRAZING_COS, view.depth_m, np.float32(0.0))
    return depth


@kernel
def _carve(free: NDArray[np.bool_], origin: F64, cell: float, depth: F32, world_from_camera: F64, intrinsics: F64) -> None:  # noqa: C901
    """Mark the cells that rays cross before a surface in range, except the last half cell.

    Voxel traversal by Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", 1987.
    """
    m = world_from_camera
    at, step = np.zeros(3, np.int64), np.zeros(3, np.int64)
    t_next, t_delta, d = np.zeros(3), np.zeros(3), np.zeros(3)
    for v in range(0, depth.shape[0], RAY_STRIDE_PX):
        for u in range(0, depth.shape[1], RAY_STRIDE_PX):
            z = depth[v, u]
            if z < 0.3 or z > 6.0:
                continue
            xn, yn = (u - intrinsics[2]) / intrinsics[0], (v - intrinsics[3]) / intrinsics[1]
            t_end = z - 0.5 * cell
            for k in range(3):
                d[k] = m[k, 0] * xn + m[k, 1] * yn + m[k, 2]
                start = (m[k, 3] - origin[k]) / cell
                at[k] = int(np.floor(start))
                if d[k] > 0:
                    step[k], t_next[k], t_delta[k] = 1, (at[k] + 1 - start) * cell / d[k], cell / d[k]
                elif d[k] < 0:
                    step[k], t_next[k], t_delta[k] = -1, (at[k] - start) * cell / d[k], -cell / d[k]
                else:
                    step[k], t_next[k], t_delta[k] = 0, np.inf, np.inf
            t = 0.0
            while t < t_end:
                if (
                    at[0] < 0 or at[1] < 0 or at[2] < 0
                    or at[0] >= free.shape[0] or at[1] >= free.shape[1] or at[2] >= free.shape[2]
                ):  # fmt: skip
                    break
                free[at[0], at[1], at[2]] = True
                k = 0
                if t_next[1] < t_next[k]:
                    k = 1
                if t_next[2] < t_next[k]:
                    k = 2
                t = t_next[k]
                at[k] += step[k]
                t_next[k] += t_delta[k]
