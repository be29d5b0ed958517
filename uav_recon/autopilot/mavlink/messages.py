"""Messages of the autopilot in our frames and units, as decoded by the codec."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from uav_recon.types.frames import FloatArray

_NO_AUTOPILOT = (0, 8)  # MAV_AUTOPILOT_GENERIC, _INVALID
#: reject: heartbeats of these MAV_TYPEs as the autopilot's: ground stations, companions, cameras and other parts
_NO_VEHICLE = (5, 6, 18, 26, 27, 30, 31, 32, 33, 34, 36, 37, 38, 39, 40, 41, 42, 44, 48)
_COMPANION = (18, 8)  # MAV_TYPE_ONBOARD_CONTROLLER, MAV_AUTOPILOT_INVALID: what our own heartbeat says


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """HEARTBEAT.

    vehicle: MAV_TYPE. autopilot: MAV_AUTOPILOT (8 = not an autopilot). custom_mode: the firmware's own number.
    """

    vehicle: int
    autopilot: int
    armed: bool
    custom_mode: int

    @property
    def from_autopilot(self) -> bool:
        """True if a vehicle's autopilot sends it, and not a ground station or another program."""
        return self.autopilot not in _NO_AUTOPILOT and self.vehicle not in _NO_VEHICLE

    @property
    def from_companion(self) -> bool:
        """True if a companion computer sends it; a second copy of this program sends the same."""
        return (self.vehicle, self.autopilot) == _COMPANION


@dataclass(frozen=True, slots=True)
class Ack:
    """Answer to a command, 0 = accepted. It proves nothing; only the vehicle's state does."""

    command: int
    result: int


@dataclass(frozen=True, slots=True)
class TimesyncMessage:
    """TIMESYNC.

    tc1_ns = 0: a request with the sender's clock in ts1_ns; otherwise the answer to our ts1_ns.
    """

    tc1_ns: int
    ts1_ns: int


@dataclass(frozen=True, slots=True)
class EstimatorStatus:
    """Status of the estimator.

    position_good: horizontal position relative to its origin is good.
    """

    position_good: bool


@dataclass(frozen=True, slots=True)
class LandedState:
    """State of the autopilot's land detector."""

    on_ground: bool


@dataclass(frozen=True, slots=True)
class SystemStatus:
    """System status.

    prearm_good: the autopilot's own checks pass. battery_fraction: NaN if unknown.
    """

    prearm_good: bool
    battery_fraction: float


@dataclass(frozen=True, slots=True, eq=False)
class LocalPosition:
    """The autopilot's estimate: position (3,) m and velocity (3,) m/s, ENU about its origin.

    boot_ms: milliseconds since its boot, a number of 32 bits.
    """

    boot_ms: int
    position_m: FloatArray
    velocity_mps: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Attitude:
    """The autopilot's estimate of world_from_body (ENU from FLU), Hamilton wxyz (4,).

    boot_ms: milliseconds since its boot, a number of 32 bits; -1 if unknown. rate_radps: turn rate (3,), body FLU; None if
    unknown.
    """

    quat_wxyz: FloatArray
    boot_ms: int = -1
    rate_radps: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class OdometryMessage:
    """ODOMETRY: a pose of the body (FLU) in a frame of the sender with z up.

    boot_us: microseconds since the autopilot's boot. position_m (3,), quat_wxyz (4,), velocity_mps (3,) in that frame, zero if
    unknown. variance (6,): position m², rotation vector rad²; None if unknown. quality: 0 (lost) to 100.
    """

    boot_us: int
    position_m: FloatArray
    quat_wxyz: FloatArray
    velocity_mps: FloatArray
    variance: FloatArray | None
    quality: int
    reset_counter: int


@dataclass(frozen=True, slots=True)
class OriginSet:
    """The autopilot has a geographic origin (GPS_GLOBAL_ORIGIN) or a home (HOME_POSITION)."""


@dataclass(frozen=True, slots=True)
class Firmware:
    """Version of the firmware as (major, minor, patch).

    uid: of the hardware, in hex; '' if it reports none.
    """

    version: tuple[int, int, int]
    uid: str = ""


@dataclass(frozen=True, slots=True)
class StatusText:
    """Text of the autopilot for people, without control characters.

    severity: 0 emergency to 7 debug.
    """

    severity: int
    text: str


@dataclass(frozen=True, slots=True)
class GimbalAttitude:
    """Measured camera pitch, positive down.

    boot_ms: milliseconds since the sender's boot, a number of 32 bits; -1 if unknown.
    """

    pitch_down_rad: float
    boot_ms: int = -1


@dataclass(frozen=True, slots=True)
class UpwardRange:
    """DISTANCE_SENSOR of a sensor that looks up along the body's z axis, with a valid reading.

    sensor: number of the sensor. fov_rad: whole angle of its cone, the smaller one of two; infinity if unknown. boot_ms:
    milliseconds since the autopilot's boot, a number of 32 bits; of the measurement (PX4) or of the message (ArduPilot).
    """

    sensor: int
    range_m: float
    fov_rad: float
    boot_ms: int


@dataclass(frozen=True, slots=True)
class DownwardRange:
    """DISTANCE_SENSOR of a sensor that looks down along the body's z axis, with a valid reading.

    sensor: number of the sensor. boot_ms: as of UpwardRange.
    """

    sensor: int
    range_m: float
    boot_ms: int


@dataclass(frozen=True, slots=True)
class FlowAngle:
    """OPTICAL_FLOW_RAD (PX4): angles over one interval, body FLU.

    They are positive as a turn of the sensor about the axis.
    sensor: number of the sensor. boot_us: microseconds since the autopilot's boot, at the end of the interval. flow_rad: about
    x and y, turn and motion together. gyro_rad: of its gyro about x, y and z; NaN if unknown. quality: 0 (none) to 255.
    """

    sensor: int
    boot_us: int
    interval_s: float
    flow_rad: tuple[float, float]
    gyro_rad: tuple[float, float, float]
    quality: int


@dataclass(frozen=True, slots=True)
class FlowRate:
    """OPTICAL_FLOW (ArduPilot): mean rates of the sensor's newest interval.

    The length of the interval is not sent.
    boot: instant of sending since the autopilot's boot, in milliseconds (ArduPilot) or microseconds (as MAVLink says).
    rate_radps, gyro_radps: about x and y, body FLU, signs as of FlowAngle. quality: 0 (none) to 255.
    """

    sensor: int
    boot: int
    rate_radps: tuple[float, float]
    gyro_radps: tuple[float, float]
    quality: int


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """One of the firmware's parameters.

    number: the float of the wire, which holds the value in the firmware's own encoding (see parameters/reader.py). kind:
    MAV_PARAM_TYPE.
    """

    name: str
    number: float
    kind: int


Message = (
    Heartbeat
    | Ack
    | TimesyncMessage
    | EstimatorStatus
    | LandedState
    | SystemStatus
    | LocalPosition
    | Attitude
    | OdometryMessage
    | OriginSet
    | Firmware
    | StatusText
    | GimbalAttitude
    | UpwardRange
    | DownwardRange
    | FlowAngle
    | FlowRate
    | ParameterValue
)


class Received(NamedTuple):
    """One checked MAVLink 2 frame. message is None if it holds nothing that is used."""

    system: int
    component: int
    message: Message | None
    frame: bytes
