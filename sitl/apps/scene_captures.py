"""Views of a scene from places that the vehicle can reach, as the simulated camera takes them, and what they saw.

For benches that need the same pictures again and again: one seed, the same poses and the same noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from sitl.camera import d435i
from sitl.geometry.transform import body_from_camera, inverse, rigid, world_from_body
from sitl.scene.rasterizer import Renderer
from sitl.scene.scene import Scene
from sitl.truth.line_of_sight import LineOfSight
from sitl.truth.visibility import GIMBAL_RAD
from uav_recon.sensors.stream_format import CameraSpec, StreamHeader

POSE_STREAM = 0xCA97
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class SceneCaptures:
    """depth_mm (K, H, W), 0 = no return; rgb (K, h, w, 3); world_from_depth (K, 4, 4) true; header: both cameras."""

    header: StreamHeader
    depth_mm: U16
    rgb: U8
    world_from_depth: F64


@dataclass(frozen=True)
class Pixels:
    """Pixels of held-out colour pictures: the number of the picture (N,), ascending; origin (N, 3) and unit direction (N, 3)
    of their rays; the true rgb (N, 3); and the surface that they show: point (N, 3), its unit normal (N, 3); world, metres.
    Pixels that show nothing are left out.
    """

    picture: NDArray[np.int64]
    origin: F32
    direction: F32
    rgb: U8
    point: F32
    normal: F32


def capture(
    scene: Scene,
    positions: F32,
    pitch_down_rad: float | None,
    camera: d435i.Model,
    noise: d435i.Noise,
    count: int,
    seed: int,
    taken: Callable[[], None] = lambda: None,
) -> SceneCaptures:
    """Take ``count`` views from random places out of positions (P, 3), random headings; about 20 ms a view.

    pitch_down_rad: tilt of a fixed mount; None: a gimbal, tilted at random. taken() is called after each view.
    """
    eye = d435i.SimulatedD435i(Renderer(scene.vertices, scene.faces, scene.rgb), camera, noise, seed)
    rng = np.random.default_rng([seed, POSE_STREAM])
    place = positions[rng.integers(len(positions), size=count)]
    yaw = rng.uniform(-math.pi, math.pi, count)
    tilt = rng.uniform(-GIMBAL_RAD, GIMBAL_RAD, count)
    pitch = tilt if pitch_down_rad is None else np.full(count, pitch_down_rad)
    depths, pictures, poses = [], [], []
    for n in range(count):
        body = world_from_body(place[n], float(yaw[n]))
        depth_mm, rgb = eye.capture(body, float(pitch[n]))
        depths.append(depth_mm)
        pictures.append(rgb)
        poses.append(body @ body_from_camera(d435i.MOUNT_M, float(pitch[n])))
        taken()
    return SceneCaptures(eye.header, np.array(depths), np.array(pictures), np.array(poses))


def held_out(scene: Scene, world_from_rgb: F64, spec: CameraSpec, stride: int) -> Pixels:
    """Every stride-th pixel, each way, of true pictures from world_from_rgb (V, 4, 4). About 20 ms a picture."""
    import open3d

    tensor = open3d.core.Tensor.from_numpy
    rays = open3d.t.geometry.RaycastingScene()
    rays.add_triangles(tensor(scene.vertices.astype(np.float32)), tensor(scene.faces.astype(np.uint32)))
    renderer = Renderer(scene.vertices, scene.faces, scene.rgb)
    rows, columns = np.arange(stride // 2, spec.height, stride), np.arange(stride // 2, spec.width, stride)
    v, u = np.repeat(rows, len(columns)), np.tile(columns, len(rows))
    bearing = np.stack([(u - spec.cx) / spec.fx, (v - spec.cy) / spec.fy, np.ones(len(u))], axis=1)
    bearing /= np.linalg.norm(bearing, axis=1, keepdims=True)
    parts = []
    for number, pose in enumerate(world_from_rgb):
        direction = bearing @ pose[:3, :3].T
        origin = np.broadcast_to(pose[:3, 3], direction.shape)
        answer = rays.cast_rays(tensor(np.concatenate([origin, direction], axis=1).astype(np.float32)))
        reach = answer["t_hit"].numpy().astype(np.float64)
        hit = np.isfinite(reach)
        geometry = (origin[hit], direction[hit], (origin + np.where(hit, reach, 0.0)[:, None] * direction)[hit])
        start, along, point = (np.ascontiguousarray(a, np.float32) for a in geometry)
        normal: F32 = answer["primitive_normals"].numpy()[hit]
        rgb = renderer.render(pose, spec).rgb[v, u][hit]
        parts.append(Pixels(np.full(len(rgb), number), start, along, rgb, point, normal))
    return Pixels(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Pixels)))


def seen(scene: Scene, captures: SceneCaptures, points: F32, normals: F32) -> tuple[NDArray[np.int64], Bools]:
    """For surface points (N, 3) with normals (N, 3): how many views got a depth return from each (N,), and whether the
    colour picture of such a view shows it (N,). About 0.1 s a view for half a million points.
    """  # fmt: skip
    sight, every = LineOfSight(scene, points, normals), np.arange(len(points))
    looks, coloured = np.zeros(len(points), np.int64), np.zeros(len(points), np.bool_)
    lens = captures.header.rgb
    rgb_from_depth = rigid(np.eye(3), captures.header.rgb_from_depth[4:])
    for world_from_depth in captures.world_from_depth:
        depth_from_world = inverse(world_from_depth)
        found = sight.returns(every, depth_from_world)
        looks[found] += 1
        rgb_from_world = rgb_from_depth @ depth_from_world
        x, y, z = (points[found] @ rgb_from_world[:3, :3].T + rgb_from_world[:3, 3]).T
        u, v = lens.fx * x / np.maximum(z, 1e-6) + lens.cx, lens.fy * y / np.maximum(z, 1e-6) + lens.cy
        coloured[found] |= (z > 0.05) & (u >= 0) & (u <= lens.width - 1) & (v >= 0) & (v <= lens.height - 1)
    return looks, coloured
