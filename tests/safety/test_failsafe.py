"""The ladder, rung by rung: when it goes down, and how it comes up again."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from uav_recon.safety.failsafe import Failsafe, FailsafeAction, FailsafeInputs, FailsafeTimeouts
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode, Value

PATIENCE = FailsafeTimeouts(
    pose_timeout_s=0.2,
    pose_land_s=1.0,
    intent_timeout_s=0.5,
    retreat_timeout_s=5.0,
    land_timeout_s=20.0,
    depth_timeout_s=0.3,
    depth_retreat_s=3.0,
    depth_land_s=10.0,
)


def because(code: ReasonCode, *values: Value) -> Reason:
    return Reason(code, values)


UNSURE = because(ReasonCode.PLACE_UNSURE, 0.09)
DISAGREE, DRIFT = because(ReasonCode.POSES_DISAGREE, 0.3), because(ReasonCode.ODOMETRY_DRIFT, 0.05)


def health(now_s: float, **changes: Any) -> FailsafeInputs:
    return dataclasses.replace(FailsafeInputs(now_s, 0.03, 0.05, 0.1, True, 0), **changes)


@pytest.mark.parametrize(
    ("changes", "rung", "why"),
    [
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
def test_the_worst_silence_names_the_rung(changes: dict[str, Any], rung: FailsafeAction, why: Reason | None) -> None:
    found, reason = Failsafe(PATIENCE).step(health(0.0, **changes))
    assert found is rung
    assert reason == why


def test_from_holding_it_comes_up_at_once_from_retreating_after_two_healthy_seconds_from_landing_never() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(0.0, intent_age_s=1.0))[0] is FailsafeAction.HOLD
    assert ladder.step(health(0.1))[0] is FailsafeAction.FLY
    assert ladder.step(health(1.0, intent_age_s=6.0))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(2.0, intent_age_s=1.0))[0] is FailsafeAction.RETREAT, "holding is not healthy"
    assert ladder.step(health(3.0)) == (FailsafeAction.RETREAT, because(ReasonCode.MISSION_SILENT, 6.0))
    assert ladder.step(health(4.9))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(4.95, pose_age_s=0.3))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(5.0))[0] is FailsafeAction.RETREAT, "healthy again"
    assert ladder.step(health(6.99))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(7.0)) == (FailsafeAction.FLY, None)
    assert ladder.step(health(8.0, pose_age_s=2.0))[0] is FailsafeAction.LAND
    assert ladder.step(health(99.0)) == (FailsafeAction.LAND, because(ReasonCode.NO_POSE, 2.0))
    assert ladder.step(health(102.0)) == (FailsafeAction.LAND, because(ReasonCode.NO_POSE, 2.0)), (
        "however long it has been healthy"
    )


def test_a_retreat_is_left_once_it_was_healthy_for_longer_than_it_must_be() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(0.0, intent_age_s=6.0))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(1.0))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(3.5)) == (FailsafeAction.FLY, None)


def test_a_push_over_the_fence_may_last_three_seconds() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(0.0, inside=False))[0] is FailsafeAction.FLY
    assert ladder.step(health(2.0, inside=False))[0] is FailsafeAction.FLY
    assert ladder.step(health(2.5))[0] is FailsafeAction.FLY
    assert ladder.step(health(5.5, inside=False))[0] is FailsafeAction.FLY
    assert ladder.step(health(5.51, inside=False)) == (FailsafeAction.LAND, because(ReasonCode.OUTSIDE_FENCE_TOO_LONG, 3.0))


def test_three_refusals_in_a_second_are_not_listened_to_for_two() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(0.0, refusals=40))[0] is FailsafeAction.FLY, "those of an earlier flight"
    assert ladder.step(health(0.1, refusals=41))[0] is FailsafeAction.FLY
    assert ladder.step(health(0.2, refusals=42))[0] is FailsafeAction.FLY
    assert ladder.step(health(1.1, refusals=43)) == (FailsafeAction.HOLD, because(ReasonCode.MANY_REFUSALS, 3))
    assert ladder.step(health(2.1, refusals=43))[0] is FailsafeAction.HOLD
    assert ladder.step(health(2.2, refusals=43))[0] is FailsafeAction.FLY
    for n in range(3):
        ladder.step(health(5.0 + 0.3 * n, refusals=44 + n))
    assert ladder.step(health(5.7, refusals=46)) == (FailsafeAction.HOLD, because(ReasonCode.MANY_REFUSALS, 3)), (
        "within less than one too"
    )
    assert ladder.step(health(7.7, refusals=46))[0] is FailsafeAction.FLY
    for n in range(6):
        assert ladder.step(health(10.0 + 0.6 * n, refusals=47 + n))[0] is FailsafeAction.FLY, (
            "slower than that is a mission at work"
        )


def test_holding_for_long_is_nobody_flying_and_lands() -> None:
    ladder = Failsafe(PATIENCE)
    for n in range(40):
        assert ladder.step(health(0.5 * n, depth_age_s=0.5))[0] is FailsafeAction.HOLD, (
            "late frames, that is no silence to land for"
        )
    assert ladder.step(health(20.0, depth_age_s=0.5))[0] is FailsafeAction.HOLD
    assert ladder.step(health(20.1, depth_age_s=0.5)) == (
        FailsafeAction.LAND,
        because(ReasonCode.NO_DEPTH, 0.5).with_detail(because(ReasonCode.HELD_TOO_LONG, 20.0)),
    )


def test_a_moment_of_flight_is_a_new_patience() -> None:
    ladder = Failsafe(PATIENCE)
    for now_s in (0.0, 19.0, 30.0, 49.0):
        assert ladder.step(health(now_s, depth_age_s=0.5))[0] is FailsafeAction.HOLD
        assert ladder.step(health(now_s + 0.5))[0] is FailsafeAction.FLY


def test_a_retreat_that_has_barely_begun_is_left_at_once() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(5.01, intent_age_s=5.01))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(5.11, intent_age_s=1.0))[0] is FailsafeAction.RETREAT, "holding is not healthy"
    assert ladder.step(health(5.20)) == (FailsafeAction.FLY, None)
    assert ladder.step(health(15.0, intent_age_s=5.01))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(15.15, intent_age_s=5.16))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(15.25))[0] is FailsafeAction.RETREAT, "the age of the retreat counts, not of its last reason"


def test_a_retreat_counts_as_begun_after_a_fifth_of_a_second_and_not_at_it() -> None:
    for age_s, rung in ((0.2, FailsafeAction.FLY), (0.201, FailsafeAction.RETREAT)):
        ladder = Failsafe(PATIENCE)
        assert ladder.step(health(0.0, intent_age_s=6.0))[0] is FailsafeAction.RETREAT
        assert ladder.step(health(age_s))[0] is rung


def test_on_the_same_rung_the_newest_reason_is_told() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(0.0, intent_age_s=6.0)) == (FailsafeAction.RETREAT, because(ReasonCode.MISSION_SILENT, 6.0))
    assert ladder.step(health(1.0, depth_age_s=4.0)) == (FailsafeAction.RETREAT, because(ReasonCode.NO_DEPTH, 4.0))
    assert ladder.step(health(2.0, pose_age_s=1.5)) == (FailsafeAction.LAND, because(ReasonCode.NO_POSE, 1.5))
    assert ladder.step(health(3.0, pose_age_s=2.5)) == (FailsafeAction.LAND, because(ReasonCode.NO_POSE, 2.5))


def test_a_count_that_falls_is_no_refusal() -> None:
    ladder = Failsafe(PATIENCE)
    for n in range(5):
        assert ladder.step(health(0.1 * n, refusals=40 - n))[0] is FailsafeAction.FLY


def test_a_clock_may_begin_anywhere() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(-50.0))[0] is FailsafeAction.FLY
    assert ladder.step(health(-49.0, inside=False, depth_age_s=0.5))[0] is FailsafeAction.HOLD
    assert ladder.step(health(-47.0, inside=False))[0] is FailsafeAction.FLY
    assert ladder.step(health(-45.9, inside=False))[0] is FailsafeAction.LAND
