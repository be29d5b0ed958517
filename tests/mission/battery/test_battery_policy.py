"""HAZARDS E5 in the mission: it turns back at need, lands where nothing is left to fly with, and says both with figures."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conductor_fixture import Desk, vehicle_state

from uav_recon.mission.battery.battery_policy import BatteryPolicy
from uav_recon.mission.battery.battery_reserve import LOW_SHARE
from uav_recon.mission.detection.detectors import LowBatteryDetector, Response
from uav_recon.mission.events import Event
from uav_recon.mission.state_machine import Phase
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.recording.flight_log import read_timeline
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import FlightPhase, VehicleState

HOME_M = np.array([0.0, 0.0, 1.1])


@pytest.fixture()
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.journal.close()


RETURNS = (ReasonCode.BATTERY_RETURN, ReasonCode.BATTERY_RATE_UNKNOWN)


def turned_back_at(far_m: float, max_speed_mps: float = math.inf, per_s: float = 0.002) -> tuple[float, Reason]:
    """The true share that is left when a vehicle that waits far away wants home, and why; from 90 %, at a rate a second."""
    track = FlightTrack(0.0)
    policy = BatteryPolicy(track, HOME_M, 0.4)
    for k in range(100_000):
        place = np.array([min(0.1 * k, far_m), 0.0, 1.1])
        gauge = round(0.9 - per_s * 0.1 * k, 2)
        vehicle = VehicleState(0.1 * k, Pose.from_yaw(0.0, place), np.zeros(3), True, "OFFBOARD", FlightPhase.FLYING,
                               gauge, False, math.nan, 1, 0, None, max_speed_mps)  # fmt: skip
        track.follow(vehicle)
        policy.update(0.1 * k, vehicle, None)
        if policy.must_return:
            return 0.9 - per_s * 0.1 * k, policy.return_reason()
    raise AssertionError("never wants home")


def test_the_farther_away_the_earlier_it_turns_back_and_says_with_what() -> None:
    near, why_near = turned_back_at(2.0)
    far, why_far = turned_back_at(21.0)
    assert near + 0.05 < far
    assert why_near == Reason(ReasonCode.BATTERY_RETURN, (25.0, 2.0, 4.0))
    assert why_far == Reason(ReasonCode.BATTERY_RETURN, (33.0, 21.0, 10.0))


def grounded_policy(battery_fraction: float) -> BatteryPolicy:
    """Return a policy that read this share once: it has no consumption to estimate from and returns below LOW_SHARE."""
    policy = BatteryPolicy(FlightTrack(0.0), HOME_M, 0.4)
    vehicle = VehicleState(0.0, Pose.identity(), np.zeros(3), True, "OFFBOARD", FlightPhase.FLYING, battery_fraction, False,
                           math.nan, 1, 0, None)  # fmt: skip
    policy.update(0.0, vehicle, None)
    return policy


@pytest.mark.parametrize(("battery_fraction", "returns"), [(0.29, True), (LOW_SHARE, False), (0.31, False), (math.nan, False)])
def test_the_battery_demands_the_return_below_the_required_charge(battery_fraction: float, returns: bool) -> None:
    policy = grounded_policy(battery_fraction)
    assert policy.required_charge == LOW_SHARE
    assert policy.must_return is returns


@pytest.mark.parametrize("battery_fraction", [0.25, 0.9, math.nan])
def test_event_and_detector_ask_the_policy(desk: Desk, monkeypatch: pytest.MonkeyPatch, battery_fraction: float) -> None:
    policy, observer = grounded_policy(battery_fraction), desk.conductor._observer
    vehicle = dataclasses.replace(vehicle_state(0.0), phase=FlightPhase.FLYING)
    for must_return in (False, True):
        monkeypatch.setattr(BatteryPolicy, "must_return", must_return)
        responses = [event.response for event in LowBatteryDetector(policy).detect(0.0, vehicle)]
        assert (Response.NOTE_IN_HOLD in responses) is must_return
        assert (Event.BATTERY_LOW in observer.events(0.0, vehicle)) is must_return


def test_while_nothing_fast_is_let_pass_it_turns_back_earlier() -> None:
    assert turned_back_at(12.0, max_speed_mps=0.3)[0] > turned_back_at(12.0)[0] + 0.05


def test_a_moment_in_which_nothing_fast_is_let_pass_calls_nobody_home() -> None:
    track = FlightTrack(0.0)
    policy, needed = BatteryPolicy(track, HOME_M, 0.4), list[float]()
    for k in range(1_000):
        max_speed_mps = 0.3 if 900 <= k < 920 else math.inf
        vehicle = VehicleState(0.1 * k, Pose.from_yaw(0.0, np.array([min(0.1 * k, 12.0), 0.0, 1.1])), np.zeros(3), True,
                               "OFFBOARD", FlightPhase.FLYING, 0.8, False, math.nan, 1, 0, None, max_speed_mps)  # fmt: skip
        track.follow(vehicle)
        policy.update(0.1 * k, vehicle, None)
        needed.append(policy.required_charge)
    assert max(needed[900:]) <= needed[899]


def test_what_is_left_when_it_turns_back_is_what_it_takes_and_a_third() -> None:
    for far_m, per_s in ((5.0, 0.001), (30.0, 0.001), (30.0, 0.004)):
        left, _ = turned_back_at(far_m, per_s=per_s)
        seconds = 6.0 + 1.1 * far_m + 9.0  # as such ways were flown
        assert left - 0.20 >= 1.3 * seconds * per_s


def test_a_battery_that_fell_at_once_is_not_reckoned_with(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.battery = 0.29
    desk.run(3.5, until=Phase.RETURN)
    desk.run(120.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) is None
    desk.journal.close()
    ended = read_timeline(desk.folder).outcomes[-1]
    assert ended.stop_codes[0] in RETURNS
    assert " 29 %" in ended.stop_reason


def test_no_flight_is_begun_with_less_than_a_flight_needs(desk: Desk) -> None:
    desk.battery = 0.35
    desk.run(5.0)
    assert desk.conductor.phase is Phase.READY, "nothing is said before somebody wants to fly"
    desk.conductor.requests.start()
    desk.run(1.0, until=Phase.DONE)
    assert desk.seen == [Phase.READY, Phase.DONE]
    assert desk.conductor.close(desk.clock.now_s()) == Reason(ReasonCode.BATTERY_TAKEOFF, (35.0, 36.0))


@pytest.mark.parametrize("battery", [0.36, math.nan])
def test_with_as_much_or_with_a_gauge_that_never_spoke_it_flies(desk: Desk, battery: float) -> None:
    desk.battery = battery
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)


def test_at_a_fifth_it_lands_where_it_is_though_it_is_held(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.conductor.requests.hold()
    desk.battery = 0.21
    desk.run(5.0)
    assert desk.conductor.phase is Phase.HOLD, "a held vehicle is its operator's"
    note = desk.progress.note
    assert note is not None
    assert note.code in RETURNS, "but he is told"
    assert note.values[0] == 21.0
    desk.battery = 0.20
    desk.run(2.5)
    assert desk.conductor.phase is Phase.HOLD
    desk.run(1.0, until=Phase.LANDING)
    desk.run(1.0, until=Phase.DONE)
    assert desk.conductor.close(desk.clock.now_s()) == Reason(ReasonCode.BATTERY_LAND, (20.0,))


def test_on_the_way_home_too(desk: Desk) -> None:
    desk.conductor.requests.start()
    desk.run(30.0, until=Phase.SURVEY)
    desk.run(8.0)
    desk.conductor.requests.return_home()
    desk.battery = 0.19
    desk.run(0.5, until=Phase.RETURN)
    desk.phase = FlightPhase.FLYING
    desk.run(3.5, until=Phase.LANDING)
