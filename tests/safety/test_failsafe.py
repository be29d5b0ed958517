"""The failsafe, rung by rung: when it goes down, and how it comes up again."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
from guard_rooms import TIMEOUTS

from uav_recon.safety.failsafe import Failsafe
from uav_recon.safety.failsafe_precedence import (
    CONDITIONS,
    ClearCondition,
    FailsafeAction,
    FailsafeInputs,
    FailsafeTimeouts,
    Override,
)
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode, Value

ACTIONS = {
    "pose_timeout_s": FailsafeAction.HOLD,
    "pose_land_s": FailsafeAction.LAND,
    "intent_timeout_s": FailsafeAction.HOLD,
    "retreat_timeout_s": FailsafeAction.RETREAT,
    "land_timeout_s": FailsafeAction.LAND,
    "depth_timeout_s": FailsafeAction.HOLD,
    "depth_retreat_s": FailsafeAction.RETREAT,
    "depth_land_s": FailsafeAction.LAND,
}
CLEARS = {
    FailsafeAction.HOLD: ClearCondition.AT_ONCE,
    FailsafeAction.RETREAT: ClearCondition.GOOD_HEALTH,
    FailsafeAction.LAND: ClearCondition.NEVER,
}
OVERRIDES = {
    FailsafeAction.HOLD: (Override.LAND,),
    FailsafeAction.RETREAT: (Override.OPERATOR_HOLD, Override.LAND),
    FailsafeAction.LAND: (),
}


def because(code: ReasonCode, *values: Value) -> Reason:
    return Reason(code, values)


UNSURE = because(ReasonCode.PLACE_UNSURE, 0.09)
DISAGREE, DRIFT = because(ReasonCode.POSES_DISAGREE, 0.3), because(ReasonCode.ODOMETRY_DRIFT, 0.05)


def health(now_s: float, **changes: Any) -> FailsafeInputs:
    return dataclasses.replace(FailsafeInputs(now_s, 0.03, 0.05, 0.1, True), **changes)


@pytest.mark.parametrize(
    ("changes", "action", "why"),
    [
        ({"depth_age_s": 0.45, "one_missing_s": 0.45}, FailsafeAction.FLY, None),
        ({"depth_age_s": 0.46, "one_missing_s": 0.45}, FailsafeAction.HOLD, because(ReasonCode.NO_DEPTH, 0.46)),
        ({"depth_age_s": 0.51, "one_missing_s": 9.0}, FailsafeAction.HOLD, because(ReasonCode.NO_DEPTH, 0.51)),
        ({"depth_age_s": 3.1, "one_missing_s": 9.0}, FailsafeAction.RETREAT, because(ReasonCode.NO_DEPTH, 3.1)),
        ({"depth_age_s": 10.1, "one_missing_s": 99.0}, FailsafeAction.LAND, because(ReasonCode.NO_DEPTH, 10.1)),
        ({}, FailsafeAction.FLY, None),
        ({"pose_age_s": 0.2}, FailsafeAction.FLY, None),
        ({"pose_age_s": 0.21}, FailsafeAction.HOLD, because(ReasonCode.NO_POSE, 0.2)),
        ({"pose_age_s": 1.0}, FailsafeAction.HOLD, because(ReasonCode.NO_POSE, 1.0)),
        ({"pose_age_s": 1.01}, FailsafeAction.LAND, because(ReasonCode.NO_POSE, 1.0)),
        ({"pose_age_s": math.nan}, FailsafeAction.LAND, because(ReasonCode.NO_POSE, math.nan)),
        ({"intent_age_s": 0.5}, FailsafeAction.FLY, None),
        ({"intent_age_s": 0.51}, FailsafeAction.HOLD, because(ReasonCode.MISSION_SILENT, 0.5)),
        ({"intent_age_s": 5.01}, FailsafeAction.RETREAT, because(ReasonCode.MISSION_SILENT, 5.0)),
        ({"intent_age_s": 20.01}, FailsafeAction.LAND, because(ReasonCode.MISSION_SILENT, 20.0)),
        ({"depth_age_s": 0.3}, FailsafeAction.FLY, None),
        ({"depth_age_s": 0.31}, FailsafeAction.HOLD, because(ReasonCode.NO_DEPTH, 0.3)),
        ({"depth_age_s": 3.01}, FailsafeAction.RETREAT, because(ReasonCode.NO_DEPTH, 3.0)),
        ({"depth_age_s": 3.01, "depth_rejected": True}, FailsafeAction.RETREAT, because(ReasonCode.DEPTH_NOT_BELIEVED, 3.0)),
        ({"depth_age_s": 0.2, "depth_rejected": True}, FailsafeAction.FLY, None),
        ({"depth_age_s": math.inf}, FailsafeAction.LAND, because(ReasonCode.NO_DEPTH, math.inf)),
        ({"depth_age_s": 4.0, "pose_age_s": 0.5}, FailsafeAction.RETREAT, because(ReasonCode.NO_DEPTH, 4.0)),
        ({"depth_age_s": 4.0, "pose_age_s": 2.0}, FailsafeAction.LAND, because(ReasonCode.NO_POSE, 2.0)),
        ({"lost": DISAGREE}, FailsafeAction.HOLD, DISAGREE),
        ({"unsure": UNSURE}, FailsafeAction.RETREAT, UNSURE),
        ({"unsure": UNSURE, "depth_age_s": 0.5}, FailsafeAction.HOLD, because(ReasonCode.NO_DEPTH, 0.5)),
        ({"unsure": UNSURE, "lost": DISAGREE}, FailsafeAction.RETREAT, UNSURE),
        ({"lost": DISAGREE, "many_refusals": True}, FailsafeAction.HOLD, DISAGREE),
        ({"many_refusals": True, "intent_age_s": 0.6}, FailsafeAction.HOLD, because(ReasonCode.MISSION_SILENT, 0.6)),
        ({"unsure": UNSURE, "pose_age_s": 1.01}, FailsafeAction.LAND, because(ReasonCode.NO_POSE, 1.0)),
        ({"lost": DISAGREE, "pose_age_s": 1.01}, FailsafeAction.LAND, because(ReasonCode.NO_POSE, 1.0)),
        ({"refused_s": 20.0}, FailsafeAction.FLY, None),
        ({"refused_s": 20.01}, FailsafeAction.LAND, because(ReasonCode.REFUSED_TOO_LONG, 20.0)),
        ({"refused_s": 19.0, "depth_age_s": 0.5}, FailsafeAction.HOLD, because(ReasonCode.NO_DEPTH, 0.5)),
        ({"wrong": DRIFT}, FailsafeAction.LAND, DRIFT),
        ({"wrong": DRIFT, "depth_age_s": 4.0}, FailsafeAction.LAND, DRIFT),
        ({"wrong": DRIFT, "inside": False}, FailsafeAction.LAND, DRIFT),
    ],
)
def test_the_first_condition_gives_action_and_reason(
    changes: dict[str, Any], action: FailsafeAction, why: Reason | None
) -> None:
    found, reason = Failsafe(TIMEOUTS).step(health(0.0, **changes))
    assert found is action
    assert reason == why


def test_from_holding_it_comes_up_at_once_from_retreating_after_two_healthy_seconds_from_landing_never() -> None:
    failsafe = Failsafe(TIMEOUTS)
    assert failsafe.step(health(0.0, intent_age_s=1.0))[0] is FailsafeAction.HOLD
    assert failsafe.step(health(0.1))[0] is FailsafeAction.FLY
    assert failsafe.step(health(1.0, intent_age_s=6.0))[0] is FailsafeAction.RETREAT
    assert failsafe.step(health(2.0, intent_age_s=1.0))[0] is FailsafeAction.RETREAT, "holding is not healthy"
    assert failsafe.step(health(3.0)) == (FailsafeAction.RETREAT, because(ReasonCode.MISSION_SILENT, 6.0))
    assert failsafe.step(health(4.9))[0] is FailsafeAction.RETREAT
    assert failsafe.step(health(4.95, pose_age_s=0.3))[0] is FailsafeAction.RETREAT
    assert failsafe.step(health(5.0))[0] is FailsafeAction.RETREAT, "healthy again, from now on"
    assert failsafe.step(health(6.99))[0] is FailsafeAction.RETREAT
    assert failsafe.step(health(7.0)) == (FailsafeAction.FLY, None)
    assert failsafe.step(health(8.0, pose_age_s=2.0))[0] is FailsafeAction.LAND
    assert failsafe.step(health(99.0)) == (FailsafeAction.LAND, because(ReasonCode.NO_POSE, 2.0))
    assert failsafe.step(health(102.0)) == (FailsafeAction.LAND, because(ReasonCode.NO_POSE, 2.0)), (
        "however long it has been healthy"
    )


def test_a_retreat_is_left_once_it_was_healthy_for_longer_than_it_must_be() -> None:
    failsafe = Failsafe(TIMEOUTS)
    assert failsafe.step(health(0.0, intent_age_s=6.0))[0] is FailsafeAction.RETREAT
    assert failsafe.step(health(1.0))[0] is FailsafeAction.RETREAT
    assert failsafe.step(health(3.5)) == (FailsafeAction.FLY, None)


def test_a_push_over_the_fence_may_last_three_seconds() -> None:
    failsafe = Failsafe(TIMEOUTS)
    assert failsafe.step(health(0.0, inside=False))[0] is FailsafeAction.FLY
    assert failsafe.step(health(2.0, inside=False))[0] is FailsafeAction.FLY
    assert failsafe.step(health(2.5))[0] is FailsafeAction.FLY
    assert failsafe.step(health(5.5, inside=False))[0] is FailsafeAction.FLY
    assert failsafe.step(health(5.51, inside=False)) == (FailsafeAction.LAND, because(ReasonCode.OUTSIDE_FENCE_TOO_LONG, 3.0))


def test_many_refusals_hold_while_they_are_many() -> None:
    failsafe = Failsafe(TIMEOUTS)
    assert failsafe.step(health(0.0, many_refusals=True)) == (FailsafeAction.HOLD, because(ReasonCode.MANY_REFUSALS, 3))
    assert failsafe.step(health(0.1)) == (FailsafeAction.FLY, None)


def test_holding_for_long_is_nobody_flying_and_lands() -> None:
    failsafe = Failsafe(TIMEOUTS)
    for n in range(40):
        assert failsafe.step(health(0.5 * n, depth_age_s=0.5))[0] is FailsafeAction.HOLD, (
            "late frames, that is no silence to land for"
        )
    assert failsafe.step(health(20.0, depth_age_s=0.5))[0] is FailsafeAction.HOLD
    assert failsafe.step(health(20.1, depth_age_s=0.5)) == (
        FailsafeAction.LAND,
        because(ReasonCode.NO_DEPTH, 0.5).with_detail(because(ReasonCode.HELD_TOO_LONG, 20.0)),
    )


def test_a_moment_of_flight_begins_the_time_again() -> None:
    failsafe = Failsafe(TIMEOUTS)
    for now_s in (0.0, 19.0, 30.0, 49.0):
        assert failsafe.step(health(now_s, depth_age_s=0.5))[0] is FailsafeAction.HOLD
        assert failsafe.step(health(now_s + 0.5))[0] is FailsafeAction.FLY


def test_a_retreat_that_has_barely_begun_is_left_at_once() -> None:
    failsafe = Failsafe(TIMEOUTS)
    assert failsafe.step(health(5.01, intent_age_s=5.01))[0] is FailsafeAction.RETREAT
    assert failsafe.step(health(5.11, intent_age_s=1.0))[0] is FailsafeAction.RETREAT, "holding is not healthy"
    assert failsafe.step(health(5.20)) == (FailsafeAction.FLY, None)
    assert failsafe.step(health(15.0, intent_age_s=5.01))[0] is FailsafeAction.RETREAT
    assert failsafe.step(health(15.15, intent_age_s=5.16))[0] is FailsafeAction.RETREAT
    assert failsafe.step(health(15.25))[0] is FailsafeAction.RETREAT, "the age of the retreat counts, not of its last reason"


def test_a_retreat_counts_as_begun_after_a_fifth_of_a_second_and_not_at_it() -> None:
    for age_s, action in ((0.2, FailsafeAction.FLY), (0.201, FailsafeAction.RETREAT)):
        failsafe = Failsafe(TIMEOUTS)
        assert failsafe.step(health(0.0, intent_age_s=6.0))[0] is FailsafeAction.RETREAT
        assert failsafe.step(health(age_s))[0] is action


def test_the_newest_reason_of_an_action_is_reported() -> None:
    failsafe = Failsafe(TIMEOUTS)
    assert failsafe.step(health(0.0, intent_age_s=6.0)) == (FailsafeAction.RETREAT, because(ReasonCode.MISSION_SILENT, 6.0))
    assert failsafe.step(health(1.0, depth_age_s=4.0)) == (FailsafeAction.RETREAT, because(ReasonCode.NO_DEPTH, 4.0))
    assert failsafe.step(health(2.0, pose_age_s=1.5)) == (FailsafeAction.LAND, because(ReasonCode.NO_POSE, 1.5))
    assert failsafe.step(health(3.0, pose_age_s=2.5)) == (FailsafeAction.LAND, because(ReasonCode.NO_POSE, 2.5))


def test_a_clock_may_begin_anywhere() -> None:
    failsafe = Failsafe(TIMEOUTS)
    assert failsafe.step(health(-50.0))[0] is FailsafeAction.FLY
    assert failsafe.step(health(-49.0, inside=False, depth_age_s=0.5))[0] is FailsafeAction.HOLD
    assert failsafe.step(health(-47.0, inside=False))[0] is FailsafeAction.FLY
    assert failsafe.step(health(-45.9, inside=False))[0] is FailsafeAction.LAND


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(FailsafeTimeouts)])
def test_each_limit_is_exact_and_an_age_that_is_no_number_exceeds_it(name: str) -> None:
    limit_s, action = getattr(TIMEOUTS, name), ACTIONS[name]
    age = "pose_age_s" if name.startswith("pose") else "depth_age_s" if name.startswith("depth") else "intent_age_s"
    for share in (0.9, 0.99, 0.999, 1.0):
        assert Failsafe(TIMEOUTS).step(health(0.0, **{age: share * limit_s}))[0] < action
    for share in (1.0 + 1e-9, 1.001, 1.01, 1.1):
        assert Failsafe(TIMEOUTS).step(health(0.0, **{age: share * limit_s}))[0] is action
    for age_s in (math.inf, math.nan):
        assert Failsafe(TIMEOUTS).step(health(0.0, **{age: age_s}))[0] is FailsafeAction.LAND


def test_every_limit_has_an_action_and_every_action_clears_and_is_overridden_in_one_way() -> None:
    assert set(ACTIONS) == {field.name for field in dataclasses.fields(FailsafeTimeouts)}
    assert [condition.clears for condition in CONDITIONS] == [CLEARS[condition.action] for condition in CONDITIONS]
    assert [condition.overrides for condition in CONDITIONS] == [OVERRIDES[condition.action] for condition in CONDITIONS]
