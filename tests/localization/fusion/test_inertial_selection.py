"""The camera's IMU, or in its place the autopilot's gyro."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from faulty_pose_flight import fly
from test_propagation_bank import undisturbed

from uav_recon.channels import MemoryChannel
from uav_recon.clock import ManualClock
from uav_recon.localization.fusion.inertial_selection import InertialSelection
from uav_recon.types.camera import ImuSample
from uav_recon.types.pose import PoseHealth
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import TurnRates


class _Sources:
    """A camera at 200 Hz and an autopilot at 30 Hz whose rates arrive 20 ms late, polled at 100 Hz."""

    def __init__(self, autopilot: bool = True) -> None:
        self.clock = ManualClock(100.0)
        self.rates = MemoryChannel(TurnRates)
        self.camera_works = self.autopilot_works = True
        self.frozen = False
        self._camera: list[ImuSample] = []
        self._stamps: list[float] = []
        self.selection = InertialSelection(self._read, self.rates if autopilot else None)

    def _read(self) -> list[ImuSample]:
        out, self._camera = self._camera, []
        return out

    def run(self, seconds: float) -> list[ImuSample]:
        out = []
        for _ in range(round(100 * seconds)):
            self.clock.advance_to(self.clock.now_s() + 0.01)
            now_s = self.clock.now_s()
            if self.camera_works:
                for stamp_s in (now_s - 0.007, now_s - 0.002):
                    gyro = np.array([0.5, 0.0, 0.0 if self.frozen else math.sin(50 * stamp_s)])
                    self._camera.append(ImuSample(stamp_s, gyro, np.array([0.0, math.sin(stamp_s), 9.8])))
            if self.autopilot_works and round(now_s * 100) % 3 == 0:
                self._stamps = [*self._stamps[-31:], now_s - 0.02]
                self.rates.publish(TurnRates(np.array(self._stamps), np.tile([0.1, 0.2, 0.3], (len(self._stamps), 1))))
            out += self.selection.samples(self.clock.now_s)
        return out


def _from_camera(samples: list[ImuSample]) -> set[bool]:
    return {bool(sample.gyro_radps[0] == 0.5) for sample in samples}


def test_an_imu_that_works_is_used_alone() -> None:
    samples = _Sources().run(3.0)
    assert len(samples) == 600
    assert _from_camera(samples) == {True}


def test_without_imu_the_autopilots_gyro_takes_its_place_after_half_a_second() -> None:
    sources = _Sources()
    sources.camera_works = False
    assert sources.run(0.49) == []
    samples = sources.run(2.0)
    assert _from_camera(samples) == {False}
    stamps_s = [sample.stamp_s for sample in samples]
    assert (np.diff(stamps_s) > 0).all(), "each rate once"
    assert 60 <= len(samples) <= 67
    assert all(np.isnan(sample.specific_force_mps2).all() for sample in samples)
    sources.camera_works = True
    assert _from_camera(sources.run(1.0)[:1]) == {True}


def test_a_frozen_gyro_gives_way_within_a_fifth_of_a_second_and_comes_back() -> None:
    sources = _Sources()
    sources.run(1.0)
    sources.frozen = True
    sources.run(0.2)
    assert _from_camera(sources.run(1.0)) == {False}
    sources.frozen = False
    sources.run(1.5)
    assert _from_camera(sources.run(1.0)) == {True}


@pytest.mark.parametrize("silent", [False, True])
def test_without_an_autopilot_that_reports_the_camera_is_all_there_is(silent: bool) -> None:
    sources = _Sources(autopilot=silent)
    sources.autopilot_works = False
    sources.run(1.0)
    sources.frozen = True
    assert _from_camera(sources.run(1.0)) == {True}  # the filter finds that it is frozen, and says so


def test_a_table_of_another_shape_is_not_used() -> None:
    sources = _Sources()
    sources.autopilot_works = sources.camera_works = False
    sources.rates.publish(TurnRates(np.array([100.0, 100.1]), np.zeros((1, 3))))
    assert sources.run(1.0) == []


def test_the_filter_flies_by_a_gyro_of_30_hz_and_says_so() -> None:
    """Turn rates alone, every seventh sample: odometry stays as near as with poses alone at least, and the reason is named."""

    def gyro_only(sample: ImuSample, since_s: float) -> ImuSample:
        kept = round(sample.stamp_s * 200) % 7 == 0
        force = np.full(3, math.nan)
        return replace(sample, specific_force_mps2=force, gyro_radps=sample.gyro_radps if kept else np.full(3, math.nan))

    flown = fly(undisturbed, seconds=6.0, inertial=gyro_only)
    alone = fly(undisturbed, seconds=6.0, imu=False)
    assert {odom.health_reason.code if odom.health_reason else None for odom in flown.odom} == {ReasonCode.AUTOPILOT_GYRO}
    assert flown.healths(0.0) == {PoseHealth.DEGRADED}
    assert flown.error_m(0.0) < 0.06
    turns = [max(flight.turns_rad[flight.since(0.0) :]) for flight in (flown, alone)]
    assert turns[0] < turns[1]
