"""Who is listened to, and what the link will send."""

from __future__ import annotations

import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from px4_link import px4_link
from pymavlink.dialects.v20 import common as wire

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.allow_list import AllowList, AllowListFilter
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Setpoint


class Wire:
    """A byte link whose other end is the test."""

    def __init__(self) -> None:
        self.inbox = b""
        self.error = ""
        self.sent: list[Any] = []
        self._voices: dict[tuple[int, int], Any] = {}

    def read(self) -> bytes:
        if self.error:
            raise OSError(5, self.error)
        data = self.inbox
        self.inbox = b""
        return data

    def write(self, data: bytes) -> None:
        if self.error:
            raise OSError(5, self.error)
        self.sent.append(wire.MAVLink(None).decode(bytearray(data)))

    def wait(self, timeout_s: float) -> None:
        pass

    def close(self) -> None:
        pass

    def restart(self) -> None:
        self._voices.clear()

    def update(self, message: Any, system: int = 1, component: int = 1) -> None:
        voice = self._voices.setdefault((system, component), wire.MAVLink(None, system, component))
        self.inbox += bytes(message.pack(voice))
        voice.seq = (voice.seq + 1) % 256


def heartbeat(mode: int = 6 << 16, armed: bool = False, autopilot: int = 12) -> Any:
    return wire.MAVLink_heartbeat_message(2, autopilot, 0x80 if armed else 0, mode, 4, 3)


@pytest.fixture
def far() -> Wire:
    return Wire()


@pytest.fixture
def pair(far: Wire) -> tuple[VehicleLink, Wire]:
    return px4_link(far), far


def converge(link: VehicleLink, far: Wire, offset_s: float = 37.5) -> None:
    far.update(heartbeat())
    link.receive(0.0)
    for i in range(12):
        now = 0.2 * i
        far.update(wire.MAVLink_timesync_message(int((now + 0.001 + offset_s) * 1e9), int(now * 1e9)))
        link.receive(now + 0.002)
    assert link.status.time_known


def test_only_the_allowed_autopilot_counts(far: Wire, caplog: pytest.LogCaptureFixture) -> None:
    allow_list = AllowListFilter(AllowList(system=7, autopilot=1, gimbal=154))
    link = px4_link(far, allow_list)
    far.update(heartbeat(autopilot=8), 255, 190)  # a ground station
    far.update(heartbeat(mode=4 << 16, armed=True), 9, 1)  # another vehicle, and earlier than ours
    far.update(heartbeat(autopilot=8), 7, 154)  # a gimbal
    link.receive(0.0)
    system_before = link.telemetry.system
    far.update(heartbeat(mode=3 << 16), 7, 1)
    for _ in range(5):
        far.update(heartbeat(mode=4 << 16, armed=True), 9, 1)
        far.update(heartbeat(mode=4 << 16, armed=True), 7, 2)
    link.receive(0.1)
    assert (system_before, link.telemetry.system) == (0, 7)
    assert (link.telemetry.mode.custom_mode, link.telemetry.mode.armed) == (3 << 16, False)
    twin_before = link.status.own_id_in_use
    far.update(wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), 233, 191)
    link.receive(0.2)
    assert (twin_before, link.status.own_id_in_use) == (False, True)
    assert allow_list.refused == 13
    named = [record.getMessage() for record in caplog.records]
    assert [
        sum(f"system {one}" in text for text in named) for one in ("255, component 190", "9, component 1", "7, component 2")
    ]
    assert len(named) == 4, "each is named once"


def test_mavlink_1_is_counted_and_named_and_says_nothing(far: Wire, caplog: pytest.LogCaptureFixture) -> None:
    allow_list = AllowListFilter()
    link = px4_link(far, allow_list)
    for _ in range(3):
        far.inbox += bytes(heartbeat(armed=True).pack(wire.MAVLink(None, 1, 1), force_mavlink1=True))
    link.receive(0.0)
    assert (link.telemetry.system, link.telemetry.mode.armed, allow_list.refused) == (0, False, 3)
    assert [record.getMessage() for record in caplog.records] == ["link: MAVLink 1: not listened to"]


