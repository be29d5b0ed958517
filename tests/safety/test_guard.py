"""The guard against hostile proposals: whatever is asked, what leaves is fit to fly."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from guard_rooms import (
    BOUNDS,
    DT,
    ENVELOPE,
    HULL_RADIUS_M,
    everything,
    frame,
    guard_of,
    known_free,
    may_stand,
    proposal,
    situation,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.safety.guard import ClearedSetpoint, Guard, SetpointProposal
from uav_recon.safety.obstacle_speed_limit import ForwardDepth
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Setpoint


def along(distance_m: float) -> FloatArray:
    return np.array([distance_m, 0.0, 0.0])


def anchored() -> Guard:
    guard = guard_of()
    guard.clear(None, situation(0.0))
    return guard


def moving(speed_mps: float = 1.0, start: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> tuple[Guard, float, FloatArray]:
    """A guard that has cleared an acceleration to a speed along x; returns it, the time and the place."""
    guard = guard_of()
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
    guard = guard_of()
    cleared, refusal = guard.clear(proposal((3.0, 0.0, 1.0)), situation(5.0, position_m=(0.1, -0.1, 0.0), yaw_rad=0.4))
    np.testing.assert_allclose(cleared.setpoint.position_m, [0.1, -0.1, 0.0])
    assert cleared.setpoint.yaw_rad == 0.4
    assert refusal is not None


def test_a_first_place_outside_is_drawn_inside() -> None:
    guard = guard_of()
    cleared, _ = guard.clear(None, situation(0.0, position_m=(9.0, 0.0, 1.0)))
    np.testing.assert_allclose(cleared.setpoint.position_m, [4.7, 0.0, 1.0])
    cleared, _ = guard_of().clear(None, situation(0.0, position_m=(math.nan, 0.0, 1.0)))
    np.testing.assert_allclose(cleared.setpoint.position_m, [0.0, 0.0, 0.0])


def test_a_sound_proposal_passes_unchanged() -> None:
    wanted = proposal((0.02, 0.0, 1.0), (0.05, 0.0, 0.0), (1.0, 0.0, 0.0), 0.01, 0.1)
    cleared, refusal = anchored().clear(wanted, situation(DT))
    assert refusal is None
    assert cleared.setpoint is wanted.setpoint


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (proposal((math.nan, 0, 1)), ReasonCode.SETPOINT_NOT_FINITE),
        (proposal(velocity=(0, math.inf, 0)), ReasonCode.SETPOINT_NOT_FINITE),
        (proposal(acceleration=(0, 0, math.nan)), ReasonCode.SETPOINT_NOT_FINITE),
        (proposal(yaw=math.nan), ReasonCode.SETPOINT_NOT_FINITE),
        (proposal(yaw_rate=math.inf), ReasonCode.SETPOINT_NOT_FINITE),
        (proposal((0, 1)), ReasonCode.SETPOINT_NOT_FINITE),
        (proposal(velocity=(1.01, 0, 0)), ReasonCode.SPEED_LIMIT),
        (proposal(acceleration=(0, 2.01, 0)), ReasonCode.ACCELERATION_LIMIT),
        (proposal(yaw_rate=-0.81), ReasonCode.YAW_RATE_LIMIT),
        (proposal((0, 0, 9.0)), ReasonCode.OUTSIDE_FENCE),
        (proposal((0.5, 0, 1.0)), ReasonCode.POSITION_STEP),
        (proposal(velocity=(0, 0.4, 0)), ReasonCode.VELOCITY_STEP),
        (proposal(yaw=1.0), ReasonCode.HEADING_STEP),
        (proposal(epoch=1), ReasonCode.TRAJECTORY_MAP_EPOCH),
    ],
)
def test_each_fault_is_refused_by_name(bad: SetpointProposal, reason: ReasonCode) -> None:
    guard = anchored()
    cleared, refusal = guard.clear(bad, situation(DT))
    assert refusal is not None
    assert refusal.reason.code is reason
    assert refusal.instead is cleared.setpoint
    np.testing.assert_allclose(cleared.setpoint.position_m, [0.0, 0.0, 1.0])


@pytest.mark.parametrize(("speed_mps", "passes"), [(0.3, True), (0.31, False)])
def test_with_a_degraded_pose_only_what_is_slow_passes(speed_mps: float, passes: bool) -> None:
    guard, now, place = moving(speed_mps)
    guard.bounds = dataclasses.replace(guard.bounds, retreat_speed_mps=0.3)
    wanted = proposal(place + along(speed_mps * DT), (speed_mps, 0.0, 0.0))
    assert (guard.clear(wanted, situation(now + DT, slow=True))[1] is None) is passes


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
    assert guard.refusals.total == 1, "one episode, however many samples"


def test_speed_towards_the_fence_must_leave_room_to_stop() -> None:
    """Tried at every millimetre about the last point from which 1 m/s can be stopped inside."""
    braking_m = 1.0 / 4.0
    for millimetres in range(-10, 11):
        start = 4.7 - braking_m + millimetres * 1e-3
        guard, now, place = moving(1.0, start=(start - 1.0, 0.0, 1.0))
        while place[0] + DT < start:
            now, place = now + DT, place + along(DT)
            guard.clear(proposal(place, (1.0, 0, 0)), situation(now))
        now += (start - place[0]) / 1.0
        _, refusal = guard.clear(proposal((start, 0, 1.0), (1.0, 0, 0)), situation(now))
        assert (refusal is None) is (millimetres <= 0), millimetres


def test_the_faster_the_sooner_silence_is_noticed() -> None:
    """v times age plus v squared over 2a stays within half a metre, and no age is beyond half a second."""
    for speed in (0.2, 0.5, 0.8, 1.0):
        limit = min((0.5 - speed**2 / 4.0) / speed, 0.5)
        for beyond in (-0.001, 0.001):
            guard, now, place = moving(speed)
            late = situation(now + DT, intent_age_s=limit + beyond)
            _, refusal = guard.clear(proposal(place + along(speed * DT), (speed, 0, 0)), late)
            assert (refusal is None) is (beyond < 0), (speed, beyond)
    guard = anchored()
    assert guard.clear(proposal(), situation(DT, intent_age_s=0.49))[1] is None
    for age in (0.51, math.nan, -0.2):
        _, refusal = guard.clear(proposal(), situation(2 * DT, intent_age_s=age))
        assert refusal is not None
        assert refusal.reason.code is ReasonCode.MISSION_STALE


def test_a_stale_pose_holds() -> None:
    guard, now, place = moving(0.5)
    for age, held in ((0.2, False), (0.201, True), (math.nan, True), (-5.0, True)):
        now, place = now + DT, place + along(0.5 * DT)
        _, refusal = guard.clear(proposal(place, (0.5, 0, 0)), situation(now, pose_age_s=age))
        assert (refusal is not None) is held, age
        if held:
            assert refusal is not None
            assert refusal.reason.code is ReasonCode.POSE_STALE
            guard, now, place = moving(0.5)


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
    assert guard.refusals.total == 3


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
    guard = guard_of()
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
        assert may_stand(ENVELOPE, (x, y, z)), (x, y, z, refusal)
        assert np.linalg.norm(flown.velocity_mps) <= 1.0 + 1e-5
        assert np.linalg.norm(flown.acceleration_mps2) <= 2.0 + 1e-5
        assert abs(flown.yaw_rate_radps) <= 0.8 + 1e-5
        assert np.linalg.norm(flown.position_m - last.position_m) <= 1.0 * dt + 0.02 + 1e-9
        assert np.linalg.norm(flown.velocity_mps - last.velocity_mps) <= 2.0 * dt + 0.05 + 1e-9
        last = flown


def test_what_is_not_known_free_is_refused() -> None:
    """A wall from x = 1 m on: the hull may come within its radius of the first voxel's centre, braking included."""
    free = everything()
    free[30:] = False
    wall = known_free(free)
    guard, now, place = moving(0.5, start=(0.0, 0.0, 1.0))
    reason = None
    for _ in range(90):
        now, place = now + DT, place + along(0.5 * DT)
        _, refusal = guard.clear(proposal(place, (0.5, 0, 0)), situation(now, free=wall))
        if refusal is not None:
            reason = refusal.reason.code
            break
    assert reason is ReasonCode.NOT_KNOWN_FREE
    assert 1.05 - 0.2 - 0.0625 - 0.5 * DT <= place[0] <= 1.05 - 0.2 - 0.0625 + 0.5 * DT


