from __future__ import annotations

import numpy as np
import pytest
from box_world import FIXED, GIMBAL, MEETING_ROOM, TWO_ROOMS
from uncertain_room import elements_of, seen_room, situation_in

from uav_recon.config import PlannerConfig
from uav_recon.geometry.traversal import visible_targets
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.reconstruction.surface_elements import Elements
from uav_recon.planning.reconstruction.surface_views import VIEW_DISCOUNT, SurfaceViews
from uav_recon.planning.reconstruction.view_gain import MIN_FACING
from uav_recon.planning.view_sampling import shell
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import SurfaceElements, VoxelMap
from uav_recon.types.tasks import TaskKind, Viewpoint

HERE = np.array([3.0, 1.0, 1.2])
CONFIG = PlannerConfig()


def cosines(voxels: VoxelMap, elements: Elements, camera: CameraGeometry, view: Viewpoint) -> FloatArray:
    """Return the cosine (N,) at which a view sees each element, 0 = not seen, as the oracle.

    It is computed in numpy with a separate frustum.
    """
    c, s = np.cos(view.yaw_rad), np.sin(view.yaw_rad)
    mount = camera.position_body_m
    eye_m = view.position_world + np.array([c * mount[0] - s * mount[1], s * mount[0] + c * mount[1], mount[2]])
    eye = (eye_m - voxels.grid.origin_world_m) / voxels.grid.resolution_m
    offset = elements.position - eye
    distance = np.linalg.norm(offset, axis=1)
    cp, sp = np.cos(view.pitch_down_rad), np.sin(view.pitch_down_rad)
    ahead, left, up = np.array([c * cp, s * cp, -sp]), np.array([-s, c, 0.0]), np.array([c * sp, s * sp, cp])
    depth = offset @ ahead
    reach = min(camera.surface_range_m, camera.range_m) / voxels.grid.resolution_m
    inside = (depth > 0) & (distance <= reach) & (distance >= camera.near_m / voxels.grid.resolution_m)
    inside &= np.abs(offset @ left) <= depth * np.tan(camera.hfov_rad / 2) * 0.95
    inside &= np.abs(offset @ up) <= depth * np.tan(camera.vfov_rad / 2) * 0.95
    cosine = -(elements.normal * offset).sum(axis=1) / distance
    cosine[~inside | (cosine < MIN_FACING)] = 0.0
    found = np.flatnonzero(cosine)
    cosine[found[~visible_targets(voxels.state, eye, elements.position[found], 1.5)]] = 0.0
    return np.asarray(cosine)


def aimed(camera: CameraGeometry, place_m: FloatArray, centre_m: FloatArray) -> Viewpoint:
    dx, dy, _ = centre_m - place_m
    flat = max(float(np.hypot(dx, dy)) - camera.position_body_m[0], 1e-6)
    pitch = np.arctan2(place_m[2] + camera.position_body_m[2] - centre_m[2], flat)
    return Viewpoint(place_m, float(np.arctan2(dy, dx)), float(np.clip(pitch, camera.pitch_min_rad, camera.pitch_max_rad)))


@pytest.mark.parametrize("camera", [FIXED, GIMBAL])
def test_gains_equal_exact_rays_and_the_chosen_view_is_nearly_the_best(camera: CameraGeometry) -> None:
    voxels, surface = seen_room(), elements_of(MEETING_ROOM)
    context = situation_in(voxels, HERE)
    elements = Elements.of(surface, voxels.grid, CONFIG.downsample)
    proposals = SurfaceViews(CONFIG, camera).propose(context, surface, np.zeros(voxels.grid.shape, dtype=np.float32), 1.0)
    assert len(proposals) >= 3
    weight = elements.sigma.copy()
    radii_m = (0.5, 0.65, *np.linspace(CONFIG.shell_min_m, CONFIG.shell_max_m, 3))
    offsets = shell(camera, tuple(float(r) for r in radii_m), 0.1)
    shares = []
    for proposal in proposals:
        task = proposal.task
        cosine = cosines(voxels, elements, camera, task.viewpoint)
        assert task.kind is TaskKind.RECONSTRUCT
        assert task.gain == pytest.approx(float(cosine @ weight), rel=1e-6)
        assert np.count_nonzero(cosine) >= CONFIG.min_visible
        promised = np.unique(elements.voxel[(cosine > 0) & (elements.voxel >= 0)])
        np.testing.assert_array_equal(proposal.expected_voxels, promised)
        np.testing.assert_allclose(proposal.view_cosine[5], cosine[elements.voxel == promised[5]].max())
        assert context.is_clear(proposal.position_padded)
        best = 0.0
        for place in np.unique(np.floor((task.centroid_world + 0.1) / 0.1 + offsets), axis=0) + 0.5:
            cell = place.astype(int) + 1
            if (place < 0).any() or (cell >= context.space.reachable.shape).any() or not context.space.reachable[tuple(cell)]:
                continue
            view = aimed(camera, (place - 1.0) * 0.1, task.centroid_world)
            best = max(best, float(cosines(voxels, elements, camera, view) @ weight))
        shares.append(task.gain / best)
        weight *= VIEW_DISCOUNT**cosine
    assert np.mean(shares) >= 0.99
    assert min(shares) >= 0.9


