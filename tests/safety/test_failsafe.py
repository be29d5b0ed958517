"""The ladder, rung by rung: when it goes down, and how it comes up again."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from uav_recon.safety.failsafe import Failsafe, FailsafeAction, FailsafeInputs, FailsafeTimeouts

PATIENCE = FailsafeTimeouts(0.2, 1.0, 0.5, 5.0, 20.0, 0.3, 3.0, 10.0)


def health(now_s: float, **changes: Any) -> FailsafeInputs:
    return dataclasses.replace(FailsafeInputs(now_s, 0.03, 0.05, 0.1, True, 0), **changes)


@pytest.mark.parametrize(
    ("changes", "rung", "why"),
    [
        ({}, FailsafeAction.FLY, ""),
        ({"pose_age_s": 0.2}, FailsafeAction.FLY, ""),
        ({"pose_age_s": 0.21}, FailsafeAction.HOLD, "no pose for 0.2 s"),
        ({"pose_age_s": 1.0}, FailsafeAction.HOLD, "no pose"),
        ({"pose_age_s": 1.01}, FailsafeAction.LAND, "no pose"),
        ({"pose_age_s": math.nan}, FailsafeAction.LAND, "no pose"),
        ({"intent_age_s": 0.5}, FailsafeAction.FLY, ""),
        ({"intent_age_s": 0.51}, FailsafeAction.HOLD, "mission silent for 0.5 s"),
        ({"intent_age_s": 5.01}, FailsafeAction.RETREAT, "mission silent"),
        ({"intent_age_s": 20.01}, FailsafeAction.LAND, "mission silent"),
        ({"depth_age_s": 0.3}, FailsafeAction.FLY, ""),
        ({"depth_age_s": 0.31}, FailsafeAction.HOLD, "no depth for 0.3 s"),
        ({"depth_age_s": 3.01}, FailsafeAction.RETREAT, "no depth"),
        ({"depth_age_s": math.inf}, FailsafeAction.LAND, "no depth"),
        ({"depth_age_s": 4.0, "pose_age_s": 0.5}, FailsafeAction.RETREAT, "no depth"),
        ({"depth_age_s": 4.0, "pose_age_s": 2.0}, FailsafeAction.LAND, "no pose"),
        ({"lost": "poses disagree for 0.3 s"}, FailsafeAction.HOLD, "poses disagree"),
        ({"lost": "poses disagree for 1.2 s", "pose_age_s": 1.01}, FailsafeAction.LAND, "no pose"),
        ({"refused_s": 20.0}, FailsafeAction.FLY, ""),
        ({"refused_s": 20.01}, FailsafeAction.LAND, "refused for 20.0 s"),
        ({"refused_s": 19.0, "depth_age_s": 0.5}, FailsafeAction.HOLD, "no depth"),
        ({"wrong": "odom creeps"}, FailsafeAction.LAND, "odom creeps"),
        ({"wrong": "odom creeps", "depth_age_s": 4.0}, FailsafeAction.LAND, "odom creeps"),
        ({"wrong": "odom creeps", "inside": False}, FailsafeAction.LAND, "odom creeps"),
    ],
)
def test_the_worst_silence_names_the_rung(changes: dict[str, Any], rung: FailsafeAction, why: str) -> None:
    found, reason = Failsafe(PATIENCE).step(health(0.0, **changes))
    assert found is rung
    assert reason.startswith(why)
    assert bool(reason) is bool(why)


def test_from_holding_it_comes_up_at_once_from_retreating_after_two_healthy_seconds_from_landing_never() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(0.0, intent_age_s=1.0))[0] is FailsafeAction.HOLD
    assert ladder.step(health(0.1))[0] is FailsafeAction.FLY
    assert ladder.step(health(1.0, intent_age_s=6.0))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(2.0, intent_age_s=1.0))[0] is FailsafeAction.RETREAT, "holding is not healthy"
    assert ladder.step(health(3.0)) == (FailsafeAction.RETREAT, "mission silent for 6.0 s")
    assert ladder.step(health(4.9))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(4.95, pose_age_s=0.3))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(5.0))[0] is FailsafeAction.RETREAT, "healthy anew"
    assert ladder.step(health(6.99))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(7.0)) == (FailsafeAction.FLY, "")
    assert ladder.step(health(8.0, pose_age_s=2.0))[0] is FailsafeAction.LAND
    assert ladder.step(health(99.0)) == (FailsafeAction.LAND, "no pose for 2.0 s")
    assert ladder.step(health(102.0)) == (FailsafeAction.LAND, "no pose for 2.0 s"), "however long it has been healthy"


def test_a_retreat_is_left_once_it_was_healthy_for_longer_than_it_must_be() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(0.0, intent_age_s=6.0))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(1.0))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(3.5)) == (FailsafeAction.FLY, "")


def test_a_push_over_the_fence_may_last_three_seconds() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(0.0, inside=False))[0] is FailsafeAction.FLY
    assert ladder.step(health(2.0, inside=False))[0] is FailsafeAction.FLY
    assert ladder.step(health(2.5))[0] is FailsafeAction.FLY
    assert ladder.step(health(5.5, inside=False))[0] is FailsafeAction.FLY
    assert ladder.step(health(5.51, inside=False)) == (FailsafeAction.LAND, "outside the fence for 3 s")


def test_three_refusals_in_a_second_are_not_listened_to_for_two() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(0.0, refusals=40))[0] is FailsafeAction.FLY, "those of an earlier flight"
    assert ladder.step(health(0.1, refusals=41))[0] is FailsafeAction.FLY
    assert ladder.step(health(0.2, refusals=42))[0] is FailsafeAction.FLY
    assert ladder.step(health(1.1, refusals=43)) == (FailsafeAction.HOLD, "3 refusals in a second")
    assert ladder.step(health(2.1, refusals=43))[0] is FailsafeAction.HOLD
    assert ladder.step(health(2.2, refusals=43))[0] is FailsafeAction.FLY
    for n in range(3):
        ladder.step(health(5.0 + 0.3 * n, refusals=44 + n))
    assert ladder.step(health(5.7, refusals=46)) == (FailsafeAction.HOLD, "3 refusals in a second"), "within less than one too"
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
    assert ladder.step(health(20.1, depth_age_s=0.5)) == (FailsafeAction.LAND, "no depth for 0.5 s, holding for 20 s")


def test_a_moment_of_flight_is_a_new_patience() -> None:
    ladder = Failsafe(PATIENCE)
    for now_s in (0.0, 19.0, 30.0, 49.0):
        assert ladder.step(health(now_s, depth_age_s=0.5))[0] is FailsafeAction.HOLD
        assert ladder.step(health(now_s + 0.5))[0] is FailsafeAction.FLY


def test_a_retreat_that_has_barely_begun_is_left_at_once() -> None:
    ladder = Failsafe(PATIENCE)
    assert ladder.step(health(5.01, intent_age_s=5.01))[0] is FailsafeAction.RETREAT
    assert ladder.step(health(5.11, intent_age_s=1.0))[0] is FailsafeAction.RETREAT, "holding is not healthy"
    assert ladder.step(health(5.20)) == (FailsafeAction.FLY, "")
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
    assert ladder.step(health(0.0, intent_age_s=6.0)) == (FailsafeAction.RETREAT, "mission silent for 6.0 s")
    assert ladder.step(health(1.0, depth_age_s=4.0)) == (FailsafeAction.RETREAT, "no depth for 4.0 s")
    assert ladder.step(health(2.0, pose_age_s=1.5)) == (FailsafeAction.LAND, "no pose for 1.5 s")
    assert ladder.step(health(3.0, pose_age_s=2.5)) == (FailsafeAction.LAND, "no pose for 2.5 s")


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
