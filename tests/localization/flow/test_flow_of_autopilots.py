"""From the readings of a sensor to motion, as each autopilot stamps, repeats and rounds them."""

from __future__ import annotations

import numpy as np
import pytest
from flow_flights import Flight

from uav_recon.autopilot.link.flow_measurements import FlowMeasurements
from uav_recon.autopilot.link.link_clock import LinkClock
from uav_recon.autopilot.mavlink.messages import DownwardRange, FlowAngle, FlowRate, TimesyncMessage
from uav_recon.localization.flow.flow_odometry import FlowOdometry
from uav_recon.localization.flow.flow_samples import FlowGeometry

BOOT_S = 37.0  # the autopilot's clock at our zero
NS = 1_000_000_000
SENT_S = 0.025  # between two messages


def link_flow() -> FlowMeasurements:
    clock = LinkClock(0.0)
    for k in range(20):
        sent_s = 0.01 * k
        clock.observe(TimesyncMessage(int((sent_s + 0.001 + BOOT_S) * NS), int(sent_s * NS)), sent_s + 0.002)
    clock.update(0.3)
    return FlowMeasurements(clock)


@pytest.mark.parametrize(
    ("autopilot", "rate_hz"), [("px4", 20.0), ("ardupilot", 10.0), ("ardupilot", 50.0)], ids=["px4", "pixart", "fast module"]
)
def test_the_readings_of_an_autopilot_give_the_motion(autopilot: str, rate_hz: float) -> None:
    """PX4 stamps each reading when it arrives; ArduPilot sends the newest one every 25 ms, with the time of sending in ms.

    The sensor is read 30 ms late; scale 3 %, noise 5 cm/s.
    """
    flight = Flight(duration_s=30.0, rate_hz=rate_hz, scale=1.03, noise_mps=0.05, range_noise_m=0.02, gyro_bias_radps=0.002)
    sensor, link, found = flight.readings(), link_flow(), FlowOdometry(FlowGeometry(np.zeros(3), np.zeros(3)), flight.turned)
    read, error = 0, []
    for k in range(40, round(flight.duration_s / SENT_S) - 10):
        now_s = k * SENT_S
        before = read
        read = int(np.searchsorted(sensor.stamps_s, now_s - 0.03))
        for j in range(before, read) if autopilot == "px4" else ():
            boot_us = int((sensor.stamps_s[j] + 0.03 + BOOT_S) * 1e6)
            x, y = sensor.flow_rad[j].tolist()
            link.update(FlowAngle(0, boot_us, 1.0 / rate_hz, (x, y), (0.0, 0.0, 0.0), 180), now_s)
        if autopilot == "ardupilot":
            (x, y), (turn_x, turn_y, _) = sensor.flow_rad[read - 1] * rate_hz, sensor.gyro_rad[read - 1] * rate_hz
            link.update(FlowRate(0, int((now_s + BOOT_S) * 1e3), (x, y), (turn_x, turn_y), 180), now_s + 0.004)
        if read:
            boot_ms = int((sensor.range_stamps_s[read - 1] + BOOT_S) * 1e3)
            link.update(DownwardRange(0, float(sensor.ranges_m[read - 1]), boot_ms), now_s + 0.004)
        if (readings := link.readings()) is not None:
            found.add(readings)
        if k % 4 == 0:
            found.add_reference(now_s, flight.pose(now_s), 0.003)
        if k % 15 == 0 and now_s > 15.0:
            from_s, to_s = now_s - 1.15, now_s - 0.15
            motion = found.moved(from_s, to_s, flight.pose(from_s))
            assert motion is not None
            off = motion.displacement_odom_m - (flight.pose(to_s).translation_m - flight.pose(from_s).translation_m)
            error.append(off)
    assert np.sqrt(np.mean(np.sum(np.array(error)[:, :2] ** 2, axis=1))) < 0.035
    assert found.errors.scale == pytest.approx(1.03, abs=0.03)
    assert 0.02 < found.errors.delay_s < 0.07
