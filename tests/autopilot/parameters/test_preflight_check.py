"""No arming while the vehicle has another parameter than the flight relies on: both simulated firmwares."""

from __future__ import annotations

import pytest
from flight_rig import ARM, TAKEOFF_LAG_S, Rig
from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.base_autopilot import Autopilot
from sitl.autopilots.byte_links import ByteEnd
from uav_recon.autopilot.firmware.ardupilot import ARDUPILOT
from uav_recon.autopilot.parameters.parameter_file import PARAMETER_FILES, RequiredParameter, load
from uav_recon.autopilot.parameters.preflight_check import ParameterCheck
from uav_recon.autopilot.parameters.reader import BYTEWISE, NUMERIC
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase

INT32 = mavlink.MAV_PARAM_TYPE_INT32
READY_S = {"px4": 20.0, "ardupilot": 60.0}


class CheckedRig(Rig):
    """PX4, with a pilot that reads parameters back."""

    name, form = "px4", BYTEWISE

    def __init__(self, wanted: tuple[RequiredParameter, ...] = ()) -> None:
        self.parameters = ParameterCheck(wanted or load(PARAMETER_FILES[self.name]), self.form)
        super().__init__()


class CheckedArduRig(CheckedRig):
    """ArduCopter."""

    name, form, firmware = "ardupilot", NUMERIC, ARDUPILOT

    def _make_autopilot(self, end: ByteEnd, seed: int) -> Autopilot:
        return ArduCopter(self.vehicle, end, ArduPilotParameters.load(), seed)


def until_noted(rig: Rig, seconds: float = 60.0) -> Reason | None:
    """Until the pilot names a parameter; its reason, a second later still the same."""
    for _ in range(round(seconds)):
        rig.run(1.0)
        if {ReasonCode.PARAMETER_DIFFERS, ReasonCode.PARAMETER_NOT_REPORTED} & set(rig.note_codes):
            break
    note = rig.state.note
    rig.run(1.0)
    assert rig.state.note == note
    return note


RIGS = [CheckedRig, CheckedArduRig]


@pytest.mark.parametrize("kind", RIGS)
def test_with_the_flown_parameters_it_is_ready_as_soon_as_without(kind: type[CheckedRig]) -> None:
    rig = kind()
    rig.until(FlightPhase.READY, READY_S[rig.name])
    asked = [m.param_id for _, m in rig.tap.sent if m.get_type() == "PARAM_REQUEST_READ"]
    assert asked == [one.name for one in load(PARAMETER_FILES[rig.name]) if one.reason.refused]
    assert rig.tap.since(0.0)["PARAM_SET"] == 0
    rig.intent = (Goal.FLY, None)
    rig.until(FlightPhase.FLYING, 15.0)


@pytest.mark.parametrize(
    ("kind", "name", "value", "wanted"),
    [
        (CheckedRig, "COM_OBL_RC_ACT", 0, "4"),
        (CheckedRig, "COM_OF_LOSS_T", 5.0, "0.5 s"),
        (CheckedArduRig, "FS_GCS_ENABLE", 0, "5"),
        (CheckedArduRig, "VISO_POS_M_NSE", 0.2, "0.1 m"),
    ],
)
def test_another_value_keeps_it_on_the_ground_and_is_named(
    kind: type[CheckedRig], name: str, value: float, wanted: str
) -> None:
    rig = kind()
    rig.autopilot.parameters.set(name, value)
    rig.intent = (Goal.FLY, None)
    note = until_noted(rig)
    assert note is not None
    _, told, *_ = note.values
    assert note == Reason(ReasonCode.PARAMETER_DIFFERS, (name, told, wanted, 1))
    assert told == pytest.approx(value, rel=1e-6)
    assert rig.pilot.phase is FlightPhase.CONNECTING
    assert rig.tap.since(0.0)[f"COMMAND_LONG {ARM}"] == 0
    rig.autopilot.parameters.set(name, {one.name: one.value for one in load(PARAMETER_FILES[rig.name])}[name])
    rig.until(FlightPhase.FLYING, 20.0)  # mended at a ground station: read again, and no restart is needed