def test_a_forger_with_a_thousand_names_fills_no_log(far: Wire, caplog: pytest.LogCaptureFixture) -> None:
    allow_list = AllowListFilter()
    link = px4_link(far, allow_list)
    for system in range(2, 245):
        for component in (1, 2, 3, 4):
            far.update(heartbeat(), system, component)
    link.receive(0.0)
    assert allow_list.refused == 4 * 243
    assert len(caplog.records) == 32


@pytest.mark.parametrize("stranger", [100, 1])
def test_only_the_vehicles_own_gimbal_tells_its_angle(pair: tuple[VehicleLink, Wire], stranger: int) -> None:
    link, far = pair
    far.update(heartbeat())
    tilted = wire.MAVLink_gimbal_device_attitude_status_message(0, 0, 0, 0, [math.cos(0.1), 0, -math.sin(0.1), 0], 0, 0, 0, 0)
    far.update(tilted, 1 if stranger == 100 else 2, stranger if stranger == 100 else 154)
    link.receive(0.0)
    assert math.isnan(link.telemetry.camera_pitch_down_rad)


def test_a_gimbal_may_speak_for_itself(pair: tuple[VehicleLink, Wire]) -> None:
    link, far = pair
    far.update(heartbeat())
    far.update(
        wire.MAVLink_gimbal_device_attitude_status_message(0, 0, 0, 0, [math.cos(0.1), 0, -math.sin(0.1), 0], 0, 0, 0, 0),
        1,
        154,
    )
    link.receive(0.0)
    assert link.telemetry.camera_pitch_down_rad == pytest.approx(0.2, abs=1e-6)


def distance_up(boot_ms: int, current_cm: int) -> Any:
    return wire.MAVLink_distance_sensor_message(boot_ms, 5, 400, current_cm, 0, 0, wire.MAV_SENSOR_ROTATION_PITCH_90, 0)


def test_a_range_has_the_time_of_its_measurement_on_our_clock(pair: tuple[VehicleLink, Wire]) -> None:
    link, far = pair
    far.update(heartbeat())
    far.update(distance_up(37_500, 120))
    link.receive(0.3)
    assert link.telemetry.range_up is not None
    assert link.telemetry.range_up.measured_s == 0.3, "its arrival, while the autopilot's clock is not known"
    converge(link, far)
    far.update(distance_up(40_400, 130))
    link.receive(3.0)
    assert link.telemetry.range_up.reading.range_m == 1.3
    assert link.telemetry.range_up.measured_s == pytest.approx(2.9, abs=0.003)


@pytest.mark.parametrize(("sender", "used"), [((1, 1), True), ((1, 154), False), ((1, 2), False), ((2, 1), False)])
def test_only_the_autopilot_tells_optical_flow(pair: tuple[VehicleLink, Wire], sender: tuple[int, int], used: bool) -> None:
    link, far = pair
    far.update(heartbeat())
    converge(link, far)
    flow = wire.MAVLink_optical_flow_rad_message(40_400_000, 0, 40_000, 0.01, 0.02, 0.0, 0.0, 0.0, 0, 200, 0, -1.0)
    down = wire.MAVLink_distance_sensor_message(40_400, 5, 400, 110, 0, 0, wire.MAV_SENSOR_ROTATION_PITCH_270, 0)
    far.update(flow, *sender)
    far.update(down, *sender)
    link.receive(3.0)
    readings = link.flow.readings()
    assert (readings is not None) is used
    if readings is not None:
        assert readings.stamps_s[-1] == pytest.approx(2.9, abs=0.003)
        assert (readings.flow_rad[-1, 1], readings.ranges_m[-1]) == pytest.approx((-0.02, 1.1))


@pytest.mark.parametrize("stranger", [(1, 154), (1, 2), (2, 1), (255, 190)])
def test_only_the_autopilot_tells_a_range(pair: tuple[VehicleLink, Wire], stranger: tuple[int, int]) -> None:
    link, far = pair
    far.update(heartbeat())
    link.receive(0.0)
    far.update(distance_up(500, 130), *stranger)
    link.receive(0.1)
    assert link.telemetry.range_up is None


