"""The upward range finder end to end: true scene, simulated autopilot, bytes, pilot, map."""

from __future__ import annotations

import math

import numpy as np
import pytest
from flight_rig import BOUNDS, ENVELOPE, HULL, ORIGIN, Rig
from guard_rooms import TIMEOUTS
from test_pilot_flight_ardupilot import CopterRig

from sitl.scene.scene import Scene, load_scene
from sitl.world.range_finder import MOUNT_M, SimulatedUpwardRangeFinder
from uav_recon.autopilot.mavlink.tlog import FrameLog
from uav_recon.autopilot.pilot.assembly import make_pilot
from uav_recon.autopilot.pilot.pilot import Pilot
from uav_recon.autopilot.pilot.situation.upward_range_finder import STREAM, RangeFinderModel
from uav_recon.mapping.occupancy.occupancy_map import DepthSensor, OccupancyMap
from uav_recon.safety.free_cone_rule import points_in_cones
from uav_recon.safety.guard import Guard
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.maps import FREE, GridSpec

FOV_RAD = math.radians(45.0)
LAMP_ROOM = "small:8"  # a lamp hangs over its pad
MODEL = RangeFinderModel(fov_rad=FOV_RAD, position_body_m=np.array(MOUNT_M), error_share=0.02)
REQUEST = 511  # MAV_CMD_SET_MESSAGE_INTERVAL


class RangeRig(Rig):
    """A flight in a room, with a range finder that looks up."""

    model: RangeFinderModel | None = MODEL

    def new_pilot(self, log: FrameLog | None = None) -> Pilot:
        seen_space = RecentlySeenSpace(blind_memory_s=60.0, vehicle_radius_m=HULL.vehicle_radius_m)
        self.guard = Guard(ENVELOPE, BOUNDS, seen_space)
        if self.model is not None:
            self.firmware = self.firmware.with_stream(*STREAM)
        return make_pilot(
            self.vehicle_link(log), self.guard, TIMEOUTS, self.channels, self.clock, ORIGIN, HULL, range_finder=self.model
        )


class CopterRangeRig(RangeRig, CopterRig):
    """The same flight on the other firmware."""


class DeclaredWithout(RangeRig):
    """The autopilot has the sensor, and the config does not say so."""

    model = None


@pytest.fixture(scope="module")
def room() -> Scene:
    return load_scene(LAMP_ROOM, fine=False)


def cones_of(rig: RangeRig, room: Scene) -> list[FreeCone]:
    """Fly up and to the side under the lamp; return every cone on the way."""
    rig.autopilot.mount_range_finder(SimulatedUpwardRangeFinder(room, 3, FOV_RAD))
    rig.take_off_and_hover()
    cones, seen = [], 0
    duration_s = rig.fly((0.3, 0.2, 1.2), (-0.3, 0.2, 1.0), identifier=2).duration_s
    for _ in range(round(duration_s / 0.01)):
        rig.step()
        cone = rig.channels.cones.latest()
        if cone is not None and rig.channels.cones.sequence() != seen:
            seen = rig.channels.cones.sequence()
            cones.append(cone)
    return cones


@pytest.mark.parametrize("kind", [RangeRig, CopterRangeRig])
def test_no_cone_and_no_voxel_that_it_frees_holds_a_true_surface(kind: type[RangeRig], room: Scene) -> None:
    rig = kind()
    cones = cones_of(rig, room)
    assert len(cones) > 30
    surface = room.samples.points.astype(np.float64)
    apex_m, axis = np.array([cone.apex_odom_m for cone in cones]), np.array([cone.axis_odom for cone in cones])
    cos, reach_m = np.array([math.cos(cone.half_angle_rad) for cone in cones]), np.array([cone.reach_m for cone in cones])
    assert not points_in_cones(surface, apex_m, axis, cos, reach_m).any()
    grid = GridSpec.covering(room.fence_min - 0.3, room.fence_max + 0.3, 0.1)
    space = OccupancyMap(grid, DepthSensor(0.3, 0.04, 0.05), 5.0, room.fence_min.tolist(), room.fence_max.tolist(), 1.1)
    assert sum(space.integrate_cone(cone) for cone in cones) > 0
    i, j, k = grid.index(surface).T
    assert not (space.snapshot().state[i, j, k] == FREE).any()
    heights = [cone.apex_odom_m[2] + cone.reach_m for cone in cones]
    assert 1.6 < max(heights) < 1.8, "the lamp hangs over all of this flight"
    assert all(cone.half_angle_rad == pytest.approx(FOV_RAD / 2 - math.radians(2.0)) for cone in cones)
    where = cones[-1].apex_odom_m
    assert rig.guard.seen_space.saw_free((float(where[0]), float(where[1]), float(where[2]) + 0.2), rig.clock.now_s())


@pytest.mark.parametrize(("kind", "asked"), [(RangeRig, True), (CopterRangeRig, True), (DeclaredWithout, False)])
def test_the_message_is_requested_only_where_the_config_declares_the_sensor(kind: type[RangeRig], asked: bool) -> None:
    rig = kind()
    rig.run(3.0)
    requests = [m for _, m in rig.tap.sent if m.get_type() == "COMMAND_LONG" and m.command == REQUEST and m.param1 == 132.0]
    assert bool(requests) is asked
    assert all(m.param2 == pytest.approx(1e6 / 15.0) for m in requests)


def test_a_sensor_that_the_config_does_not_declare_frees_nothing(room: Scene) -> None:
    assert cones_of(DeclaredWithout(), room) == []
