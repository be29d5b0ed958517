"""Failsafe: selects the action of a flight from the health of its inputs.

The causes are a table of their own, `failsafe_precedence`. The action becomes more severe at once. It becomes less severe as
its row says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_recon.safety.failsafe_precedence import (
    CONDITIONS,
    ClearCondition,
    FailsafeAction,
    FailsafeInputs,
    FailsafeTimeouts,
    Observation,
)
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

#: retreat: ends after this time without a cause, so that a failing source does not make it begin again and again
_HEALTH_S = 2.0
_RETREAT_BEGUN_S = 0.2  #: retreat: a younger one ends at once: it has not moved yet, and a mission that is back flies on


@dataclass(frozen=True, slots=True)
class _State:
    """An action, when it may end, and its reason."""

    action: FailsafeAction
    clears: ClearCondition
    reason: Reason | None


_FLYING = _State(FailsafeAction.FLY, ClearCondition.AT_ONCE, None)


class Failsafe:
    """The failsafe of one flight. Call step() once per control step."""

    def __init__(self, timeouts: FailsafeTimeouts) -> None:
        self._timeouts = timeouts
        self._state = _FLYING
        self._healthy_since_s = self._unhealthy_since_s = math.inf
        self._inside_s = self._retreat_s = math.inf

    def step(self, inputs: FailsafeInputs) -> tuple[FailsafeAction, Reason | None]:
        """Return the action, and the reason why it is not FLY.

        It becomes more severe at once. It returns from HOLD at once, from RETREAT after _HEALTH_S (at once if just begun), from
        LAND never. If the inputs require more than FLY for longer than ``land_timeout_s``, for any reason, it becomes LAND.
        """
        required = self._required(inputs)
        flies = required.action is FailsafeAction.FLY
        self._healthy_since_s = min(self._healthy_since_s, inputs.now_s) if flies else math.inf
        if required.action >= self._state.action or self._clears(flies, inputs.now_s):
            if self._state.action is not FailsafeAction.RETREAT:
                self._retreat_s = inputs.now_s
            self._state = required
        return self._state.action, self._state.reason

    def _clears(self, healthy: bool, now_s: float) -> bool:
        """Return True if the present action may become less severe."""
        if self._state.clears is ClearCondition.GOOD_HEALTH:
            wait_s = _HEALTH_S if now_s - self._retreat_s > _RETREAT_BEGUN_S else 0.0
            return healthy and now_s - self._healthy_since_s >= wait_s
        return self._state.clears is ClearCondition.AT_ONCE

    def _required(self, inputs: FailsafeInputs) -> _State:
        """Return the action that the inputs require now.

        It is that of the first condition that applies, or LAND if any has applied for too long.
        """
        state = self._first_condition(inputs)
        self._unhealthy_since_s = math.inf if state is _FLYING else min(self._unhealthy_since_s, inputs.now_s)
        if inputs.now_s - self._unhealthy_since_s <= self._timeouts.land_timeout_s:
            return state
        held = Reason(ReasonCode.HELD_TOO_LONG, (self._timeouts.land_timeout_s,))
        return _State(
            FailsafeAction.LAND, ClearCondition.NEVER, held if state.reason is None else state.reason.with_detail(held)
        )

    def _first_condition(self, inputs: FailsafeInputs) -> _State:
        self._inside_s = inputs.now_s if inputs.inside else min(self._inside_s, inputs.now_s)
        observation = Observation(inputs, inputs.now_s - self._inside_s, self._timeouts)
        for condition in CONDITIONS:
            reason = condition.cause(observation)
            if reason is not None:
                return _State(condition.action, condition.clears, reason)
        return _FLYING
