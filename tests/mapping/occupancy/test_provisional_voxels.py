"""Something walks through a known room, or stays in it."""

from __future__ import annotations

import numpy as np
import pytest
from test_occupancy_map import D435I, LENS, NO_COLOUR, ROOM, depth_of_box, looking, voxels

from uav_recon.mapping.occupancy.multiresolution_map import MultiResolutionMap
from uav_recon.mapping.occupancy.occupancy_map import OccupancyMap
from uav_recon.mapping.occupancy.provisional_voxels import CONFIRMED_S, GIVEN_UP_S
from uav_recon.types.camera import Frame, PosedFrame
from uav_recon.types.frames import Float32Array
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, GridSpec
from uav_recon.types.pose import Pose

PERIOD_S = 1.0 / 6.0
HERE = looking(-1.0, 0.0, 1.2)
AWAY = looking(-1.0, 0.0, 1.2, np.pi)
BODY_M = 2.0  # from the camera
PLACE = np.array([1.05, 0.05, 1.25])  # the voxel that the body's near side is in


def _posed(stamp_s: float, pose: Pose, body: slice | None = None) -> PosedFrame:
    depth_m: Float32Array = depth_of_box(pose, *ROOM).copy()
    if body is not None:
        depth_m[20:100, body] = np.minimum(depth_m[20:100, body], BODY_M + 0.05)
    return PosedFrame(Frame(stamp_s, 0, depth_m, LENS, NO_COLOUR, LENS, Pose.identity()), pose)


def _known_room() -> OccupancyMap:
    space = voxels()
    for n in range(8):
        space.integrate(_posed(n * PERIOD_S, HERE))
    assert _state(space) == FREE
    return space


def _state(space: OccupancyMap) -> int:
    return int(space.snapshot().state[tuple(space.grid.index(PLACE))])


def _occupied(space: OccupancyMap) -> int:
    return int(np.count_nonzero(space.snapshot().state == OCCUPIED))


def _body(space: OccupancyMap, from_s: float, seconds: float) -> float:
    """Show a body for a while; return the stamp of the last frame."""
    stamps = from_s + PERIOD_S * np.arange(1 + round(seconds / PERIOD_S))
    for stamp_s in stamps:
        space.integrate(_posed(float(stamp_s), HERE, slice(90, 120)))
    return float(stamps[-1])


def test_what_was_there_for_a_moment_does_not_stay_though_nobody_looks_again() -> None:
    space = _known_room()
    room = _occupied(space)
    last_s = _body(space, 10.0, 1.0)
    assert _state(space) == OCCUPIED, "while it is there"
    space.integrate(_posed(last_s + GIVEN_UP_S - 0.01, AWAY))
    assert _state(space) == OCCUPIED
    space.integrate(_posed(last_s + GIVEN_UP_S, AWAY))
    assert _state(space) == UNKNOWN, "not free: nobody has seen it go"
    assert _occupied(space) >= room
    ahead = space.snapshot().state[space.grid.index(PLACE)[0] - 2 :][:6, 20:40, 8:18]
    assert not (ahead == OCCUPIED).any()


def test_a_frame_tells_whether_it_shows_something_that_moves() -> None:
    space = _known_room()
    told = [space.shows_motion]
    _body(space, 10.0, 1.0)
    told.append(space.shows_motion)
    space.integrate(_posed(11.2, HERE))
    told.append(space.shows_motion)
    _body(space, 12.0, CONFIRMED_S + 2.0)
    assert [*told, space.shows_motion] == [False, True, False, False], "at last it stays"


def test_returns_beside_a_surface_are_the_surface() -> None:
    """A wall that is seen 0.25 m too near for a moment, by errors of camera and pose, is neither motion nor given up."""
    space = _known_room()
    room = _occupied(space)
    for n in range(12):
        frame = _posed(10.0 + n * PERIOD_S, HERE)
        depth_m = frame.frame.depth_m.copy()
        depth_m[60:80, 90:120] -= 0.25
        space.integrate(PosedFrame(Frame(frame.frame.stamp_s, 0, depth_m, LENS, NO_COLOUR, LENS, Pose.identity()), HERE))
        assert not space.shows_motion
    nearer = _occupied(space)
    assert nearer > room + 12
    space.integrate(_posed(20.0, AWAY))
    assert _occupied(space) >= nearer


def test_what_stays_is_there_for_good() -> None:
    space = _known_room()
    last_s = _body(space, 10.0, CONFIRMED_S + 1.0)
    space.integrate(_posed(last_s + 100.0, AWAY))
    assert _state(space) == OCCUPIED


def test_what_has_gone_is_soon_free_where_the_camera_looks() -> None:
    space = _known_room()
    last_s = _body(space, 10.0, 1.5)
    for n in range(5):
        space.integrate(_posed(last_s + (n + 1) * PERIOD_S, HERE))
    assert _state(space) == FREE


def test_it_does_not_stay_where_it_hid_the_room_either() -> None:
    """Behind a body free space becomes unknown. A second one that comes there is as provisional."""
    space = _known_room()
    behind = PLACE + np.array([0.3, 0.0, 0.0])
    last_s = _body(space, 10.0, 0.5)
    assert space.snapshot().state[tuple(space.grid.index(behind))] == UNKNOWN
    for n in range(4):
        frame = _posed(last_s + (n + 1) * PERIOD_S, HERE)
        depth_m = frame.frame.depth_m.copy()
        depth_m[20:100, 90:120] = BODY_M + 0.35
        seen = Frame(frame.frame.stamp_s, 0, depth_m, LENS, NO_COLOUR, LENS, Pose.identity())
        space.integrate(PosedFrame(seen, HERE))
    assert space.snapshot().state[tuple(space.grid.index(behind))] == OCCUPIED
    space.integrate(_posed(last_s + 10.0, AWAY))
    assert space.snapshot().state[tuple(space.grid.index(behind))] == UNKNOWN


def test_a_wall_that_is_seen_first_is_no_guest() -> None:
    space = voxels()
    for n in range(2):
        space.integrate(_posed(n * PERIOD_S, HERE, slice(90, 120)))
    assert _state(space) == OCCUPIED, "unknown before"
    space.integrate(_posed(100.0, AWAY))
    assert _state(space) == OCCUPIED


def test_nothing_of_it_stays_in_a_fine_map_that_nobody_looks_at() -> None:
    def make(grid: GridSpec, _: int) -> OccupancyMap:
        return OccupancyMap(grid, D435I, 2.5, (-2, -3, 0), (6, 3, 3), 1.1)

    space = MultiResolutionMap(voxels(), make)
    space.refine([PLACE])
    for n in range(12):
        space.integrate(_posed(n * PERIOD_S, HERE))
    for n in range(14):
        space.integrate(_posed(10.0 + n * PERIOD_S, HERE, slice(90, 120)))

    def middle() -> int:
        (fine,) = space.snapshot().fine
        around = fine.state[tuple(slice(k - 4, k + 5) for k in fine.grid.index(PLACE))]
        return int(np.count_nonzero(around == OCCUPIED))

    assert middle() > 0
    space.integrate(_posed(20.0, AWAY))
    assert middle() == 0


@pytest.mark.parametrize("reset", [True, False])
def test_a_new_epoch_forgets_it(reset: bool) -> None:
    space = _known_room()
    last_s = _body(space, 10.0, 1.0)
    if reset:
        space.reset(0)
        for n in range(2):
            space.integrate(_posed(last_s + n * PERIOD_S, HERE, slice(90, 120)))
    space.integrate(_posed(last_s + 10.0, AWAY))
    assert _state(space) == (OCCUPIED if reset else UNKNOWN)
