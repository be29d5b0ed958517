"""Optical flow and ranges of the autopilot: on our clock, without repeated and foreign readings."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.autopilot.link.flow_measurements import STREAMS, FlowMeasurements
from uav_recon.autopilot.link.link_clock import LinkClock
from uav_recon.autopilot.mavlink.messages import DownwardRange, FlowAngle, FlowRate, TimesyncMessage
from uav_recon.types.flow import FlowReadings

BOOT_S = 37.0  # the autopilot's clock at our zero
NS = 1_000_000_000


@pytest.fixture
def flow() -> FlowMeasurements:
    clock = LinkClock(0.0)
    for k in range(20):
        sent_s = 0.01 * k
        clock.observe(TimesyncMessage(int((sent_s + 0.001 + BOOT_S) * NS), int(sent_s * NS)), sent_s + 0.002)
    clock.update(0.3)
    assert clock.known
    return FlowMeasurements(clock)


def angle(stamp_s: float, x: float = 0.01, sensor: int = 0, quality: int = 51) -> FlowAngle:
    return FlowAngle(sensor, int((stamp_s + BOOT_S) * 1e6), 0.04, (x, -0.02), (0.001, 0.002, 0.003), quality)


def rate(stamp_s: float, x: float, unit_s: float = 1e-3, sensor: int = 0) -> FlowRate:
    return FlowRate(sensor, round((stamp_s + BOOT_S) / unit_s), (x, -0.2), (0.1 * x, 0.05), 102)


def downward(stamp_s: float, range_m: float, sensor: int = 0) -> DownwardRange:
    return DownwardRange(sensor, range_m, round((stamp_s + BOOT_S) * 1e3))


def told(flow: FlowMeasurements) -> FlowReadings:
    readings = flow.readings()
    assert readings is not None
    return readings


def test_angles_and_ranges_come_on_our_clock(flow: FlowMeasurements) -> None:
    assert flow.readings() is None
    flow.update(angle(1.00), 1.03)
    flow.update(downward(1.01, 0.9), 1.03)
    flow.update(angle(1.05, 0.02), 1.08)
    readings = told(flow)
    np.testing.assert_allclose(readings.stamps_s, [1.00, 1.05], atol=1e-3)
    np.testing.assert_allclose(readings.intervals_s, 0.04)
    np.testing.assert_allclose(readings.flow_rad, [[0.01, -0.02], [0.02, -0.02]])
    np.testing.assert_allclose(readings.gyro_rad, [[0.001, 0.002, 0.003]] * 2)
    np.testing.assert_allclose(readings.quality, 0.2)
    np.testing.assert_allclose(readings.range_stamps_s, [1.01], atol=2e-3)
    np.testing.assert_allclose(readings.ranges_m, [0.9])
    assert flow.readings() is None, "nothing is new"


def test_repeated_old_and_future_readings_are_ignored(flow: FlowMeasurements) -> None:
    flow.update(angle(1.0), 1.03)
    for wrong in (angle(1.0, 0.5), angle(0.9, 0.5), angle(2.2, 0.5)):
        flow.update(wrong, 1.06)
    flow.update(angle(1.1), 2.5)
    flow.update(downward(1.0, 0.9), 1.03)
    flow.update(downward(1.0, 1.9), 1.05)
    readings = told(flow)
    np.testing.assert_allclose(readings.flow_rad, [[0.01, -0.02]])
    np.testing.assert_allclose(readings.ranges_m, [0.9])


def test_a_second_sensor_replaces_a_silent_one_only(flow: FlowMeasurements) -> None:
    flow.update(angle(1.0, 0.01, sensor=4), 1.0)
    flow.update(angle(1.1, 0.5, sensor=5), 1.1)
    flow.update(downward(1.0, 0.9, sensor=1), 1.0)
    flow.update(downward(1.1, 0.1, sensor=0), 1.1)
    flow.update(angle(1.2, 0.02, sensor=4), 1.2)
    flow.update(downward(1.2, 0.8, sensor=1), 1.2)
    readings = told(flow)
    np.testing.assert_allclose(readings.flow_rad[:, 0], [0.01, 0.02])
    np.testing.assert_allclose(readings.ranges_m, [0.9, 0.8])
    flow.update(angle(3.3, 0.03, sensor=5), 3.3)
    flow.update(downward(3.3, 0.7, sensor=0), 3.3)
    readings = told(flow)
    assert readings.flow_rad[-1, 0] == 0.03
    assert readings.ranges_m[-1] == 0.7


@pytest.mark.parametrize("unit_s", [1e-3, 1e-6], ids=["milliseconds", "microseconds"])
def test_rates_become_angles_over_the_time_since_the_last_ones(flow: FlowMeasurements, unit_s: float) -> None:
    """A message that was sent again holds no new reading: the next one is of the whole time."""
    for stamp_s, x in ((1.00, 0.1), (1.02, 0.2), (1.04, 0.2), (1.08, 0.3), (1.58, 0.4)):
        flow.update(rate(stamp_s, x, unit_s), stamp_s + 0.01)
    readings = told(flow)
    np.testing.assert_allclose(readings.stamps_s, [1.02, 1.08, 1.58], atol=2e-3)
    np.testing.assert_allclose(readings.intervals_s, [0.02, 0.06, 0.12], atol=1e-6)
    np.testing.assert_allclose(
        readings.flow_rad, np.array([[0.2, -0.2], [0.3, -0.2], [0.4, -0.2]]) * readings.intervals_s[:, None]
    )
    np.testing.assert_allclose(
        readings.gyro_rad[:, :2], np.array([[0.02, 0.05], [0.03, 0.05], [0.04, 0.05]]) * readings.intervals_s[:, None]
    )
    assert all(math.isnan(turn) for turn in readings.gyro_rad[:, 2])
    np.testing.assert_allclose(readings.quality, 0.4)


def test_without_a_clock_nothing_is_kept() -> None:
    flow = FlowMeasurements(LinkClock(0.0))
    flow.update(angle(1.0), 1.0)
    flow.update(rate(1.0, 0.1), 1.0)
    flow.update(downward(1.0, 0.9), 1.0)
    assert flow.readings() is None


def test_each_firmware_is_asked_for_its_own_message() -> None:
    assert [identifier for identifier, _ in STREAMS["px4"]] == [106, 132]
    assert [identifier for identifier, _ in STREAMS["ardupilot"]] == [100, 132]
