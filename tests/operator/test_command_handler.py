"""What becomes of each order in each phase, with and without a mission that listens."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from uav_recon.app.flight_channels import memory_channels
from uav_recon.channels import MemoryChannel
from uav_recon.clock import ManualClock
from uav_recon.operator.command_handler import SILENT_S, CommandHandler
from uav_recon.operator.status import Status
from uav_recon.types.operator_command import GivenCommand, OperatorCommand
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason, codes_of, text_of
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal, Intent
from uav_recon.types.vehicle import FlightPhase, MissionProgress, VehicleState

GROUND = (FlightPhase.CONNECTING, FlightPhase.READY, FlightPhase.LANDED)


class Vehicle:
    """A pilot that only notes what is asked of it, and its channels."""

    def __init__(self, phase: FlightPhase, mission: bool = True, note: Reason | None = None) -> None:
        self.phase = phase
        self.asked = list[str]()
        self.received_s = -math.inf
        self.clock = ManualClock(100.0)
        channels = memory_channels()
        self.intent, self.progress, self.perception = channels.intent, channels.progress, channels.perception
        self.commands = MemoryChannel(GivenCommand)
        at = Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([1.0, 2.0, 1.1]))
        channels.vehicle.publish(
            VehicleState(99.9, at, np.zeros(3), True, "OFFBOARD", phase, 0.83, False, float("nan"), 1, 2, note)
        )
        channels.odom.publish(StampedPose(99.96, at, np.zeros(3), quality=97))
        self.progress.publish(MissionProgress(99.9, "survey", "explore", 31, 120, 42.7, 18.4, 5, 7, 40, 0.2, None, False))
        if mission:
            self.intent.publish(Intent(99.9, Goal.FLY))
        self.operator = self
        self.handler = CommandHandler(self, channels, self.commands, self.clock)

    def request_land(self, why: Reason) -> None:
        self.asked.append(f"land: {why.code.value}")

    def request_hold(self, hold: bool) -> None:
        self.asked.append("hold" if hold else "go on")

    def hear_operator(self) -> None:
        self.received_s = self.clock.now_s()

    def order(self, word: str) -> tuple[bool, str]:
        answer = self.handler.serve(word)
        return answer["ok"], answer["said"]

    def refused(self, word: str) -> Reason | None:
        """The reason of a refusal, None for an order that is carried out; its text and codes are the answer's."""
        order = OperatorCommand(word)
        answer, reason = self.handler.serve(word), self.handler._refusal(order)
        if answer["ok"]:
            return None
        assert reason is not None
        assert (answer["said"], tuple(answer["codes"])) == (reason.text(), reason.codes())
        return reason

    @property
    def passed_on(self) -> OperatorCommand | None:
        given = self.commands.latest()
        return None if given is None else given.order


@pytest.mark.parametrize("mission", [True, False])
def test_hold_and_land_work_whether_or_not_the_mission_lives(mission: bool) -> None:
    flying = Vehicle(FlightPhase.FLYING, mission)
    assert flying.order("hold") == (True, "holding")
    assert flying.order("land") == (True, "landing")
    assert flying.asked == ["hold", "land: operator-land"]
    assert flying.passed_on is OperatorCommand.LAND


@pytest.mark.parametrize("why", [Reason(ReasonCode.MODE_CHANGED, ("POSCTL",)), Reason(ReasonCode.AUTOPILOT_SILENT)])
def test_a_vehicle_that_is_not_ours_gets_no_order_and_the_reason_is_said(why: Reason) -> None:
    note = Reason(ReasonCode.CONTROL_RELEASED, details=(why,))
    yielded = Vehicle(FlightPhase.YIELDED, note=note)
    for order in OperatorCommand:
        assert yielded.refused(order.value) == Reason(ReasonCode.CONTROL_HANDED_OVER, details=(note,))
    assert (yielded.asked, yielded.passed_on) == ([], None)
    assert Vehicle(FlightPhase.YIELDED).refused("land") == Reason(ReasonCode.CONTROL_HANDED_OVER)


@pytest.mark.parametrize("phase", GROUND)
def test_on_the_ground_there_is_nothing_to_stop(phase: FlightPhase) -> None:
    grounded = Vehicle(phase)
    for word in ("hold", "return", "land"):
        assert grounded.refused(word) == Reason(ReasonCode.NOT_FLYING, (phase.value, word))
    assert (grounded.asked, grounded.passed_on) == ([], None)


