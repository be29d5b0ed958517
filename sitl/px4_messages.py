"""What the simulated PX4 tells: one builder per message, from the estimator's view, never from the truth."""

from __future__ import annotations

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from sitl.mavlink_wire import Packet, packet
from sitl.px4_modes import Mode
from sitl.px4_state import State
from sitl.rotation import conjugate, euler_of, rotate

_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_AHRS
)
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_VERSION_1_17_0 = 1 << 24 | 17 << 16 | 0 << 8 | 255  # major, minor, patch, official release
_UID = 0x5349544C50583401
_HALF_LIFTED = (Mode.TAKEOFF, Mode.LAND)
_NAN21 = [math.nan] * 21


class Messages:
    """Builders over the state of the autopilot; each returns a message, or None when there is nothing to tell."""

    def __init__(self, state: State) -> None:
        self._s = state

    def rates(self) -> dict[int, tuple[Callable[[], Packet | None], float]]:
        """Message id to (builder, default rate in Hz); rate 0 is sent on request only."""
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
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: (self.version, 0.0),
        }

    def heartbeat(self) -> Packet:
        """1 Hz; custom_mode is the only proof of a mode."""
        c = self._s.commander
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        base |= (
            mavlink.MAV_MODE_FLAG_GUIDED_ENABLED | mavlink.MAV_MODE_FLAG_AUTO_ENABLED if c.mode >> 16 & 0xFF in (4, 6) else 0
        )
        base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED if c.armed else 0
        status = mavlink.MAV_STATE_ACTIVE if c.armed else mavlink.MAV_STATE_STANDBY
        return packet(
            mavlink.MAVLink_heartbeat_message,
            mavlink.MAV_TYPE_QUADROTOR,
            mavlink.MAV_AUTOPILOT_PX4,
            base,
            int(c.mode),
            status,
            3,
        )

    def timesync(self) -> Packet:
        """Our question; the answer teaches us the companion's clock."""
        return packet(mavlink.MAVLink_timesync_message, 0, self._s.boot_us * 1000)

    def sys_status(self) -> Packet:
        """Sensors, battery and the PREARM bit."""
        s = self._s
        ready = s.commander.armed or not s.commander.arming_refusal(s.condition())
        prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        health = _SENSORS | (prearm if ready else 0)
        volts = round(s.battery.voltage * 1000)
        amps = round(s.battery.current_a * 100)
        both = _SENSORS | prearm
        return packet(
            mavlink.MAVLink_sys_status_message,
            both,
            both,
            health,
            300,
            volts,
            amps,
            round(s.battery.fraction * 100),
            0,
            0,
            0,
            0,
            0,
            0,
        )

    def battery_status(self) -> Packet:
        """Four cells."""
        b = self._s.battery
        cells = [round(b.voltage * 250)] * 4 + [65535] * 6
        return packet(
            mavlink.MAVLink_battery_status_message,
            0,
            0,
            0,
            32767,
            cells,
            round(b.current_a * 100),
            round(b.used_mah),
            -1,
            round(b.fraction * 100),
        )

    def attitude(self) -> Packet:
        """Euler angles, FRD in NED."""
        e = self._s.estimator
        roll, pitch, yaw = euler_of(e.quat_wxyz)
        return packet(mavlink.MAVLink_attitude_message, self._s.boot_ms, roll, pitch, yaw, *e.angular_rate)

    def attitude_quaternion(self) -> Packet:
        """Attitude ned_from_frd."""
        e = self._s.estimator
        return packet(mavlink.MAVLink_attitude_quaternion_message, self._s.boot_ms, *e.quat_wxyz, *e.angular_rate)

    def local_position(self) -> Packet | None:
        """Nothing before the first pose was fused."""
        e = self._s.estimator
        if not e.started:
            return None
        return packet(mavlink.MAVLink_local_position_ned_message, self._s.boot_ms, *e.position, *e.velocity)

    def odometry(self) -> Packet | None:
        """The estimate in one message: local NED, velocity in the body."""
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

    def position_target(self) -> Packet | None:
        """What the controller follows now."""
        t = self._s.flight.active
        if not self._s.commander.armed:
            return None
        fields = (*t.position, *t.velocity, *t.acceleration)
        mask = sum(1 << i for i, value in enumerate(fields) if not math.isfinite(value))
        return packet(
            mavlink.MAVLink_position_target_local_ned_message,
            self._s.boot_ms,
            mavlink.MAV_FRAME_LOCAL_NED,
            mask,
            *fields,
            t.yaw,
            t.yaw_rate,
        )

    def estimator_status(self) -> Packet:
        """Flags and innovation test ratios."""
        e = self._s.estimator
        return packet(
            mavlink.MAVLink_estimator_status_message,
            self._s.boot_us, e.flags, 0.0, math.sqrt(e.position_test_ratio), math.sqrt(e.height_test_ratio), 0.0, 0.0, 0.0,
            e.position_accuracy_m, e.position_accuracy_m,
        )  # fmt: skip

    def extended_sys_state(self) -> Packet:
        """Landed state."""
        s = self._s
        state = mavlink.MAV_LANDED_STATE_ON_GROUND if s.flight.landed else mavlink.MAV_LANDED_STATE_IN_AIR
        if not s.flight.landed and s.commander.mode in _HALF_LIFTED:
            landing = s.commander.mode is Mode.LAND
            state = mavlink.MAV_LANDED_STATE_LANDING if landing else mavlink.MAV_LANDED_STATE_TAKEOFF
        return packet(mavlink.MAVLink_extended_sys_state_message, 0, state)

    def home_position(self) -> Packet | None:
        """Home, once there is an origin and a position."""
        s = self._s
        if s.origin is None or s.home is None:
            return None
        lat, lon, alt = s.origin
        return packet(
            mavlink.MAVLink_home_position_message, lat, lon, alt, *s.home, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, s.boot_us
        )

    def global_origin(self) -> Packet | None:
        """The origin as it was accepted."""
        if self._s.origin is None:
            return None
        return packet(mavlink.MAVLink_gps_global_origin_message, *self._s.origin, self._s.boot_us)

    def gimbal_attitude(self) -> Packet:
        """Pitch relative to the body; PX4 drives the gimbal itself, so the device id is 1 and the component its own."""
        g = self._s.gimbal
        half = 0.5 * g.pitch
        return packet(
            mavlink.MAVLink_gimbal_device_attitude_status_message,
            0, 0, self._s.boot_ms, mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME,
            [math.cos(half), 0.0, math.sin(half), 0.0], 0.0, g.pitch_rate, 0.0, 0, 0.0, 0.0, 1,
        )  # fmt: skip

    def version(self) -> Packet:
        """PX4 1.17.0."""
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
