"""Each limit of the guard tried on both sides of its border, and its brake against the mechanics of a constant force."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from guard_rooms import (
    BOUNDS,
    ENVELOPE,
    HULL_RADIUS_M,
    MOUNT,
    everything,
    frame,
    guard_of,
    known_free,
    proposal,
    situation,
)

from uav_recon.safety.guard import Guard, SetpointProposal
from uav_recon.safety.obstacle_speed_limit import ForwardDepth
from uav_recon.types.frames import FloatArray
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Setpoint

HERE = np.array([1.0, 0.2, 1.1])
OBLIQUE = np.array([0.6, -0.48, 0.64])
NEAR = 1e-5


def resting(yaw_rad: float = 0.0, at_s: float = 10.0) -> Guard:
    guard = guard_of()
    guard.clear(None, situation(at_s, position_m=tuple(HERE.tolist()), yaw_rad=yaw_rad))
    return guard


def refusal(guard: Guard, wanted: SetpointProposal, now_s: float, **changes: Any) -> Reason | None:
    """Why it is refused, None for cleared."""
    found = guard.clear(wanted, situation(now_s, position_m=tuple(HERE.tolist()), **changes))[1]
    return None if found is None else found.reason


@pytest.mark.parametrize("step_s", [0.01, 0.1, 0.44, 0.46, 3.0])
def test_a_brake_is_a_constant_force_against_the_way_in_any_direction(step_s: float) -> None:
    guard, start, velocity = resting(), HERE + 0.2 * OBLIQUE, 0.9 * OBLIQUE
    wanted = SetpointProposal(Setpoint(start, velocity, np.zeros(3), 0.3, 0.1, 0.25), 1, 0)
    assert refusal(guard, wanted, 10.45) is None
    flown = guard.clear(None, situation(10.45 + step_s))[0].setpoint
    braking_s = min(step_s, 0.9 / 2.0)
    np.testing.assert_allclose(flown.position_m, start + OBLIQUE * (0.9 * braking_s - braking_s**2), atol=1e-9)
    np.testing.assert_allclose(flown.velocity_mps, OBLIQUE * (0.9 - 2.0 * braking_s), atol=1e-9)
    np.testing.assert_allclose(flown.acceleration_mps2, OBLIQUE * (-2.0 if step_s < 0.45 else 0.0), atol=1e-9)
    assert (flown.yaw_rad, flown.yaw_rate_radps, flown.camera_pitch_down_rad) == (0.3, 0.0, 0.25)


def test_a_brake_goes_on_from_the_brake_before() -> None:
    guard = resting()
    assert refusal(guard, proposal(HERE + 0.2 * OBLIQUE, 0.9 * OBLIQUE), 10.45) is None
    for now_s in (10.5, 10.6, 10.55, 10.9, 11.5):
        flown = guard.clear(None, situation(now_s))[0].setpoint
    np.testing.assert_allclose(flown.position_m, HERE + OBLIQUE * (0.2 + 0.9**2 / 4.0), atol=1e-9)
    assert not flown.velocity_mps.any()


@pytest.mark.parametrize(("step_s", "counted_s"), [(0.1, 0.1), (0.4, 0.4), (0.0, 0.0), (-3.0, 0.0), (9.0, 0.5)])
def test_velocity_and_heading_may_change_by_so_much(step_s: float, counted_s: float) -> None:
    for beyond, may in ((-NEAR, True), (NEAR, False)):
        push = OBLIQUE * (2.0 * min(counted_s, 0.4) + 0.05 + beyond)
        turn = 0.8 * counted_s + 0.03 + beyond
        if counted_s <= 0.4:
            for way in (push, -push):
                assert (refusal(resting(), proposal(HERE + way * counted_s / 2.0, way), 10.0 + step_s) is None) is may
        for yaw in (0.0, 3.1, -3.1):
            for sign in (1.0, -1.0):
                wanted = proposal(HERE, yaw=math.remainder(yaw + sign * turn, math.tau))
                assert (refusal(resting(yaw), wanted, 10.0 + step_s) is None) is may


@pytest.mark.parametrize(
    ("changes", "limit"),
    [
        ({"velocity": 1.0}, ReasonCode.SPEED_LIMIT),
        ({"acceleration": 2.0}, ReasonCode.ACCELERATION_LIMIT),
        ({"yaw_rate": 0.8}, ReasonCode.YAW_RATE_LIMIT),
    ],
)
def test_the_limits_themselves_are_flown_and_no_more(changes: dict[str, float], limit: ReasonCode) -> None:
    (name, most), *_ = changes.items()
    for sign in (1.0, -1.0):
        for factor, may in ((1.0, True), (1.0 + NEAR, False)):
            value = sign * most * factor
            asked: dict[str, Any] = {name: value if name == "yaw_rate" else OBLIQUE * value}
            way = asked.get("velocity", np.zeros(3)) * 0.25
            found = refusal(resting(), proposal(HERE + way, **asked), 10.5)
            assert found == (None if may else Reason(limit, (value if name == "yaw_rate" else abs(value),)))


@pytest.mark.parametrize(
    ("evading", "slow", "most"),
    [(False, False, BOUNDS.retreat_speed_mps), (True, False, BOUNDS.margins.slow_mps), (True, True, BOUNDS.margins.slow_mps)],
)
def test_out_of_the_way_of_what_comes_on_is_flown_faster_than_back(evading: bool, slow: bool, most: float) -> None:
    for factor, may in ((1.0, True), (1.0 + NEAR, False)):
        wanted = dataclasses.replace(proposal(HERE, OBLIQUE * most * factor, retreating=True), evading=evading)
        assert refusal(resting(), wanted, 10.5, slow=slow) == (None if may else Reason(ReasonCode.SPEED_LIMIT, (most,)))


def test_a_way_aside_through_what_is_not_known_free_is_refused() -> None:
    wanted = dataclasses.replace(proposal(HERE, (0.4, 0.0, 0.0), retreating=True), evading=True)
    assert refusal(resting(), wanted, 10.5, free=None) == Reason(ReasonCode.NO_FREE_SPACE)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"pose_age_s": 0.2}, None),
        ({"pose_age_s": -0.1}, None),
        ({"pose_age_s": -0.1001}, Reason(ReasonCode.POSE_STALE)),
        ({"intent_age_s": 0.5}, None),
        ({"intent_age_s": -0.1}, None),
        ({"intent_age_s": -0.1001}, Reason(ReasonCode.MISSION_STALE)),
        ({"map_epoch": 1}, Reason(ReasonCode.TRAJECTORY_MAP_EPOCH, (0, 1))),
        ({"map_epoch": -1}, Reason(ReasonCode.TRAJECTORY_MAP_EPOCH, (0, -1))),
    ],
)
def test_how_old_a_word_may_be_and_of_which_map(changes: dict[str, Any], reason: Reason | None) -> None:
    assert refusal(resting(), proposal(HERE), 10.1, **changes) == reason


def test_depth_may_be_as_old_as_agreed_and_a_little_ahead_of_the_clock() -> None:
    for age_s, may in ((0.25, True), (0.2501, False), (-0.09, True), (-0.11, False)):
        guard = guard_of(bounds=dataclasses.replace(BOUNDS, depth_timeout_s=0.25))
        guard.clear(None, situation(10.0, position_m=tuple(HERE.tolist())))
        ahead = ForwardDepth(frame(stamp_s=10.5 - age_s), HULL_RADIUS_M)
        assert (refusal(guard, proposal(HERE, (0.3, 0.0, 0.0)), 10.5, ahead=ahead) is None) is may, age_s


def test_one_missing_frame_of_a_slow_camera_is_no_refusal_and_a_longer_hole_is() -> None:
    for one_missing_s, age_s, may in (
        (0.0, 0.2999, True), (0.0, 0.3001, False), (0.45, 0.4499, True), (0.45, 0.4501, False), (9.0, 0.4999, True),
        (9.0, 0.5001, False),
    ):  # fmt: skip
        ahead = ForwardDepth(frame(stamp_s=10.6 - age_s), HULL_RADIUS_M)
        said = refusal(resting(), proposal(HERE, (0.3, 0.0, 0.0)), 10.6, ahead=ahead, one_missing_s=one_missing_s)
        assert said == (None if may else Reason(ReasonCode.DEPTH_STALE)), (one_missing_s, age_s)


def test_the_way_flown_since_an_older_frame_is_taken_off_its_room() -> None:
    """At 0.7 m/s a frame of 0.45 s ago shows 0.3 m more than there is now."""
    for age_s, may in ((0.1, True), (0.45, False)):
        ahead = ForwardDepth(frame(0.95, stamp_s=10.5 - age_s), HULL_RADIUS_M)
        wanted = proposal(HERE + np.array((0.25, 0.0, 0.0)), (0.7, 0.0, 0.0))
        said = refusal(resting(), wanted, 10.5, ahead=ahead, one_missing_s=0.46)
        assert (said is None) is may
        assert said is None or said.code is ReasonCode.OBSTACLE_NEAR


def test_two_centimetres_a_second_want_no_free_way() -> None:
    assert refusal(resting(), proposal(HERE, (0.02, 0.0, 0.0)), 10.1, ahead=None) is None
    assert refusal(resting(), proposal(HERE, (0.0201, 0.0, 0.0)), 10.1, ahead=None) == Reason(ReasonCode.DEPTH_STALE)


def test_what_is_ahead_is_ahead_of_the_nose_wherever_that_points() -> None:
    """The nose to +y in odom, so that a wall before it is in the way of +y alone."""
    body_from_odom = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    wall = {"body_from_odom": body_from_odom, "ahead": ForwardDepth(frame(0.5, 10.4), HULL_RADIUS_M)}
    for velocity, near in (((0.0, 0.9, 0.0), True), ((0.9, 0.0, 0.0), False), ((0.0, -0.9, 0.0), False)):
        said = refusal(resting(), proposal(HERE + 0.25 * np.array(velocity), velocity), 10.5, **wall)
        assert (said is not None) is near
        assert said is None or (said.code, said.values[1]) == (ReasonCode.OBSTACLE_NEAR, 0.9)


def test_a_rest_after_a_new_odom_ends_when_it_was_said_to() -> None:
    guard = resting()
    guard.rebase(situation(10.0), rest_s=2.0)
    guard.clear(None, situation(11.0, position_m=tuple(HERE.tolist())))
    assert refusal(guard, proposal(HERE), 11.99) == Reason(ReasonCode.POSE_RESET)
    assert refusal(guard, proposal(HERE), 12.0) is None


def test_before_anything_was_cleared_nothing_is_flown() -> None:
    assert refusal(guard_of(), proposal(HERE), 10.0) == Reason(ReasonCode.NO_SETPOINT_YET)


def test_reasons_hold_figures_that_a_person_can_use() -> None:
    assert refusal(resting(), proposal((9.0, -0.5, 1.25)), 10.1) == Reason(ReasonCode.OUTSIDE_FENCE, (9.0, -0.5, 1.25))
    assert refusal(resting(), proposal(HERE, yaw=math.pi / 2), 10.1) == Reason(ReasonCode.HEADING_STEP, (90.0,))
    assert refusal(resting(), proposal(HERE + OBLIQUE), 10.1) == Reason(ReasonCode.POSITION_STEP, (1.0,))
    assert refusal(resting(), proposal(HERE, OBLIQUE * 0.5), 10.1) == Reason(ReasonCode.VELOCITY_STEP, (0.5,))


def along_x(way_m: float) -> FloatArray:
    return np.array([way_m, 0.0, 0.0])


def wall(room_m: float, stamp_s: float) -> ForwardDepth:
    """One return straight ahead, at a distance before the hull."""
    ranges = np.full((1, 1), room_m + HULL_RADIUS_M - MOUNT.translation_m[0])
    return ForwardDepth(MinRangeGrid(stamp_s, MOUNT, ranges, (0.95, 0.55), 0.9), HULL_RADIUS_M)


@pytest.mark.parametrize(
    ("wanted", "at_s", "room_m"),
    [
        (proposal((0.25, 0.0, 1.0), (1.0 + 1e-6, 0.0, 0.0)), 0.5, 9.0),
        (proposal(velocity=(0.5, 0.0, 0.0)), 0.5, 0.5),
        (proposal(velocity=(0.3 + 1e-6, 0.0, 0.0), retreating=True), 0.5, 9.0),
        (proposal(acceleration=(0.0, 2.0 + 1e-6, 0.0)), 0.5, 9.0),
        (proposal(yaw_rate=0.8 + 1e-6), 0.5, 9.0),
        (proposal((0.5**2 * 2.0 / 4.0 + 0.02, 0.0, 1.0)), 0.5, 9.0),
        (proposal((0.0, 0.07, 1.0), (0.0, 2.0 * 0.25 + 0.05 - 1e-9, 0.0)), 0.25, 9.0),
        (proposal(yaw=0.8 * 0.5 + 0.03 - 1e-9), 0.5, 9.0),
    ],
)
def test_a_limit_and_the_slack_beside_it_are_flown(wanted: SetpointProposal, at_s: float, room_m: float) -> None:
    guard = guard_of()
    guard.clear(None, situation(0.0))
    assert guard.clear(wanted, situation(at_s, ahead=wall(room_m, at_s)))[1] is None


def test_braking_may_be_longer_than_the_silent_way_but_only_while_the_mission_speaks() -> None:
    for age_s, reason in ((0.0, None), (-0.05, None), (NEAR, ReasonCode.MISSION_STALE)):
        guard = guard_of(bounds=dataclasses.replace(BOUNDS, silence_way_m=0.2))
        guard.clear(None, situation(10.0))
        found = guard.clear(proposal((0.25, 0.0, 1.0), (1.0, 0.0, 0.0)), situation(10.5, intent_age_s=age_s))[1]
        assert (found and found.reason.code) is reason


def test_a_clock_may_begin_anywhere() -> None:
    guard = resting(at_s=-5.0)
    assert refusal(guard, proposal(HERE), -4.9) is None


def test_the_take_off_column_stands_over_where_the_vehicle_is() -> None:
    free = everything()
    free[23, 26, 18] = False  # its centre at 0.35, -0.35, 0.85: over this place, and over no other that is tried by mistake
    here = situation(0.0, position_m=(0.3, -0.2, 0.0), free=known_free(free))
    assert guard_of().takeoff_fault(here, 1.1) == Reason(ReasonCode.TAKEOFF_COLUMN_NOT_FREE)
    assert guard_of().takeoff_fault(here, 0.7) is None


@pytest.mark.parametrize("push_mps2", [1.5, 2.5])
def test_another_acceleration_is_another_brake_another_silence_and_another_distance(push_mps2: float) -> None:
    envelope = dataclasses.replace(ENVELOPE, max_acceleration_mps2=push_mps2)

    def flying(**changes: Any) -> tuple[Guard, Reason | None]:
        guard = guard_of(envelope)
        guard.clear(None, situation(10.0, position_m=tuple(HERE.tolist())))
        return guard, refusal(guard, proposal(HERE + along_x(0.175), (0.7, 0.0, 0.0)), 10.5, **changes)

    guard, reason = flying()
    assert reason is None
    np.testing.assert_allclose(
        guard.clear(None, situation(20.0))[0].setpoint.position_m,
        HERE + along_x(0.175 + 0.49 / (2.0 * push_mps2)),
        atol=1e-9,
    )
    silent_s = (0.5 - 0.49 / (2.0 * push_mps2)) / 0.7
    room_m = 0.4 + (0.49 - 0.25) / (2.0 * push_mps2) + 0.7 * 0.25 + 0.7 * 0.1
    for beyond, may in ((-NEAR, True), (NEAR, False)):
        assert (flying(intent_age_s=min(silent_s, 0.5) + beyond)[1] is None) is may
        assert (flying(ahead=wall(room_m - beyond, 10.4))[1] is None) is may


@pytest.mark.parametrize(
    ("age_s", "counted_s", "retreating"),
    [(0.0, 0.0, False), (-0.09, 0.0, False), (0.2, 0.2, False), (0.2, 0.2, True), (3.0, 0.3, True), (-3.0, 0.0, True)],
)
def test_a_frame_takes_the_way_of_its_age_and_on_a_retreat_no_more_than_of_one_that_may_be_flown_by(
    age_s: float, counted_s: float, retreating: bool
) -> None:
    room_m = 0.1 + 0.3**2 / 4.0 + 0.3 * 0.25 + 0.3 * counted_s
    for beyond, may in ((NEAR, True), (-NEAR, False)):
        wanted = proposal(HERE, (0.3, 0.0, 0.0), retreating=retreating)
        assert (refusal(resting(), wanted, 10.5, ahead=wall(room_m + beyond, 10.5 - age_s)) is None) is may


def test_a_frame_may_be_ahead_of_the_clock_by_just_as_much_as_agreed() -> None:
    guard = guard_of()
    guard.clear(None, situation(0.0))
    assert guard.clear(proposal(velocity=(0.04, 0.0, 0.0)), situation(0.0, ahead=wall(5.0, 0.1)))[1] is None


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_no_hold_but_a_hold_does_without_known_free_space(axis: int, sign: float) -> None:
    nudge = np.zeros(3)
    nudge[axis] = sign * 0.015
    for wanted in (proposal(HERE + nudge), proposal(HERE, nudge)):
        assert refusal(resting(), wanted, 10.1, free=None) == Reason(ReasonCode.NO_FREE_SPACE)
    assert refusal(resting(), proposal(HERE), 10.1, free=None) is None


def test_where_the_camera_does_not_look_turns_with_the_nose_and_is_not_asked_of_a_retreat() -> None:
    """The nose to +y in odom: there it looks, along -x it does not."""
    nose: dict[str, Any] = {"body_from_odom": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])}

    def blind(velocity: tuple[float, float, float], blind_speed_mps: float = 0.3, **changes: Any) -> Reason | None:
        guard = guard_of(bounds=dataclasses.replace(BOUNDS, blind_speed_mps=blind_speed_mps))
        guard.clear(None, situation(10.0, position_m=tuple(HERE.tolist())))
        return refusal(guard, proposal(HERE, velocity, **changes), 10.5, **nose)

    assert blind((0.0, 0.5, 0.0)) is None
    assert blind((-0.1, 0.0, 0.0)) == Reason(ReasonCode.NOT_SEEN_RECENTLY, (0.75, 0.2, 1.1))
    assert blind((0.0, -0.1, 0.0)) == Reason(ReasonCode.NOT_SEEN_RECENTLY, (1.0, -0.05, 1.1))
    assert blind((-0.24, 0.18, 0.0)) == Reason(ReasonCode.NOT_SEEN_RECENTLY, (0.8, 0.35, 1.1))
    assert blind((-0.1, 0.0, 0.0), retreating=True) is None
    at_the_limit = blind((-0.3 - 1e-6, 0.0, 0.0))
    assert at_the_limit is not None
    assert at_the_limit.code is ReasonCode.NOT_SEEN_RECENTLY
    assert blind((-0.3 - NEAR, 0.0, 0.0)) == Reason(ReasonCode.SPEED_OUT_OF_VIEW, (0.3,))
    assert blind((-0.5, 0.0, 0.0), blind_speed_mps=1.5) is None, "more than the envelope's speed is not asked for either"


def test_a_first_place_or_heading_that_is_no_number_is_the_pad_and_ahead() -> None:
    for changes in ({"position_m": (0.5, math.inf, 1.0)}, {"yaw_rad": math.nan}):
        held = guard_of().clear(None, situation(0.0, **{"yaw_rad": 0.7, "position_m": (0.5, 0.0, 1.0), **changes}))[0].setpoint
        np.testing.assert_array_equal(held.position_m, ENVELOPE.pad_m)
        assert held.yaw_rad == 0.0


@pytest.mark.parametrize(
    ("space_epoch", "refused"),
    [
        (999, Reason(ReasonCode.FREE_SPACE_MAP_EPOCH, (999, 1000))),
        (1000, None),
        (1001, Reason(ReasonCode.FREE_SPACE_MAP_EPOCH, (1001, 1000))),
    ],
)
def test_space_of_another_epoch_older_or_newer_is_not_flown_through(space_epoch: int, refused: bool) -> None:
    wanted = dataclasses.replace(proposal(HERE, (0.02, 0.0, 0.0)), map_epoch=int("1000"))
    found = refusal(resting(), wanted, 10.1, map_epoch=int("1000"), free=known_free(everything(), epoch=space_epoch))
    assert found == (Reason(ReasonCode.FREE_SPACE_MAP_EPOCH, (space_epoch, 1000)) if refused else None)


def test_one_trajectory_is_one_episode_however_high_its_number() -> None:
    guard = resting()
    for n in range(1, 4):
        refusal(guard, proposal((9.0, 0.0, 1.0), identifier=int("1000")), 10.0 + n * 0.03)
    assert guard.refusals.total == 1


def test_a_clock_that_goes_back_does_not_speed_up_the_brake() -> None:
    guard = resting()
    assert refusal(guard, proposal(HERE, 0.5 * OBLIQUE), 10.45) is None
    for now_s in (10.4, 10.0):
        flown = guard.clear(None, situation(now_s))[0].setpoint
        np.testing.assert_allclose(flown.position_m, HERE, atol=1e-12)
        np.testing.assert_allclose(flown.velocity_mps, 0.5 * OBLIQUE, atol=1e-12)


def test_four_numbers_are_no_place() -> None:
    assert refusal(resting(), proposal((*HERE, 0.0)), 10.1) == Reason(ReasonCode.SETPOINT_NOT_FINITE)
