"""Optical flow module beside a real firmware: its readings become MAVLink messages to it."""

from __future__ import annotations

from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.base_autopilot import VehicleTruth
from sitl.autopilots.mavlink_codec import Packet, packet
from sitl.world.flow_sensor import RANGE_FOV_RAD, RANGE_M, FlowMeasurement, RangeMeasurement, SimulatedFlowModule

_BEYOND_CM = 1  # a distance outside the limits: the firmwares take one at a limit for valid
_UNKNOWN_SIGNAL, _INVALID_SIGNAL = 0, 1  # signal_quality
_NO_ATTITUDE = (0.0, 0.0, 0.0, 0.0)


class FlowFeed:
    """Steps the module along the true trajectory; each reading becomes one message."""

    def __init__(self, module: SimulatedFlowModule, optical_flow: Callable[[FlowMeasurement], Packet]) -> None:
        """optical_flow: returns a reading as the message that this firmware takes."""
        self._module = module
        self._optical_flow = optical_flow
        self._flow: FlowMeasurement | None = None
        self._distance: RangeMeasurement | None = None

    def step(self, truth: VehicleTruth) -> list[Packet]:
        """Advance the module to this state; return the messages of its new readings."""
        module, messages = self._module, []
        module.step(truth.stamp_s, truth.position, truth.quat_wxyz)
        if module.distance is not None and module.distance is not self._distance:
            self._distance = module.distance
            messages.append(distance_below(module.distance))
        if module.flow is not None and module.flow is not self._flow:
            self._flow = module.flow
            messages.append(self._optical_flow(module.flow))
        return messages


def distance_below(measured: RangeMeasurement) -> Packet:
    """Return DISTANCE_SENSOR with orientation down.

    time_boot_ms is 0: both firmwares take the time of arrival. A distance that is not valid lies outside the limits.
    """
    low_cm, high_cm = (round(100.0 * limit_m) for limit_m in RANGE_M)
    cm, signal = round(100.0 * measured.range_m), _UNKNOWN_SIGNAL
    if not measured.valid:
        signal = _INVALID_SIGNAL
        cm = low_cm - _BEYOND_CM if 2 * cm < low_cm + high_cm else high_cm + _BEYOND_CM
    kind, down = mavlink.MAV_DISTANCE_SENSOR_LASER, mavlink.MAV_SENSOR_ROTATION_PITCH_270
    return packet(
        mavlink.MAVLink_distance_sensor_message, 0, low_cm, high_cm, cm, kind, 0, down, 0, RANGE_FOV_RAD, RANGE_FOV_RAD,
        _NO_ATTITUDE, signal,
    )  # fmt: skip