@pytest.mark.parametrize(
    ("component", "ago_s", "stamp_ago_s"),
    [(1, 0.03, 0.03), (1, 2.0, 0.0), (154, 0.03, 0.0)],
    ids=["autopilot", "another clock", "gimbal with a clock of its own"],
)
def test_an_angle_has_the_time_of_its_measurement_where_the_clock_is_known(
    pair: tuple[VehicleLink, Wire], component: int, ago_s: float, stamp_ago_s: float
) -> None:
    link, far = pair
    far.update(heartbeat())
    converge(link, far)
    now_s = 60.0
    boot_ms, quat = int((now_s - ago_s + 37.5) * 1000), [math.cos(0.1), 0, -math.sin(0.1), 0]
    far.update(wire.MAVLink_gimbal_device_attitude_status_message(0, 0, boot_ms, 0, quat, 0, 0, 0, 0), 1, component)
    link.receive(now_s)
    assert link.telemetry.camera_pitch_s == pytest.approx(now_s - stamp_ago_s, abs=0.003)


def test_nothing_but_a_cleared_setpoint_is_streamed(pair: tuple[VehicleLink, Wire]) -> None:
    link, far = pair
    with pytest.raises(AttributeError):
        link.stream(Setpoint.hold(np.zeros(3), 0.0), 0.0, False)  # type: ignore[arg-type]
    assert far.sent == []


def test_we_speak_five_times_a_second_and_ask_for_the_clock(pair: tuple[VehicleLink, Wire]) -> None:
    link, far = pair
    for i in range(1000):
        link.keep_alive(i / 100)
    assert [m.get_type() for m in far.sent] == ["HEARTBEAT"] * 50
    far.update(heartbeat())
    link.receive(10.0)
    for i in range(1000, 2000):
        link.keep_alive(i / 100)
    assert sum(m.get_type() == "TIMESYNC" for m in far.sent) == 100


def test_no_pose_before_the_clock_is_known_and_then_on_its_clock(pair: tuple[VehicleLink, Wire]) -> None:
    link, far = pair
    pose = StampedPose(2.5, Pose.identity(), np.zeros(3))
    link.feed_pose(pose, 2.5)
    assert far.sent == []
    converge(link, far)
    link.feed_pose(pose, 2.5)
    assert far.sent[-1].time_usec == pytest.approx(40_000_000, abs=1100)


def test_only_an_answer_that_comes_at_once_teaches_the_autopilot_our_clock(pair: tuple[VehicleLink, Wire]) -> None:
    link, far = pair
    converge(link, far)
    for n, late_s in enumerate((0.001, 0.02, 0.15, 0.5, 0.004)):
        asked_s = 10.0 + n
        far.update(wire.MAVLink_timesync_message(0, int((asked_s + 37.5) * 1e9)))
        link.receive(asked_s + late_s)
    answers = [m for m in far.sent if m.get_type() == "TIMESYNC" and m.tc1 != 0]
    assert len(answers) == 5
    assert link.status.clock_answers == 3


def test_its_questions_are_answered_on_its_own_clock(pair: tuple[VehicleLink, Wire]) -> None:
    link, far = pair
    far.update(heartbeat())
    far.update(wire.MAVLink_timesync_message(0, 777))
    link.receive(0.0)
    assert far.sent == [], "before convergence any answer would be a lie"
    converge(link, far)
    far.update(wire.MAVLink_timesync_message(0, 778))
    link.receive(5.0)
    assert far.sent[-1].ts1 == 778
    assert far.sent[-1].tc1 == pytest.approx(42.5e9, abs=2e6)


def test_no_heartbeat_pretends_that_we_hear(pair: tuple[VehicleLink, Wire]) -> None:
    """ArduPilot lands two seconds after the last one: within 3.7 s of the link's end, and never before its third second."""
    link, far = pair
    for phase_s in (10.0, 20.3, 30.6, 40.9):
        for n in range(100):
            link.keep_alive(phase_s - 1.0 + 0.01 * n)
        far.update(heartbeat())
        link.receive(phase_s)
        last_s = 0.0
        for n in range(800):
            far.sent.clear()
            link.keep_alive(phase_s + 0.01 * n)
            last_s = 0.01 * n if any(m.get_type() == "HEARTBEAT" for m in far.sent) else last_s
        assert 1.5 <= last_s <= 1.7
    far.update(heartbeat())
    link.receive(50.0)
    far.sent.clear()
    link.keep_alive(50.0)
    assert any(m.get_type() == "HEARTBEAT" for m in far.sent)


