"""Messages of the simulated PX4: one builder each, from the estimate, not from the truth."""

from __future__ import annotations

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.base_messages import BaseMessages
from sitl.autopilots.mavlink_codec import Built, Packet, packet
from sitl.autopilots.px4.commander import Px4Mode
from sitl.autopilots.px4.state import Px4State
from sitl.geometry.quaternion import conjugate, rotate

_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_VERSION_1_17_0 = 1 << 24 | 17 << 16 | 0 << 8 | 255  # major, minor, patch, official release
_UID = 0x5349544C50583401
_HALF_LIFTED = {Px4Mode.TAKEOFF: mavlink.MAV_LANDED_STATE_TAKEOFF, Px4Mode.LAND: mavlink.MAV_LANDED_STATE_LANDING}
_NAN21 = [math.nan] * 21
_INVALID_SIGNAL = 1  # signal_quality of DISTANCE_SENSOR


class Px4Messages(BaseMessages):
    """Builders of the messages of PX4, and their default rates."""

    def __init__(self, state: Px4State) -> None:
        super().__init__(state)
        self._s = state
        self._range_sent_s = -math.inf
        self._down_sent_s = -math.inf
        self._flow_sent_s = -math.inf

    def rates(self) -> dict[int, tuple[Callable[[], Built], float]]:
        """Return (builder, default rate in Hz) by message id; rate 0 is sent on request only."""
        return {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: (self.heartbeat, 1.0),
            mavlink.MAVLINK_MSG_ID_TIMESYNC: (self.timesync, 10.0),
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: (self.sys_status, 5.0),
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: (self.battery_status, 0.5),
            mavlink.MAVLINK_MSG_ID_ATTITUDE: (self.attitude, 50.0),
            mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: (self.attitude_quaternion, 50.0),
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: (self.local_position, 30.0),
            mavlink.MAVLINK_MSG_ID_ODOMETRY: (self.odometry, 30.0),
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: (self.position_target, 10.0),
            mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: (self.estimator_status, 5.0),
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: (self.extended_sys_state, 5.0),
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: (self.home_position, 0.5),
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: (self.global_origin, 1.0),
            mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: (self.gimbal_attitude, 30.0),
            mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: (self.distance_sensors, 10.0),
            mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD: (self.optical_flow_rad, 10.0),
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: (self.version, 0.0),
        }

    def heartbeat(self) -> Packet:
        """Return HEARTBEAT; only its custom_mode identifies the mode."""
        steered = mavlink.MAV_MODE_FLAG_GUIDED_ENABLED | mavlink.MAV_MODE_FLAG_AUTO_ENABLED
        return self._heartbeat(mavlink.MAV_AUTOPILOT_PX4, steered if self._s.commander.mode >> 16 & 0xFF in (4, 6) else 0)

    def sys_status(self) -> Packet:
        """Return SYS_STATUS: sensors, battery and the PREARM bit."""
        c = self._s.commander
        return self._health(c.armed or not c.arming_refusal(self._s.condition()))

    def odometry(self) -> Packet | None:
        """Return ODOMETRY: position in local NED, velocity in the body frame; None without a pose."""
        s, e = self._s, self._s.estimator
        if not e.started:
            return None
        body_velocity = rotate(conjugate(e.quat_wxyz), e.velocity)
        covariance = [math.nan, *_NAN21[1:]]
        return packet(
            mavlink.MAVLink_odometry_message,
            s.boot_us, mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD, *e.position, e.quat_wxyz, *body_velocity,
            *e.angular_rate, covariance, covariance, e.reset_count & 255, mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT, 100,
        )  # fmt: skip

    def estimator_status(self) -> Packet:
        """Return ESTIMATOR_STATUS: flags and innovation test ratios."""
        e = self._s.estimator
        return packet(
            mavlink.MAVLink_estimator_status_message,
            self._s.boot_us, e.flags, math.sqrt(e.flow_test_ratio), math.sqrt(e.position_test_ratio),
            math.sqrt(e.height_test_ratio), 0.0, 0.0, 0.0, e.position_accuracy_m, e.position_accuracy_m,
        )  # fmt: skip

    def extended_sys_state(self) -> Packet:
        """Return EXTENDED_SYS_STATE: the landed state."""
        return self._landed_state(self._s.flight.landed, _HALF_LIFTED.get(self._s.commander.mode))

    def distance_sensors(self) -> list[Packet]:
        """Return DISTANCE_SENSOR of each sensor with the time of its measurement, once for each.

        From the sources (DISTANCE_SENSOR.hpp, PX4Rangefinder.cpp): signal_quality is 1 (invalid) out of range.
        """
        messages = []
        sensor, module = self._s.range_finder, self._s.flow_module
        if sensor is not None and sensor.measured_s > self._range_sent_s:
            self._range_sent_s = sensor.measured_s
            messages.append(self._distance_up(sensor, self._boot_ms(sensor.measured_s)))
        if module is not None and module.distance is not None and module.distance.read_s > self._down_sent_s:
            self._down_sent_s = module.distance.read_s
            quality = 0 if module.distance.valid else _INVALID_SIGNAL
            messages.append(self._distance_down(module.distance, self._boot_ms(module.distance.read_s), quality))
        return messages

    def optical_flow_rad(self) -> Packet | None:
        """Return OPTICAL_FLOW_RAD, once for each measurement; None without one.

        From the sources (OPTICAL_FLOW_RAD.hpp, VehicleOpticalFlow.cpp): the time is that of the driver's reading, without the
        sensor's delay; distance is that of a valid range, else -1; temperature and the age of the distance are always 0.
        """
        module = self._s.flow_module
        if module is None or module.flow is None or not module.flow.read_s > self._flow_sent_s:
            return None
        flow, near = module.flow, module.distance
        self._flow_sent_s = flow.read_s
        return packet(
            mavlink.MAVLink_optical_flow_rad_message,
            round((flow.read_s - self._s.boot_s) * 1e6), 0, round(flow.interval_s * 1e6), *flow.flow_rad, *flow.gyro_rad,
            0, flow.quality, 0, near.range_m if near is not None and near.valid else -1.0,
        )  # fmt: skip

    def _boot_ms(self, world_s: float) -> int:
        return round((world_s - self._s.boot_s) * 1e3) & 0xFFFFFFFF

    def version(self) -> Packet:
        """Return AUTOPILOT_VERSION of PX4 1.17.0."""
        none = [0] * 8
        return packet(
            mavlink.MAVLink_autopilot_version_message,
            _CAPABILITIES,
            _VERSION_1_17_0,
            0,
            0,
            0,
            none,
            none,
            none,
            0x26AC,
            0x0010,
            _UID,
        )
