"""Images of a scene by the simulated camera from reachable positions, and what they show.

For benchmarks that need identical images: a seed determines the poses and the noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from sitl.camera import d435i
from sitl.camera.camera_errors import CameraErrors
from sitl.geometry.transform import body_from_camera, inverse, rigid, world_from_body
from sitl.scene.rasterizer import Renderer
from sitl.scene.scene import Scene
from sitl.truth.line_of_sight import LineOfSight
from sitl.truth.visibility import GIMBAL_RAD
from uav_recon.sensors.stream_format import CameraSpec, StreamHeader

POSE_STREAM = 0xCA97
PERIOD_S = 0.5  # between the stamps of captures; exposure wanders with them
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class SceneCaptures:
    """Captured images.

    depth_mm (K, H, W): 0 = no return. rgb (K, h, w, 3). world_from_depth (K, 4, 4): true poses of a camera without
    errors on the same vehicle. header: both cameras.
    """

    header: StreamHeader
    depth_mm: U16
    rgb: U8
    world_from_depth: F64


@dataclass(frozen=True)
class Pixels:
    """Pixels of held-out colour images; world frame, m. Pixels without a surface are left out.

    picture (N,): index of the image, ascending. origin (N, 3) and direction (N, 3, unit): rays. rgb (N, 3): true colour.
    point (N, 3) and normal (N, 3, unit): the visible surface.
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
    errors: CameraErrors = d435i.EXACT,
    taken: Callable[[], None] = lambda: None,
) -> SceneCaptures:
    """Capture ``count`` images at random positions out of positions (P, 3) with random headings.

    pitch_down_rad: tilt of a fixed mount; None: a gimbal with random tilt. errors: of the camera; its delays have no effect,
    because it does not move. taken() is called after each image. Takes about 20 ms per image.
    """
    eye = d435i.SimulatedD435i(Renderer(scene.vertices, scene.faces, scene.rgb), camera, noise, seed, errors)
    rng = np.random.default_rng([seed, POSE_STREAM])
    place = positions[rng.integers(len(positions), size=count)]
    yaw = rng.uniform(-math.pi, math.pi, count)
    tilt = rng.uniform(-GIMBAL_RAD, GIMBAL_RAD, count)
    pitch = tilt if pitch_down_rad is None else np.full(count, pitch_down_rad)
    depths, pictures, poses = [], [], []
    for n in range(count):
        body = world_from_body(place[n], float(yaw[n]))
        depth_mm, rgb = eye.capture(body, float(pitch[n]), n * PERIOD_S)
        depths.append(depth_mm)
        pictures.append(rgb)
        poses.append(body @ body_from_camera(d435i.MOUNT_M, float(pitch[n])))
        taken()
    return SceneCaptures(eye.header, np.array(depths), np.array(pictures), np.array(poses))


def held_out_pixels(scene: Scene, world_from_rgb: F64, spec: CameraSpec, stride: int) -> Pixels:
    """Return every stride-th pixel, in u and v, of true images at world_from_rgb (V, 4, 4).

    Takes about 20 ms per image.
    """
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
    """Return how many views measured each surface point (N,), and whether colour shows it (N,).

    points (N, 3) have normals (N, 3). The second result is True if the colour image of such a view contains the point.
    Takes about 0.1 s per view for half a million points.
    """
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
