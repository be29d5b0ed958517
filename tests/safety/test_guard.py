"""The guard against hostile proposals: whatever is asked, what leaves is fit to fly."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.safety.envelope import Envelope
from uav_recon.safety.guard import ClearedSetpoint, Guard, Patience, Proposal, Situation, fault_of
from uav_recon.types.frames import FloatArray
from uav_recon.types.trajectory import Setpoint, Trajectory

DT = 1 / 30
ENVELOPE = Envelope((-1.0, -2.0, -0.1), (5.0, 2.0, 2.4), 0.3, 1.0, 2.0, 0.8)
PATIENCE = Patience(pose_hold_s=0.2, pose_land_s=1.0, intent_hold_s=0.5, intent_land_s=20.0)


def situation(now_s: float, **changes: Any) -> Situation:
    usual = Situation(now_s, (0.0, 0.0, 1.0), 0.0, pose_age_s=0.03, intent_age_s=0.05, map_epoch=0)
    return dataclasses.replace(usual, **changes)


def proposal(
    position: Any = (0.0, 0.0, 1.0),
    velocity: Any = (0.0, 0.0, 0.0),
    acceleration: Any = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    yaw_rate: float = 0.0,
    identifier: int = 1,
    epoch: int = 0,
) -> Proposal:
    p, v, a = (np.array(vector, dtype=np.float64) for vector in (position, velocity, acceleration))
    return Proposal(Setpoint(p, v, a, yaw, yaw_rate, 0.0), identifier, epoch)


def along(distance_m: float) -> FloatArray:
    return np.array([distance_m, 0.0, 0.0])


def anchored() -> Guard:
    guard = Guard(ENVELOPE, PATIENCE)
    guard.clear(None, situation(0.0))
    return guard


def moving(speed_mps: float = 1.0, start: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> tuple[Guard, float, FloatArray]:
    """A guard that has cleared an acceleration to a speed along x; returns it, the time and the place."""
    guard = Guard(ENVELOPE, PATIENCE)
    guard.clear(None, situation(0.0, position_m=start))
    now, place, v = 0.0, np.array(start), 0.0
    while v < speed_mps - 1e-9:
        now += DT
        step = min(1.5 * DT, speed_mps - v)
        place = place + along((v + step / 2) * DT)
        v += step
        _, refusal = guard.clear(proposal(place, (v, 0, 0), (1.5, 0, 0)), situation(now))
        assert refusal is None
    return guard, now, place


def test_nobody_else_makes_a_cleared_setpoint() -> None:
    with pytest.raises(TypeError, match=r"Guard\.clear"):
        ClearedSetpoint(Setpoint.hold(np.zeros(3), 0.0), object())


def test_the_first_setpoint_holds_the_present_place() -> None:
    guard = Guard(ENVELOPE, PATIENCE)
    cleared, refusal = guard.clear(proposal((3.0, 0.0, 1.0)), situation(5.0, position_m=(0.1, -0.1, 0.0), yaw_rad=0.4))
    np.testing.assert_allclose(cleared.setpoint.position_m, [0.1, -0.1, 0.0])
    assert cleared.setpoint.yaw_rad == 0.4
    assert refusal is not None


def test_a_first_place_outside_is_drawn_inside() -> None:
    guard = Guard(ENVELOPE, PATIENCE)
    cleared, _ = guard.clear(None, situation(0.0, position_m=(9.0, 0.0, 1.0)))
    np.testing.assert_allclose(cleared.setpoint.position_m, [4.7, 0.0, 1.0])
    cleared, _ = Guard(ENVELOPE, PATIENCE).clear(None, situation(0.0, position_m=(math.nan, 0.0, 1.0)))
    np.testing.assert_allclose(cleared.setpoint.position_m, [0.0, 0.0, 0.0])


def test_a_sound_proposal_passes_unchanged() -> None:
    wanted = proposal((0.02, 0.0, 1.0), (0.05, 0.0, 0.0), (1.0, 0.0, 0.0), 0.01, 0.1)
    cleared, refusal = anchored().clear(wanted, situation(DT))
    assert refusal is None
    assert cleared.setpoint is wanted.setpoint


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (proposal((math.nan, 0, 1)), "finite"),
        (proposal(velocity=(0, math.inf, 0)), "finite"),
        (proposal(acceleration=(0, 0, math.nan)), "finite"),
        (proposal(yaw=math.nan), "finite"),
        (proposal(yaw_rate=math.inf), "finite"),
        (proposal((0, 1)), "finite"),
        (proposal(velocity=(1.01, 0, 0)), "speed"),
        (proposal(acceleration=(0, 2.01, 0)), "acceleration"),
        (proposal(yaw_rate=-0.81), "yaw rate"),
        (proposal((0, 0, 9.0)), "fence"),
        (proposal((0.5, 0, 1.0)), "jump of 0.50 m"),
        (proposal(velocity=(0, 0.4, 0)), "velocity jump"),
        (proposal(yaw=1.0), "heading jump"),
        (proposal(epoch=1), "epoch"),
    ],
)
def test_each_fault_is_refused_by_name(bad: Proposal, reason: str) -> None:
    guard = anchored()
    cleared, refusal = guard.clear(bad, situation(DT))
    assert refusal is not None
    assert reason in refusal.reason
    assert refusal.instead is cleared.setpoint
    np.testing.assert_allclose(cleared.setpoint.position_m, [0.0, 0.0, 1.0])


def test_a_refusal_brakes_within_the_limit_from_where_it_was_told_to_be() -> None:
    guard, now, place = moving(1.0)
    velocity, position, positions = np.array([1.0, 0, 0]), place, []
    for _ in range(30):
        now += DT
        cleared, refusal = guard.clear(proposal((99.0, 0.0, 1.0)), situation(now, position_m=(-0.5, 0.0, 1.0)))
        assert refusal is not None
        new = cleared.setpoint.velocity_mps
        assert np.linalg.norm(new - velocity) <= 2.0 * DT + 1e-9
        assert np.linalg.norm(cleared.setpoint.position_m - position) <= 1.0 * DT + 1e-9
        assert np.linalg.norm(cleared.setpoint.acceleration_mps2) <= 2.0 + 1e-9
        velocity, position = new, cleared.setpoint.position_m
        positions.append(position[0])
    assert np.linalg.norm(velocity) == 0.0
    assert positions[-1] - place[0] == pytest.approx(1.0 / 4.0, abs=1e-6), "v squared over 2a"
    assert guard.refusals == 1, "one episode, however many samples"


def test_speed_towards_the_fence_must_leave_room_to_stop() -> None:
    """Tried at every millimetre about the last point from which 1 m/s can be stopped inside."""
    stop_m = 1.0 / 4.0
    for millimetres in range(-10, 11):
        start = 4.7 - stop_m + millimetres * 1e-3
        guard, now, place = moving(1.0, start=(start - 1.0, 0.0, 1.0))
        while place[0] + DT < start:
            now, place = now + DT, place + along(DT)
            guard.clear(proposal(place, (1.0, 0, 0)), situation(now))
        now += (start - place[0]) / 1.0
        _, refusal = guard.clear(proposal((start, 0, 1.0), (1.0, 0, 0)), situation(now))
        assert (refusal is None) is (millimetres <= 0), millimetres


def test_a_silent_mission_ends_its_trajectory_and_starts_no_other() -> None:
    guard, now, place = moving(0.5)
    late = situation(now + DT, intent_age_s=3.0)
    following = proposal(place + along(0.5 * DT), (0.5, 0, 0))
    _, refusal = guard.clear(following, late)
    assert refusal is None, "its end is at rest in free space: play on"
    other = proposal(place + along(1.0 * DT), (0.5, 0, 0), identifier=2)
    _, refusal = guard.clear(other, situation(now + 2 * DT, intent_age_s=3.0))
    assert refusal is not None
    assert "silent" in refusal.reason


def test_a_stale_pose_holds() -> None:
    guard, now, place = moving(0.5)
    for age, held in ((0.2, False), (0.201, True), (math.nan, True), (-5.0, True)):
        now, place = now + DT, place + along(0.5 * DT)
        _, refusal = guard.clear(proposal(place, (0.5, 0, 0)), situation(now, pose_age_s=age))
        assert (refusal is not None) is held, age
        if held:
            assert refusal is not None
            assert refusal.reason == "pose is stale"
            guard, now, place = moving(0.5)


@pytest.mark.parametrize(
    ("pose_age_s", "intent_age_s", "lands"),
    [(1.0, 20.0, False), (1.001, 0.0, True), (0.0, 20.01, True), (math.inf, 0.0, True), (math.nan, 0.0, True)],
)
def test_the_ladder_ends_in_a_landing(pose_age_s: float, intent_age_s: float, lands: bool) -> None:
    reason = anchored().must_land(situation(9.0, pose_age_s=pose_age_s, intent_age_s=intent_age_s))
    assert bool(reason) is lands


def test_a_reset_of_odom_holds_the_new_place_for_a_second() -> None:
    guard, now, _ = moving(0.5)
    guard.rebase(situation(now))
    cleared, _ = guard.clear(None, situation(now + DT, position_m=(2.0, 1.0, 1.2)))
    np.testing.assert_allclose(cleared.setpoint.position_m, [2.0, 1.0, 1.2])
    step = proposal((2.0, 1.0, 1.2))
    assert guard.clear(step, situation(now + 0.95))[1] is not None
    assert guard.clear(step, situation(now + 1.05))[1] is None


def test_refusals_count_episodes() -> None:
    guard = anchored()
    for i in range(1, 6):
        guard.clear(proposal((9, 0, 1), identifier=1), situation(i * DT))
    guard.clear(proposal((9, 0, 1), identifier=2), situation(6 * DT))
    guard.clear(proposal(identifier=2), situation(7 * DT))
    guard.clear(proposal((9, 0, 1), identifier=2), situation(8 * DT))
    assert guard.refusals == 3


HOSTILE = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.floats(-6.0, 6.0),
    st.floats(-0.1, 0.1),
    st.sampled_from([4.7, 4.7000001, 4.6999999, -0.7, 2.1, 2.1001, 0.2, 0.1999, 1.0, 2.0]),
)
VECTOR = st.tuples(HOSTILE, HOSTILE, HOSTILE)
NUDGE = st.tuples(*[st.floats(-0.06, 0.06)] * 3)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_nothing_invalid_ever_leaves(data: st.DataObject) -> None:
    guard = Guard(ENVELOPE, PATIENCE)
    now = 0.0
    cleared, _ = guard.clear(None, situation(now, position_m=data.draw(VECTOR), yaw_rad=data.draw(HOSTILE)))
    last = cleared.setpoint
    for _ in range(data.draw(st.integers(1, 25))):
        dt = data.draw(st.sampled_from([DT, DT, DT, 0.0, 0.01, 0.15]))
        now += dt
        if data.draw(st.booleans()):  # near what was flown: reaches the checks behind the first
            place = last.position_m + np.array(data.draw(NUDGE))
            velocity = last.velocity_mps + np.array(data.draw(NUDGE))
            wanted = proposal(place, velocity, data.draw(NUDGE), last.yaw_rad, 0.0)
        else:
            wanted = proposal(data.draw(VECTOR), data.draw(VECTOR), data.draw(VECTOR), data.draw(HOSTILE), data.draw(HOSTILE))
        cleared, refusal = guard.clear(None if data.draw(st.booleans()) else wanted, situation(now))
        flown = cleared.setpoint
        numbers = np.concatenate(
            [flown.position_m, flown.velocity_mps, flown.acceleration_mps2, [flown.yaw_rad, flown.yaw_rate_radps]]
        )
        assert np.isfinite(numbers).all()
        x, y, z = flown.position_m.tolist()
        assert ENVELOPE.contains((x, y, z)), (x, y, z, refusal)
        assert np.linalg.norm(flown.velocity_mps) <= 1.0 + 1e-5
        assert np.linalg.norm(flown.acceleration_mps2) <= 2.0 + 1e-5
        assert abs(flown.yaw_rate_radps) <= 0.8 + 1e-5
        assert np.linalg.norm(flown.position_m - last.position_m) <= 1.0 * dt + 0.02 + 1e-9
        assert np.linalg.norm(flown.velocity_mps - last.velocity_mps) <= 2.0 * dt + 0.05 + 1e-9
        last = flown


def line(**changes: Any) -> Trajectory:
    n = 5
    usual = Trajectory(
        0.0, 0.1, np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(0), 0, 1
    )
    return dataclasses.replace(usual, **changes)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({}, ""),
        ({"position_m": np.zeros((4, 3))}, "malformed"),
        ({"position_m": np.zeros((5, 2))}, "malformed"),
        ({"yaw_rad": np.zeros((5, 1))}, "malformed"),
        ({"yaw_rad": np.zeros(0)}, "malformed"),
        ({"step_s": 0.0}, "time axis"),
        ({"start_s": math.nan}, "time axis"),
        ({"yaw_rate_radps": np.full(5, math.nan)}, "finite"),
        ({"velocity_mps": np.full((5, 3), 0.2)}, "rest"),
    ],
)
def test_trajectories_that_cannot_be_sampled_are_named(changes: dict[str, Any], fault: str) -> None:
    found = fault_of(line(**changes))
    assert fault in found
    assert bool(found) is bool(fault)
