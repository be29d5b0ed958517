"""What the pilot makes of the upward range finder's readings: cones in odom, or nothing."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.link_status import LinkStatus
from uav_recon.autopilot.mavlink.messages import UpwardRange
from uav_recon.autopilot.mavlink.telemetry import Telemetry, updated
from uav_recon.autopilot.pilot.situation.upward_range_finder import RangeFinderModel, UpwardRangeFinder
from uav_recon.channels import MemoryChannel
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.frames import FloatArray
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.pose import Pose, PoseHealth, StampedPose

MODEL = RangeFinderModel(fov_rad=math.radians(24.0), position_body_m=np.array([0.1, 0.0, 0.05]), error_share=0.02)
PLACE = np.array([1.0, 2.0, 1.1])


class Finder:
    """A finder on a link without bytes. Poses are odometry at 30 Hz, readings come at 15 Hz."""

    def __init__(self) -> None:
        self.link = SimpleNamespace(telemetry=Telemetry(), status=LinkStatus())
        self.seen_space = RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=0.2)
        self.channel = MemoryChannel(FreeCone)
        self.finder = UpwardRangeFinder(MODEL, cast("VehicleLink", self.link), self.seen_space, self.channel)
        self._boot_ms = 5000

    def read(self, stamp_s: float, range_m: float = 2.0, **changes: Any) -> None:
        """Let a reading arrive, with a boot clock that goes on."""
        self._boot_ms += 66
        fields = {"sensor": 0, "fov_rad": math.inf, "boot_ms": self._boot_ms} | changes
        self.link.telemetry = updated(self.link.telemetry, UpwardRange(range_m=range_m, **fields), stamp_s)

    def step(self, now_s: float, **changes: Any) -> FreeCone | None:
        """Step with a pose of this moment; returns the cone that this published."""
        before = self.channel.sequence()
        self.finder.step(pose(now_s, **changes), now_s)
        return self.channel.latest() if self.channel.sequence() > before else None

    def cone(
        self, range_m: float = 2.0, now_s: float = 10.0, /, *, body: FloatArray | None = None, **changes: Any
    ) -> FreeCone | None:
        """Let a reading of this moment arrive, and step."""
        self.read(now_s, range_m, **changes)
        return self.step(now_s) if body is None else self.step(now_s, lean=body)


def pose(stamp_s: float, lean: Any = (0.0, 0.0, 0.0), velocity_mps: Any = (0.0, 0.0, 0.0), **changes: Any) -> StampedPose:
    body = Pose.from_rotation_vector(np.array(lean), PLACE)
    return StampedPose(stamp_s, body, np.array(velocity_mps), map_epoch=3, **changes)


def test_a_reading_is_a_cone_around_the_bodys_axis_with_margins() -> None:
    finder = Finder()
    cone = finder.cone()
    assert cone is not None
    assert (cone.stamp_s, cone.map_epoch) == (10.0, 3)
    np.testing.assert_allclose(cone.apex_odom_m, [1.1, 2.0, 1.15])
    np.testing.assert_allclose(cone.axis_odom, [0.0, 0.0, 1.0])
    assert cone.half_angle_rad == pytest.approx(math.radians(10.0)), "two degrees less than the half angle"
    assert cone.reach_m == pytest.approx(1.88), "three sigmas less than the reading"
    assert finder.seen_space.saw_free((1.1, 2.0, 2.9), 10.1)
    assert not finder.seen_space.saw_free((1.1, 2.0, 3.1), 10.1)


@pytest.mark.parametrize(("fov_deg", "half_deg"), [(20.0, 8.0), (30.0, 10.0), (4.1, 0.05)])
def test_the_narrower_one_of_message_and_config_counts(fov_deg: float, half_deg: float) -> None:
    cone = Finder().cone(fov_rad=math.radians(fov_deg))
    assert cone is not None
    assert cone.half_angle_rad == pytest.approx(math.radians(half_deg))


def test_it_ends_earlier_by_what_the_vehicle_flies_in_a_tenth_of_a_second() -> None:
    finder = Finder()
    finder.read(10.0)
    cone = finder.step(10.0, velocity_mps=(0.0, 0.6, 0.8))
    assert cone is not None
    assert cone.reach_m == pytest.approx(1.78)
    finder.read(10.1, 0.1)
    assert finder.step(10.1, velocity_mps=(0.0, 0.0, -1.0)) is None, "nothing is left"


def test_a_cone_that_is_no_wider_than_its_errors_is_none() -> None:
    assert Finder().cone(fov_rad=math.radians(4.0)) is None


@pytest.mark.parametrize(("lean_deg", "used"), [(9.9, True), (10.1, False), (-9.9, True), (-10.1, False), (180.0, False)])
def test_the_axis_leans_with_the_body_and_not_too_far(lean_deg: float, used: bool) -> None:
    cone = Finder().cone(body=np.array([0.0, math.radians(lean_deg), 0.0]))
    assert (cone is not None) is used
    if cone is not None:
        np.testing.assert_allclose(cone.axis_odom, [math.sin(math.radians(lean_deg)), 0.0, math.cos(math.radians(lean_deg))])


@pytest.mark.parametrize("health", [PoseHealth.DEGRADED, PoseHealth.LOST, PoseHealth.WRONG])
def test_a_pose_that_is_not_good_places_no_cone(health: PoseHealth) -> None:
    finder = Finder()
    finder.read(10.0)
    assert finder.step(10.0, health=health) is None
    assert finder.step(10.03) is None, "the reading is gone"


def test_a_reading_waits_for_the_next_pose_and_takes_the_nearest() -> None:
    finder = Finder()
    finder.step(9.967, lean=(0.1, 0.0, 0.0))
    finder.read(9.98)
    finder.finder.step(None, 9.99)
    assert finder.channel.latest() is None
    cone = finder.step(10.0)
    assert cone is not None
    assert cone.axis_odom[1] == pytest.approx(-math.sin(0.1))
    assert cone.stamp_s == 9.98


def test_a_reading_without_a_pose_near_in_time_is_not_used() -> None:
    finder = Finder()
    finder.step(9.9)
    finder.read(9.95)
    assert finder.step(10.0) is None
    finder.read(9.97)
    assert finder.step(10.03) is not None
    finder.read(9.98)
    assert finder.step(10.3) is None, "it is too old"


def test_a_frozen_reading_is_not_used_and_a_new_value_is() -> None:
    finder = Finder()
    used = [finder.cone(2.0, 10.0 + n / 15) is not None for n in range(30)]
    assert used == [True] * 3 + [False] * 27
    assert finder.cone(2.01, 13.0) is not None
    assert finder.cone(2.0, 13.1) is not None


def test_a_repeated_stamp_is_no_new_measurement() -> None:
    finder = Finder()
    assert finder.cone(2.0, 10.0, boot_ms=77) is not None
    assert finder.cone(2.1, 10.1, boot_ms=77) is None
    assert finder.step(10.2) is None
    assert finder.cone(2.1, 10.3, boot_ms=78) is not None


def test_only_the_first_sensor_counts() -> None:
    finder = Finder()
    assert finder.cone(2.0, 10.0, sensor=4) is not None
    assert finder.cone(3.0, 10.1, sensor=5) is None
    assert finder.cone(2.1, 10.2, sensor=4) is not None


def test_two_autopilots_place_no_cone() -> None:
    finder = Finder()
    finder.link.status = LinkStatus(duplicate_autopilot=True)
    assert finder.cone() is None
    finder.link.status = LinkStatus()
    assert finder.cone(2.1, 10.1) is not None


def test_a_jump_of_odom_drops_what_waits() -> None:
    finder = Finder()
    finder.step(9.99)
    finder.read(10.0)
    finder.finder.step(None, 10.0)
    finder.finder.forget()
    assert finder.step(10.01) is None
