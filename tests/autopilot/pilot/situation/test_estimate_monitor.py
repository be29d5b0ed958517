"""The autopilot's own estimate against the poses that it is fed: a difference that lasts is held for, and then landed for."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
import pytest
from flight_copy import flight_copy
from flight_rig import TICK_S, Rig
from test_pilot_flight_ardupilot import CopterRig

from sitl.geometry.quaternion import from_yaw, multiply
from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.link_status import LinkStatus
from uav_recon.autopilot.mavlink.telemetry import MotionEstimate, Telemetry
from uav_recon.autopilot.pilot.situation.estimate_monitor import EstimateMonitor
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal, Setpoint
from uav_recon.types.vehicle import FlightPhase

LIMIT_DEG, TURNED_DEG = 10.0, 20.0
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass
class Link:
    """What the monitor reads of a link."""

    telemetry: Telemetry = field(default_factory=Telemetry)
    status: LinkStatus = field(default_factory=LinkStatus)
    stamp_s: float = math.nan

    def estimate_s(self, now_s: float) -> float:
        return self.stamp_s


class Bench:
    """A vehicle that flies north-east and up at a constant velocity, poses at 30 Hz, estimates at 30 Hz between them."""

    velocity_mps = np.array([0.5, 0.3, 0.2])

    def __init__(self) -> None:
        self.link = Link()
        self.monitor = EstimateMonitor(cast(VehicleLink, self.link))
        self.turn = 0
        self.delay_s = 0.0  # of the estimates on the link; their stamps are right
        self.off_m: FloatArray = np.zeros(3)
        self.off_mps: FloatArray = np.zeros(3)
        self.turn_rad = self.off_rad = 0.0  # heading of the body; of the estimate, off it
        self.turn_radps = 0.0  # of the body
        self.attitudes = True  # arrive
        self.health = PoseHealth.GOOD
        self.health_reason: Reason | None = None
        self.quat_wxyz: FloatArray = LEVEL
        self.waiting: list[tuple[float, float, MotionEstimate]] = []

    def run(self, seconds: float) -> None:
        for _ in range(round(60 * seconds)):
            self.turn += 1
            self.turn_rad += self.turn_radps / 60
            now_s = self.turn / 60
            pose = None
            if self.turn % 2 == 0:
                body = Pose.from_yaw(self.turn_rad, self.velocity_mps * now_s)
                pose = StampedPose(now_s, body, self.velocity_mps, health=self.health, health_reason=self.health_reason)
            else:
                place = self.velocity_mps * now_s + self.off_m
                if self.attitudes:
                    self.quat_wxyz = Pose.from_yaw(self.turn_rad + self.off_rad, place).quat_wxyz
                estimate = MotionEstimate(place, self.velocity_mps + self.off_mps, self.quat_wxyz, self.turn)
                self.waiting.append((now_s + self.delay_s, now_s, estimate))
            while self.waiting and self.waiting[0][0] <= now_s:
                _, self.link.stamp_s, estimate = self.waiting.pop(0)
                self.link.telemetry = Telemetry(estimate=estimate)
            self.monitor.update(pose, now_s)

    @property
    def codes(self) -> tuple[ReasonCode | None, ReasonCode | None]:
        hold, land = self.monitor.hold_reason, self.monitor.land_reason
        return hold.code if hold else None, land.code if land else None


@pytest.fixture
def bench() -> Bench:
    one = Bench()
    one.run(2.0)
    one.monitor.begin()
    one.run(1.0)
    return one


def after(bench: Bench, seconds: float) -> tuple[ReasonCode | None, ReasonCode | None]:
    bench.run(seconds)
    return bench.codes


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_position_that_is_off_is_held_for_and_then_landed_for(bench: Bench, axis: int, sign: float) -> None:
    bench.off_m = sign * 0.16 * np.eye(3)[axis]
    said = ReasonCode.ESTIMATE_POSITION
    assert [after(bench, s) for s in (0.9, 0.2, 1.8, 0.3)] == [(None, None), (said, None), (said, None), (said, said)]
    bench.off_m = np.zeros(3)
    assert after(bench, 0.1) == (None, None)


def test_a_position_within_the_limit_is_no_deviation(bench: Bench) -> None:
    bench.off_m = np.array([0.0, 0.0, 0.14])
    assert after(bench, 10.0) == (None, None)


def test_a_deviation_with_a_break_begins_again(bench: Bench) -> None:
    for _ in range(5):
        bench.off_m = np.array([0.0, 0.0, 0.5])
        assert after(bench, 0.9) == (None, None)
        bench.off_m = np.zeros(3)
        assert after(bench, 0.1) == (None, None)


@pytest.mark.parametrize("off_mps", [0.25, -0.25])
def test_a_velocity_that_is_off_is_held_for_and_then_landed_for(bench: Bench, off_mps: float) -> None:
    bench.off_mps = np.array([0.0, 0.0, off_mps])
    said = ReasonCode.ESTIMATE_VELOCITY
    assert [after(bench, s) for s in (1.2, 0.4, 1.6, 0.4)] == [(None, None), (said, None), (said, None), (said, said)]


def test_a_velocity_within_the_limit_is_no_deviation(bench: Bench) -> None:
    bench.off_mps = np.array([0.0, 0.0, 0.19])
    assert after(bench, 10.0) == (None, None)


def test_a_link_that_delays_is_no_deviation(bench: Bench) -> None:
    """At 0.62 m/s a delay of 0.6 s would be 0.37 m, if the stamps of the estimates did not count."""
    bench.delay_s = 0.6
    bench.run(0.7)
    assert after(bench, 5.0) == (None, None)
    bench.off_m = np.array([0.0, 0.0, 0.4])
    bench.run(4.0)
    assert bench.codes == (ReasonCode.ESTIMATE_POSITION, ReasonCode.ESTIMATE_POSITION)


def test_an_offset_of_the_ground_is_legal_until_it_is_too_large() -> None:
    bench = Bench()
    bench.off_m = np.array([0.0, 0.0, 0.15])
    bench.run(5.0)
    assert bench.monitor.ground_fault is None
    bench.monitor.begin()
    bench.off_m = np.array([0.0, 0.0, 0.15 + 0.14])
    assert after(bench, 5.0) == (None, None)
    bench.off_m = np.array([0.0, 0.0, 0.15 - 0.16])
    assert after(bench, 1.2) == (ReasonCode.ESTIMATE_POSITION, None)


def test_an_offset_that_is_too_large_forbids_arming_until_it_ends() -> None:
    bench = Bench()
    bench.off_m = np.array([0.0, 0.0, 0.25])
    bench.run(5.0)
    fault = bench.monitor.ground_fault
    assert fault is not None
    assert fault == Reason(ReasonCode.ESTIMATE_POSITION, (0.25,))
    bench.off_m = np.zeros(3)
    bench.run(5.0)
    assert bench.monitor.ground_fault is None


@pytest.mark.parametrize("stamp_s", [math.nan, 1e4, -1e4])
def test_a_stamp_of_another_clock_stops_nothing(bench: Bench, stamp_s: float) -> None:
    bench.link.stamp_s, bench.link.telemetry = stamp_s, Telemetry(estimate=MotionEstimate(boot_ms=10**9))
    bench.monitor.update(None, bench.turn / 60)
    bench.off_m = np.array([0.0, 0.0, 0.5])
    assert after(bench, 1.2) == (ReasonCode.ESTIMATE_POSITION, None)


def test_nothing_is_compared_while_two_autopilots_use_one_id(bench: Bench) -> None:
    bench.off_m = np.array([0.0, 0.0, 0.5])
    bench.run(2.0)
    bench.link.status = LinkStatus(duplicate_autopilot=True)
    assert after(bench, 5.0) == (None, None)
    bench.link.status = LinkStatus()
    assert after(bench, 1.2) == (ReasonCode.ESTIMATE_POSITION, None)


def test_lost_poses_are_not_compared(bench: Bench) -> None:
    bench.health = PoseHealth.LOST
    bench.off_m = np.array([5.0, 0.0, 0.0])
    assert after(bench, 5.0) == (None, None)


def test_nothing_is_compared_while_odometry_leaves_an_excluded_source(bench: Bench) -> None:
    bench.health, bench.health_reason = PoseHealth.DEGRADED, Reason(ReasonCode.SOURCE_EXCLUDED)
    bench.off_m = np.array([0.5, 0.0, 0.0])
    assert after(bench, 2.2) == (None, None)
    assert after(bench, 0.6) == (ReasonCode.ESTIMATE_POSITION, None)


@pytest.mark.parametrize("code", [ReasonCode.PLACE_UNSURE, ReasonCode.NO_POSE])
def test_nothing_is_compared_while_odometry_is_dead_reckoning(bench: Bench, code: ReasonCode) -> None:
    """What is found wrong then leaves odometry, and the autopilot follows."""
    bench.health, bench.health_reason = PoseHealth.DEGRADED, Reason(code, (0.3,))
    bench.off_m = np.array([0.5, 0.0, 0.0])
    assert after(bench, 5.0) == (None, None)
    bench.health, bench.health_reason = PoseHealth.GOOD, None
    assert after(bench, 2.2) == (None, None)
    assert after(bench, 0.6) == (ReasonCode.ESTIMATE_POSITION, None)


def test_a_jump_of_odom_and_a_landing_end_what_was_compared(bench: Bench) -> None:
    bench.off_m = np.array([0.0, 0.0, 0.5])
    bench.run(2.0)
    bench.monitor.forget()
    assert bench.codes == (None, None)
    bench.run(2.0)
    bench.monitor.land()
    assert after(bench, 5.0) == (None, None)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("body_rad", [0.0, math.radians(179.0)])
def test_a_heading_that_is_off_is_held_for_and_then_landed_for(bench: Bench, body_rad: float, sign: float) -> None:
    bench.turn_rad = body_rad
    bench.run(0.1)
    bench.off_rad = sign * math.radians(LIMIT_DEG + 0.5)
    said = ReasonCode.ESTIMATE_HEADING
    assert [after(bench, s) for s in (0.9, 0.2, 1.8, 0.3)] == [(None, None), (said, None), (said, None), (said, said)]
    bench.off_rad = 0.0
    assert after(bench, 0.1) == (None, None)


def test_a_heading_within_the_limit_is_no_deviation(bench: Bench) -> None:
    bench.off_rad = math.radians(LIMIT_DEG - 0.5)
    assert after(bench, 10.0) == (None, None)


def test_a_heading_that_is_far_off_is_landed_for_at_once(bench: Bench) -> None:
    bench.off_rad = math.radians(TURNED_DEG + 0.5)
    assert after(bench, 0.15) == (None, None)
    assert after(bench, 0.15) == (None, ReasonCode.ESTIMATE_HEADING)


def test_a_turn_of_the_body_is_compared_at_the_stamps(bench: Bench) -> None:
    """At 100 degrees a second the heading moves by 60 degrees within the delay of the link."""
    bench.delay_s, bench.turn_radps = 0.6, math.radians(100.0)
    bench.run(0.7)
    assert after(bench, 10.0) == (None, None)


def test_a_heading_is_not_compared_while_no_attitude_arrives(bench: Bench) -> None:
    bench.attitudes, bench.turn_radps = False, math.radians(100.0)
    assert after(bench, 2.0) == (None, None)


@pytest.mark.parametrize(("off_deg", "degps"), [(LIMIT_DEG + 0.5, 0.0), (45.0, 0.0), (180.0, 0.0), (0.0, 30.0), (0.0, 3.0)])
def test_a_heading_that_is_off_forbids_arming_in_words(off_deg: float, degps: float) -> None:
    bench = Bench()
    bench.off_rad = math.radians(off_deg)
    forbidden = 0
    for _ in range(120):
        bench.off_rad += math.radians(degps)
        bench.run(1.0)
        fault = bench.monitor.ground_fault
        forbidden += fault is not None and fault.code is ReasonCode.ESTIMATE_HEADING
    assert forbidden >= (120 if degps == 0.0 else 90)


def test_an_offset_of_heading_within_the_limit_is_flown() -> None:
    bench = Bench()
    bench.off_rad = math.radians(LIMIT_DEG - 0.5)
    bench.run(5.0)
    assert bench.monitor.ground_fault is None
    bench.monitor.begin()
    assert after(bench, 5.0) == (None, None)


def test_a_heading_that_was_off_on_the_ground_must_have_been_right_for_seconds() -> None:
    bench = Bench()
    bench.off_rad = math.radians(45.0)
    bench.run(2.0)
    bench.off_rad = 0.0
    bench.run(2.8)
    assert bench.monitor.ground_fault is not None
    bench.run(0.3)
    assert bench.monitor.ground_fault is None


def at_height(bench: Bench, height_m: float, up_mps: float, seconds: float) -> tuple[ReasonCode | None, ReasonCode | None]:
    """Fly on with a setpoint this far above the newest pose."""
    for _ in range(round(30 * seconds)):
        bench.run(1 / 30)
        z_m = float(bench.velocity_mps[2] * bench.turn / 60) - height_m
        x_m, y_m = (bench.velocity_mps[:2] * bench.turn / 60).tolist()
        setpoint = Setpoint.hold(np.array([x_m, y_m, z_m]), 0.0)
        object.__setattr__(setpoint, "velocity_mps", np.array([0.0, 0.0, up_mps]))
        bench.monitor.update_setpoint(setpoint, bench.turn / 60)
    return bench.codes


def test_a_height_off_the_setpoints_counts_from_the_end_of_the_climb_on(bench: Bench) -> None:
    said = ReasonCode.OFF_HEIGHT
    assert at_height(bench, 0.0, 0.0, 0.1) == (None, None), "before the climb it is where the setpoint is"
    assert at_height(bench, -0.5, 0.3, 5.0) == (None, None)
    assert at_height(bench, -0.5, 0.0, 5.0) == (None, None)
    assert at_height(bench, 0.05, 0.0, 0.1) == (None, None)
    assert at_height(bench, 0.29, 0.0, 5.0) == (None, None)
    assert at_height(bench, -0.31, 0.0, 0.9) == (None, None)
    assert at_height(bench, -0.31, 0.0, 0.3) == (said, None)
    assert at_height(bench, 0.31, 0.0, 2.0) == (said, said)


@pytest.mark.parametrize("height_m", [-0.16, 0.16])
@pytest.mark.parametrize("up_mps", [0.0, 0.3])
def test_an_estimate_that_is_off_and_moves_the_vehicle_is_landed_for_at_once(
    bench: Bench, height_m: float, up_mps: float
) -> None:
    at_height(bench, 0.0, 0.3, 0.1)
    at_height(bench, 0.0, 0.0, 0.1)
    assert at_height(bench, height_m, up_mps, 2.0) == (None, None), "of itself it may be late"
    bench.off_mps = np.array([0.0, 0.0, 0.5])
    assert at_height(bench, height_m, up_mps, 0.3) == (None, None)
    assert at_height(bench, height_m, up_mps, 0.3) == (None, ReasonCode.ESTIMATE_VELOCITY)
    assert at_height(bench, 0.14, up_mps, 0.1) == (None, None)
    bench.off_mps = np.zeros(3)
    at_height(bench, 0.0, 0.0, 1.0)
    bench.off_m = np.array([0.0, 0.0, 0.35])
    assert at_height(bench, height_m, up_mps, 0.4) == (None, ReasonCode.ESTIMATE_POSITION)


@pytest.mark.parametrize(("beside_m", "speed_mps", "leaves"), [(0.16, 0.0, True), (0.14, 0.0, False), (0.5, 0.3, False)])
def test_a_position_that_is_off_and_moves_the_vehicle_from_its_hold_is_landed_for_at_once(
    bench: Bench, beside_m: float, speed_mps: float, leaves: bool
) -> None:
    """It does not follow the poses any more; beside a setpoint that moves it may be late."""

    def hold(seconds: float) -> tuple[ReasonCode | None, ReasonCode | None]:
        for _ in range(round(30 * seconds)):
            bench.run(1 / 30)
            setpoint = Setpoint.hold(bench.velocity_mps * bench.turn / 60 + [0.0, beside_m, 0.0], 0.0)
            object.__setattr__(setpoint, "velocity_mps", np.array([speed_mps, 0.0, 0.0]))
            bench.monitor.update_setpoint(setpoint, bench.turn / 60)
        return bench.codes

    assert hold(5.0) == (None, None), "a push, or a swing after a brake"
    bench.off_m = np.array([0.0, 0.16, 0.0])
    assert hold(0.15) == (None, None)
    assert hold(0.25) == (None, ReasonCode.ESTIMATE_POSITION if leaves else None)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_an_autopilot_that_drops_odometry_is_landed_while_it_still_knows_its_velocity(seed: int) -> None:
    """ArduCopter notices 8 s later, and is then carried off (mavros issue 1208)."""
    rig = CopterRig(seed=seed)
    rig.take_off_and_hover()
    begin_s, rig.autopilot.estimator.take = rig.clock.now_s(), lambda pose: None  # type: ignore[method-assign]
    assert rig.until(FlightPhase.LANDING, 7.0) < 6.0
    begun_m = rig.autopilot.truth().position[:2]
    rig.run(0.2)
    assert any(ReasonCode.ESTIMATE_POSITION in codes for _, codes in rig.reported(begin_s))
    rig.until(FlightPhase.LANDED, 15.0)
    assert math.dist(rig.autopilot.truth().position[:2], begun_m) < 0.5


@pytest.mark.parametrize(
    ("height_m", "up_mps", "late"), [(-0.5, 0.3, True), (0.5, -0.3, True), (0.5, 0.3, False), (-0.5, -0.3, False)]
)
def test_a_vehicle_behind_a_climb_or_descent_is_late(bench: Bench, height_m: float, up_mps: float, late: bool) -> None:
    at_height(bench, 0.0, 0.3, 0.1)
    at_height(bench, 0.0, 0.0, 0.1)
    assert (at_height(bench, height_m, up_mps, 4.0) == (None, None)) is late


@pytest.fixture(params=["px4", "ardupilot"])
def flying(request: pytest.FixtureRequest, both_flown_up: dict[str, Rig]) -> Rig:
    return flight_copy(both_flown_up[request.param])


@pytest.mark.parametrize(
    "up_mps", [pytest.param(-0.5, marks=pytest.mark.nightly), -0.3, pytest.param(0.3, marks=pytest.mark.nightly), 0.5]
)
def test_a_vertical_velocity_that_is_off_ends_the_flight_in_words(flying: Rig, up_mps: float) -> None:
    begin_s = flying.clock.now_s()
    flying.autopilot.estimator.velocity_error = (0.0, 0.0, -up_mps)
    assert flying.until(FlightPhase.LANDING, 3.0) < (0.8 if abs(up_mps) > 0.4 else 1.1)
    assert abs(flying.height_m - 1.1) < 0.3
    flying.run(0.2)
    assert any(ReasonCode.ESTIMATE_VELOCITY in codes for _, codes in flying.reported(begin_s))
    for _ in range(2000):
        flying.autopilot.estimator.velocity_error = (0.0, 0.0, 0.0 if flying.vehicle.on_ground else -up_mps)
        flying.step()
    assert not flying.autopilot.truth().armed


@pytest.mark.parametrize("up_m", [-0.5, pytest.param(0.5, marks=pytest.mark.nightly)])
def test_a_height_datum_that_moves_ends_the_flight_in_words(flying: Rig, up_m: float) -> None:
    begin_s = flying.clock.now_s()
    flying.autopilot.estimator.move_height_datum(up_m)
    assert flying.until(FlightPhase.LANDING, 3.0) < 0.8
    assert abs(flying.height_m - 1.1) < 0.3
    flying.run(0.2)
    assert any(ReasonCode.ESTIMATE_POSITION in codes for _, codes in flying.reported(begin_s))
    flying.run(20.0)
    assert not flying.autopilot.truth().armed


def turn_heading(rig: Rig, angle_rad: float) -> None:
    """Turn the autopilot's heading, which poses do not correct any more."""
    estimator = rig.autopilot.estimator
    estimator.configure(replace(estimator._tuning, fuse_yaw=False))
    estimator.quat_wxyz = multiply(from_yaw(-angle_rad), estimator.quat_wxyz)


