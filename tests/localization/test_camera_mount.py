from __future__ import annotations

import numpy as np
import pytest

from uav_recon.channels import MemoryChannel
from uav_recon.localization.camera_mount import FixedMount, GimbalMount
from uav_recon.types.camera import body_from_camera
from uav_recon.types.pose import Pose
from uav_recon.types.vehicle import FlightPhase, VehicleState

AT = np.array([0.1, 0.0, -0.02])


def _state(stamp_s: float, pitch_rad: float) -> VehicleState:
    return VehicleState(
        stamp_s, Pose.identity(), np.zeros(3), True, "OFFBOARD", FlightPhase.FLYING, 0.9, False, pitch_rad, -1, 0, None
    )


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
    newest = mount.body_from_depth(10.0 + 19 / 30 + 0.05)
    assert newest
    np.testing.assert_allclose(newest.matrix(), body_from_camera(AT, 0.1 + 0.02 * 19).matrix(), atol=1e-9)


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
