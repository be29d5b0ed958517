"""What a frame may be off does not add up over many, and a place that moves has a velocity: the limits over time."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from guard_rooms import DT, ENVELOPE, HULL_RADIUS_M, frame, guard_of, proposal, situation
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.safety.guard import Guard
from uav_recon.safety.obstacle_speed_limit import ForwardDepth
from uav_recon.safety.setpoint_continuity import ClearedMotion, ContinuityCheck
from uav_recon.types.frames import FloatArray
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

NEAR = 1e-6
OBLIQUE = np.array([0.6, -0.48, 0.64])
SPEED, PUSH, TURN = 1.0, 2.0, 0.8  # the envelope's limits
assert (ENVELOPE.max_speed_mps, ENVELOPE.max_acceleration_mps2, ENVELOPE.max_yaw_rate_radps) == (SPEED, PUSH, TURN)


def motion(at_s: float, place: FloatArray, velocity: FloatArray | None = None, yaw_rad: float = 0.0) -> ClearedMotion:
    x, y, z = place.tolist()
    u, v, w = (np.zeros(3) if velocity is None else velocity).tolist()
    return ClearedMotion(at_s, (x, y, z), (u, v, w), yaw_rad, 0.0)


def taken(motions: list[ClearedMotion], steps: ContinuityCheck | None = None) -> tuple[ContinuityCheck, Reason | None]:
    """One after the other, and the last one's fault; those before it have none."""
    steps = steps or ContinuityCheck()
    fault: Reason | None = None
    for last, new in itertools.pairwise(motions):
        assert fault is None
        steps, fault = steps.after(last, new, ENVELOPE)
    return steps, fault


@pytest.mark.parametrize("dt_s", [0.01, DT, 0.1, 0.5])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_place_may_go_as_far_as_the_greatest_speed_and_two_centimetres(dt_s: float, sign: float) -> None:
    velocity = sign * SPEED * OBLIQUE
    for beyond, may in ((-NEAR, True), (NEAR, False)):
        way = sign * OBLIQUE * (SPEED * dt_s + 0.02 + beyond)
        fault = taken([motion(5.0, np.zeros(3), velocity), motion(5.0 + dt_s, way, velocity)])[1]
        assert fault == (None if may else Reason(ReasonCode.POSITION_STEP, (SPEED * dt_s + 0.02,)))


@pytest.mark.parametrize("dt_s", [0.01, DT, 0.1, 0.4])
def test_a_place_may_be_off_its_velocity_by_what_the_acceleration_allows_and_two_centimetres(dt_s: float) -> None:
    velocity = 0.1 * OBLIQUE
    for side in (OBLIQUE, np.array([0.8, 0.36, -0.48])):
        for beyond, may in ((-NEAR, True), (NEAR, False)):
            off_m = PUSH * dt_s**2 / 4.0 + 0.02 + beyond
            fault = taken([motion(0.0, np.zeros(3), velocity), motion(dt_s, velocity * dt_s + off_m * side, velocity)])[1]
            assert fault == (None if may else Reason(ReasonCode.POSITION_OFF_VELOCITY, (off_m,)))


def test_faster_and_slower_within_one_step_is_what_the_acceleration_allows() -> None:
    """From rest to rest in half a second, with all that the limit gives each way: a quarter of a t squared."""
    fault = taken([motion(0.0, np.zeros(3)), motion(0.5, OBLIQUE * PUSH * 0.5**2 / 4.0)])[1]
    assert fault is None


def crawl(guard: Guard, speed_mps: float, frames: int, ahead: ForwardDepth | None = None) -> tuple[float, Reason | None]:
    """Places that advance, of which no velocity tells: how far they come, and why no farther."""
    guard.clear(None, situation(0.0))
    way_m = 0.0
    for k in range(1, frames):
        here = situation(k * DT) if ahead is None else situation(k * DT, ahead=ahead)
        cleared, refusal = guard.clear(proposal((speed_mps * k * DT, 0.0, 1.0)), here)
        if refusal is not None:
            return way_m, refusal.reason
        way_m = float(cleared.setpoint.position_m[0])
    return way_m, None


@pytest.mark.parametrize("speed_mps", [0.05, 0.3, 0.9, 1.5])
def test_a_place_that_moves_without_a_velocity_is_refused_within_centimetres(speed_mps: float) -> None:
    way_m, why = crawl(guard_of(), speed_mps, 600)
    assert why is not None
    assert why.code is ReasonCode.POSITION_OFF_VELOCITY or why == Reason(ReasonCode.POSITION_STEP, (0.05,))
    assert way_m <= 0.02 + speed_mps * (PUSH * DT / 4.0) / (speed_mps - PUSH * DT / 4.0) + NEAR


