"""AUTOPILOTS.md: parameters, rates and commands of the simulated ArduCopter.

Its parameter file is tested too.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from ardupilot_rig import ARM, INTERVAL, SET_MODE, copter, flying, ready
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl.autopilots.ardupilot.parameters import DEFAULT_FILE, ArduPilotParameters
from sitl.autopilots.ardupilot.tuning import lean_lag_s
from sitl.autopilots.parameter_table import ParameterError


def test_only_heartbeats_are_sent_without_a_request() -> None:
    c = copter()
    for message_id in (1, 31, 32, 85, 193, 245):
        assert c.ask(INTERVAL, message_id, -1.0) == 0
    c.keep = set(c.last) | {"LOCAL_POSITION_NED", "EKF_STATUS_REPORT", "ATTITUDE_QUATERNION"}
    c.messages.clear()
    c.run(5.0)
    assert {m.get_type() for m in c.messages} <= {"HEARTBEAT", "TIMESYNC"}
    assert sum(m.get_type() == "HEARTBEAT" for m in c.messages) == 5


def test_message_rates_can_be_requested() -> None:
    c = copter()
    c.keep = {"EKF_STATUS_REPORT"}
    assert c.ask(INTERVAL, 193, 20_000.0) == 0
    c.messages.clear()
    c.run(1.0)
    assert len(c.messages) == pytest.approx(50, abs=6)
    assert c.ask(INTERVAL, 9999, 10_000.0) == 2


def test_the_camera_is_healthy_while_poses_come() -> None:
    c = ready()
    vision = mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION
    told = c.last["SYS_STATUS"]
    assert all(bits & vision for bits in (told.onboard_control_sensors_present, told.onboard_control_sensors_enabled))
    assert told.onboard_control_sensors_health & vision
    c.pose_on = False
    c.run(0.9)
    told = c.last["SYS_STATUS"]
    assert told.onboard_control_sensors_present & vision
    assert not told.onboard_control_sensors_health & vision


def test_prearm_stays_healthy_once_armed() -> None:
    c = flying(BATT_ARM_MAH=5000.0)  # on the ground, arming would be refused now
    c.run(1.0)
    assert c.prearm


def test_parameters_are_sent_as_plain_numbers() -> None:
    c = copter()
    c.keep = {"PARAM_VALUE"}
    c.send(mavlink.MAVLink_param_request_list_message(1, 1))
    c.run(2.0)
    assert {m.param_index for m in c.messages} == set(range(len(c.copter.parameters)))
    told = {m.param_id: m.param_value for m in c.messages}
    assert told["MAV_GCS_SYSID"] == 233.0
    assert told["GUID_TIMEOUT"] == 0.5
    c.send(mavlink.MAVLink_param_set_message(1, 1, b"FS_GCS_TIMEOUT", 4.0, mavlink.MAV_PARAM_TYPE_REAL32))
    c.run(0.1)
    assert c.copter.parameters["FS_GCS_TIMEOUT"] == 4.0


def test_a_changed_parameter_changes_the_flight() -> None:
    c = flying()
    c.send(mavlink.MAVLink_param_set_message(1, 1, b"WP_SPD", 0.4, mavlink.MAV_PARAM_TYPE_REAL32))
    c.stay(9.0, 0.0, -1.2)
    c.run(4.0)
    assert c.speed < 0.5


def test_the_version_is_sent_on_request() -> None:
    c = copter()
    assert c.ask(mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == 0
    version = c.last["AUTOPILOT_VERSION"].flight_sw_version
    assert (version >> 24, version >> 16 & 255, version >> 8 & 255) == (4, 8, 0)
    assert c.last["HEARTBEAT"].autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA


def test_unknown_commands_are_refused_and_commands_for_other_systems_ignored() -> None:
    c = copter()
    assert c.ask(mavlink.MAV_CMD_NAV_WAYPOINT) == 3
    assert c.ask(SET_MODE, 0, 4) == 2
    c.acks.clear()
    c.send(mavlink.MAVLink_command_long_message(7, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0))
    c.run(0.1)
    assert c.acks == []


def test_the_indoor_file_sets_no_failsafe_to_return() -> None:
    p = ArduPilotParameters.load()
    assert (p.integer("FS_THR_ENABLE"), p.integer("FS_GCS_ENABLE"), p.integer("FS_EKF_ACTION")) == (3, 5, 1)
    assert (p.integer("FENCE_ACTION"), p.integer("FS_DR_ENABLE")) == (2, 1)
    assert (p.integer("BATT_FS_LOW_ACT"), p.integer("BATT_FS_CRT_ACT")) == (1, 1)
    assert p["RTL_ALT_M"] == 0.0


def test_the_attitude_lag_follows_from_its_parameter() -> None:
    assert lean_lag_s(ArduPilotParameters()) == pytest.approx(0.18)
    assert lean_lag_s(ArduPilotParameters.load()) == pytest.approx(0.08)


def test_the_readme_explains_each_value_of_the_file() -> None:
    section = DEFAULT_FILE.with_name("README.md").read_text().split("## ArduCopter")[1]
    told = dict(re.findall(r"^\| ([A-Z0-9_]+) \| ([^ |]+) \|", section, re.MULTILINE))
    told.pop("parameter", None)
    rows = [line.split(",") for line in DEFAULT_FILE.read_text().splitlines() if line and not line.startswith("#")]
    assert told == dict(rows)


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("NO_SUCH_NAME,1", "unknown parameter NO_SUCH_NAME"),
        ("GUID_TIMEOUT 0.5", "comma"),
        ("GUID_TIMEOUT,nan", "finite"),
        ("FS_GCS_ENABLE,4.5", "invalid literal"),
    ],
)
def test_a_bad_line_names_file_line_and_fault(tmp_path: Path, line: str, fault: str) -> None:
    path = tmp_path / "some.param"
    path.write_text(f"#NOTE: header\n{line}\n", encoding="utf-8")
    with pytest.raises(ParameterError, match=re.escape(f"{path}:2: ")) as caught:
        ArduPilotParameters.load(path)
    assert fault in str(caught.value)