def test_surface_behind_a_wall_is_a_task_only_if_the_path_through_the_door_is_short() -> None:
    solid = TWO_ROOMS.copy()
    voxels, here = seen_room(solid), np.array([3.2, 0.8, 1.2])
    surface = elements_of(solid)
    behind = (surface.position_world[:, 0] > 4.35) & (surface.position_world[:, 1] < 0.6)
    only = SurfaceElements(surface.position_world, surface.normal_world, np.where(behind, surface.uncertainty, 0.0), 1)
    views = SurfaceViews(CONFIG, GIMBAL)
    cosine_sums = np.zeros(voxels.grid.shape, dtype=np.float32)
    assert views.propose(situation_in(voxels, here), only, cosine_sums, 1.0) == []
    assert views.propose(situation_in(voxels, here), only, cosine_sums, 3.0)
    assert views.propose(situation_in(voxels, np.array([5.0, 0.8, 1.2])), only, cosine_sums, 1.0)


def test_surface_in_the_map_but_not_in_the_model_is_viewed_first() -> None:
    voxels, surface = seen_room(), elements_of(MEETING_ROOM)
    context, cosine_sums = situation_in(voxels, HERE), np.zeros(voxels.grid.shape, dtype=np.float32)
    x, y = surface.position_world[:, 0], surface.position_world[:, 1]
    bare = (y < 0.1) & (x > 1.5) & (x < 4.5)  # most of a wall
    rest = SurfaceElements(surface.position_world[~bare], surface.normal_world[~bare], surface.uncertainty[~bare], 2)
    first = SurfaceViews(CONFIG, GIMBAL).propose(context, rest, cosine_sums, 1.0)[0]
    i, j, _ = np.unravel_index(first.expected_voxels, voxels.grid.shape)
    assert np.count_nonzero((j == 0) & (i > 16) & (i < 44)) > 100
    whole = SurfaceViews(CONFIG, GIMBAL).propose(context, surface, cosine_sums, 1.0)[0]
    assert whole.task.gain < 0.7 * first.task.gain


def test_a_fixed_mount_views_a_bare_ceiling_from_far_away() -> None:
    voxels, surface = seen_room(), elements_of(MEETING_ROOM)
    context, cosine_sums = situation_in(voxels, HERE), np.zeros(voxels.grid.shape, dtype=np.float32)
    ceiling = surface.position_world[:, 2] > 2.35
    seen = SurfaceElements(surface.position_world[~ceiling], surface.normal_world[~ceiling], np.zeros(int((~ceiling).sum())), 1)
    proposals = SurfaceViews(CONFIG, FIXED).propose(context, seen, cosine_sums, 3.0)
    assert len(proposals) >= 3
    for proposal in proposals:
        assert np.count_nonzero(proposal.expected_voxels % voxels.grid.shape[2] >= 25) >= CONFIG.min_visible


def test_tasks_run_out_as_they_are_viewed() -> None:
    voxels, surface = seen_room(), elements_of(MEETING_ROOM)
    context, views = situation_in(voxels, HERE), SurfaceViews(CONFIG, GIMBAL)
    cosine_sums = np.zeros(voxels.grid.shape, dtype=np.float32)
    gains = []
    for _ in range(12):
        proposals = views.propose(context, surface, cosine_sums, 3.0)
        gains.append(sum(proposal.task.gain for proposal in proposals))
        for proposal in proposals:
            cosine_sums.ravel()[proposal.expected_voxels] += proposal.view_cosine
    assert gains[0] > 300
    assert gains[-1] == 0.0


def test_no_surface_makes_no_task_and_the_same_surface_the_same_tasks() -> None:
    voxels = seen_room()
    context, cosine_sums = situation_in(voxels, HERE), np.zeros(voxels.grid.shape, dtype=np.float32)
    nothing = SurfaceElements(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), 1)
    views = SurfaceViews(CONFIG, FIXED)
    assert views.propose(context, None, cosine_sums, 1.0) == []
    assert views.propose(context, nothing, cosine_sums, 1.0), (
        "of a mapper that has learned nothing, all surface of the map is bare"
    )
    surface = elements_of(MEETING_ROOM)
    first = views.propose(context, surface, cosine_sums, 1.0)
    again = views.propose(context, surface, cosine_sums, 1.0)
    fresh = SurfaceViews(CONFIG, FIXED).propose(context, surface, cosine_sums, 1.0)
    for one, other in ((first, again), (first, fresh)):
        assert [p.task.gain for p in one] == [p.task.gain for p in other]
        assert [p.position_padded.tolist() for p in one] == [p.position_padded.tolist() for p in other]
    # another surface with arrays of the same size is not taken for the last one
    moved = SurfaceElements(surface.position_world, surface.normal_world, surface.uncertainty[::-1].copy(), 2)
    assert [p.task.gain for p in views.propose(context, moved, cosine_sums, 1.0)] != [p.task.gain for p in first]
