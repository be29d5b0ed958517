"""Who may not speak and does: told once for each kind and flight, whatever else comes."""

from __future__ import annotations

from typing import Any

import pytest
from flight_copy import flight_copy
from flight_rig import ARM, MODE, Rig
from pymavlink.dialects.v20 import common as mavlink
from test_pilot_flight_ardupilot import CopterRig

from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase

PX4_MODES = {"ours": 6 << 16, "pilot's": 3 << 16, "landing": 6 << 24 | 4 << 16}
pytestmark = pytest.mark.slow
COPTER_MODES = {"ours": 4, "pilot's": 5, "landing": 9}
ORDER = mavlink.MAVLink_command_long_message(233, 191, 400, 0, 0.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PLACE = mavlink.MAVLink_local_position_ned_message(7, 90.0, -80.0, 5.0, 3.0, 3.0, 3.0)


class Crowd:
    """Slips frames of others behind what the autopilot says."""

    def __init__(self, rig: Rig) -> None:
        self.voices: dict[tuple[int, int], Any] = {}
        self._waiting = b""
        self._inner = rig.tap.read
        rig.tap.read = self._read  # type: ignore[method-assign]

    def _read(self) -> bytes:
        data = self._inner() + self._waiting
        self._waiting = b""
        return data

    def say(self, message: Any, system: int, component: int, old: bool = False) -> None:
        voice = self.voices.setdefault((system, component), mavlink.MAVLink(None, system, component))
        self._waiting += bytes(message.pack(voice, force_mavlink1=old))
        voice.seq = (voice.seq + 1) % 256


@pytest.fixture(params=["px4", "ardupilot"])
def flying(request: pytest.FixtureRequest, both_flown_up: dict[str, Rig]) -> tuple[Rig, Crowd]:
    rig = flight_copy(both_flown_up[request.param])
    return rig, Crowd(rig)


def texts(rig: Rig, since_s: float) -> list[str]:
    return [m.text for at, m in rig.tap.sent if m.get_type() == "STATUSTEXT" and at >= since_s]


def heartbeat(rig: Rig, mode: str, armed: bool = True) -> Any:
    modes, family = (COPTER_MODES, 3) if isinstance(rig, CopterRig) else (PX4_MODES, 12)
    return mavlink.MAVLink_heartbeat_message(2, family, 0x80 if armed else 0, modes[mode], 4, 3)


def speak_twice(rig: Rig, crowd: Crowd, mode: str, seconds: float, armed: bool = True) -> None:
    """For some time another autopilot speaks with the vehicle's name."""
    for turn in range(round(seconds * 100)):
        boot_ms = 900_000 + 10 * turn
        crowd.say(mavlink.MAVLink_local_position_ned_message(boot_ms, 3.0, -2.0, -1.5, 0.3, 0.0, 0.0), 1, 1)
        if turn % 10 == 0:
            crowd.say(heartbeat(rig, mode, armed), 1, 1)
        rig.step()


@pytest.mark.parametrize(
    ("who", "message", "old", "says"),
    [
        ((42, 1), ORDER, False, Reason(ReasonCode.INTRUDER_COMMANDS, (42, 1))),
        ((1, 77), PLACE, False, Reason(ReasonCode.INTRUDER_STATE, (1, 77))),
        ((42, 1), mavlink.MAVLink_heartbeat_message(2, 12, 0, 3, 3, 3), False, Reason(ReasonCode.INTRUDER_STATE, (42, 1))),
        ((233, 191), mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), False, Reason(ReasonCode.INTRUDER_OWN_ID)),
        ((1, 1), PLACE, True, Reason(ReasonCode.INTRUDER_MAVLINK1)),
    ],
)
def test_people_are_told_once_of_who_may_not_speak(
    flying: tuple[Rig, Crowd], who: tuple[int, int], message: Any, old: bool, says: Reason
) -> None:
    (rig, crowd), begin_s = flying, flying[0].clock.now_s()
    for _ in range(300):
        for _ in range(5):
            crowd.say(message, *who, old=old)
        rig.step()
    told = [(at, m.text) for at, m in rig.tap.sent if m.get_type() == "STATUSTEXT" and at >= begin_s]
    assert [text for _, text in told] == [says.short()]
    assert told[0][0] - begin_s <= 1.0
    assert rig.state.note == says
    assert rig.pilot.phase is FlightPhase.FLYING


