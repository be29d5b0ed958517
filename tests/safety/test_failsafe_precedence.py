"""The failsafe against a second implementation: precedence by nested conditions, over random sequences of inputs."""

from __future__ import annotations

import math
import random

from guard_rooms import TIMEOUTS
from test_failsafe import DISAGREE, DRIFT, UNSURE

from uav_recon.safety.failsafe import Failsafe
from uav_recon.safety.failsafe_precedence import FailsafeAction, FailsafeInputs
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

AGES_S = (
    0.0,
    0.05,
    0.2,
    0.21,
    0.3,
    0.31,
    0.5,
    0.51,
    1.0,
    1.01,
    3.0,
    3.01,
    5.0,
    5.01,
    10.0,
    10.01,
    20.0,
    20.01,
    math.inf,
    math.nan,
)


class NestedFailsafe:
    """Takes the worst silence first; then what lands, what retreats, and what holds."""

    def __init__(self) -> None:
        self.action = FailsafeAction.FLY
        self.reason: Reason | None = None
        self.healthy_since_s = self.held_since_s = self.inside_s = self.retreat_s = math.inf

    def step(self, x: FailsafeInputs) -> tuple[FailsafeAction, Reason | None]:
        action, reason = self.required(x)
        self.held_since_s = math.inf if action is FailsafeAction.FLY else min(self.held_since_s, x.now_s)
        if x.now_s - self.held_since_s > TIMEOUTS.land_timeout_s:
            held = Reason(ReasonCode.HELD_TOO_LONG, (TIMEOUTS.land_timeout_s,))
            action, reason = FailsafeAction.LAND, held if reason is None else reason.with_detail(held)
        self.healthy_since_s = min(self.healthy_since_s, x.now_s) if action is FailsafeAction.FLY else math.inf
        wait_s = 2.0 if x.now_s - self.retreat_s > 0.2 else 0.0
        well = action is FailsafeAction.FLY and x.now_s - self.healthy_since_s >= wait_s
        if action >= self.action or self.action is FailsafeAction.HOLD or (self.action is FailsafeAction.RETREAT and well):
            self.retreat_s = self.retreat_s if self.action is FailsafeAction.RETREAT else x.now_s
            self.action, self.reason = action, reason
        return self.action, self.reason

    def required(self, x: FailsafeInputs) -> tuple[FailsafeAction, Reason | None]:
        self.inside_s = x.now_s if x.inside else min(self.inside_s, x.now_s)
        outside = Reason(ReasonCode.OUTSIDE_FENCE_TOO_LONG, (3.0,)) if x.now_s - self.inside_s > 3.0 else None
        silences = (
            (ReasonCode.NO_POSE, x.pose_age_s, (0.2, math.inf, 1.0)),
            (ReasonCode.MISSION_SILENT, x.intent_age_s, (0.5, 5.0, 20.0)),
            (ReasonCode.DEPTH_NOT_BELIEVED if x.depth_rejected else ReasonCode.NO_DEPTH, x.depth_age_s, (0.3, 3.0, 10.0)),
            (ReasonCode.REFUSED_TOO_LONG, x.refused_s, (math.inf, math.inf, 20.0)),
        )
        actions = [max((n for n, limit_s in enumerate(row[2], 1) if not row[1] <= limit_s), default=0) for row in silences]
        worst = max(actions)
        if worst < FailsafeAction.LAND and (outside or x.wrong):
            return FailsafeAction.LAND, outside or x.wrong
        if worst > FailsafeAction.FLY:
            code, age_s, _ = silences[actions.index(worst)]
            return FailsafeAction(worst), Reason(code, (age_s,))
        if x.unsure:
            return FailsafeAction.RETREAT, x.unsure
        reason = x.lost or (Reason(ReasonCode.MANY_REFUSALS, (3,)) if x.many_refusals else None)
        return FailsafeAction.HOLD if reason else FailsafeAction.FLY, reason


def inputs_at(now_s: float, draw: random.Random, trouble: float) -> FailsafeInputs:
    """Draw inputs; each is in trouble with this probability."""

    def age_s() -> float:
        return draw.choice(AGES_S) if draw.random() < trouble else 0.05

    return FailsafeInputs(
        now_s, age_s(), age_s(), age_s(), draw.random() > trouble, draw.random() < trouble,
        DISAGREE if draw.random() < trouble else None, DRIFT if draw.random() < trouble / 20 else None,
        age_s(), draw.random() < 0.5, UNSURE if draw.random() < trouble else None,
    )  # fmt: skip


def same(one: tuple[FailsafeAction, Reason | None], other: tuple[FailsafeAction, Reason | None]) -> bool:
    return repr(one) == repr(other)  # a NaN is not equal to itself


def test_the_table_has_the_precedence_of_nested_conditions() -> None:
    draw, seen = random.Random(5), set()
    for _ in range(400):
        now_s, trouble = draw.uniform(-50.0, 50.0), draw.choice((0.02, 0.1, 0.3))
        table, nested = Failsafe(TIMEOUTS), NestedFailsafe()
        for _ in range(40):
            now_s += draw.choice((0.01, 0.1, 0.2, 0.21, 1.0, 3.01))
            inputs = inputs_at(now_s, draw, trouble)
            found = table.step(inputs)
            assert same(found, nested.step(inputs)), inputs
            seen.add((found[0], None if found[1] is None else found[1].code))
    assert len(seen) == 21, "each action was reached by each of its causes, and by having held too long"