def test_a_change_on_the_ground_is_seen_before_the_next_flight() -> None:
    rig = CheckedRig()
    rig.until(FlightPhase.READY, 20.0)
    rig.autopilot.parameters.set("NAV_RCL_ACT", 2)
    assert until_noted(rig, 31.0) == Reason(ReasonCode.PARAMETER_DIFFERS, ("NAV_RCL_ACT", 2.0, "3", 1))
    assert rig.pilot.phase is FlightPhase.CONNECTING


def test_what_the_room_decides_may_differ() -> None:
    rig = CheckedArduRig()
    rig.autopilot.parameters.set("FENCE_ALT_MAX", 2.4)
    rig.until(FlightPhase.READY, READY_S["ardupilot"])


def test_a_parameter_that_the_firmware_does_not_know_is_named(tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("p") / "mine.params"
    path.write_text(PARAMETER_FILES["px4"].read_text() + "1\t1\tNOT_OF_THIS_FW\t1\t6\n")
    rig = CheckedRig(load(path))
    assert until_noted(rig) == Reason(ReasonCode.PARAMETER_NOT_REPORTED, ("NOT_OF_THIS_FW", "1", 1))


def test_several_faults_are_counted() -> None:
    rig = CheckedRig()
    for name, value in (("GF_ACTION", 2), ("NAV_RCL_ACT", 2), ("COM_OBL_RC_ACT", 0)):
        rig.autopilot.parameters.set(name, value)
    assert until_noted(rig) == Reason(ReasonCode.PARAMETER_DIFFERS, ("COM_OBL_RC_ACT", 0.0, "4", 3))


@pytest.mark.nightly
def test_nothing_is_asked_for_in_flight() -> None:
    rig = CheckedRig()
    rig.take_off_and_hover()
    begin_s = rig.clock.now_s()
    rig.run(35.0)
    assert rig.tap.since(begin_s)["PARAM_REQUEST_READ"] == 0


def told_of(rig: CheckedRig, name: str, value: float) -> bytes:
    """What the firmware tells everybody when a ground station has written a parameter."""
    message = mavlink.MAVLink_param_value_message(name.encode(), rig.form.number_of(value, INT32), INT32, 1, 0)
    return bytes(message.pack(mavlink.MAVLink(None, 1, 1)))


@pytest.mark.parametrize(
    ("kind", "name", "value", "right"),
    [
        pytest.param(CheckedRig, "COM_OBL_RC_ACT", 0, 4, marks=pytest.mark.nightly),
        (CheckedArduRig, "FS_GCS_ENABLE", 0, 5),
    ],
)
def test_a_change_in_flight_is_held_for_and_told_until_it_is_taken_back(
    kind: type[CheckedRig], name: str, value: float, right: float
) -> None:
    rig = kind()
    rig.until(FlightPhase.READY, READY_S[rig.name])
    rig.intent = (Goal.FLY, None)
    rig.until(FlightPhase.FLYING, 15.0)
    rig.run(rig.fly((0.0, 0.0, 1.1)).duration_s + TAKEOFF_LAG_S)
    rig.fly((2.0, 0.0, 1.1), identifier=2)
    rig.run(1.5)
    rig.tap.forged, changed_s = told_of(rig, name, value), rig.clock.now_s()
    rig.run(0.1)
    changed = Reason(ReasonCode.PARAMETER_DIFFERS, (name, float(value), f"{right:g}", 1))
    assert rig.state.note == Reason(ReasonCode.PARAMETER_CHANGED, details=(changed,))
    rig.run(2.0)
    assert rig.tap.since(changed_s)["STATUSTEXT"] > 0
    stood = rig.autopilot.truth().position[0]
    rig.run(3.0)
    assert abs(rig.autopilot.truth().position[0] - stood) < 0.05
    rig.tap.forged = told_of(rig, name, right)
    rig.run(0.5)
    rig.fly((2.0, 0.0, 1.1), identifier=3)
    rig.run(8.0)
    assert abs(rig.autopilot.truth().position[0] - 2.0) < 0.1


def test_what_may_differ_may_be_changed_in_flight() -> None:
    rig = CheckedRig()
    rig.take_off_and_hover()
    rig.tap.forged = told_of(rig, "COM_DL_LOSS_T", 5)
    rig.run(1.0)
    assert rig.state.note is None
