from __future__ import annotations

import math

import numpy as np
import pytest
from flight_rig import HULL

from uav_recon.autopilot.pilot.situation.surroundings import Surroundings
from uav_recon.channels import MemoryChannel
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.camera import body_from_camera
from uav_recon.types.maps import FreeSpace, GridSpec
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import Pose, StampedPose

MOUNT = body_from_camera(np.array([0.1, 0.0, 0.0]), 0.0)
FORWARD = np.array([1.0, 0.0, 0.0])


def _nearby(stamp_s: float, range_m: float, consistent: bool = True) -> MinRangeGrid:
    return MinRangeGrid(stamp_s, MOUNT, np.full((12, 16), range_m, np.float32), (0.95, 0.55), 0.9, consistent)


def test_a_picture_that_is_inconsistent_is_none_but_for_what_is_near_in_it() -> None:
    channel, seen_space = MemoryChannel(MinRangeGrid), RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=0.2)
    surroundings = Surroundings(MemoryChannel(FreeSpace), channel, seen_space, HULL)

    def pose(stamp_s: float) -> StampedPose:
        return StampedPose(stamp_s, Pose.identity(), np.zeros(3))

    assert surroundings.depth_age_s(5.0) == math.inf
    channel.publish(_nearby(5.0, 2.0))
    surroundings.step(pose(5.0), 5.0)
    channel.publish(_nearby(5.2, 4.0, consistent=False))
    surroundings.step(pose(5.2), 5.2)
    assert math.isclose(surroundings.depth_age_s(5.2), 0.2)
    assert surroundings.rejects_depth(5.2, 0.3)
    assert not surroundings.rejects_depth(5.6, 0.3), "no frame comes any more"
    assert surroundings.ahead is not None
    assert surroundings.ahead.room_m(FORWARD) > 3.0
    assert not seen_space.saw_free((3.0, 0.0, 0.0), 5.2)
    channel.publish(_nearby(5.4, 4.0))
    surroundings.step(pose(5.4), 5.4)
    assert surroundings.depth_age_s(5.4) == 0.0
    assert not surroundings.rejects_depth(5.4, 0.3)
    assert seen_space.saw_free((3.0, 0.0, 0.0), 5.4)


def test_a_frame_that_comes_late_was_taken_where_the_vehicle_was_then() -> None:
    channel, seen_space = MemoryChannel(MinRangeGrid), RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=0.2)
    surroundings = Surroundings(MemoryChannel(FreeSpace), channel, seen_space, HULL)
    turned = Pose.from_yaw(math.pi / 2.0, np.zeros(3))
    surroundings.step(StampedPose(5.0, Pose.identity(), np.zeros(3)), 5.0)
    channel.publish(_nearby(5.0, 4.0))
    surroundings.step(StampedPose(5.1, turned, np.zeros(3)), 5.1)
    assert seen_space.saw_free((3.0, 0.0, 0.0), 5.1)
    assert not seen_space.saw_free((0.0, 3.0, 0.0), 5.1)
    channel.publish(_nearby(5.4, 4.0))
    surroundings.step(None, 5.4)
    assert not seen_space.saw_free((0.0, 3.0, 0.0), 5.4), "no pose of that time is known"


@pytest.mark.parametrize(
    ("origin_m", "resolution_m"),
    [((0.0, 0.0, 0.0), 0.0), ((0.0, 0.0, 0.0), math.nan), ((math.nan, 0.0, 0.0), 0.1), ((0.0, 0.0), 0.1)],
)
def test_a_free_space_that_makes_no_sense_leaves_the_one_before_it(origin_m: tuple[float, ...], resolution_m: float) -> None:
    channel = MemoryChannel(FreeSpace)
    surroundings = Surroundings(
        channel, MemoryChannel(MinRangeGrid), RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=0.2), HULL
    )
    bits = np.packbits(np.ones((30, 30, 30), dtype=np.bool_))
    channel.publish(FreeSpace(GridSpec(np.zeros(3), 0.1, (30, 30, 30)), bits, 1))
    surroundings.step(None, 5.0)
    channel.publish(FreeSpace(GridSpec(np.array(origin_m), resolution_m, (30, 30, 30)), bits, 2))
    surroundings.step(None, 5.1)
    assert surroundings.known_free is not None
    assert surroundings.known_free.admits((1.0, 1.0, 1.0), (2.0, 1.0, 1.0))
    assert not surroundings.known_free.admits((1.0, 1.0, 1.0), (4.0, 1.0, 1.0))


def test_a_picture_that_makes_no_sense_is_none() -> None:
    channel = MemoryChannel(MinRangeGrid)
    surroundings = Surroundings(
        MemoryChannel(FreeSpace), channel, RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=0.2), HULL
    )
    for n, cells in enumerate((np.full(16, 2.0, np.float32), np.zeros((0, 0), np.float32))):
        channel.publish(MinRangeGrid(5.0 + n, MOUNT, cells, (0.95, 0.55), 0.9))
        surroundings.step(None, 5.0 + n)
    assert surroundings.ahead is None
    assert surroundings.depth_age_s(6.0) == math.inf