def test_what_comes_late_or_twice_undoes_nothing(pair: tuple[VehicleLink, Wire]) -> None:
    link, far = pair
    far.update(heartbeat(mode=3 << 16))
    old = far.inbox
    link.receive(0.0)
    far.update(heartbeat(mode=6 << 16, armed=True))
    link.receive(0.1)
    far.inbox = old
    link.receive(0.2)
    assert (link.telemetry.mode.custom_mode, link.telemetry.mode.armed, link.telemetry.received_s) == (6 << 16, True, 0.1)
    assert link.status.stale_frames == 1


def test_a_battery_that_is_told_no_more_is_not_known(pair: tuple[VehicleLink, Wire]) -> None:
    link, far = pair
    far.update(heartbeat())
    far.update(wire.MAVLink_sys_status_message(0, 0, 0, 0, 15000, 0, 62, 0, 0, 0, 0, 0, 0))
    link.receive(5.0)
    assert link.telemetry.battery.fraction_at(5.9) == 0.62
    far.update(heartbeat())
    link.receive(6.0)
    assert math.isnan(link.telemetry.battery.fraction_at(6.1)), "other words go on"


def test_a_reboot_forgets_the_origin(pair: tuple[VehicleLink, Wire]) -> None:
    link, far = pair
    converge(link, far)
    far.update(wire.MAVLink_gps_global_origin_message(1, 2, 3))
    link.receive(3.0)
    known_before = link.telemetry.readiness.origin_known
    for i in range(6):
        now = 4.0 + 0.2 * i
        far.update(wire.MAVLink_timesync_message(int((now - 3.0) * 1e9), int(now * 1e9)))
        link.receive(now + 0.001)
    assert link.status.reboots == 1
    assert (known_before, link.telemetry.readiness.origin_known) == (True, False)
    assert not link.status.time_known


def test_no_pose_is_sent_by_a_clock_in_doubt(pair: tuple[VehicleLink, Wire]) -> None:
    """An autopilot that restarts in the air: the first answer of its new clock ends the feed, and we ask more often."""
    link, far = pair
    converge(link, far)
    pose, sent = StampedPose(4.0, Pose.identity(), np.zeros(3)), []

    def fed(now: float) -> int:
        far.sent.clear()
        link.feed_pose(pose, now)
        return len(far.sent)

    for i in range(12):
        now = 4.0 + 0.02 * i
        sent.append(fed(now))
        far.update(wire.MAVLink_timesync_message(int((now - 3.0) * 1e9), int(now * 1e9)))
        link.receive(now + 0.001)
        link.keep_alive(now + 0.001)
        assert link.status.time_known or "TIMESYNC" in [message.get_type() for message in far.sent]
    assert sent == [1] + [0] * 9 + [1, 1]
    assert far.sent[0].time_usec == pytest.approx(1e6, abs=2e3)


def test_an_autopilot_that_restarts_its_count_is_understood_at_once(pair: tuple[VehicleLink, Wire]) -> None:
    """Its first answer is numbered like one of before; by its round trip it is new."""
    link, far = pair
    converge(link, far)
    for n in range(5):
        far.restart()
        now = 2.4 + 0.02 * n
        far.update(wire.MAVLink_timesync_message(int((now - 2.0) * 1e9), int(now * 1e9)))
        link.receive(now + 0.001)
        assert not link.status.time_known
    assert link.status.reboots == 1
    far.update(heartbeat(mode=2 << 16))
    link.receive(2.6)
    assert link.telemetry.mode.custom_mode == 2 << 16


def test_a_link_that_breaks_is_a_reason_not_a_crash(pair: tuple[VehicleLink, Wire]) -> None:
    link, far = pair
    far.error = "Input/output error"
    link.receive(0.0)
    link.keep_alive(0.0)
    assert link.status.failure == Reason(ReasonCode.LINK_ERROR, ("Input/output error",))
    far.error = ""
    link.receive(0.1)
    assert link.status.failure is None, "it is back"


def test_the_pilots_imports_stay_small() -> None:
    heavy = {"torch", "open3d", "rerun", "cv2", "numba", "scipy", "pydantic"}
    pilot = "uav_recon.autopilot.pilot.assembly, uav_recon.autopilot.mavlink.transport"
    code = f"import sys, {pilot}; print({heavy!r} & set(sys.modules))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert out.stdout.strip() == "set()"
