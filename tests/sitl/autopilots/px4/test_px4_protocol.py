"""AUTOPILOTS.md: parameters, rates, commands and gimbal of the simulated PX4."""

from __future__ import annotations

import math

import pytest
from px4_rig import ARM, companion, flying, truth_mode
from pymavlink.dialects.v20 import common as mavlink


def test_parameters_are_listed_read_and_set() -> None:
    c = companion()
    c.keep = {"PARAM_VALUE"}
    c.send(mavlink.MAVLink_param_request_list_message(1, 1))
    c.run(2.0)
    assert {m.param_index for m in c.messages} == set(range(len(c.px4.parameters)))
    c.messages.clear()
    c.send(mavlink.MAVLink_param_request_read_message(1, 1, b"COM_OF_LOSS_T", -1))
    c.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH_PARAM", -1))
    c.run(0.1)
    assert [(m.param_id, m.param_value) for m in c.messages] == [("COM_OF_LOSS_T", 0.5)]
    c.messages.clear()
    wire = c.px4.parameters.on_wire("COM_OBL_RC_ACT")
    c.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", wire, mavlink.MAV_PARAM_TYPE_INT32))
    c.send(mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_VEL_MAX", 0.4, mavlink.MAV_PARAM_TYPE_REAL32))
    c.run(0.1)
    assert c.px4.parameters.integer("COM_OBL_RC_ACT") == 4
    assert c.px4.parameters["MPC_XY_VEL_MAX"] == pytest.approx(0.4)
    assert len(c.messages) == 2


def test_a_changed_parameter_changes_the_flight() -> None:
    c = flying()
    c.send(mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_VEL_MAX", 0.4, mavlink.MAV_PARAM_TYPE_REAL32))
    c.go_to(9.0, 0.0, -1.2)
    c.run(4.0)
    assert math.hypot(*c.vehicle.velocity[:2]) < 0.5


def test_message_rates_can_be_requested() -> None:
    c = companion()
    c.run(2.0)
    c.keep = {"LOCAL_POSITION_NED"}
    assert c.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 32, 10_000.0) == 0
    c.messages.clear()
    c.run(1.0)
    assert len(c.messages) == pytest.approx(100, abs=12)
    assert c.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 32, -1.0) == 0
    c.messages.clear()
    c.run(1.0)
    assert c.messages == []
    assert c.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 9999, 10_000.0) == 2


def test_default_rates() -> None:
    c = companion()
    c.run(3.0)
    c.keep = {"HEARTBEAT", "TIMESYNC", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GIMBAL_DEVICE_ATTITUDE_STATUS"}
    c.run(10.0)
    counts = {kind: sum(m.get_type() == kind for m in c.messages) / 10.0 for kind in c.keep}
    assert counts == pytest.approx(
        {
            "HEARTBEAT": 1,
            "TIMESYNC": 10,
            "ATTITUDE_QUATERNION": 50,
            "LOCAL_POSITION_NED": 30,
            "GIMBAL_DEVICE_ATTITUDE_STATUS": 30,
        },
        rel=0.11,
    )


def test_the_heartbeat_rate_is_fixed_but_one_can_be_requested() -> None:
    """Measured on 1.17."""
    c = companion()
    assert c.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_HEARTBEAT, 100_000.0) == 4
    c.run(0.5)
    c.keep = {"HEARTBEAT"}
    c.messages.clear()
    c.run(5.0)
    assert len(c.messages) == 5
    for _ in range(10):
        assert c.ask(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_HEARTBEAT) == 0
    assert len(c.messages) >= 15


def test_the_version_is_sent_on_request() -> None:
    c = companion()
    assert c.ask(mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == 0
    version = c.last["AUTOPILOT_VERSION"].flight_sw_version
    assert (version >> 24, version >> 16 & 255, version >> 8 & 255) == (1, 17, 0)


def test_unknown_commands_are_refused_and_commands_for_other_systems_ignored() -> None:
    c = companion()
    assert c.ask(mavlink.MAV_CMD_NAV_WAYPOINT) == 3
    assert c.ask(mavlink.MAV_CMD_DO_SET_MODE, 0, 6) == 2
    c.acks.clear()
    c.send(mavlink.MAVLink_command_long_message(7, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0))
    c.run(0.1)
    assert c.acks == []


def test_command_int_works_too() -> None:
    c = companion()
    c.ready()
    c.send(mavlink.MAVLink_command_int_message(1, 1, 0, ARM, 0, 0, 1.0, 0.0, 0.0, 0.0, 0, 0, 0.0))
    c.run(1.1)
    assert c.armed


def test_garbage_on_the_link_does_no_harm() -> None:
    c = companion()
    c.run(1.0)
    for i in range(50):
        c._pipe.write(bytes((j * 37 + i) % 256 for j in range(200)))
    c.run(2.0)
    assert c.px4.estimator.started


def test_a_failed_link_counts_as_silence() -> None:
    c = flying()
    c.px4._server._link.close()  # type: ignore[attr-defined]
    c.setpoint = None
    c.pose_on = False
    c.run(4.5)
    assert truth_mode(c) == "LAND"


def test_the_gimbal_obeys_its_owner_only_within_rate_and_range() -> None:
    c = companion()
    c.run(0.5)

    def aim(pitch_rad: float) -> None:
        c.send(mavlink.MAVLink_gimbal_manager_set_pitchyaw_message(1, 1, 0, 0, pitch_rad, math.nan, math.nan, math.nan))

    aim(-0.5)
    c.run(0.5)
    assert c.px4.truth().gimbal_pitch_down_rad == 0.0
    assert c.ask(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, 42, 191, -1, -1) == 0
    aim(-2.0)
    c.run(0.5)
    assert c.px4.truth().gimbal_pitch_down_rad == pytest.approx(math.radians(30.0), abs=0.03)
    c.run(1.0)
    assert c.px4.truth().gimbal_pitch_down_rad == pytest.approx(math.radians(60.0), abs=1e-6)
    w, _, y, _ = c.last["GIMBAL_DEVICE_ATTITUDE_STATUS"].q
    assert 2.0 * math.atan2(y, w) == pytest.approx(-math.radians(60.0), abs=1e-3)
    assert c.ask(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, 10.0, math.nan, math.nan, math.nan) == 0
    c.run(2.0)
    assert c.px4.truth().gimbal_pitch_down_rad == pytest.approx(-math.radians(10.0), abs=1e-6)
