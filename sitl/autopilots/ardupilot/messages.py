"""Messages of the simulated ArduCopter: HEARTBEAT and TIMESYNC, all others on request only."""

from __future__ import annotations

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl.autopilots.ardupilot.modes import ArduPilotMode
from sitl.autopilots.ardupilot.state import ArduPilotState
from sitl.autopilots.base_messages import BaseMessages
from sitl.autopilots.mavlink_codec import Built, Packet, packet

_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_VERSION_4_8_0_DEV = 4 << 24 | 8 << 16
_UID = 0x5349544C41500801
# EKF_STATUS_REPORT; the last two measured
_UNINITIALISED = 0x400
_CONSTANT = 0xA5
_BLIND = 0x25
_FOLLOWING = 0x33F
_ABSOLUTE = mavlink.EKF_POS_HORIZ_ABS | mavlink.EKF_PRED_POS_HORIZ_ABS  # lost when poses stop, while flow holds the rest
_TERRAIN = mavlink.EKF_POS_VERT_AGL
# from the sources
_FLOW_HEALTHY_S = 0.5  # AP_OpticalFlow::update
_RANGE_DATA_S = 0.2  # AP_RangeFinder_VL53L1X::update
_VISION_HEALTHY_S = 0.3  # maximum age of the last pose


class ArduPilotMessages(BaseMessages):
    """Builders of the messages of ArduCopter, and their default rates."""

    def __init__(self, state: ArduPilotState) -> None:
        super().__init__(state)
        self._s = state

    def rates(self) -> dict[int, tuple[Callable[[], Built], float]]:
        """Return (builder, default rate in Hz) by message id; rate 0 is sent on request only."""
        return {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: (self.heartbeat, 1.0),
            mavlink.MAVLINK_MSG_ID_TIMESYNC: (self.timesync, 0.1),
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: (self.sys_status, 0.0),
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: (self.battery_status, 0.0),
            mavlink.MAVLINK_MSG_ID_ATTITUDE: (self.attitude, 0.0),
            mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: (self.attitude_quaternion, 0.0),
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: (self.local_position, 0.0),
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: (self.position_target, 0.0),
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: (self.ekf_status, 0.0),
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: (self.extended_sys_state, 0.0),
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: (self.home_position, 0.0),
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: (self.global_origin, 0.0),
            mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: (self.gimbal_attitude, 0.0),
            mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: (self.distance_sensors, 0.0),
            mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW: (self.optical_flow, 0.0),
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: (self.version, 0.0),
        }

    def heartbeat(self) -> Packet:
        """Return HEARTBEAT; only its custom_mode identifies the mode."""
        guided = self._s.commander.mode in (ArduPilotMode.GUIDED, ArduPilotMode.LAND)
        flags = mavlink.MAV_MODE_FLAG_GUIDED_ENABLED if guided else 0
        return self._heartbeat(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, flags)

    def sys_status(self) -> Packet:
        """Return SYS_STATUS: sensors, battery and the PREARM bit.

        The vision sensor is healthy while poses arrive (from the sources).
        """
        c, s = self._s.commander, self._s
        vision = mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION
        heard = vision if s.estimator.pose_age_s <= _VISION_HEALTHY_S else 0
        more = vision | mavlink.MAV_SYS_STATUS_PREARM_CHECK  # present here; in PX4 only healthy or not (measured)
        return self._health(c.armed or not c.arming_refusal(s.condition()), more, heard)

    def ekf_status(self) -> Packet:
        """Return EKF_STATUS_REPORT: flags, and innovations relative to their gates.

        Above 1, poses are rejected.
        """
        s, e = self._s, self._s.estimator
        if not s.ekf_active:
            flags = _UNINITIALISED
        elif not e.started:
            flags = _CONSTANT
        else:
            flags = _FOLLOWING if e.horizontal_valid else _BLIND
            if e.horizontal_valid and e.poses_timed_out:
                flags &= ~_ABSOLUTE
            if math.isfinite(e.height_above_ground_m):
                flags |= _TERRAIN
        horizontal, vertical = math.sqrt(e.position_test_ratio), math.sqrt(e.height_test_ratio)
        return packet(mavlink.MAVLink_ekf_status_report_message, flags, 0.0, horizontal, vertical, 0.0, 0.0)

    def extended_sys_state(self) -> Packet:
        """Return EXTENDED_SYS_STATE: the landed state."""
        flight, half = self._s.flight, None
        if flight.taking_off:
            half = mavlink.MAV_LANDED_STATE_TAKEOFF
        elif self._s.commander.mode is ArduPilotMode.LAND:
            half = mavlink.MAV_LANDED_STATE_LANDING
        return self._landed_state(flight.landed, half)

    def distance_sensors(self) -> list[Packet]:
        """Return DISTANCE_SENSOR of each sensor: newest measurement, time of sending.

        From the sources (GCS_Common.cpp): a sensor without a valid reading for a while sends none.
        """
        s, module = self._s, self._s.flow_module
        sensor, messages = s.range_finder, []
        if sensor is not None and sensor.measured_s >= 0.0:
            messages.append(self._distance_up(sensor, s.boot_ms))
        near = None if module is None else module.valid_distance
        if s.estimator.flow_tuning.range_read and near is not None and s.now_s - near.read_s <= _RANGE_DATA_S:
            messages.append(self._distance_down(near, s.boot_ms, 0))
        return messages

    def optical_flow(self) -> Packet | None:
        """Return OPTICAL_FLOW: newest measurement; None without a sensor that is read and healthy.

        From the sources (GCS_MAVLINK::send_opticalflow): time_usec is the time of sending in MILLISECONDS; flow_x, flow_y and
        flow_rate are the flow in rad/s; flow_comp_m is the flow minus the turn of the body, in rad/s and not in m/s;
        ground_distance is the estimated height above ground, 0 if not known.
        """
        s, module = self._s, self._s.flow_module
        flow = None if module is None else module.flow
        if flow is None or not s.estimator.flow_tuning.read or s.now_s - flow.read_s > _FLOW_HEALTHY_S:
            return None
        x, y = (angle / flow.interval_s for angle in flow.flow_rad)
        still_x, still_y = x - flow.gyro_rad[0] / flow.interval_s, y - flow.gyro_rad[1] / flow.interval_s
        height_m = s.estimator.height_above_ground_m
        ground_m = height_m if math.isfinite(height_m) else 0.0
        return packet(
            mavlink.MAVLink_optical_flow_message,
            s.boot_ms, 0, int(x), int(y), still_x, still_y, flow.quality, ground_m, x, y,
        )  # fmt: skip

    def version(self) -> Packet:
        """Return AUTOPILOT_VERSION of ArduCopter 4.8.0-dev."""
        none = [0] * 8
        return packet(
            mavlink.MAVLink_autopilot_version_message, _CAPABILITIES, _VERSION_4_8_0_DEV, 0, 0, 0, none, none, none, 0, 0, _UID
        )