@pytest.mark.parametrize("degps", [3.0, pytest.param(-30.0, marks=pytest.mark.nightly)])
def test_a_heading_that_turns_by_itself_ends_the_flight_in_words(flying: Rig, degps: float) -> None:
    begin_s = flying.clock.now_s()
    flying.fly((1.5, 0.0, 1.1), (0.0, 0.0, 1.1), (1.5, 0.0, 1.1), (0.0, 0.0, 1.1), identifier=7)
    while flying.pilot.phase is not FlightPhase.LANDING:
        turn_heading(flying, math.radians(degps) * TICK_S)
        flying.step()
    assert flying.clock.now_s() - begin_s < (7.0 if abs(degps) < 10.0 else 2.0)
    flying.run(0.2)
    assert any(ReasonCode.ESTIMATE_HEADING in codes for _, codes in flying.reported(begin_s))
    for _ in range(1500):
        turn_heading(flying, math.radians(degps) * TICK_S)
        flying.step()
    assert not flying.autopilot.truth().armed
    assert max(abs(position_m[1]) for _, position_m in flying.track) < 0.4


@pytest.mark.parametrize("degrees", [45.0, 180.0])
@pytest.mark.parametrize("kind", [Rig, CopterRig], ids=["px4", "ardupilot"])
def test_a_heading_that_is_off_on_the_ground_is_not_flown(kind: type[Rig], degrees: float) -> None:
    rig = kind()
    rig.until(FlightPhase.READY, 20.0)
    turn_heading(rig, math.radians(degrees))
    rig.run(0.5)
    rig.intent = (Goal.FLY, None)
    rig.run(5.0)
    assert rig.pilot.phase is FlightPhase.CONNECTING
    assert rig.note_codes == (ReasonCode.ESTIMATE_HEADING,)
    assert not rig.autopilot.truth().armed


