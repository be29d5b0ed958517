"""Best view of a cluster, against all positions by brute force.

The voxels on which the result depends are reported.
"""

from __future__ import annotations

import numpy as np
import pytest
from box_world import FIXED, GIMBAL, MEETING_ROOM, TWO_ROOMS, Solid
from growing_map import GrowingMap

from uav_recon.bench.planner import view_oracle
from uav_recon.config import PlannerConfig
from uav_recon.planning.camera_frustum import EDGE_MARGIN, CameraGeometry
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.free_space.subvoxel_clearance import SIDES2
from uav_recon.planning.frontier.frontiers import Frontiers
from uav_recon.planning.frontier.view_cache import MAX_BLOCKERS, targets
from uav_recon.planning.frontier.view_search import MAX_MOVE_TESTS, SearchScene, _ranked, best_view
from uav_recon.planning.frontier.visibility_bound import HASH_SIZE
from uav_recon.planning.view_sampling import explore_shell
from uav_recon.types.maps import FREE, TILE

START = np.array([1.0, 1.0, 1.1])


@pytest.mark.parametrize("camera", [FIXED, GIMBAL], ids=["fixed", "gimbal"])
@pytest.mark.parametrize("solid", [MEETING_ROOM, TWO_ROOMS], ids=["meeting_room", "two_rooms"])
def test_a_view_is_nearly_as_good_as_the_best_of_a_thousand(solid: Solid, camera: CameraGeometry) -> None:
    world = GrowingMap(solid)
    world.state[4:17, 4:17, 1:18] = np.where(solid[4:17, 4:17, 1:18], 0, FREE)
    # camera at the body's centre, so that the brute force uses the planner's positions
    camera = CameraGeometry(camera.hfov_rad, camera.vfov_rad, np.zeros(3), camera.pitch_min_rad, camera.pitch_max_rad, 4.5)
    for n in range(4):
        world.look(camera, START, n * np.pi / 3)
    voxels, frontiers = world.picture(), Frontiers()
    low, high = np.ones(3, dtype=np.int64), np.array(world.grid.shape) - 1
    frontiers.update(voxels, low, high, np.zeros(world.grid.shape, dtype=np.uint8))
    space = FlyableSpace(world.grid, 0.35, low + 2, high - 2)
    space.update(voxels)
    space.locate_vehicle(START)
    shell, lens = explore_shell(PlannerConfig(), camera, 0.1), camera.lens(0.1, 4.5)
    tan_h, tan_v = (float(np.tan(angle / 2)) * EDGE_MARGIN for angle in (camera.hfov_rad, camera.vfov_rad))
    oracle = view_oracle.OracleLens(tan_h, tan_v, lens[2], lens[3], camera.pitch_min_rad, camera.pitch_max_rad)
    reachable, shares = space.reachable[1:-1, 1:-1, 1:-1] > 0, []
    closed, off_centre = np.argwhere(voxels.state != FREE) + 0.5, 0
    scene = SearchScene(
        distance2=voxels.distance2.reshape(-1), shape=world.grid.shape, reachable=space.reachable.reshape(-1),
        clearance_box=space.clearance_box, lens=lens,
    )  # fmt: skip
    asked, blockers = np.zeros(len(shell.offsets) + MAX_MOVE_TESTS, dtype=np.int32), np.zeros(MAX_BLOCKERS, dtype=np.int32)
    for row in frontiers.rows():
        points, first = targets(frontiers.faces, frontiers.flat(int(row)))
        view, seen, tested, hidden, boxes = best_view(
            scene, shell, frontiers.table.rows.centre[row], points, first, asked, blockers
        )
        assert tested <= len(asked)
        cells = asked[:tested]
        assert hidden < MAX_BLOCKERS
        assert len(set(blockers[:hidden].tolist())) == hidden
        assert (voxels.distance2.reshape(-1)[blockers[:hidden]] == 0).all()
        assert (space.reachable.reshape(-1)[np.where(cells >= 0, cells, ~cells)] > 0).tolist() == (cells >= 0).tolist()
        target = view_oracle.OracleFrontier(frontiers.cluster(int(row)).cells, low, high)
        best = view_oracle.best_seen(voxels.state, oracle, reachable, target, (5.0, 42.0), int(row))
        if best >= 10:
            shares.append(view_oracle.cells_seen(voxels.state, oracle, view, target) / best)
            assert reachable[tuple(view[:3].astype(int))]
            off_centre += bool((view[:3] % 1.0 != 0.5).any())
            # clearance to the nearest side is at least that of a voxel centre
            assert ((np.maximum(np.abs(closed - view[:3]) - 0.5, 0.0) ** 2).sum(axis=1) >= space.clearance_box[SIDES2]).all()
            assert ((view[:3] >= low + 2.5) & (view[:3] <= high - 2.5)).all()
            assert seen.sum() <= view_oracle.cells_seen(voxels.state, oracle, view, target)
            at = np.array(np.unravel_index(np.where(cells >= 0, cells, ~cells), space.reachable.shape)) - 1
            for box, places in zip(boxes, (view[:2, None], at[:2]), strict=True):
                assert (box[:2, None] * TILE <= places).all()
                assert (places < box[2:, None] * TILE + TILE).all()
    assert len(shares) >= 8
    assert off_centre
    assert np.mean(np.array(shares) >= 0.95) >= 0.9
    assert min(shares) >= 0.8


def test_positions_are_ranked_by_their_bound_and_ties_keep_their_order() -> None:
    promises = np.random.default_rng(0).integers(0, 30, 400)
    np.testing.assert_array_equal(_ranked(promises, 60), np.argsort(-promises, kind="stable"))


def test_the_table_of_blocking_voxels_has_room_for_all_that_are_kept() -> None:
    assert MAX_BLOCKERS < HASH_SIZE