def test_start_goes_to_the_mission() -> None:
    ready = Vehicle(FlightPhase.READY)
    assert ready.order("start") == (True, "it takes off when the mission is ready")
    assert ready.passed_on is OperatorCommand.START


def test_start_says_what_is_missing() -> None:
    note = Reason(ReasonCode.PARAMETER_DIFFERS, ("GF_ACTION", 2.0, "5", 1))
    assert Vehicle(FlightPhase.CONNECTING, note=note).refused("start") == Reason(ReasonCode.NOT_READY, details=(note,))
    assert Vehicle(FlightPhase.READY, mission=False).refused("start") == Reason(ReasonCode.MISSION_NOT_RUNNING)
    for phase in (FlightPhase.LANDING, FlightPhase.LANDED):
        assert Vehicle(phase).refused("start") == Reason(ReasonCode.FLIGHT_OVER)


def test_start_in_the_air_ends_a_hold() -> None:
    flying = Vehicle(FlightPhase.FLYING)
    flying.order("hold")
    assert flying.order("start") == (True, "the mission continues")
    assert flying.asked == ["hold", "go on"]


def test_return_needs_a_mission_and_ends_a_hold() -> None:
    assert Vehicle(FlightPhase.FLYING).order("return") == (True, "returning")
    alone = Vehicle(FlightPhase.FLYING, mission=False)
    assert alone.refused("return") == Reason(ReasonCode.MISSION_CANNOT_RETURN)
    assert (alone.asked, alone.passed_on) == ([], None)


def test_a_landing_is_not_taken_back() -> None:
    landing = Vehicle(FlightPhase.LANDING)
    for word in ("hold", "return", "start"):
        assert not landing.order(word)[0]
    assert landing.order("land")[0]


def test_before_it_flies_it_can_only_be_landed() -> None:
    arming = Vehicle(FlightPhase.ARMING)
    assert not arming.order("hold")[0]
    assert arming.order("land") == (True, "landing")


def test_a_mission_that_died_a_moment_ago_is_silent() -> None:
    flying = Vehicle(FlightPhase.FLYING)
    flying.clock.advance_to(100.0 + SILENT_S)
    assert not flying.order("return")[0]
    assert flying.handler.status().mission == "silent"


def test_an_unknown_word_is_told_the_known_ones() -> None:
    answer = Vehicle(FlightPhase.FLYING).handler.serve("jump")
    unknown = Reason(ReasonCode.UNKNOWN_COMMAND, ("'jump'", "start, hold, return, land, status"))
    assert (answer["said"], answer["codes"]) == (unknown.text(), ["unknown-command"])


def test_status_reads_like_an_instrument_panel() -> None:
    refused = Reason(ReasonCode.REFUSED, details=(Reason(ReasonCode.POSE_STALE),))
    answer = Vehicle(FlightPhase.FLYING, note=refused).handler.serve("status")
    told = Status(**json.loads(json.dumps(answer["status"], allow_nan=False)))
    assert told.lines() == [
        "pilot     flying",
        "mission   survey",
        "mode      OFFBOARD, ARMED",
        "battery   83%",
        "position  x 1.00  y 2.00  z 1.10 m",
        "pose      quality 97, 0.04 s old",
        "views     31 of 120",
        "explored  42.7 m³ on 18.4 m",
        "speed     -",
        "refused   2 by the guard",
        "note      refused: pose is stale",
        "origin    -",
        "calibr.   -",
        "corrected -",
        "flown map -",
        "rejected  -",
    ]


def test_status_says_why_the_speed_is_reduced() -> None:
    vehicle = VehicleState(
        1.0, Pose.identity(), np.zeros(3), True, "OFFBOARD", FlightPhase.FLYING, 0.8, False, float("nan"), 1, 0, None,
        max_speed_mps=0.3, slow_reason=Reason(ReasonCode.NO_IMU),
    )  # fmt: skip
    status = Status.of(1.0, vehicle, None, None, False)
    assert "speed     at most 0.30 m/s: no inertial samples" in status.lines()
    assert (status.max_speed_mps, status.slow_codes) == (0.3, ("no-imu",))
    assert Status.from_json(json.loads(json.dumps(status.as_json()))) == status


