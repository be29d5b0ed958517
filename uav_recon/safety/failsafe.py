"""Failsafe: selects the action of a flight from the health of its inputs.

The action becomes more severe at once. It becomes less severe only after a time of good health, and never after LAND.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

#: retreat: ends after this time without a cause, so that a failing source does not make it begin again and again
_HEALTH_S = 2.0
_RETREAT_BEGUN_S = 0.2  #: retreat: a younger one ends at once: it has not moved yet, and a mission that is back flies on
_OUTSIDE_S = 3.0  #: land: outside the fence itself for longer; a push over it must be corrected within this time
_REFUSALS = 3  #: hold: this many refusals within _REFUSALS_S; the mission is ignored for a while
_REFUSALS_S = 1.0  #: hold: time within which _REFUSALS count together


class FailsafeAction(IntEnum):
    """Actions from flight to the ground, in order of severity.

    Handing over to the firmware is what the pilot does when its link is lost.
    """

    FLY = 0
    HOLD = 1
    RETREAT = 2
    LAND = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class FailsafeTimeouts:
    """Silence (s) of pose, mission and depth that is allowed before each action."""

    pose_timeout_s: float
    pose_land_s: float
    intent_timeout_s: float
    retreat_timeout_s: float
    land_timeout_s: float
    depth_timeout_s: float
    depth_retreat_s: float
    depth_land_s: float


@dataclass(frozen=True, slots=True)
class FailsafeInputs:
    """Inputs of the failsafe. Ages in seconds, infinity for never.

    inside: the position is inside the fence itself. refusals: number of refusals.

    pose_age_s: of the newest sound pose, or since any was fed if longer. lost, wrong, unsure: the reason, or None; unsure: the
    source of the poses becomes uncertain of the place, and knows views in which it was not.
    refused_s: without motion. depth_rejected: depth frames arrive, and none is believed.
    """

    now_s: float
    pose_age_s: float
    intent_age_s: float
    depth_age_s: float
    inside: bool
    refusals: int
    lost: Reason | None = None
    wrong: Reason | None = None
    refused_s: float = 0.0
    depth_rejected: bool = False
    unsure: Reason | None = None


class Failsafe:
    """The failsafe of one flight. Call step() once per control step."""

    def __init__(self, timeouts: FailsafeTimeouts) -> None:
        self._patience = timeouts
        self._rung = FailsafeAction.FLY
        self._why: Reason | None = None
        self._healthy_since_s = self._kept_since_s = math.inf
        self._inside_s = self._retreat_s = math.inf
        self._refused: list[float] = []
        self._refusals: int | None = None

    def step(self, health: FailsafeInputs) -> tuple[FailsafeAction, Reason | None]:
        """Return the action, and the reason why it is not FLY.

        It becomes more severe at once. It returns from HOLD at once, from RETREAT after _HEALTH_S (at once if just begun), from
        LAND never. If the inputs require more than FLY for longer than ``land_timeout_s``, for any reason, it becomes LAND.
        """
        rung, why = self._wanted(health)
        self._kept_since_s = math.inf if rung is FailsafeAction.FLY else min(self._kept_since_s, health.now_s)
        if health.now_s - self._kept_since_s > self._patience.land_timeout_s:
            held = Reason(ReasonCode.HELD_TOO_LONG, (self._patience.land_timeout_s,))
            rung, why = FailsafeAction.LAND, held if why is None else why.with_detail(held)
        self._healthy_since_s = min(self._healthy_since_s, health.now_s) if rung is FailsafeAction.FLY else math.inf
        wait_s = _HEALTH_S if health.now_s - self._retreat_s > _RETREAT_BEGUN_S else 0.0
        well = rung is FailsafeAction.FLY and health.now_s - self._healthy_since_s >= wait_s
        if rung >= self._rung or self._rung is FailsafeAction.HOLD or (self._rung is FailsafeAction.RETREAT and well):
            self._retreat_s = self._retreat_s if self._rung is FailsafeAction.RETREAT else health.now_s
            self._rung = rung
            self._why = why
        return self._rung, self._why

    def _wanted(self, health: FailsafeInputs) -> tuple[FailsafeAction, Reason | None]:
        p, over, refused = self._patience, self._outside_too_long(health) or health.wrong, self._refused_too_often(health)
        no_depth = ReasonCode.DEPTH_NOT_BELIEVED if health.depth_rejected else ReasonCode.NO_DEPTH
        silences = (
            (ReasonCode.NO_POSE, health.pose_age_s, (p.pose_timeout_s, math.inf, p.pose_land_s)),
            (ReasonCode.MISSION_SILENT, health.intent_age_s, (p.intent_timeout_s, p.retreat_timeout_s, p.land_timeout_s)),
            (no_depth, health.depth_age_s, (p.depth_timeout_s, p.depth_retreat_s, p.depth_land_s)),
            (ReasonCode.REFUSED_TOO_LONG, health.refused_s, (math.inf, math.inf, p.land_timeout_s)),
        )
        rungs = [_action_of(age_s, limits_s) for _, age_s, limits_s in silences]
        if (rung := max(rungs)) < FailsafeAction.LAND and over:
            return FailsafeAction.LAND, over
        if rung > FailsafeAction.FLY:
            code, age_s, _ = silences[rungs.index(rung)]
            return rung, Reason(code, (age_s,))
        if health.unsure:
            return FailsafeAction.RETREAT, health.unsure
        why = health.lost or (Reason(ReasonCode.MANY_REFUSALS, (_REFUSALS,)) if refused else None)
        return FailsafeAction.HOLD if why else FailsafeAction.FLY, why

    def _outside_too_long(self, health: FailsafeInputs) -> Reason | None:
        self._inside_s = health.now_s if health.inside else min(self._inside_s, health.now_s)
        too_long = health.now_s - self._inside_s > _OUTSIDE_S
        return Reason(ReasonCode.OUTSIDE_FENCE_TOO_LONG, (_OUTSIDE_S,)) if too_long else None

    def _refused_too_often(self, health: FailsafeInputs) -> bool:
        before = self._refusals
        self._refusals = health.refusals
        if before is not None and health.refusals > before:
            self._refused.append(health.now_s)
        self._refused = [at_s for at_s in self._refused if health.now_s - at_s <= _HEALTH_S]
        dense = zip(self._refused, self._refused[_REFUSALS - 1 :], strict=False)
        return any(last_s - first_s <= _REFUSALS_S for first_s, last_s in dense)


def _action_of(age_s: float, limits_s: tuple[float, float, float]) -> FailsafeAction:
    """Return the most severe action whose limit an age exceeds; NaN exceeds all."""
    return FailsafeAction(max([rung for rung, limit_s in enumerate(limits_s, 1) if not age_s <= limit_s], default=0))