NO_SPACE = Reason(ReasonCode.NO_FREE_SPACE)


@pytest.mark.parametrize(
    ("free", "reason"),
    [(None, NO_SPACE), (known_free(everything(), epoch=2), Reason(ReasonCode.FREE_SPACE_MAP_EPOCH, (2, 0)))],
)
def test_without_known_free_space_of_this_epoch_nothing_moves(free: Any, reason: Reason) -> None:
    _, refusal = anchored().clear(proposal((0.01, 0, 1.0)), situation(DT, free=free))
    assert refusal is not None
    assert refusal.reason == reason
    assert anchored().clear(proposal(), situation(DT, free=free))[1] is None, "a hold goes nowhere"


def test_near_things_slow_and_stop() -> None:
    for wall_m, speed, passes in ((3.0, 1.0, True), (0.9, 1.0, False), (1.0, 1.0, True), (0.9, 0.5, True), (0.3, 0.5, False)):
        guard, now, place = moving(speed)
        near = ForwardDepth(frame(wall_m, now), HULL_RADIUS_M)
        _, refusal = guard.clear(proposal(place + along(speed * DT), (speed, 0, 0)), situation(now + DT, ahead=near))
        assert (refusal is None) is passes, (wall_m, speed)
        if refusal is not None:
            assert refusal.reason.code is ReasonCode.OBSTACLE_NEAR