def test_depth_cannot_be_passed_by_a_velocity_that_is_not_told() -> None:
    """0.10 m before the hull: nothing may come nearer, however it is put."""
    near = ForwardDepth(frame(0.3, 0.0), HULL_RADIUS_M)
    way_m, why = crawl(guard_of(), 0.9, 60, near)
    assert why
    assert way_m <= 0.02


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_slack_does_not_add_up(seed: int) -> None:
    """Whatever is put, over any stretch of what was taken places, velocities and headings keep the limits and one slack, and
    places lie where the velocities have led.
    """
    rng = np.random.default_rng(seed)
    steps, flown = ContinuityCheck(), [motion(0.0, np.zeros(3))]
    greed = rng.uniform(0.9, 1.6, 3)
    for _ in range(150):
        last, dt_s = flown[-1], float(rng.choice([0.01, DT, DT, 0.1]))
        place, velocity = np.array(last.position_m), np.array(last.velocity_mps)
        way = rng.normal(size=3)
        new = velocity + greed[0] * PUSH * dt_s * way / np.linalg.norm(way)
        new *= min(1.0, SPEED / max(float(np.linalg.norm(new)), 1e-9))
        aside = rng.normal(size=3)
        place = place + greed[1] * (velocity + new) / 2.0 * dt_s + 0.01 * (greed[1] - 0.9) * aside / np.linalg.norm(aside)
        wanted = motion(last.at_s + dt_s, place, new, math.remainder(last.yaw_rad + greed[2] * TURN * dt_s, math.tau))
        after, fault = steps.after(last, wanted, ENVELOPE)
        rest = motion(wanted.at_s, np.array(last.position_m), velocity, last.yaw_rad)
        if fault:  # so it stays, as no vehicle could, and what was owed is made up for
            after, _ = steps.after(rest, rest, ENVELOPE)
            flown, steps = [rest], ContinuityCheck()
        else:
            flown, steps = [*flown, wanted], after
            _assert_kept(flown)


def _assert_kept(flown: list[ClearedMotion]) -> None:
    at_s = np.array([m.at_s for m in flown])
    places, velocities = np.array([m.position_m for m in flown]), np.array([m.velocity_mps for m in flown])
    led = np.zeros((len(flown), 3))
    dt_s = np.diff(at_s)[:, None]
    led[1:] = np.cumsum((velocities[1:] + velocities[:-1]) / 2.0 * dt_s, axis=0)
    allowed = np.concatenate([[0.0], np.cumsum(PUSH * dt_s[:, 0] ** 2 / 4.0)])
    turned = np.unwrap([m.yaw_rad for m in flown])
    since_s = at_s[-1] - at_s
    assert (np.linalg.norm(places[-1] - places, axis=1) <= SPEED * since_s + 0.02 + NEAR).all()
    assert (np.linalg.norm(velocities[-1] - velocities, axis=1) <= PUSH * since_s + 0.05 + NEAR).all()
    assert (np.abs(turned[-1] - turned) <= TURN * since_s + 0.03 + NEAR).all()
    off_m = np.linalg.norm(places[-1] - places - (led[-1] - led), axis=1)
    assert (off_m <= 0.04 + allowed[-1] - allowed + NEAR).all(), "from one side of what is borne to the other"


def test_what_was_taken_too_much_is_made_up_for() -> None:
    still = np.zeros(3)
    first, turned = motion(0.0, still), motion(0.0, still, yaw_rad=0.03)
    steps, fault = taken([first, turned])
    assert fault is None
    more = motion(0.0, still, yaw_rad=0.031)
    assert steps.after(turned, more, ENVELOPE)[1] == Reason(ReasonCode.HEADING_STEP, (0.0,))
    waited = motion(0.03 / TURN + NEAR, still, yaw_rad=0.03)
    steps, _ = steps.after(turned, waited, ENVELOPE)
    assert steps.beyond == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)
    assert steps.after(waited, motion(waited.at_s, still, yaw_rad=0.0599), ENVELOPE)[1] is None


def test_a_long_pause_counts_half_a_second_and_a_clock_that_goes_back_nothing() -> None:
    velocity = SPEED * OBLIQUE
    start = motion(9.0, np.zeros(3), velocity)
    for later_s, counted_s in ((3.0, 0.5), (0.0, 0.0), (-4.0, 0.0)):
        for beyond, may in ((-NEAR, True), (NEAR, False)):
            end = motion(9.0 + later_s, OBLIQUE * (SPEED * counted_s + 0.02 + beyond), velocity)
            assert (taken([start, end])[1] is None) is may
