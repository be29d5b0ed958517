"""Surface that keyframes show in passing, against exact rays."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from box_world import FIXED, MEETING_ROOM
from test_surface_views import CONFIG, cosines
from uncertain_room import elements_of, seen_room

from uav_recon.planning.reconstruction.seen_surface import PASSING_SHARE, SeenSurface
from uav_recon.planning.reconstruction.surface_elements import Elements, ElementsCache
from uav_recon.types.frames import Float32Array
from uav_recon.types.pose import Pose
from uav_recon.types.tasks import PlanRequest, Viewpoint

VOXELS, SURFACE = seen_room(), elements_of(MEETING_ROOM)
VIEWS = [
    Viewpoint(np.array([3.0, 1.0, 1.2]), 0.4, FIXED.pitch_min_rad),
    Viewpoint(np.array([2.0, 2.0, 1.0]), -2.0, FIXED.pitch_min_rad),
]


def keyframe(view: Viewpoint) -> Pose:
    """Return the pose of the depth imager, z ahead and y down, at a view of FIXED."""
    c, s = math.cos(view.yaw_rad), math.sin(view.yaw_rad)
    cp, sp = math.cos(view.pitch_down_rad), math.sin(view.pitch_down_rad)
    ahead, right = np.array([c * cp, s * cp, -sp]), np.array([s, -c, 0.0])
    x, y, z = FIXED.position_body_m
    eye_m = view.position_world + np.array([c * x - s * y, s * x + c * y, z])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.column_stack([right, np.cross(ahead, right), ahead]), eye_m
    return Pose.from_matrix(matrix)


def request(*views: Viewpoint, revision: int = 1, epoch: int = 0) -> PlanRequest:
    voxels = dataclasses.replace(VOXELS, map_epoch=epoch)
    surface = dataclasses.replace(SURFACE, revision=revision)
    return PlanRequest(voxels, surface, np.array([3.0, 1.0, 1.2]), 0.0, 9, keyframes=tuple(map(keyframe, views)))


def sums() -> Float32Array:
    return np.zeros(VOXELS.grid.shape, dtype=np.float32)


def expected(*views: Viewpoint) -> Float32Array:
    """Return half the largest cosine of each voxel, summed over the views."""
    elements = Elements.of(SURFACE, VOXELS.grid, CONFIG.downsample)
    total = np.zeros(VOXELS.grid.shape).reshape(-1)
    for view in views:
        best = np.zeros_like(total)
        inside = elements.voxel >= 0
        np.maximum.at(best, elements.voxel[inside], cosines(VOXELS, elements, FIXED, view)[inside])
        total += PASSING_SHARE * best
    return total.reshape(VOXELS.grid.shape).astype(np.float32)


def seen() -> SeenSurface:
    return SeenSurface(FIXED, ElementsCache(CONFIG.downsample))


def test_a_keyframe_counts_once_and_only_when_the_surface_is_newer() -> None:
    counted, one = sums(), seen()
    one.update(request(VIEWS[0], revision=1), counted)
    assert not counted.any(), "the model has not learned from it yet"
    one.update(request(*VIEWS, revision=2), counted)
    np.testing.assert_allclose(counted, expected(VIEWS[0]), atol=1e-5)
    assert np.count_nonzero(counted) > 100
    one.update(request(*VIEWS, revision=2), counted)
    np.testing.assert_allclose(counted, expected(VIEWS[0]), atol=1e-5)
    one.update(request(*VIEWS, revision=3), counted)
    one.update(request(*VIEWS, revision=4), counted)
    np.testing.assert_allclose(counted, expected(*VIEWS), atol=1e-5)


def test_another_map_begins_again() -> None:
    one = seen()
    one.update(request(*VIEWS, revision=1), sums())
    one.update(request(*VIEWS, revision=2), sums())
    counted = sums()
    one.update(request(VIEWS[1], revision=3, epoch=1), counted)
    assert not counted.any()
    one.update(request(VIEWS[1], revision=4, epoch=1), counted)
    np.testing.assert_allclose(counted, expected(VIEWS[1]), atol=1e-5)


def test_without_a_surface_nothing_counts() -> None:
    counted, one = sums(), seen()
    for _ in range(2):
        one.update(dataclasses.replace(request(*VIEWS), surface=None), counted)
    assert not counted.any()