@pytest.mark.parametrize(("age_s", "passes"), [(0.0, True), (0.05, True), (0.25, False)])
def test_what_was_flown_since_a_frame_is_room_no_more(age_s: float, passes: bool) -> None:
    guard, now, place = moving(1.0)
    near = ForwardDepth(frame(1.1, now + DT - age_s), HULL_RADIUS_M)
    _, refusal = guard.clear(proposal(place + along(DT), (1.0, 0, 0)), situation(now + DT, ahead=near))
    assert (refusal is None) is passes


@pytest.mark.parametrize("stamp_s", [-0.5, 0.5, math.nan, None])
def test_nothing_moves_without_fresh_depth_but_a_retreat(stamp_s: float | None) -> None:
    ahead = None if stamp_s is None else ForwardDepth(frame(stamp_s=stamp_s), HULL_RADIUS_M)
    creep: dict[str, Any] = {"position": (0.005, 0, 1.0), "velocity": (0.05, 0, 0)}
    _, refusal = anchored().clear(proposal(**creep), situation(DT, ahead=ahead))
    assert refusal is not None
    assert refusal.reason.code is ReasonCode.DEPTH_STALE
    assert anchored().clear(proposal(**creep, retreating=True), situation(DT, ahead=ahead, intent_age_s=9.0))[1] is None
    assert anchored().clear(proposal(), situation(DT, ahead=ahead))[1] is None


def test_a_retreat_is_slow_and_still_sees() -> None:
    guard = anchored()
    fast = proposal((0.01, 0, 1.0), (0.31, 0, 0), retreating=True)
    _, refusal = guard.clear(fast, situation(0.2))
    assert refusal is not None
    assert refusal.reason == Reason(ReasonCode.SPEED_LIMIT, (0.31,))
    near = ForwardDepth(frame(0.25), HULL_RADIUS_M)
    _, refusal = guard.clear(proposal((0.01, 0, 1.0), (0.2, 0, 0), retreating=True), situation(0.3, ahead=near))
    assert refusal is not None
    assert refusal.reason.code is ReasonCode.OBSTACLE_NEAR


def test_where_the_camera_does_not_look_only_what_was_seen_lately_is_entered_and_slowly() -> None:
    sight = RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=HULL_RADIUS_M)
    guard = guard_of(bounds=dataclasses.replace(BOUNDS, blind_speed_mps=0.3), sight=sight)
    start = (1.0, 0.0, 1.0)
    guard.clear(None, situation(0.0, position_m=start))
    back = proposal((0.99, 0, 1.0), (-0.1, 0, 0))
    _, refusal = guard.clear(back, situation(0.05))
    assert refusal is not None
    assert refusal.reason == Reason(ReasonCode.NOT_SEEN_RECENTLY, (0.74, 0.0, 1.0))
    sight.add(frame(9.0, 0.1), Pose.from_yaw(math.pi, np.array(start)))
    assert guard.clear(back, situation(0.1))[1] is None
    _, refusal = guard.clear(proposal((0.98, 0, 1.0), (-0.1, 0, 0)), situation(10.2))
    assert refusal is not None, "seen ten seconds ago is not lately"
    sight.add(frame(9.0, 10.3), Pose.from_yaw(math.pi, np.array(start)))
    assert guard.clear(proposal((1.08, 0.0, 1.0), (0.5, 0, 0)), situation(11.0))[1] is None, "ahead it may go"
    guard.rebase(situation(11.1), rest_s=0.0)
    guard.clear(None, situation(11.2, position_m=start))
    assert guard.clear(back, situation(11.3))[1] is not None, "nothing was seen in the new odom"


