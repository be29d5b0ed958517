"""Optical flow and downward ranges of the autopilot on our clock."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from uav_recon.autopilot.link.link_clock import LinkClock
from uav_recon.autopilot.mavlink.messages import DownwardRange, FlowAngle, FlowRate
from uav_recon.types.flow import FlowReadings

_DISTANCE_SENSOR = (132, 20.0)
# OPTICAL_FLOW_RAD, OPTICAL_FLOW: at twice the sensor's rate, as the firmware sends the newest reading when it is due
STREAMS = {"px4": ((106, 40.0), _DISTANCE_SENSOR), "ardupilot": ((100, 40.0), _DISTANCE_SENSOR)}
_READINGS = 32  #: internal: readings that are published together: one to two seconds
#: reject: a second flow sensor or range finder, unless the first one was silent for this time
_SILENT_S = 2.0
_OLD_S = 1.0  #: reject: optical flow whose stamp is farther from now
#: reject: a reading whose stamp is not later than the last one by this: the same one, as the clocks are compared again
_SAME_S = 0.0015
#: internal: ArduPilot does not send the interval of a reading. It is the time since the one before, at most this
_LONGEST_INTERVAL_S = 0.12


_Flow = tuple[float, float, tuple[float, float], tuple[float, float, float], float]  # stamp, interval, flow, gyro, quality


class FlowMeasurements:
    """Keeps the newest readings of one flow sensor and one range finder.

    A reading without a stamp on our clock, a repeated one, and one of another sensor are not kept.
    """

    def __init__(self, clock: LinkClock) -> None:
        self._clock = clock
        self._flows: deque[_Flow] = deque(maxlen=_READINGS)
        self._ranges: deque[tuple[float, float]] = deque(maxlen=_READINGS)
        self._flow_sensor = _OneSensor()
        self._range_finder = _OneSensor()
        self._rate: FlowRate | None = None  # the newest message of rates, which is sent again until the sensor has a new one
        self._rate_s = -math.inf
        self._is_new = False

    def update(self, message: FlowAngle | FlowRate | DownwardRange, now_s: float) -> None:
        """Process a message of the autopilot."""
        match message:
            case FlowAngle():
                stamp_s = self._clock.stamp_of_us_s(message.boot_us, now_s)
                if stamp_s is not None and self._flow_sensor.admits(message.sensor, now_s):
                    self._keep(stamp_s, message.interval_s, message.flow_rad, message.gyro_rad, message.quality, now_s)
            case FlowRate():
                stamp_s = self._sent_s(message.boot, now_s)
                if stamp_s is not None and self._flow_sensor.admits(message.sensor, now_s):
                    self._keep_rate(message, stamp_s, now_s)
            case DownwardRange():
                stamp_s = self._clock.measured_s(message.boot_ms, now_s)
                if stamp_s is not None and self._range_finder.admits(message.sensor, now_s):
                    self._keep_range(stamp_s, message.range_m)

    def readings(self) -> FlowReadings | None:
        """Return the newest readings on our clock, None if nothing is new.

        Each value also holds those before it, because its reader may miss one.
        """
        if not self._is_new:
            return None
        self._is_new = False
        stamps_s, intervals_s, flows_rad, gyros_rad, quality = zip(*self._flows, strict=True) if self._flows else ((),) * 5
        range_stamps_s, ranges_m = zip(*self._ranges, strict=True) if self._ranges else ((),) * 2
        return FlowReadings(
            stamps_s=np.array(stamps_s),
            intervals_s=np.array(intervals_s),
            flow_rad=np.array(flows_rad).reshape(-1, 2),
            gyro_rad=np.array(gyros_rad).reshape(-1, 3),
            quality=np.array(quality),
            range_stamps_s=np.array(range_stamps_s),
            ranges_m=np.array(ranges_m),
        )

    def _sent_s(self, boot: int, now_s: float) -> float | None:
        """Return when a message was sent, None if it is not known.

        ArduPilot stamps it in milliseconds, MAVLink asks for microseconds.
        """
        for stamp_s in (self._clock.stamp_s(boot, now_s), self._clock.stamp_of_us_s(boot, now_s)):
            if stamp_s is not None and abs(now_s - stamp_s) <= _OLD_S:
                return stamp_s
        return None

    def _keep_rate(self, message: FlowRate, stamp_s: float, now_s: float) -> None:
        """Keep rates as angles over the time since the rates before.

        The same rates of flow and gyro are an old reading that was sent again.
        """
        before, before_s = self._rate, self._rate_s
        values = (message.rate_radps, message.gyro_radps, message.quality)
        if stamp_s <= before_s + _SAME_S or (
            before is not None and values == (before.rate_radps, before.gyro_radps, before.quality)
        ):
            return
        self._rate, self._rate_s = message, stamp_s
        if before is None:
            return
        interval_s = min(stamp_s - before_s, _LONGEST_INTERVAL_S)
        (x, y), (gyro_x, gyro_y) = message.rate_radps, message.gyro_radps
        gyro_rad = (gyro_x * interval_s, gyro_y * interval_s, math.nan)
        self._keep(stamp_s, interval_s, (x * interval_s, y * interval_s), gyro_rad, message.quality, now_s)

    def _keep(
        self,
        stamp_s: float,
        interval_s: float,
        flow_rad: tuple[float, float],
        gyro_rad: tuple[float, float, float],
        quality: int,
        now_s: float,
    ) -> None:
        """Keep a reading that is newer than the last one."""
        if abs(now_s - stamp_s) <= _OLD_S and (not self._flows or stamp_s > self._flows[-1][0] + _SAME_S):
            self._flows.append((min(stamp_s, now_s), interval_s, flow_rad, gyro_rad, quality / 255.0))
            self._is_new = True

    def _keep_range(self, stamp_s: float, range_m: float) -> None:
        """Keep a range that is newer than the last one."""
        if not self._ranges or stamp_s > self._ranges[-1][0] + _SAME_S:
            self._ranges.append((stamp_s, range_m))
            self._is_new = True


class _OneSensor:
    """The first sensor that was received; another one replaces it once it is silent."""

    def __init__(self) -> None:
        self._sensor = -1
        self._heard_s = -math.inf

    def admits(self, sensor: int, now_s: float) -> bool:
        """Return True for a message of the sensor that is used."""
        if sensor != self._sensor and now_s - self._heard_s <= _SILENT_S:
            return False
        self._sensor, self._heard_s = sensor, now_s
        return True
