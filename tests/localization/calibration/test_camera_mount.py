from __future__ import annotations

import numpy as np
import pytest

from uav_recon.channels import MemoryChannel
from uav_recon.localization.calibration.camera_mount import FixedMount, GimbalMount
from uav_recon.types.camera import body_from_camera
from uav_recon.types.pose import Pose
from uav_recon.types.vehicle import FlightPhase, VehicleState

AT = np.array([0.1, 0.0, -0.02])


def _state(stamp_s: float, pitch_rad: float) -> VehicleState:
    return VehicleState(
        stamp_s + 0.02, Pose.identity(), np.zeros(3), True, "OFFBOARD", FlightPhase.FLYING, 0.9, False, pitch_rad, -1, 0, None,
        camera_pitch_s=stamp_s,
    )  # fmt: skip


@pytest.fixture
def vehicle() -> MemoryChannel[VehicleState]:
    return MemoryChannel(VehicleState)


def test_a_fixed_camera_looks_down_by_its_tilt() -> None:
    mount = FixedMount(body_from_camera(AT, np.radians(15)))
    mount.observe()
    pose = mount.body_from_depth(1.0)
    assert pose
    axis = pose.apply(np.array([0.0, 0.0, 1.0])) - AT
    np.testing.assert_allclose(axis, [np.cos(np.radians(15)), 0.0, -np.sin(np.radians(15))])


def test_a_gimbal_is_where_it_was_measured_around_the_stamp(vehicle: MemoryChannel[VehicleState]) -> None:
    mount = GimbalMount(AT, vehicle)
    for k in range(20):
        vehicle.publish(_state(10.0 + k / 30, 0.1 + 0.02 * k))
        mount.observe()
        mount.observe()
    pose = mount.body_from_depth(10.0 + 5.5 / 30)
    assert pose
    np.testing.assert_allclose(pose.matrix(), body_from_camera(AT, 0.1 + 0.02 * 5.5).matrix(), atol=1e-9)
    assert mount.measured_until_s == pytest.approx(10.0 + 19 / 30)


@pytest.mark.parametrize(("after_s", "turned_rad"), [(0.05, 0.03), (0.1, 0.06), (0.25, 0.06)])
def test_a_gimbal_turns_on_for_a_moment_after_the_newest_measurement(
    vehicle: MemoryChannel[VehicleState], after_s: float, turned_rad: float
) -> None:
    mount = GimbalMount(AT, vehicle)
    for k in range(2):
        vehicle.publish(_state(10.0 + k / 30, 0.1 + 0.02 * k))
        mount.observe()
    pose = mount.body_from_depth(10.0 + 1 / 30 + after_s)
    assert pose
    np.testing.assert_allclose(pose.matrix(), body_from_camera(AT, 0.12 + turned_rad).matrix(), atol=1e-9)


def test_one_measurement_published_twice_is_one(vehicle: MemoryChannel[VehicleState]) -> None:
    mount = GimbalMount(AT, vehicle)
    for stamp_s, pitch_rad in ((10.0, 0.1), (10.0, 0.1), (10.1, 0.2)):
        vehicle.publish(_state(stamp_s, pitch_rad))
        mount.observe()
    pose = mount.body_from_depth(10.05)
    assert pose
    np.testing.assert_allclose(pose.matrix(), body_from_camera(AT, 0.15).matrix(), atol=1e-9)


def test_a_gimbal_nobody_measured_is_unknown(vehicle: MemoryChannel[VehicleState]) -> None:
    mount = GimbalMount(AT, vehicle, stale_s=0.3)
    mount.observe()
    assert mount.body_from_depth(10.0) is None
    vehicle.publish(_state(10.0, float("nan")))
    mount.observe()
    assert mount.body_from_depth(10.0) is None
    vehicle.publish(_state(10.1, 0.2))
    mount.observe()
    assert mount.body_from_depth(10.39) is not None
    assert mount.body_from_depth(10.41) is None
    assert mount.body_from_depth(9.79) is None
