"""From the setpoint flown last onto a new trajectory: no jump of place or velocity, and in the end nothing is left."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.autopilot.pilot.setpoints.setpoint_blending import SetpointBlender
from uav_recon.types.trajectory import Setpoint, Trajectory


def still(place: tuple[float, float, float], yaw: float = 0.0) -> Trajectory:
    flat = np.zeros(2)
    return Trajectory(
        0.0, 1.0, np.array([place, place]), np.zeros((2, 3)), np.zeros((2, 3)), flat + yaw, flat, flat, flat, 0, 1
    )


def test_the_gap_closes_smoothly() -> None:
    trajectory = still((0.1, 0.0, 1.0), yaw=6.3)
    flown = Setpoint.hold(np.array([0.0, 0.05, 1.0]), 0.1)
    handover = SetpointBlender(flown, 0.03, trajectory, 5.0)
    times = np.arange(5.0, 8.0, 1e-3)
    samples = [handover.apply(trajectory.setpoint_at(t), t) for t in times]
    places = np.array([s.position_m for s in samples])
    np.testing.assert_allclose(places[0], flown.position_m, atol=1e-12)
    np.testing.assert_allclose(places[-1], [0.1, 0.0, 1.0], atol=1e-12)
    assert samples[0].yaw_rad - 2 * np.pi == pytest.approx(0.1)
    velocities = np.array([s.velocity_mps for s in samples])
    np.testing.assert_allclose(np.gradient(places, 1e-3, axis=0)[1:-1], velocities[1:-1], atol=2e-3)
    accelerations = np.array([s.acceleration_mps2 for s in samples])
    inside = slice(1, 1300)
    np.testing.assert_allclose(np.gradient(velocities, 1e-3, axis=0)[inside], accelerations[inside], atol=2e-3)
    assert np.linalg.norm(velocities, axis=1).max() < 0.15
    assert np.linalg.norm(accelerations, axis=1).max() < 0.7


def test_a_beginning_elsewhere_is_left_for_the_guard_to_refuse() -> None:
    trajectory = still((0.51, 0.0, 1.0))
    handover = SetpointBlender(Setpoint.hold(np.array([0.0, 0.0, 1.0]), 0.0), 0.03, trajectory, 0.0)
    np.testing.assert_array_equal(handover.apply(trajectory.setpoint_at(0.0), 0.0).position_m, [0.51, 0.0, 1.0])
    turned = SetpointBlender(Setpoint.hold(np.array([0.51, 0.0, 1.0]), 0.6), 0.03, trajectory, 0.0)
    assert turned.apply(trajectory.setpoint_at(0.0), 0.0).yaw_rad == 0.0


def test_what_was_pushed_off_its_way_goes_on_from_where_it_is() -> None:
    """Off its way counts from 0.35 m: the mission holds it where it then is, and that must not be a jump."""
    trajectory = still((0.45, 0.0, 1.0))
    handover = SetpointBlender(Setpoint.hold(np.array([0.0, 0.0, 1.0]), 0.0), 0.0, trajectory, 0.0)
    places = np.array([handover.apply(trajectory.setpoint_at(t), t).position_m[0] for t in np.arange(0.0, 8.0, 0.03)])
    assert places[0] == pytest.approx(0.0)
    assert places[-1] == pytest.approx(0.45)
    assert np.abs(np.diff(places)).max() < 0.01


def test_what_goes_on_in_motion_is_flown_as_it_is() -> None:
    """The setpoint flown last is a turn of the loop old: the way since is no gap."""
    times, flat = np.arange(0.0, 4.0, 0.02), np.zeros(200)
    places = np.stack([0.8 * times, flat, flat + 1.0], axis=1)
    trajectory = Trajectory(
        0.0, 0.02, places, np.tile([0.8, 0.0, 0.0], (200, 1)), np.zeros((200, 3)), 0.5 * times, flat + 0.5, flat, flat, 0, 1
    )
    for turn_s in (1 / 60, 1 / 30):
        handover = SetpointBlender(trajectory.setpoint_at(2.0 - turn_s), turn_s, trajectory, 2.0)
        for t in (2.0, 2.3, 2.9):
            wanted, flown = trajectory.setpoint_at(t), handover.apply(trajectory.setpoint_at(t), t)
            np.testing.assert_allclose(flown.position_m, wanted.position_m, atol=1e-12)
            np.testing.assert_allclose(flown.acceleration_mps2, wanted.acceleration_mps2, atol=1e-12)
            assert flown.yaw_rad == pytest.approx(wanted.yaw_rad)