@pytest.mark.parametrize("kind", [Rig, CopterRig], ids=["px4", "ardupilot"])
def test_a_height_that_is_off_on_the_ground_is_not_flown(kind: type[Rig]) -> None:
    rig = kind()
    rig.until(FlightPhase.READY, 20.0)
    rig.autopilot.estimator.move_height_datum(0.4)
    rig.run(2.0)
    rig.intent = (Goal.FLY, None)
    rig.run(5.0)
    assert rig.pilot.phase is FlightPhase.CONNECTING
    assert rig.note_codes == (ReasonCode.ESTIMATE_POSITION,)
    assert not rig.autopilot.truth().armed


@pytest.mark.parametrize(("degrees", "refused"), [(0.0, False), (14.5, False), (15.5, True), (90.0, True), (180.0, True)])
def test_another_vertical_than_the_autopilots_forbids_arming(degrees: float, refused: bool) -> None:
    bench = Bench()
    bench.velocity_mps = np.zeros(3)
    bench.run(0.5)
    turn = Pose.from_rotation_vector(np.array([math.radians(degrees), 0.0, 0.0]), np.zeros(3))
    for n in range(90):
        bench.monitor.update(StampedPose(1.0 + n / 60, turn, np.zeros(3)), 1.0 + n / 60)
    fault = bench.monitor.ground_fault
    assert (fault is not None and fault.code is ReasonCode.AXES_ATTITUDE) == refused
