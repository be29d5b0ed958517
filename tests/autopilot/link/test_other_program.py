"""Heartbeats of routers and companion programs with the ids of the autopilot, or with ours: named once, and ignored."""

from __future__ import annotations

from typing import Any

import pytest
from flight_copy import flight_copy
from flight_rig import Rig
from px4_link import px4_link
from pymavlink.dialects.v20 import common as mavlink
from test_link_alerts import Crowd, texts
from test_pilot_flight_ardupilot import CopterRig
from test_vehicle_link import Wire, heartbeat

from uav_recon.autopilot.mavlink.address import COMPANION_ADDRESS
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase

GCS, QUADROTOR, COMPANION, CAMERA = 6, 2, 18, 30
GENERIC, ARDUPILOT, INVALID, PX4_FAMILY = 0, 3, 8, 12
# (MAV_TYPE, MAV_AUTOPILOT): mavp2p, MAVSDK, a router that claims a vehicle, a camera manager that claims an autopilot
OTHERS = [(GCS, INVALID), (COMPANION, INVALID), (QUADROTOR, GENERIC), (GCS, GENERIC), (CAMERA, ARDUPILOT), (GCS, PX4_FAMILY)]


def beat(kind: int, family: int, state: int = 4) -> Any:
    return mavlink.MAVLink_heartbeat_message(kind, family, 0, 0, state, 3)


def place(x: float) -> Any:
    return mavlink.MAVLink_local_position_ned_message(7, x, 0.0, 0.0, 0.0, 0.0, 0.0)


class Two:
    """An autopilot and another program with its ids, each with sequence numbers of its own."""

    def __init__(self) -> None:
        self.far = Wire()
        self.link = px4_link(self.far)
        self.voices = {name: mavlink.MAVLink(None, 1, 1) for name in ("autopilot", "other")}
        self.voices["other"].seq = 100
        self.now_s = 0.0

    def say(self, name: str, message: Any) -> None:
        voice = self.voices[name]
        self.far.inbox += bytes(message.pack(voice))
        voice.seq = (voice.seq + 1) % 256
        self.now_s += 0.01
        self.link.receive(self.now_s)

    @property
    def north_m(self) -> float:
        return float(self.link.telemetry.estimate.position_m[1])


@pytest.mark.parametrize(("kind", "family"), OTHERS)
def test_its_heartbeats_are_no_telemetry_and_are_named_once(kind: int, family: int, caplog: pytest.LogCaptureFixture) -> None:
    two = Two()
    for _ in range(3):
        two.say("other", beat(kind, family))
    assert two.link.telemetry.system == 0
    two.say("autopilot", heartbeat(mode=6 << 16, armed=True))
    before = two.link.telemetry
    for _ in range(30):
        two.say("other", beat(kind, family))
    assert two.link.telemetry == before
    assert not two.link.status.duplicate_autopilot
    assert [record.getMessage() for record in caplog.records] == [
        f"link: system 1, component 1 (MAV_TYPE {kind}, MAV_AUTOPILOT {family}): not listened to"
    ]
    assert two.link.alerts.news() == [Reason(ReasonCode.INTRUDER_HEARTBEAT, (kind, family))]
    assert two.link.alerts.news() == []


def test_a_wrong_firmware_is_still_an_autopilot() -> None:
    two = Two()
    two.say("autopilot", beat(QUADROTOR, ARDUPILOT))
    assert two.link.telemetry.mode.firmware_family == ARDUPILOT


def test_what_follows_its_heartbeat_is_its_own() -> None:
    two = Two()
    two.say("autopilot", heartbeat())
    two.say("autopilot", place(1.0))
    two.say("other", beat(GCS, INVALID))
    for n in range(3):
        two.say("autopilot", place(2.0 + n))
        two.say("other", place(90.0 + n))
        assert two.north_m == 2.0 + n


def test_no_frame_of_the_autopilot_is_lost_while_both_count_in_step() -> None:
    two = Two()
    two.say("autopilot", heartbeat())
    for n in range(600):
        if n % 37 == 0:
            two.voices["other"].seq = (two.voices["autopilot"].seq - 1) % 256
            two.say("other", beat(GCS, INVALID))
        two.say("autopilot", place(float(n)))
        assert two.north_m == float(n)


