"""What the guard judges by cannot be changed behind its back nor grow a misspelt name; what holds arrays is equal to itself."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from guard_rooms import BOUNDS, ENVELOPE, TIMEOUTS, proposal, situation

from uav_recon.safety.failsafe import _FLYING
from uav_recon.safety.failsafe_precedence import CONDITIONS, FailsafeAction, FailsafeInputs, Observation
from uav_recon.safety.guard import _motion_of
from uav_recon.safety.pose_gate import PoseVerdict
from uav_recon.safety.setpoint_continuity import ContinuityCheck
from uav_recon.safety.sight_speed_limit import SightSpeedLimit

INPUTS = FailsafeInputs(0.0, 0.0, 0.0, 0.0, True)
SIGHT_LIMIT = SightSpeedLimit(
    full_speed_mps=1.0, blind_speed_mps=0.3, blind_fresh_s=3.0, blind_stale_s=10.0, blind_memory_s=60.0
)

VALUES = (
    BOUNDS,
    BOUNDS.margins,
    ENVELOPE,
    ENVELOPE.fence,
    INPUTS,
    Observation(INPUTS, 0.0, TIMEOUTS),
    CONDITIONS[0],
    _FLYING,
    SIGHT_LIMIT,
    ContinuityCheck(),
    TIMEOUTS,
    PoseVerdict(True),
    proposal(),
    situation(0.0),
    _motion_of(proposal().setpoint, 0.0),
)


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_a_value_is_frozen_and_has_no_room_for_more(value: Any) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(value, dataclasses.fields(value)[0].name, None)
    assert not hasattr(value, "__dict__")


def test_what_holds_arrays_is_equal_to_itself_alone() -> None:
    for value in (proposal(), situation(0.0)):
        assert value == value  # noqa: PLR0124
        assert value != dataclasses.replace(value)


@pytest.mark.parametrize("value", [TIMEOUTS, SIGHT_LIMIT, BOUNDS, BOUNDS.margins], ids=lambda value: type(value).__name__)
def test_protective_numbers_are_passed_by_keyword(value: Any) -> None:
    with pytest.raises(TypeError, match="positional"):
        type(value)(*dataclasses.astuple(value))


def test_inputs_are_healthy_unless_they_say_otherwise() -> None:
    assert (INPUTS.refused_s, INPUTS.many_refusals, INPUTS.depth_rejected) == (0.0, False, False)
    assert [int(action) for action in FailsafeAction] == [0, 1, 2, 3]
