"""Precedence of the failsafe: cause, action, when the action may end, and what overrides it.

The first row that applies decides. A row whose action is less severe stands above a more severe one only where the latter could
not be carried out: a retreat needs a pose, the mission's map and depth.

A human with the sticks overrides every row: the pilot yields at once. A trajectory of the mission overrides none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum

from uav_recon.safety.depth_age_limit import depth_limit_s
from uav_recon.safety.refusals import MANY_REFUSALS
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

OUTSIDE_S = 3.0  #: land: outside the fence itself for longer; a push over it must be corrected within this time


class FailsafeAction(IntEnum):
    """Actions from flight to the ground, in order of severity.

    Handing over to the firmware is what the pilot does when its link is lost.
    """

    FLY = 0
    HOLD = 1
    RETREAT = 2
    LAND = 3


class ClearCondition(Enum):
    """Condition for a less severe action, once the cause is gone."""

    AT_ONCE = "at once"
    GOOD_HEALTH = "after a time without a cause"
    NEVER = "never"


class Override(Enum):
    """Command that is carried out in place of the action, while its cause lasts.

    A hold of the operator stops a retreat at once. The retreat is the machine's best guess, and moves; a person who sees the
    vehicle and wants it to stand still may see what the machine does not, and standing still is what the milder row does. The
    cause stays in force and in words: a landing that it leads to, or `land_timeout_s` of it, overrides the hold.
    """

    OPERATOR_HOLD = "hold of the operator"
    LAND = "land, of the operator or of the mission"


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

    inside: the position is inside the fence itself. pose_age_s: of the newest sound pose, or since any was fed if longer. lost,
    wrong, unsure: the reason, or None; unsure: the source of the poses becomes uncertain of the place, and knows views in which
    it was not. refused_s: duration of refusals without motion. many_refusals: the newest came close together. depth_rejected:
    depth frames arrive, and none is believed. one_missing_s: age of depth that one missing frame causes, 0 while unknown.
    """

    now_s: float
    pose_age_s: float
    intent_age_s: float
    depth_age_s: float
    inside: bool
    many_refusals: bool = False
    lost: Reason | None = None
    wrong: Reason | None = None
    refused_s: float = 0.0
    depth_rejected: bool = False
    unsure: Reason | None = None
    one_missing_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Observation:
    """The facts that a condition examines: inputs, time outside the fence (s), limits."""

    inputs: FailsafeInputs
    outside_s: float
    timeouts: FailsafeTimeouts


@dataclass(frozen=True, slots=True)
class FailsafeCondition:
    """One row.

    cause: the reason, or None while it does not apply. overrides: commands that replace the action; the pilot's sequence
    carries them out, and its tests hold it to this column.
    """

    cause: Callable[[Observation], Reason | None]
    action: FailsafeAction
    clears: ClearCondition
    overrides: tuple[Override, ...]


def _silence(code: ReasonCode, age_s: float, limit_s: float) -> Reason | None:
    """Return the reason if an age exceeds its limit; NaN exceeds every limit."""
    return None if age_s <= limit_s else Reason(code, (age_s,))


def _no_pose(seen: Observation, limit_s: float) -> Reason | None:
    return _silence(ReasonCode.NO_POSE, seen.inputs.pose_age_s, limit_s)


def _mission_silent(seen: Observation, limit_s: float) -> Reason | None:
    return _silence(ReasonCode.MISSION_SILENT, seen.inputs.intent_age_s, limit_s)


def _no_depth(seen: Observation, limit_s: float) -> Reason | None:
    code = ReasonCode.DEPTH_NOT_BELIEVED if seen.inputs.depth_rejected else ReasonCode.NO_DEPTH
    return _silence(code, seen.inputs.depth_age_s, limit_s)


def _depth_hold_s(seen: Observation) -> float:
    return depth_limit_s(seen.timeouts.depth_timeout_s, seen.inputs.one_missing_s)


def _refused_too_long(seen: Observation) -> Reason | None:
    return _silence(ReasonCode.REFUSED_TOO_LONG, seen.inputs.refused_s, seen.timeouts.land_timeout_s)


def _outside_too_long(seen: Observation) -> Reason | None:
    return Reason(ReasonCode.OUTSIDE_FENCE_TOO_LONG, (OUTSIDE_S,)) if seen.outside_s > OUTSIDE_S else None


def _many_refusals(seen: Observation) -> Reason | None:
    return Reason(ReasonCode.MANY_REFUSALS, (MANY_REFUSALS,)) if seen.inputs.many_refusals else None


_HOLD = FailsafeAction.HOLD, ClearCondition.AT_ONCE, (Override.LAND,)
_RETREAT = FailsafeAction.RETREAT, ClearCondition.GOOD_HEALTH, (Override.OPERATOR_HOLD, Override.LAND)
_LAND = FailsafeAction.LAND, ClearCondition.NEVER, ()

CONDITIONS = (
    FailsafeCondition(lambda seen: _no_pose(seen, seen.timeouts.pose_land_s), *_LAND),
    FailsafeCondition(lambda seen: _mission_silent(seen, seen.timeouts.land_timeout_s), *_LAND),
    FailsafeCondition(lambda seen: _no_depth(seen, seen.timeouts.depth_land_s), *_LAND),
    FailsafeCondition(_refused_too_long, *_LAND),
    FailsafeCondition(_outside_too_long, *_LAND),
    FailsafeCondition(lambda seen: seen.inputs.wrong, *_LAND),
    FailsafeCondition(lambda seen: _mission_silent(seen, seen.timeouts.retreat_timeout_s), *_RETREAT),
    FailsafeCondition(lambda seen: _no_depth(seen, seen.timeouts.depth_retreat_s), *_RETREAT),
    FailsafeCondition(lambda seen: _no_pose(seen, seen.timeouts.pose_timeout_s), *_HOLD),
    FailsafeCondition(lambda seen: _mission_silent(seen, seen.timeouts.intent_timeout_s), *_HOLD),
    FailsafeCondition(lambda seen: _no_depth(seen, _depth_hold_s(seen)), *_HOLD),
    FailsafeCondition(lambda seen: seen.inputs.unsure, *_RETREAT),
    FailsafeCondition(lambda seen: seen.inputs.lost, *_HOLD),
    FailsafeCondition(_many_refusals, *_HOLD),
)
