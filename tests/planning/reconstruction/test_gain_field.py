from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from box_world import FIXED, GIMBAL, MEETING_ROOM, BoxWorld
from uncertain_room import elements_of, seen_room, situation_in

from uav_recon.config import PlannerConfig
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.candidate_view import PlanningContext
from uav_recon.planning.frontier.frontiers import FACES, Frontier, Frontiers, fence_box
from uav_recon.planning.reconstruction.gain_field import BEST_VIEWS, UNKNOWN_WEIGHT, FieldViews, frontier_patches
from uav_recon.types.maps import SurfaceElements
from uav_recon.types.tasks import TaskKind

HERE = np.array([3.0, 1.0, 1.2])
CONFIG = PlannerConfig()


def half_seen(camera: CameraGeometry) -> tuple[PlanningContext, list[Frontier]]:
    """Return the planning context and the frontiers after one look ahead."""
    world = BoxWorld(MEETING_ROOM, camera, HERE)
    for yaw in (-0.4, 0.0, 0.4):
        world.yaw_rad = yaw
        world.look(float(np.clip(0.0, camera.pitch_min_rad, camera.pitch_max_rad)))
    voxels = world.request().voxels
    low, high = fence_box(voxels.grid, np.zeros(3), np.array([6.2, 5.0, 2.4]))
    found = Frontiers()
    found.update(voxels, low, high, np.zeros(voxels.grid.shape, dtype=np.uint8))
    return situation_in(voxels, HERE), found.clusters()


def looks_of(context: PlanningContext) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.zeros(context.voxels.grid.shape, dtype=np.float32)


@pytest.mark.parametrize("camera", [FIXED, GIMBAL])
def test_in_a_mostly_unknown_room_views_show_frontiers(camera: CameraGeometry) -> None:
    context, frontiers = half_seen(camera)
    proposals = FieldViews(CONFIG, camera).propose(context, frontiers, None, looks_of(context))
    assert 3 <= len(proposals) <= BEST_VIEWS
    cells = {int(c) for f in frontiers for c in np.ravel_multi_index(tuple(f.cells.T), context.voxels.grid.shape)}
    for proposal in proposals:
        assert proposal.task.kind is TaskKind.EXPLORE
        assert len(proposal.expected_voxels) >= 4
        assert {int(c) for c in proposal.expected_voxels} <= cells
        assert proposal.task.gain >= UNKNOWN_WEIGHT * len(proposal.expected_voxels)
        assert context.is_clear(proposal.position_padded)
        view = proposal.task.viewpoint
        assert camera.pitch_min_rad <= view.pitch_down_rad <= camera.pitch_max_rad
        bearing = view.yaw_rad
        ahead = context.voxels.grid.centre(
            np.stack(np.unravel_index(proposal.expected_voxels, context.voxels.grid.shape), axis=-1)
        )
        forward = (ahead - view.position_world)[:, :2] @ np.array([np.cos(bearing), np.sin(bearing)])
        assert (forward > 0).mean() > 0.95


def test_the_order_of_the_frontiers_does_not_matter() -> None:
    context, frontiers = half_seen(GIMBAL)
    surface = elements_of(MEETING_ROOM)
    one = FieldViews(CONFIG, GIMBAL).propose(context, frontiers, surface, looks_of(context))
    other = FieldViews(CONFIG, GIMBAL).propose(context, frontiers[::-1], surface, looks_of(context))
    assert [p.position_padded.tolist() for p in one] == [p.position_padded.tolist() for p in other]
    assert [p.task.gain for p in one] == [p.task.gain for p in other]


def test_in_a_known_room_views_show_surface_until_it_was_looked_at() -> None:
    context = situation_in(seen_room(), HERE)
    surface, views, cosine_sums = elements_of(MEETING_ROOM), FieldViews(CONFIG, GIMBAL), looks_of(context)
    first = views.propose(context, [], surface, cosine_sums)
    assert first
    assert {p.task.kind for p in first} == {TaskKind.RECONSTRUCT}
    for _ in range(40):
        proposals = views.propose(context, [], surface, cosine_sums)
        if not proposals:
            break
        cosine_sums.ravel()[proposals[0].expected_voxels] += proposals[0].view_cosine.astype(np.float32)
    assert not proposals


def test_without_gain_there_is_no_view() -> None:
    context = situation_in(seen_room(), HERE)
    nothing = SurfaceElements(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), 1)
    views = FieldViews(CONFIG, FIXED)
    assert views.propose(context, [], None, looks_of(context)) == []
    assert views.propose(context, [], nothing, looks_of(context)) == []


def test_each_frontier_cell_is_gathered_once_and_faces_away_from_the_unknown() -> None:
    _, frontiers = half_seen(FIXED)
    shape = MEETING_ROOM.shape
    flat, rows, groups = frontier_patches(frontiers, (shape[0], shape[1], shape[2]))
    wanted = np.sort(np.concatenate([np.ravel_multi_index(tuple(f.cells.T), shape) for f in frontiers]))
    np.testing.assert_array_equal(np.sort(flat), wanted)
    assert groups[0] == 0
    assert groups[-1] == len(flat)
    np.testing.assert_allclose(rows[:, 6], UNKNOWN_WEIGHT * np.diff(groups))
    cell = Frontier(np.array([[9, 9, 9]]), np.array([2], dtype=np.uint8))  # the neighbour at +x is unknown
    _, one, _ = frontier_patches([cell], (20, 20, 20))
    np.testing.assert_allclose(one, [[9.5, 9.5, 9.5, *-FACES[1], UNKNOWN_WEIGHT]])


PROBE = """
import sys
from numba.core.registry import CPUDispatcher as Dispatcher
sys.path[:0] = sys.argv[1:]
import numpy as np
from test_gain_field import CONFIG, FIXED, GIMBAL, elements_of, half_seen, looks_of, FieldViews, MEETING_ROOM
from uav_recon.planning.reconstruction import gain_field, surface_elements

def compiled():
    names = [f"reconstruction.{m}" for m in ("gain_field", "view_gain", "surface_elements")] + ["camera_frustum"]
    return {(m, k): len(v.signatures) for m in names
            for k, v in vars(sys.modules["uav_recon.planning." + m]).items() if isinstance(v, Dispatcher)}

context, frontiers = half_seen(FIXED)
surface = elements_of(MEETING_ROOM)
surface_elements.Elements.of(surface, context.voxels.grid, 5)  # as SurfaceViews' warm-up does
gain_field.warm_up()
before = compiled()
FieldViews(CONFIG, GIMBAL).propose(context, frontiers, surface, looks_of(context))
after = compiled()
assert before == after, {k: (before[k], after[k]) for k in before if before[k] != after[k]}
"""


def test_nothing_is_compiled_after_warm_up() -> None:
    # a fresh process, because earlier tests have compiled kernels in this one
    here = Path(__file__).parent
    probe = subprocess.run(
        [sys.executable, "-c", PROBE, str(here), str(here.parent)], capture_output=True, text=True, check=False, timeout=240
    )
    assert probe.returncode == 0, probe.stderr
