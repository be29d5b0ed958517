"""Builders of the messages common to both autopilots, from the estimate, not from the truth."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.autopilot_state import AutopilotState
from sitl.autopilots.mavlink_codec import Built, Packet, packet
from sitl.autopilots.position_controller import ControlSetpoint
from sitl.geometry.quaternion import euler_of
from sitl.world.flow_sensor import RANGE_M as RANGE_DOWN_M
from sitl.world.flow_sensor import RangeMeasurement
from sitl.world.range_finder import RANGE_M, SimulatedUpwardRangeFinder

SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_AHRS
)


class BaseMessages(ABC):
    """Builders of messages; each returns a message, or None if its data are not available yet.

    DISTANCE_SENSOR has one message for each range finder.
    """

    def __init__(self, board: AutopilotState) -> None:
        self._board = board

    @abstractmethod
    def rates(self) -> dict[int, tuple[Callable[[], Built], float]]:
        """Return (builder, default rate in Hz) by message id; rate 0 is sent on request only."""

    def timesync(self) -> Packet:
        """Return a TIMESYNC request, whose answer gives the offset of the companion's clock."""
        return packet(mavlink.MAVLink_timesync_message, 0, self._board.boot_us * 1000)

    def position_target(self) -> Packet | None:
        """Return POSITION_TARGET_LOCAL_NED, the setpoint of the controller; None while disarmed."""
        return self._followed(self._board.flight.active) if self._board.commander.armed else None

    def battery_status(self) -> Packet:
        """Return BATTERY_STATUS with four cells."""
        b = self._board.battery
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
        """Return ATTITUDE: Euler angles of FRD in NED, and angular rates."""
        e = self._board.estimator
        roll, pitch, yaw = euler_of(e.quat_wxyz)
        return packet(mavlink.MAVLink_attitude_message, self._board.boot_ms, roll, pitch, yaw, *e.angular_rate)

    def attitude_quaternion(self) -> Packet:
        """Return ATTITUDE_QUATERNION: ned_from_frd, and angular rates."""
        e = self._board.estimator
        return packet(mavlink.MAVLink_attitude_quaternion_message, self._board.boot_ms, *e.quat_wxyz, *e.angular_rate)

    def local_position(self) -> Packet | None:
        """Return LOCAL_POSITION_NED; None before the first pose is fused."""
        e = self._board.estimator
        if not e.started:
            return None
        return packet(mavlink.MAVLink_local_position_ned_message, self._board.boot_ms, *e.position, *e.velocity)

    def home_position(self) -> Packet | None:
        """Return HOME_POSITION; None without an origin or a home."""
        b = self._board
        if b.origin is None or b.home is None:
            return None
        lat, lon, alt = b.origin
        return packet(
            mavlink.MAVLink_home_position_message, lat, lon, alt, *b.home, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, b.boot_us
        )

    def global_origin(self) -> Packet | None:
        """Return GPS_GLOBAL_ORIGIN; None without an origin."""
        if self._board.origin is None:
            return None
        return packet(mavlink.MAVLink_gps_global_origin_message, *self._board.origin, self._board.boot_us)

    def gimbal_attitude(self) -> Packet:
        """Return GIMBAL_DEVICE_ATTITUDE_STATUS: pitch relative to the body.

        The autopilot drives the gimbal itself, so the device id is 1 and the component is the autopilot's.
        """
        g = self._board.gimbal
        half = 0.5 * g.pitch
        return packet(
            mavlink.MAVLink_gimbal_device_attitude_status_message,
            0, 0, self._board.boot_ms, mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME,
            [math.cos(half), 0.0, math.sin(half), 0.0], 0.0, g.pitch_rate, 0.0, 0, 0.0, 0.0, 1,
        )  # fmt: skip

    def _distance_up(self, sensor: SimulatedUpwardRangeFinder, boot_ms: int) -> Packet:
        """Return DISTANCE_SENSOR of a sensor that looks up, without field of view and quality."""
        low_m, high_m = RANGE_M
        kind, up = mavlink.MAV_DISTANCE_SENSOR_LASER, mavlink.MAV_SENSOR_ROTATION_PITCH_90
        cm = (round(100.0 * low_m), round(100.0 * high_m), round(100.0 * sensor.range_m))
        return packet(mavlink.MAVLink_distance_sensor_message, boot_ms, *cm, kind, 0, up, 0)

    def _distance_down(self, measured: RangeMeasurement, boot_ms: int, signal_quality: int) -> Packet:
        """Return DISTANCE_SENSOR of the sensor that looks down.

        Its id follows that of one that looks up.
        """
        kind, down = mavlink.MAV_DISTANCE_SENSOR_LASER, mavlink.MAV_SENSOR_ROTATION_PITCH_270
        cm = (*(round(100.0 * limit_m) for limit_m in RANGE_DOWN_M), round(100.0 * measured.range_m))
        number = 0 if self._board.range_finder is None else 1
        unknown = [0.0, 0.0, 0.0, 0.0]
        return packet(
            mavlink.MAVLink_distance_sensor_message, boot_ms, *cm, kind, number, down, 0, 0.0, 0.0, unknown, signal_quality
        )

    def _heartbeat(self, autopilot: int, flags: int) -> Packet:
        """Return HEARTBEAT of a quadrotor. flags: base mode flags of this firmware's mode."""
        c = self._board.commander
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED | flags
        base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED if c.armed else 0
        status = mavlink.MAV_STATE_ACTIVE if c.armed else mavlink.MAV_STATE_STANDBY
        return packet(mavlink.MAVLink_heartbeat_message, mavlink.MAV_TYPE_QUADROTOR, autopilot, base, int(c.mode), status, 3)

    def _health(self, ready: bool, more: int = 0, healthy: int = 0) -> Packet:
        """Return SYS_STATUS: sensors, battery and the PREARM bit.

        more: additional sensors of this firmware. healthy: those of them that are healthy.
        """
        battery, prearm = self._board.battery, mavlink.MAV_SYS_STATUS_PREARM_CHECK if ready else 0
        return packet(
            mavlink.MAVLink_sys_status_message,
            SENSORS | more,
            SENSORS | more,
            SENSORS | prearm | healthy,
            300,
            round(battery.voltage * 1000),
            round(battery.current_a * 100),
            round(battery.fraction * 100),
        )

    def _landed_state(self, landed: bool, half: int | None) -> Packet:
        """Return EXTENDED_SYS_STATE. half: MAV_LANDED_STATE during a take-off or landing, else None."""
        state = mavlink.MAV_LANDED_STATE_ON_GROUND if landed else half or mavlink.MAV_LANDED_STATE_IN_AIR
        return packet(mavlink.MAVLink_extended_sys_state_message, 0, state)

    def _followed(self, t: ControlSetpoint) -> Packet:
        """Return POSITION_TARGET_LOCAL_NED: the setpoint of the controller."""
        fields = (*t.position, *t.velocity, *t.acceleration)
        mask = sum(1 << i for i, value in enumerate(fields) if not math.isfinite(value))
        frame = mavlink.MAV_FRAME_LOCAL_NED
        boot_ms = self._board.boot_ms
        return packet(mavlink.MAVLink_position_target_local_ned_message, boot_ms, frame, mask, *fields, t.yaw, t.yaw_rate)