@pytest.mark.parametrize(
    ("who", "message"),
    [
        ((255, 190), mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)),
        ((255, 190), mavlink.MAVLink_command_long_message(1, 1, 400, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        ((1, 100), mavlink.MAVLink_statustext_message(4, b"camera hot")),
        ((51, 68), mavlink.MAVLink_radio_status_message(100, 100, 50, 10, 10, 0, 0)),
    ],
)
def test_a_ground_station_a_camera_and_a_radio_are_no_intruders(
    flying: tuple[Rig, Crowd], who: tuple[int, int], message: Any
) -> None:
    (rig, crowd), begin_s = flying, flying[0].clock.now_s()
    for _ in range(50):
        crowd.say(message, *who)
        rig.step()
    assert texts(rig, begin_s) == []


def test_a_thousand_intruders_are_told_of_in_two_lines(flying: tuple[Rig, Crowd]) -> None:
    (rig, crowd), begin_s = flying, flying[0].clock.now_s()
    for n in range(1000):
        crowd.say(PLACE, 2 + n % 240, 1 + n // 240)
        crowd.say(ORDER, 2 + n % 240, 1 + n // 240)
        rig.step()
    assert len(texts(rig, begin_s)) == 2


def test_an_intruder_on_the_ground_is_told_of_when_the_flight_begins() -> None:
    rig = Rig()
    crowd = Crowd(rig)
    rig.until(FlightPhase.READY, 20.0)
    crowd.say(ORDER, 42, 1)
    rig.run(0.5)
    assert texts(rig, 0.0) == []
    rig.intent = (Goal.FLY, None)
    rig.until(FlightPhase.ARMING, 1.0)
    crowd.say(ORDER, 42, 1)
    rig.run(0.5)
    assert texts(rig, 0.0) == [Reason(ReasonCode.INTRUDER_COMMANDS, (42, 1)).short()]


@pytest.mark.parametrize("armed", [True, False], ids=["armed", "disarmed"])
def test_a_second_autopilot_is_told_of_and_held_for_and_the_flight_goes_on(flying: tuple[Rig, Crowd], armed: bool) -> None:
    rig, crowd = flying
    duration_s = rig.fly((2.0, 0.0, 1.1), identifier=2).duration_s
    rig.run(duration_s / 2)
    begin_s = rig.clock.now_s()
    speak_twice(rig, crowd, "ours", 4.0, armed)
    assert [codes for _, codes in rig.reported(begin_s)] == [(ReasonCode.TWO_AUTOPILOTS,)]
    assert rig.pilot.phase is FlightPhase.FLYING
    assert sum(x * x for x in rig.autopilot.truth().velocity) < 0.1**2
    rig.run(2.5)
    rig.fly((3.0, 0.0, 1.1), identifier=3)
    rig.run(1.5)
    assert rig.state.trajectory_id == 3
    assert rig.autopilot.truth().velocity[0] > 0.1
    assert rig.autopilot.failsafes == []


def test_a_second_autopilot_that_goes_on_ends_the_flight_as_whatever_keeps_it_from_flying(flying: tuple[Rig, Crowd]) -> None:
    rig, crowd = flying
    speak_twice(rig, crowd, "ours", 15.0)
    held = rig.pilot.phase
    speak_twice(rig, crowd, "ours", 7.0)
    assert (held, rig.pilot.phase in (FlightPhase.LANDING, FlightPhase.YIELDED)) == (FlightPhase.FLYING, True)
    rig.run(25.0)
    assert not rig.autopilot.truth().armed


@pytest.mark.parametrize("seconds", [0.0, 4.0], ids=["once", "for four seconds"])
def test_a_forged_pilots_mode_leaves_no_vehicle_unattended(flying: tuple[Rig, Crowd], seconds: float) -> None:
    """It is yielded at once, for it may be a pilot; and then the firmware lands what nobody flies."""
    rig, crowd = flying
    begin_s = rig.clock.now_s()
    crowd.say(heartbeat(rig, "pilot's"), 1, 1)
    crowd.voices[1, 1].seq = 100
    for _ in range(300):
        if rig.pilot.phase is FlightPhase.YIELDED:
            break
        speak_twice(rig, crowd, "pilot's", 0.1)
    assert rig.pilot.phase is FlightPhase.YIELDED
    quiet_s = rig.clock.now_s()
    speak_twice(rig, crowd, "pilot's", seconds)
    rig.run(25.0)
    assert not rig.autopilot.truth().armed
    assert not any(rig.tap.since(quiet_s + 0.02)[f"COMMAND_LONG {order}"] for order in (MODE, ARM))
    note = rig.state.note
    assert note is not None
    assert note.details[-1] == Reason(ReasonCode.FAILSAFE_LANDS)
    assert note.short() in texts(rig, begin_s)


@pytest.mark.parametrize("mode", ["landing", pytest.param("ours", marks=pytest.mark.nightly), "pilot's"])
@pytest.mark.parametrize("armed", [True, pytest.param(False, marks=pytest.mark.nightly)], ids=["armed", "disarmed"])
def test_nobody_is_talked_out_of_a_landing(flying: tuple[Rig, Crowd], mode: str, armed: bool) -> None:
    rig, crowd = flying
    speak_twice(rig, crowd, mode, 0.5, armed)
    rig.pilot.operator.request_land()
    speak_twice(rig, crowd, mode, 12.0, armed)
    rig.run(20.0)
    assert not rig.autopilot.truth().armed
    assert rig.height_m < 0.1


def test_a_pilot_wins_among_two_autopilots(flying: tuple[Rig, Crowd]) -> None:
    rig, crowd = flying
    speak_twice(rig, crowd, "ours", 2.0)
    rig.autopilot.pilot_takes_over("LOITER")
    speak_twice(rig, crowd, "ours", 0.3)
    assert rig.pilot.phase is FlightPhase.YIELDED
    taken_s = rig.clock.now_s()
    speak_twice(rig, crowd, "ours", 8.0)
    assert rig.autopilot.truth().mode == "LOITER"
    assert not any(rig.tap.since(taken_s)[f"COMMAND_LONG {order}"] for order in (MODE, ARM))


def test_nothing_is_armed_while_two_autopilots_speak() -> None:
    rig = Rig()
    crowd = Crowd(rig)
    rig.until(FlightPhase.READY, 20.0)
    rig.intent = (Goal.FLY, None)
    rig.run(0.2)
    speak_twice(rig, crowd, "ours", 10.0, armed=False)
    assert rig.state.note == Reason(ReasonCode.TWO_AUTOPILOTS)
    assert rig.pilot.phase is FlightPhase.CONNECTING
    assert not rig.autopilot.truth().armed
