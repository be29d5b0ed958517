from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.typing import NDArray

from sitl.geometry.transform import body_from_camera, world_from_body
from sitl.scene.rasterizer import Renderer
from uav_recon.sensors.stream_format import CameraSpec

SPEC = CameraSpec(64, 48, 34.0, 33.0, 31.5, 23.5)
F64 = NDArray[np.float64]


def soup(count: int = 400, seed: int = 0) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8]]:
    """Return triangles of all sizes around the origin.

    Some cross the near plane of a camera at the origin.
    """
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-3, 3, (count, 1, 3))
    corners = centre + rng.normal(0, 1, (count, 3, 3)) * rng.uniform(0.02, 1.5, (count, 1, 1))
    rgb = rng.integers(0, 256, (3 * count, 3)).astype(np.uint8)
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3), rgb


def rays(world_from_camera: F64, spec: CameraSpec) -> F64:
    u, v = np.meshgrid(np.arange(spec.width), np.arange(spec.height))
    local = np.stack([(u - spec.cx) / spec.fx, (v - spec.cy) / spec.fy, np.ones(u.shape)], axis=-1)
    return np.asarray(local @ world_from_camera[:3, :3].T)


def cast(origin: F64, directions: F64, corners: F64, near: float) -> tuple[F64, NDArray[np.int64], F64, F64]:
    """Intersect every ray with every triangle (Möller and Trumbore).

    Returns t (0 = miss), the triangle, and two barycentric weights.
    """
    d = directions.reshape(-1, 1, 3)
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(d, e2[None])
    det = (p * e1).sum(axis=-1)
    s = origin - corners[:, 0]
    b1 = (p * s).sum(axis=-1) / det
    q = np.cross(s, e1)
    b2 = (d * q).sum(axis=-1) / det
    t = (e2 * q).sum(axis=-1) / det
    t = np.where((b1 >= 0) & (b2 >= 0) & (b1 + b2 <= 1) & (t >= near), t, np.inf)
    best = t.argmin(axis=1)
    row = np.arange(len(best))
    return np.where(np.isfinite(t[row, best]), t[row, best], 0.0), best, b1[row, best], b2[row, best]


@pytest.mark.parametrize("yaw", [0.0, 0.9, 2.5, -1.7])
def test_depth_colour_and_incidence_agree_with_ray_casting(yaw: float) -> None:
    vertices, faces, rgb = soup()
    pose = world_from_body((0.1, -0.2, 0.3), yaw) @ body_from_camera((0.1, 0, 0), 0.3)
    view = Renderer(vertices, faces, rgb).render(pose, SPEC, near_m=0.05)
    direction = rays(pose, SPEC)
    corners = vertices[faces].astype(np.float64)
    t, triangle, b1, b2 = cast(pose[:3, 3], direction, corners, 0.05)
    close = np.abs(view.depth_m.ravel() - t) < 1e-4
    assert close.mean() > 0.999  # a ray that meets an edge exactly may hit either triangle
    weights = np.stack([1 - b1 - b2, b1, b2], axis=1)
    expected = (weights[:, :, None] * rgb[faces[triangle]]).sum(axis=1)
    hit = close & (t > 0)
    assert hit.sum() > 500
    assert np.abs(view.rgb.reshape(-1, 3)[hit] - expected[hit]).max() <= 1.0
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[triangle]
    flat = direction.reshape(-1, 3)
    cosine = np.abs((normal * flat).sum(axis=1)) / np.linalg.norm(normal, axis=1) / np.linalg.norm(flat, axis=1)
    assert np.abs(view.incidence_cos.ravel() - cosine)[hit].max() < 1e-3
    np.testing.assert_array_equal(Renderer(vertices, faces, rgb).depth(pose, SPEC), view.depth_m)


def wall(distance: float, step: float) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return a wall x = distance, 4 m wide and high, in cells of size step."""
    n = int(4 / step)
    y, z = np.meshgrid(np.linspace(-2, 2, n + 1), np.linspace(-2, 2, n + 1), indexing="ij")
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return np.stack([np.full(y.size, distance), y.ravel(), z.ravel()], -1).astype(np.float32), faces.astype(np.int32)


@pytest.mark.parametrize(("distance", "step"), [(0.3, 0.02), (0.3, 4.0), (1.5, 0.013), (0.06, 1.0)])
def test_a_wall_has_no_holes(distance: float, step: float) -> None:
    vertices, faces = wall(distance, step)
    rgb = np.full((len(vertices), 3), 90, np.uint8)
    view = Renderer(vertices, faces, rgb).render(body_from_camera((0, 0, 0), 0.0), SPEC)
    np.testing.assert_allclose(view.depth_m, distance, rtol=1e-5)
    assert (view.rgb == 90).all()


def test_floor_reaching_behind_the_camera_is_cut_at_the_near_plane() -> None:
    vertices = np.array([[-50, -50, -1], [50, -50, -1], [50, 50, -1], [-50, 50, -1]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    pose = body_from_camera((0, 0, 0), 0.0)
    depth = Renderer(vertices, faces, np.zeros((4, 3), np.uint8)).depth(pose, SPEC)
    v = np.arange(26, SPEC.height)
    np.testing.assert_allclose(depth[26:], np.repeat((SPEC.fy / (v - SPEC.cy))[:, None], SPEC.width, axis=1), rtol=1e-4)
    assert (depth[:23] == 0).all()


def test_the_image_is_upright_and_not_mirrored() -> None:
    """Red is to the left (+y) and green above (+z) for a vehicle that looks along +x."""
    patches = [((2.0, 1.0, 0.0), (255, 0, 0)), ((2.0, 0.0, 0.8), (0, 255, 0))]
    vertices = np.concatenate([wall(0.0, 4.0)[0] * 0.1 + np.array(at, np.float32) for at, _ in patches])
    faces = np.concatenate([wall(0.0, 4.0)[1], wall(0.0, 4.0)[1] + 4])
    rgb = np.repeat(np.array([colour for _, colour in patches], np.uint8), 4, axis=0)
    view = Renderer(vertices, faces, rgb).render(body_from_camera((0, 0, 0), 0.0), SPEC)
    red_v, red_u = np.nonzero(view.rgb[..., 0] == 255)
    green_v, green_u = np.nonzero(view.rgb[..., 1] == 255)
    assert red_u.mean() == pytest.approx(SPEC.cx - 0.5 * SPEC.fx, abs=0.6)
    assert red_v.mean() == pytest.approx(SPEC.cy, abs=0.6)
    assert green_v.mean() == pytest.approx(SPEC.cy - 0.4 * SPEC.fy, abs=0.6)
    assert green_u.mean() == pytest.approx(SPEC.cx, abs=0.6)


def test_threads_share_a_renderer() -> None:
    renderer = Renderer(*soup())
    poses = [world_from_body((0, 0, 0), 0.3 * i) @ body_from_camera((0, 0, 0), 0.0) for i in range(8)]
    alone = [renderer.depth(pose, SPEC) for pose in poses]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda pose: renderer.depth(pose, SPEC), poses))
    np.testing.assert_array_equal(alone, together)


def test_surface_beyond_the_far_distance_is_left_out() -> None:
    vertices, faces = wall(3.0, 0.5)
    renderer, pose = Renderer(vertices, faces, np.zeros((len(vertices), 3), np.uint8)), body_from_camera((0, 0, 0), 0.0)
    assert (renderer.depth(pose, SPEC, far_m=2.9) == 0).all()
    np.testing.assert_array_equal(renderer.depth(pose, SPEC, far_m=3.1), renderer.depth(pose, SPEC))
