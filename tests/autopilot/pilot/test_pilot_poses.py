"""What the pilot does with poses that are late, lost, wrong or made no sense of; each test is a promise."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from flight_copy import flight_copy
from flight_rig import BOUNDS, GRID, MODE, POSES_DISAGREE, Rig, setpoints, smooth_way
from scipy.spatial.transform import Rotation

from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase


def en_route(rig: Rig, health: PoseHealth = PoseHealth.GOOD) -> float:
    """In the middle of a way out along x, poses are of that health from now on; when that is."""
    rig.fly((2.5, 0.0, 1.1), identifier=2)
    rig.run(2.5)
    assert rig.px4.truth().velocity[0] > 0.3
    rig.health = health
    return rig.clock.now_s()


def test_poses_are_stamped_on_the_autopilots_clock(hovering: Rig) -> None:
    errors = [
        at - 1e-6 * m.time_usec - (100.0 - 37.5) for at, m in hovering.tap.sent if m.get_type() == "ODOMETRY"
    ]  # the simulated autopilot booted 37.5 s before the test's clock showed 100 s
    assert len(errors) > 400
    assert min(errors) > -0.002
    assert max(errors) < 0.015


def test_lost_poses_hold_then_land(hovering: Rig) -> None:
    lost_s, hovering.poses = en_route(hovering), False
    hovering.run(0.3)
    assert hovering.pilot.phase is FlightPhase.FLYING
    hovering.until(FlightPhase.LANDING, 1.2)
    assert hovering.clock.now_s() - lost_s <= 1.2
    times, places = setpoints(hovering, lost_s + 0.6)
    assert len(times) > 5
    assert np.ptp(places, axis=0).max() < 1e-6, "held"
    assert hovering.tap.since(lost_s + 0.05)["ODOMETRY"] == 0, "an old pose is never repeated"
    hovering.until(FlightPhase.LANDED, 25.0)
    assert ReasonCode.NO_POSE in hovering.note_codes


@pytest.mark.parametrize(("code", "fed"), [("NO_POSE", False), ("POSES_DISAGREE", False), ("FEW_POSES", True)])
def test_a_pose_that_is_lost_but_told_holds_at_once_and_lands(hovering: Rig, code: str, fed: bool) -> None:
    """Odometry goes on, carried by the IMU; nobody flies on it. The autopilot is fed only while poses stand behind it."""
    hovering.health_reason = Reason(ReasonCode[code], (0.3,))
    lost_s = en_route(hovering, PoseHealth.LOST)
    hovering.until(FlightPhase.LANDING, 1.2)
    assert (hovering.tap.since(lost_s + 0.1)["ODOMETRY"] > 10) is fed
    times, places = setpoints(hovering, lost_s + 0.7)
    assert len(times) > 5
    assert np.ptp(places, axis=0).max() < 1e-6, "held"


def publish_after_loss(rig: Rig, age_s: float, off_mps2: float) -> None:
    """Publish odometry as it is after the last pose of its source: dead reckoning by an accelerometer that is off."""
    truth = rig.autopilot.truth()
    east = np.array([1.0, 0.0, 0.0])
    place_m = np.array(truth.position) + 0.5 * off_mps2 * age_s**2 * east
    velocity_mps = np.array(truth.velocity) + off_mps2 * age_s * east
    health, most = (PoseHealth.DEGRADED, 60) if age_s <= 0.25 else (PoseHealth.LOST, 20)
    quality = min(most, math.ceil(100 * (0.5 - age_s) / 0.3))
    reason, attitude = Reason(ReasonCode.NO_POSE, (age_s,)), np.array(truth.quat_wxyz)
    if quality > 0:
        pose = StampedPose(truth.stamp_s, Pose(attitude, place_m), velocity_mps, np.eye(6) * 1e-3, quality)
        rig.channels.odom.publish(replace(pose, health=health, health_reason=reason))


@pytest.mark.parametrize(
    ("kind", "off_mps2"),
    [("px4", 1.0), ("ardupilot", 0.0), pytest.param("px4", -1.0, marks=pytest.mark.nightly)]
    + [pytest.param("ardupilot", off_mps2, marks=pytest.mark.nightly) for off_mps2 in (-1.0, 1.0)],
)
def test_a_landing_without_poses_begins_at_rest_and_stays(both_flown_up: dict[str, Rig], kind: str, off_mps2: float) -> None:
    rig = flight_copy(both_flown_up[kind])
    rig.intent = (Goal.FLY, smooth_way(rig.clock.now_s() + 0.1, [rig.autopilot.truth().position, (3.5, 0.0, 1.1)], 2, 0.5))
    rig.run(3.4)
    assert rig.autopilot.truth().velocity[0] > 0.85
    lost_s, rig.poses, speeds_mps, begun_m = rig.clock.now_s(), False, [], None
    while rig.pilot.phase is not FlightPhase.LANDED:
        rig.step()
        age_s, truth = rig.clock.now_s() - lost_s, rig.autopilot.truth()
        if rig.turn % 3 == 0:
            publish_after_loss(rig, age_s, off_mps2)
        if rig.pilot.phase is FlightPhase.LANDING:
            begun_m = truth.position[:2] if begun_m is None else begun_m
            speeds_mps.append(math.hypot(*truth.velocity[:2]))
    assert begun_m is not None
    assert speeds_mps[0] < 0.25, "at rest"
    assert max(speeds_mps) < 0.35
    assert math.dist(begun_m, rig.autopilot.truth().position[:2]) < 0.6


def test_a_pose_that_is_wrong_lands_once_it_rests(hovering: Rig) -> None:
    """To stand still by it is to move with its error, and the autopilot does so while it comes down. Told to land in motion it
    would look for its own place to stop, 0.6 s and more farther on.
    """
    wrong_s = en_route(hovering, PoseHealth.WRONG)
    times, places = setpoints(hovering, wrong_s - 0.2)
    assert np.linalg.norm(places[1] - places[0]) / (times[1] - times[0]) > 0.3, "under way"
    hovering.until(FlightPhase.LANDING, 0.6)
    _, places = setpoints(hovering, hovering.clock.now_s() - 0.05)
    assert np.ptp(places[-2:], axis=0).max() < 0.005, "at rest"
    assert hovering.tap.since(wrong_s)[f"COMMAND_LONG {MODE}"] == 1
    assert hovering.state.note == POSES_DISAGREE
    hovering.until(FlightPhase.LANDED, 15.0)
    assert hovering.tap.since(wrong_s + 1.0)["ODOMETRY"] > 10, "better than none to land by"


def test_with_a_degraded_pose_nothing_fast_is_flown(hovering: Rig) -> None:
    slow_s = en_route(hovering, PoseHealth.DEGRADED)
    hovering.run(2.0)
    assert hovering.pilot.phase is FlightPhase.FLYING
    times, places = setpoints(hovering, slow_s + 1.0)
    assert (np.linalg.norm(np.diff(places, axis=0), axis=1) <= 0.3 * np.diff(times) + 1e-3).all()


def test_a_vehicle_stops_while_the_view_is_missing_and_goes_on_with_it(hovering: Rig) -> None:
    """Its velocity is still known; later it would not be."""
    hovering.health_reason = Reason(ReasonCode.NO_POSE, (0.3,))
    begin_s, place_m = hovering.clock.now_s(), hovering.px4.truth().position
    hovering.intent = (Goal.FLY, smooth_way(begin_s + 0.1, [place_m, (2.5, 0.0, 1.1)], 2, 0.12))
    hovering.run(8.0)
    assert hovering.px4.truth().velocity[0] > 0.15, "no faster than with any degraded pose"
    late_s, hovering.health = hovering.clock.now_s(), PoseHealth.DEGRADED
    hovering.run(1.0)
    _, places = setpoints(hovering, late_s + 0.7)
    assert np.ptp(places, axis=0).max() < 1e-6, "held"
    assert math.hypot(*hovering.px4.truth().velocity[:2]) < 0.1
    hovering.health = PoseHealth.GOOD
    hovering.run(0.5)
    assert hovering.pilot.phase is FlightPhase.FLYING


def test_the_reason_for_a_reduced_speed_is_reported_once_and_its_end(hovering: Rig) -> None:
    begin_s = hovering.clock.now_s()
    hovering.health = PoseHealth.DEGRADED
    hovering.run(10.0)
    assert hovering.state.slow_reason == POSES_DISAGREE
    assert hovering.state.max_speed_mps == BOUNDS.retreat_speed_mps
    ((at_s, codes),) = hovering.reported(begin_s)
    assert codes == (ReasonCode.REDUCED_SPEED, ReasonCode.POSES_DISAGREE)
    assert at_s - begin_s < 1.0
    hovering.health = PoseHealth.GOOD
    hovering.run(10.0)
    assert [codes for _, codes in hovering.reported(begin_s)][1:] == [(ReasonCode.FULL_SPEED,)]
    assert hovering.state.slow_reason is None


def test_a_reduced_speed_is_reported_before_take_off() -> None:
    rig = Rig()
    rig.health = PoseHealth.DEGRADED
    rig.until(FlightPhase.READY, 20.0)
    rig.run(1.0)
    assert [codes for _, codes in rig.reported()] == [(ReasonCode.REDUCED_SPEED, ReasonCode.POSES_DISAGREE)]


def test_poses_that_come_back_do_not_stop_a_landing(hovering: Rig) -> None:
    hovering.poses = False
    hovering.until(FlightPhase.LANDING, 1.3)
    hovering.poses = True
    hovering.until(FlightPhase.LANDED, 15.0)


def test_a_reset_of_odom_holds_the_new_place(hovering: Rig) -> None:
    """The source restarts 0.4 m aside and says so: the setpoint follows in the same tick, no flight back, and after a second
    of rest it lands: what is known free was mapped in the old odom.
    """
    rig = hovering
    rig.fly((2.0, 0.0, 1.1), identifier=2)
    rig.run(2.0)
    rig.poses = False
    begin, start = rig.clock.now_s(), np.array(rig.px4.truth().position)
    phases = []
    for turn in range(2500):
        if turn % 3 == 0:
            truth = rig.px4.truth()
            pose = Pose(np.array(truth.quat_wxyz), np.array(truth.position) + np.array([0.0, 0.4, 0.0]))
            rig.channels.odom.publish(StampedPose(truth.stamp_s, pose, np.array(truth.velocity), reset_counter=1))
        rig.step()
        phases.append(rig.pilot.phase)
    assert phases[98] is FlightPhase.FLYING
    assert phases[105] is FlightPhase.LANDING
    assert phases[-1] is FlightPhase.LANDED
    times, places = setpoints(rig, begin + 0.05)
    assert len(times) >= 28, "held by our own setpoints for a second"
    assert np.abs(places[:, 1] - 0.4).max() < 0.12
    assert rig.state.trajectory_id == -1, "what was planned in the old odom is not taken up again"
    assert np.linalg.norm((np.array(rig.px4.truth().position) - start)[:2]) < 0.45
    assert ReasonCode.ODOMETRY_RESTARTED in rig.note_codes


class Late:
    """A link on which everything comes so late that no round trip tells of the autopilot's clock any more."""

    def __init__(self, rig: Rig) -> None:
        self._clock = rig.clock
        self._inner = rig.tap._inner
        self._under_way: deque[tuple[float, bytes]] = deque()

    def read(self) -> bytes:
        self._under_way.append((self._clock.now_s() + 0.03, self._inner.read()))
        data = b""
        while self._under_way and self._under_way[0][0] <= self._clock.now_s():
            data += self._under_way.popleft()[1]
        return data

    def write(self, data: bytes) -> None:
        self._inner.write(data)

    def wait(self, timeout_s: float) -> None:
        self._inner.wait(timeout_s)

    def close(self) -> None:
        self._inner.close()