def test_what_perception_rejected_is_in_the_status() -> None:
    flying = Vehicle(FlightPhase.FLYING)
    frames = ((ReasonCode.DEPTH_FRAME_EMPTY, 3), (ReasonCode.DEPTH_FRAME_NOISE, 12))
    newest = Reason(ReasonCode.DEPTH_FRAME_EMPTY, (0.1,))
    flying.perception.publish(PerceptionStatus(99.5, 800, frames, (("jump", 2),), newest, 97.0))
    status = flying.handler.status()
    assert status.perception == {"depth-frame-empty": 3, "depth-frame-noise": 12, "pose jump": 2}
    assert Status.from_json(status.as_json()) == status
    assert status.lines()[-1] == (
        "rejected  perception: 12 depth-frame-noise, 3 depth-frame-empty, 2 pose jump;"
        " newest 3 s ago: depth frame: returns in 10% of the pixels"
    )


def test_the_camera_and_the_pad_that_is_awaited_are_in_the_status() -> None:
    ready = Vehicle(FlightPhase.CONNECTING)
    streams = Reason(ReasonCode.CAMERA_STREAMS, ("480x270 at 15 Hz", "424x240 at 15 Hz", "none", "2.1"))
    ready.perception.publish(
        PerceptionStatus(
            99.5, origin=Reason(ReasonCode.PAD_AWAITED, (0.5,)), camera=(streams, Reason(ReasonCode.CAMERA_USB2, ("2.1", "15")))
        )
    )
    status = ready.handler.status()
    assert status.camera_codes == ("camera-streams", "camera-usb2")
    assert Status.from_json(json.loads(json.dumps(status.as_json()))) == status
    assert [line for line in status.lines() if line.startswith(("camera", "origin"))] == [
        "origin    no odometry yet: waiting until the pose source has been at rest on the pad for 0.5 s",
        "camera    depth 480x270 at 15 Hz, colour 424x240 at 15 Hz, IMU none, USB 2.1",
        "camera    the camera is on USB 2.1: 15 frames a second, later than on USB 3; use a USB 3 port and cable",
    ]


def test_what_is_not_known_is_a_dash() -> None:
    vehicle = Vehicle(FlightPhase.CONNECTING)
    lines = CommandHandler(vehicle, memory_channels(), vehicle.commands, vehicle.clock).status().lines()
    assert lines[:3] == ["pilot     starting", "mission   silent", "mode      -"]
    battery = VehicleState(
        1.0, Pose.identity(), np.zeros(3), False, "LAND", FlightPhase.LANDED, float("nan"), False, 0.0, -1, 0, None
    )
    assert Status.of(1.0, battery, None, None, False).battery is None


def test_what_nobody_has_told_yet_is_not_known() -> None:
    at = Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
    silent = VehicleState(0.9, at, np.zeros(3), False, "", FlightPhase.CONNECTING, 0.5, False, float("nan"), -1, 0, None)
    told = Status.of(1.0, silent, None, None, False)
    assert (told.mode, told.armed, told.position_m) == (None, None, None)
    told = Status.of(1.0, silent, StampedPose(0.95, at, np.zeros(3), quality=97), None, False)
    assert told.position_m == (0.0, 0.0, 0.0)


def test_who_asks_or_orders_has_been_heard_and_who_babbles_has_not() -> None:
    flying = Vehicle(FlightPhase.FLYING)
    flying.order("jump")
    assert flying.received_s == -math.inf
    for word in ("status", "hold", "start"):
        flying.clock.advance_to(flying.clock.now_s() + 1.0)
        flying.order(word)
        assert flying.received_s == flying.clock.now_s(), word
    flying.phase = FlightPhase.LANDING
    flying.clock.advance_to(110.0)
    assert not flying.order("hold")[0]
    assert flying.received_s == 110.0, "a refused order is a sign of life too"


def test_on_the_ground_status_says_what_the_mission_waits_for() -> None:
    missing = Reason(ReasonCode.OPERATOR_MISSING)
    for phase, note in ((FlightPhase.READY, missing), (FlightPhase.FLYING, None)):
        waiting = Vehicle(phase)
        progress = MissionProgress(99.9, "ready", "", 0, 120, 1.0, 0.0, 0, 0, 0, 0.0, missing, False)
        waiting.progress.publish(progress)
        status = waiting.handler.status()
        assert (status.note, status.note_codes) == (text_of(note), codes_of(note))