def backwards(speed_mps: float, age_s: float, range_m: float = 9.0, post: bool = False) -> Reason | None:
    """What the guard says to a motion backwards through what was seen age_s ago, from 0.4 m behind; post: beside the way."""
    sight = RecentlySeenSpace(blind_memory_s=60.0, vehicle_radius_m=HULL_RADIUS_M)
    guard = guard_of(bounds=dataclasses.replace(BOUNDS, blind_speed_mps=0.3), sight=sight)
    start, seen = (1.6, 0.0, 1.0), frame(range_m, 100.0)
    if post:
        ranges = np.full((12, 16), 9.0, dtype=np.float32)
        ranges[:, :7] = 0.3
        seen = dataclasses.replace(seen, range_m=ranges)
    sight.add(seen, Pose.from_yaw(math.pi, np.array([2.0, 0.0, 1.0])))
    now_s = 100.0 + age_s
    guard.clear(None, situation(now_s - 0.5, position_m=start))
    guard._last = None if guard._last is None else dataclasses.replace(guard._last, velocity_mps=(-speed_mps, 0.0, 0.0))
    _, refusal = guard.clear(proposal((1.6 - 0.5 * speed_mps, 0, 1.0), (-speed_mps, 0, 0)), situation(now_s))
    return None if refusal is None else refusal.reason


@pytest.mark.parametrize(
    ("speed_mps", "age_s", "cleared"),
    [
        (1.0, 0.5, True), (1.0, 2.99, True), (1.0, 3.1, False), (0.66, 6.5, False), (0.64, 6.5, True),
        (0.31, 9.85, True), (0.31, 9.95, False), (0.3, 10.5, True), (0.3, 59.9, True), (0.31, 59.9, False), (0.1, 60.1, False),
    ],
)  # fmt: skip
def test_outside_the_view_the_speed_falls_with_the_age_of_the_last_sight(speed_mps: float, age_s: float, cleared: bool) -> None:
    reason = backwards(speed_mps, age_s)
    assert (reason is None) is cleared, reason
    if reason is not None:
        assert reason.code is (ReasonCode.SPEED_OUT_OF_VIEW if speed_mps > 0.3 else ReasonCode.NOT_SEEN_RECENTLY)


def test_fast_outside_the_view_needs_the_whole_hull_and_its_stopping_way_seen() -> None:
    """At 1 m/s the hull stops 0.25 m on, and reaches 1.4 m from the camera; beside the way stands a post."""
    assert backwards(1.0, 1.0, range_m=1.6) is None
    assert backwards(1.0, 1.0, range_m=1.3) == Reason(ReasonCode.SPEED_OUT_OF_VIEW, (1.0,))
    assert backwards(0.3, 1.0, range_m=1.3) is None
    assert backwards(1.0, 1.0, post=True) == Reason(ReasonCode.SPEED_OUT_OF_VIEW, (1.0,))
    assert backwards(0.3, 1.0, post=True) is None


def test_who_allows_the_full_speed_everywhere_does_not_ask_what_was_seen() -> None:
    for blind_speed_mps, cleared in ((1.0, True), (0.999, False)):
        guard = guard_of(bounds=dataclasses.replace(BOUNDS, blind_speed_mps=blind_speed_mps))
        guard.clear(None, situation(0.0, position_m=(-0.6, 0.0, 1.0)))
        refusal = guard.clear(proposal((-0.61, 0, 1.0), (-0.1, 0, 0)), situation(0.05))[1]
        assert (refusal is None) is cleared


def test_over_the_pad_the_declared_column_may_be_climbed_unseen() -> None:
    guard = guard_of(bounds=dataclasses.replace(BOUNDS, blind_speed_mps=0.3))
    guard.clear(None, situation(0.0))
    assert guard.clear(proposal((0, 0, 1.01), (0, 0, 0.4)), situation(0.2))[1] is None


COLUMN = {"position_m": (0.0, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("changes", "height_m", "reason"),
    [
        ({}, 1.1, None),
        ({"free": None}, 1.1, ReasonCode.TAKEOFF_COLUMN_NOT_SEEN),
        ({"ahead": None}, 1.1, ReasonCode.TAKEOFF_COLUMN_NOT_SEEN),
        ({}, 2.2, ReasonCode.TAKEOFF_COLUMN_OUTSIDE_FENCE),
        ({"position_m": (1.0, 0.0, 0.0)}, 1.1, ReasonCode.TAKEOFF_COLUMN_OUTSIDE_FENCE),
        (COLUMN | {"free": known_free(everything() & (np.arange(45) != 18))}, 1.1, ReasonCode.TAKEOFF_COLUMN_NOT_FREE),
        (COLUMN | {"free": known_free(everything() & (np.arange(45) != 24))}, 1.1, None),
    ],
)
def test_a_take_off_wants_its_column(changes: dict[str, Any], height_m: float, reason: ReasonCode | None) -> None:
    found = guard_of().takeoff_fault(situation(0.0, **changes), height_m)
    assert (found and found.code) is reason