def test_poses_that_no_clock_lets_us_feed_hold_then_land(hovering: Rig) -> None:
    """One answer contradicts, none comes to clear it up: the autopilot hears of no pose, however good ours are."""
    doubt_s, clock = en_route(hovering), hovering.pilot._link._clock._timesync
    now_ns = int(doubt_s * 1e9)
    clock.observe(now_ns - 10_000_000, clock.autopilot_ns(doubt_s) + 300_000_000, now_ns)
    hovering.tap._inner = Late(hovering)
    hovering.run(0.9)
    assert hovering.pilot.phase is FlightPhase.FLYING
    _, places = setpoints(hovering, doubt_s + 0.8)
    assert np.ptp(places, axis=0).max() < 1e-6, "held"
    hovering.until(FlightPhase.LANDING, 0.3)
    hovering.until(FlightPhase.LANDED, 25.0)
    assert hovering.tap.since(doubt_s + 0.05)["ODOMETRY"] == 0
    assert hovering.state.note == Reason(ReasonCode.NO_POSE, (1.0,)).with_detail(Reason(ReasonCode.CLOCK_UNCERTAIN))


def test_nothing_is_cleared_on_a_map_of_the_old_odom(hovering: Rig) -> None:
    """Odom begins again 1.5 m aside: a way that is free in the old map leads into a wall 2.2 m off."""
    rig = hovering
    middle_m = GRID.origin_world_m[1] + (np.arange(GRID.shape[1]) + 0.5) * GRID.resolution_m
    rig.free[:, np.abs(middle_m) >= 2.2, :] = False
    rig.publish_free()
    rig.poses = False
    for turn in range(2500):
        if turn % 3 == 0:
            truth = rig.px4.truth()
            pose = Pose(np.array(truth.quat_wxyz), np.array(truth.position) + np.array([0.0, -1.5, 0.0]))
            rig.channels.odom.publish(StampedPose(truth.stamp_s, pose, np.array(truth.velocity), reset_counter=1))
        if turn == 20:
            rig.intent = (Goal.FLY, smooth_way(rig.clock.now_s() + 0.1, [(0.0, -1.5, 1.1), (0.0, 1.7, 1.1)], 7))
        if turn % 50 == 0:
            rig.publish_free()
        rig.step()
    assert max(place[1] for _, place in rig.track) < 0.3
    assert rig.pilot.phase is FlightPhase.LANDED


