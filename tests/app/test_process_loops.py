"""Process loops: when perception ends, and when the pilot has reported its landing.

The clock is simulated.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.app import processes, systemd_notify
from uav_recon.channels import MemoryChannel
from uav_recon.clock import ManualClock
from uav_recon.sensors.realsense import RealSenseError
from uav_recon.types.pose import Pose
from uav_recon.types.vehicle import FlightPhase, VehicleState


def vehicle(now_s: float, phase: FlightPhase, armed: bool) -> VehicleState:
    pose = Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
    return VehicleState(now_s, pose, np.zeros(3), armed, "", phase, math.nan, False, math.nan, -1, 0, None)


class Turns:
    """Perception's step on a simulated clock, at 100 Hz.

    The flight lands after 20 s; its state is published at each step.
    """

    def __init__(self, lands_s: float = 20.0, dies_s: float = math.inf) -> None:
        self.clock = ManualClock()
        self.channel = MemoryChannel(VehicleState)
        self.asked = False
        self.gone_from_s = self.gone_to_s = self.asked_s = math.inf
        self._lands_s = lands_s
        self._dies_s = dies_s
        self.turns = 0
        self._tell()

    def step(self) -> None:
        self.clock.advance_to(self.clock.now_s() + 0.01)
        self.turns += 1
        self.asked = self.clock.now_s() >= self.asked_s
        if self.clock.now_s() < self._dies_s:
            self._tell()
        assert self.clock.now_s() < 60.0, "it does not end"
        if self.gone_from_s <= self.clock.now_s() < self.gone_to_s:
            raise RealSenseError(f"gone at {self.clock.now_s():.1f}")

    def _tell(self) -> None:
        flies = self.clock.now_s() < self._lands_s
        phase = FlightPhase.FLYING if flies else FlightPhase.LANDED
        self.channel.publish(vehicle(self.clock.now_s(), phase, armed=flies))

    def run(self) -> str:
        return processes.run_perception(self.step, self.channel, self.clock, lambda: self.asked)


def test_perception_asked_to_end_continues_until_the_pilot_has_landed(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A stop of the target stops pilot and perception at once.

    systemd, which allows 5 s, is notified at each step that perception takes longer.
    """
    flight, fed, prolonged = Turns(), [0], list[float]()
    flight.asked_s = 15.0
    monkeypatch.setattr(systemd_notify, "watchdog", lambda: fed.append(flight.turns))
    monkeypatch.setattr(systemd_notify, "extend", prolonged.append)
    assert flight.run() == ""
    assert flight.clock.now_s() == pytest.approx(20.0, abs=0.02)
    assert fed == list(range(flight.turns + 1))
    assert prolonged == [3.0] * len(prolonged)
    assert len(prolonged) == pytest.approx(500, abs=3), "from the moment on at which it was asked"
    assert [record.message for record in caplog.records] == [
        "asked to end: perception ends after the landing; the vehicle flies by its poses"
    ]


def test_perception_ends_at_once_on_the_ground(caplog: pytest.LogCaptureFixture) -> None:
    flight = Turns(lands_s=0.0)
    flight.asked_s = 5.0
    assert flight.run() == ""
    assert flight.clock.now_s() == pytest.approx(5.0, abs=0.02)
    assert not caplog.records


def test_perception_ends_a_second_after_a_pilot_that_died_in_the_air() -> None:
    flight = Turns(dies_s=16.0)
    flight.asked_s = 15.0
    assert flight.run() == ""
    assert flight.clock.now_s() == pytest.approx(17.0, abs=0.03)


def test_a_lost_camera_ends_perception_at_once_on_the_ground(caplog: pytest.LogCaptureFixture) -> None:
    flight = Turns(lands_s=0.0)
    flight.gone_from_s = 5.0
    assert flight.run() == "gone at 5.0"
    assert flight.clock.now_s() == pytest.approx(5.0, abs=0.02)
    assert not caplog.records, "told once: as the reason of its end"


def test_a_lost_camera_in_flight_costs_no_pose_and_ends_perception_after_the_landing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    flight = Turns()
    flight.gone_from_s = 5.0
    assert flight.run() == "gone at 5.0"
    assert flight.clock.now_s() == pytest.approx(20.0, abs=0.02)
    assert flight.turns == pytest.approx(2000, abs=2)
    assert [record.message for record in caplog.records] == [
        "gone at 5.0: perception ends after the landing; the vehicle flies by its poses"
    ]


def test_a_camera_that_recovers_in_flight_does_not_end_perception() -> None:
    flight = Turns()
    flight.gone_from_s, flight.gone_to_s, flight.asked_s = 5.0, 8.0, 30.0
    assert flight.run() == ""
    assert flight.clock.now_s() == pytest.approx(30.0, abs=0.02)


def test_a_phase_counts_as_reported_only_once_it_is_published() -> None:
    """The landing can fall between two publications.

    If the mission read only LANDING, it would write no report.
    """
    channel = MemoryChannel(VehicleState)
    assert not processes.phase_published(FlightPhase.LANDED, channel)
    channel.publish(vehicle(1.0, FlightPhase.LANDING, armed=True))
    assert not processes.phase_published(FlightPhase.LANDED, channel)
    channel.publish(vehicle(1.03, FlightPhase.LANDED, armed=False))
    assert processes.phase_published(FlightPhase.LANDED, channel)
