"""AUTOPILOTS.md: origin and arming of the simulated PX4."""

from __future__ import annotations

import pytest
from px4_rig import companion, seconds_until
from pymavlink.dialects.v20 import common as mavlink
from scripted_companion import LOITER, OFFBOARD


def test_prearm_comes_about_five_seconds_after_the_origin() -> None:
    c = companion()
    c.run(8.0)
    assert c.flags & 8
    assert not c.prearm
    c.send_origin()
    assert 4.5 < seconds_until(c, lambda: c.prearm, 8.0) < 6.0
    assert c.last["GPS_GLOBAL_ORIGIN"].latitude == 473977000
    assert abs(c.last["HOME_POSITION"].z) < 0.1


def test_without_an_origin_offboard_arms_but_loiter_does_not() -> None:
    c = companion()
    c.run(8.0)
    assert c.arm() == 1
    assert any("Global position estimate required" in text for text in c.texts)
    c.go_to(0.0, 0.0, 0.3)
    c.run(1.2)
    assert c.set_mode(OFFBOARD) == 0
    assert c.arm() == 0


def test_a_heading_in_local_frd_gives_no_global_position_for_any_origin() -> None:
    """Measured on 1.17: poses are fused and OFFBOARD arms, but there is no Hold and no PREARM."""
    c = companion()
    c.pose_frame = (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD)
    c.run(8.0)
    c.send_origin()
    c.run(8.0)
    assert c.flags & 8
    assert not c.prearm
    assert c.arm() == 1
    c.go_to(0.0, 0.0, 0.3)
    c.run(1.2)
    assert c.set_mode(OFFBOARD) == 0
    assert c.arm() == 0


def test_an_origin_before_the_first_pose_adds_488_m_to_the_height() -> None:
    c = companion()
    c.pose_on = False
    c.run(0.5)
    c.send_origin()
    c.run(0.2)
    c.pose_on = True
    c.run(3.0)
    assert c.last["LOCAL_POSITION_NED"].z == pytest.approx(488.0, abs=0.2)


def test_no_position_is_sent_before_poses_are_fused() -> None:
    c = companion()
    c.pose_on = False
    c.run(3.0)
    assert "LOCAL_POSITION_NED" not in c.last
    assert not c.flags & 8
    assert c.flags & 128


def test_without_a_pose_offboard_does_not_arm() -> None:
    c = companion()
    c.pose_on = False
    c.go_to(0.0, 0.0, -1.0)
    c.run(2.0)
    c.set_mode(OFFBOARD)
    assert c.arm() == 1
    assert any("Position estimate required" in text for text in c.texts)


def test_at_one_setpoint_a_second_arming_is_denied() -> None:
    c = companion()
    c.ready()
    c.setpoint_hz = 1.0
    c.go_to(0.0, 0.0, -1.0)
    c.run(4.0)
    assert c.set_mode(OFFBOARD) == 0
    c.run(3.0)
    assert c.mode == LOITER
    assert c.arm() == 1
    assert any("No offboard signal" in text for text in c.texts)


def test_a_low_battery_and_a_silent_transmitter_forbid_arming() -> None:
    c = companion()
    c.ready()
    c.px4.set_battery(0.25)
    assert c.arm() == 1
    c.px4.set_battery(1.0)
    c.px4.transmitter(heard=False)
    c.run(1.0)
    assert c.arm() == 1
    assert any("No manual control input" in text for text in c.texts)
    c.px4.transmitter(heard=True)
    assert c.arm() == 0


def test_an_armed_vehicle_on_the_ground_disarms_after_five_seconds() -> None:
    c = companion()
    c.ready()
    assert c.arm() == 0
    c.run(1.0)
    assert c.armed
    assert 3.0 < seconds_until(c, lambda: not c.armed, 8.0) < 5.5


@pytest.mark.parametrize(("ramp_s", "least_s", "max_s"), [(3.0, 2.5, 4.5), (0.5, 0.1, 1.2)])
def test_thrust_ramps_up_from_zero_before_lift_off(ramp_s: float, least_s: float, max_s: float) -> None:
    """Measured on 1.17: with a ramp of 3 s it stayed on the ground for 3.8 s and more.

    That is the time after its spool-up, while the setpoint climbed away from it.
    """
    c = companion(MPC_TKO_RAMP_T=ramp_s)
    c.run(8.0)
    c.go_to(0.0, 0.0, -1.2)
    c.run(1.2)
    assert c.set_mode(OFFBOARD) == 0
    assert c.arm() == 0
    c.run(1.0)
    assert least_s < seconds_until(c, lambda: c.vehicle.position[2] > 0.05, 8.0) < max_s