@pytest.mark.parametrize("fault", ["old", "future", "repeated", "lost", "nan", "huge"])
def test_bad_poses_are_not_fed(fault: str) -> None:
    rig = Rig()
    rig.until(FlightPhase.READY, 20.0)
    rig.poses = False
    begin = rig.clock.now_s()
    for _ in range(50):
        now = rig.clock.now_s()
        stamp = {"old": now - 0.16, "future": now + 5.0, "repeated": begin}.get(fault, now)
        velocity = np.full(3, math.nan if fault == "nan" else 0.0)
        quality = 0 if fault == "lost" else 100
        covariance = np.diag([0.85e39 if fault == "huge" else 1e-4] * 3 + [1e-5] * 3)
        rig.channels.odom.publish(StampedPose(stamp, Pose.identity(), velocity, covariance, quality))
        rig.step()
    assert rig.tap.since(begin + 0.02)["ODOMETRY"] <= (1 if fault == "repeated" else 0)
    rig.run(1.0)
    assert rig.pilot.phase is FlightPhase.CONNECTING


def test_the_autopilots_turn_rates_come_on_our_clock_in_body_axes() -> None:
    """Perception uses them where the camera has no IMU. The truth's attitudes are differentiated."""
    rig = Rig()
    rig.take_off_and_hover()
    rig.fly((1.2, 0.8, 1.1), identifier=2)
    told: dict[float, list[float]] = {}
    stamps_s, turns, ages_s = [], [], []
    for _ in range(250):
        rig.step()
        stamps_s.append(rig.clock.now_s())
        turns.append(rig.autopilot.truth().quat_wxyz)
        rates = rig.channels.rates.latest()
        assert rates is not None
        ages_s.append(rig.clock.now_s() - rates.stamps_s[-1])
        told |= dict(zip(rates.stamps_s.tolist(), rates.rates_radps.tolist(), strict=True))
    assert 0.0 <= min(ages_s) <= max(ages_s) < 0.06
    times_s, attitudes = np.array(stamps_s), Rotation.from_quat(turns, scalar_first=True)
    true_radps = (attitudes[:-2].inv() * attitudes[2:]).as_rotvec() / (times_s[2:] - times_s[:-2])[:, None]
    inside = [stamp_s for stamp_s in told if times_s[1] <= stamp_s <= times_s[-2]]
    assert len(inside) > 60
    truth = np.array([np.interp(inside, times_s[1:-1], true_radps[:, k]) for k in range(3)]).T
    error = np.array([told[stamp_s] for stamp_s in inside]) - truth
    assert np.abs(true_radps[:, :2]).max(axis=0).min() > 0.05, "it rolls and pitches"
    assert np.abs(error).max() < 0.3 * np.abs(true_radps).max()