def test_a_gap_in_the_autopilots_numbers_costs_few_of_its_frames() -> None:
    two = Two()
    two.say("autopilot", heartbeat())
    two.say("other", beat(GCS, INVALID))
    two.voices["autopilot"].seq = two.voices["other"].seq  # what came in between was lost
    seen = []
    for n in range(50):
        two.say("autopilot", place(1.0 + n))
        seen.append(two.north_m == 1.0 + n)
    assert seen.count(False) == 4


def test_a_heartbeat_of_the_autopilot_is_never_the_others() -> None:
    two = Two()
    two.say("autopilot", heartbeat())
    two.say("other", beat(GCS, INVALID))
    two.voices["autopilot"].seq = two.voices["other"].seq
    two.say("autopilot", heartbeat(mode=3 << 16, armed=True))
    assert two.link.telemetry.mode.custom_mode == 3 << 16


@pytest.mark.parametrize(
    ("message", "copy_of_us"),
    [
        (beat(COMPANION, INVALID), True),
        (beat(COMPANION, INVALID, state=3), True),
        (mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0, *[0.0] * 11), True),
        (beat(GCS, INVALID), False),
        (beat(QUADROTOR, GENERIC), False),
        (beat(QUADROTOR, PX4_FAMILY), False),
        (mavlink.MAVLink_timesync_message(0, 5), False),
    ],
)
def test_our_ids_forbid_arming_only_for_a_copy_of_us(message: Any, copy_of_us: bool) -> None:
    far = Wire()
    link = px4_link(far)
    far.update(message, *COMPANION_ADDRESS)
    link.receive(0.0)
    assert link.status.own_id_in_use is copy_of_us
    assert link.alerts.news() == [Reason(ReasonCode.INTRUDER_OWN_ID)]


@pytest.mark.parametrize("ids", [(1, 1), COMPANION_ADDRESS], ids=["the autopilot's ids", "our ids"])
@pytest.mark.parametrize("kind", [Rig, CopterRig], ids=["px4", "ardupilot"])
def test_from_boot_on_they_keep_nobody_on_the_ground(kind: type[Rig], ids: tuple[int, int]) -> None:
    rig = kind()
    crowd = Crowd(rig)
    crowd.say(beat(GCS, INVALID), *ids)
    rig.intent = (Goal.FLY, None)
    for turn in range(4000):
        if turn % 20 == 0:
            crowd.say(beat(GCS, INVALID), *ids)
        rig.step()
        if rig.pilot.phase is FlightPhase.FLYING:
            break
    assert rig.pilot.phase is FlightPhase.FLYING
    said = Reason(ReasonCode.INTRUDER_HEARTBEAT, (GCS, INVALID)) if ids == (1, 1) else Reason(ReasonCode.INTRUDER_OWN_ID)
    assert texts(rig, 0.0) == [said.short()]


@pytest.mark.parametrize("ids", [(1, 1), COMPANION_ADDRESS], ids=["the autopilot's ids", "our ids"])
@pytest.mark.parametrize("other", [(GCS, INVALID), (QUADROTOR, GENERIC)], ids=["invalid", "generic"])
@pytest.mark.parametrize("name", ["px4", "ardupilot"])
def test_in_the_air_the_flight_goes_on(
    name: str, other: tuple[int, int], ids: tuple[int, int], both_flown_up: dict[str, Rig]
) -> None:
    rig = flight_copy(both_flown_up[name])
    crowd, begin_s = Crowd(rig), rig.clock.now_s()
    duration_s = rig.fly((2.0, 0.0, 1.1), identifier=2).duration_s
    for turn in range(round(100 * (duration_s + 2.0))):
        if turn % 20 == 0:
            crowd.say(beat(*other), *ids)
        rig.step()
    assert rig.pilot.phase is FlightPhase.FLYING
    assert abs(rig.autopilot.truth().position[0] - 2.0) < 0.1
    assert len(texts(rig, begin_s)) == 1
