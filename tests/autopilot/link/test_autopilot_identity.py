"""Another autopilot on the same link: known by its uid, never commanded."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from flight_copy import flight_copy
from flight_rig import ARM, MODE, SETPOINT, Rig
from pymavlink.dialects.v20 import common as mavlink

from uav_recon.autopilot.link.autopilot_identity import AutopilotIdentity
from uav_recon.autopilot.mavlink.allow_list import AllowList, AllowListFilter
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase

PX4_UID, OTHER = "5349544c50583401", 0x1234ABCD
ORDERS = (SETPOINT, "ODOMETRY", f"COMMAND_LONG {MODE}", f"COMMAND_LONG {ARM}")
VERSION = 148


def exchange(rig: Rig, uid: Callable[[], int]) -> None:
    """From now on AUTOPILOT_VERSION says another uid, where one is given (0: its own)."""
    read, parser = rig.tap.read, mavlink.MAVLink(None)

    def changed() -> bytes:
        out = b""
        for message in parser.parse_buffer(read()) or []:
            frame = bytes(message.get_msgbuf())
            if message.get_msgId() == VERSION and uid():
                voice = mavlink.MAVLink(None, 1, 1)
                voice.seq, message.uid = frame[4], uid()
                frame = bytes(message.pack(voice))
            out += frame
        return out

    rig.tap.read = changed  # type: ignore[method-assign]


def asked(rig: Rig, since_s: float) -> int:
    return sum(at >= since_s and requested(m) == VERSION for at, m in rig.tap.sent)


def requested(message: object) -> int:
    return int(message.param1) if getattr(message, "command", 0) == 512 else 0  # type: ignore[attr-defined]


def silence(rig: Rig, seconds: float) -> None:
    rig.tap.deaf = True
    rig.run(seconds)
    rig.tap.deaf = False


@pytest.fixture(params=["px4", "ardupilot"])
def hovering(request: pytest.FixtureRequest, both_flown_up: dict[str, Rig]) -> Rig:
    return flight_copy(both_flown_up[request.param])


def test_after_a_silence_it_is_asked_who_it_is_and_the_flight_goes_on(hovering: Rig) -> None:
    begin_s = hovering.clock.now_s()
    silence(hovering, 1.0)
    assert asked(hovering, begin_s) == 0
    hovering.run(1.0)
    assert asked(hovering, begin_s) == 1
    assert hovering.pilot.phase is FlightPhase.FLYING
    silence(hovering, 0.3)
    hovering.run(1.0)
    assert asked(hovering, begin_s) == 1, "too short to exchange it"


def test_another_vehicle_in_flight_is_commanded_nothing(hovering: Rig) -> None:
    exchange(hovering, lambda: OTHER)
    silence(hovering, 1.0)
    hovering.run(0.1)
    assert hovering.pilot.phase is FlightPhase.YIELDED
    note = hovering.state.note
    assert note is not None
    (changed,) = note.details
    assert (note.code, changed.code) == (ReasonCode.CONTROL_RELEASED, ReasonCode.AUTOPILOT_CHANGED)
    assert changed.values[0] == "000000001234abcd"
    assert str(changed.values[1]).startswith("5349544c")
    quiet_s = hovering.clock.now_s()
    hovering.fly((1.0, 0.0, 1.1), identifier=9)
    hovering.pilot.operator.request_land()
    hovering.run(20.0)
    assert not any(hovering.tap.since(quiet_s)[order] for order in ORDERS)
    assert hovering.tap.since(quiet_s)["HEARTBEAT"] == 0, "the true one may hear us still, and is to land"
    assert hovering.reported()[-1][1] == (ReasonCode.CONTROL_RELEASED, ReasonCode.AUTOPILOT_CHANGED)


def test_an_answer_that_is_lost_is_asked_for_again(hovering: Rig) -> None:
    exchange(hovering, lambda: OTHER)
    silence(hovering, 1.0)
    hovering.tap.mute = True
    hovering.run(0.2)
    hovering.tap.mute = False
    phases = [hovering.pilot.phase]
    hovering.run(0.6)
    assert [*phases, hovering.pilot.phase] == [FlightPhase.FLYING, FlightPhase.YIELDED]


def test_another_vehicle_on_the_ground_is_not_flown_until_the_first_is_back() -> None:
    rig, uid = Rig(), [0]
    exchange(rig, lambda: uid[0])
    rig.until(FlightPhase.READY, 20.0)
    uid[0] = OTHER
    silence(rig, 1.0)
    rig.run(1.0)
    assert rig.pilot.phase is FlightPhase.CONNECTING
    assert rig.state.note == Reason(ReasonCode.AUTOPILOT_CHANGED, ("000000001234abcd", PX4_UID))
    quiet_s = rig.clock.now_s()
    rig.intent = (Goal.FLY, None)
    rig.run(5.0)
    assert not any(rig.tap.since(quiet_s)[order] for order in ORDERS)
    rig.intent, uid[0] = (Goal.STANDBY, None), 0
    silence(rig, 1.0)
    rig.until(FlightPhase.READY, 10.0)


class OneVehicle(Rig):
    """Configured for one autopilot."""

    uid = PX4_UID

    def allow_list(self) -> AllowListFilter:
        return AllowListFilter(AllowList(uid=self.uid))


class AnotherVehicle(OneVehicle):
    uid = "1234abcd"


def test_the_configured_autopilot_is_flown() -> None:
    rig = OneVehicle()
    rig.until(FlightPhase.READY, 20.0)


def test_another_than_the_configured_one_is_refused_and_both_are_named() -> None:
    rig = AnotherVehicle()
    rig.intent = (Goal.FLY, None)
    rig.run(20.0)
    assert rig.pilot.phase is FlightPhase.CONNECTING
    assert rig.state.note == Reason(ReasonCode.AUTOPILOT_NOT_CONFIGURED, (PX4_UID, "1234abcd"))
    assert not any(rig.tap.since(0.0)[order] for order in ORDERS[1:])


@pytest.mark.parametrize(
    ("wanted", "told", "fault"),
    [
        ("", ["aa", "aa"], None),
        ("", ["aa", "ab"], Reason(ReasonCode.AUTOPILOT_CHANGED, ("ab", "aa"))),
        ("", ["aa", "ab", "aa"], None),
        ("", ["", ""], None),
        ("", ["", "aa"], None),
        ("", ["aa", ""], Reason(ReasonCode.AUTOPILOT_CHANGED, ("none", "aa"))),
        ("aa", [""], Reason(ReasonCode.AUTOPILOT_NOT_CONFIGURED, ("none", "aa"))),
        ("00AA", ["aa"], None),
    ],
)
def test_who_it_is(wanted: str, told: list[str], fault: Reason | None) -> None:
    identity = AutopilotIdentity(wanted)
    for uid in told:
        identity.check_uid(uid)
    assert identity.fault == fault
