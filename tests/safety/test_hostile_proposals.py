"""Hostile proposals: whatever is asked, nothing leaves that is not fit to fly. The script beside it does a million."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from typing import Any

import numpy as np
import pytest
from guard_rooms import GRID, proposal, situation
from hostile_proposals import adds_up, attack, undue, violation

from uav_recon.safety.guard import SetpointProposal
from uav_recon.types.trajectory import Setpoint

NOTHING = GRID.centre(np.zeros((0, 3), dtype=np.int64))


@pytest.mark.parametrize("seed", [1, 2])
def test_nothing_hostile_reaches_the_wire(seed: int) -> None:
    fates, violations = attack(1200, seed)
    assert violations == []
    assert fates["flown"] > 40, "and some of it was fit to fly"
    assert len(fates) > 12, "refused for many reasons"


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"position_m": np.array([np.nan, 0.0, 1.0])}, "finite"),
        ({"position_m": np.array([4.8, 0.0, 1.0])}, "fence"),
        ({"velocity_mps": np.array([1.1, 0.0, 0.0])}, "too fast"),
        ({"yaw_rate_radps": 0.9}, "turns"),
        ({"position_m": np.array([0.5, 0.0, 1.0])}, "jumps"),
        ({"velocity_mps": np.array([0.5, 0.0, 0.0])}, "changes"),
        ({"yaw_rad": 0.5}, "jerks"),
    ],
)
def test_the_judge_of_the_wire_sees_violations(changes: dict[str, object], word: str) -> None:
    last = Setpoint.hold(np.array([0.0, 0.0, 1.0]), 0.0)
    assert violation(last, last, 1 / 30, NOTHING) == ""
    assert word in violation(dataclasses.replace(last, **changes), last, 1 / 30, NOTHING)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("place", "velocity", "yaw", "word"),
    [
        ((0.03, 0.0, 0.0), (0.9, 0.0, 0.0), 0.0, ""),
        ((0.04, 0.0, 0.0), (0.9, 0.0, 0.0), 0.0, "jumps"),
        ((0.0, 0.03, 0.0), (0.0, 0.0, 0.0), 0.0, "velocity"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.05, "jerks"),
    ],
)
def test_the_judge_of_the_wire_sees_what_adds_up(place: Any, velocity: Any, yaw: float, word: str) -> None:
    many = [(1 / 30, Setpoint(np.multiply(place, k), np.array(velocity), np.zeros(3), yaw * k, 0.0, 0.0)) for k in range(12)]
    assert word in (found := adds_up(deque(many)))
    assert bool(found) is bool(word)


def test_the_judge_of_the_wire_sees_an_acceleration_in_many_steps() -> None:
    many = deque((1 / 30, Setpoint(np.zeros(3), np.array([0.1 * k, 0.0, 0.0]), np.zeros(3), 0.0, 0.0, 0.0)) for k in range(9))
    assert "changes speed" in adds_up(many)


def test_the_judge_knows_what_is_not_known_free() -> None:
    last = Setpoint.hold(np.array([1.0, 0.0, 1.0]), 0.0)
    assert "known free" in violation(last, last, 1 / 30, np.array([[1.1, 0.0, 1.05]]))


MOVING = proposal(velocity=(0.4, 0.0, 0.0))
FAST = proposal(velocity=(0.9, 0.0, 0.0))


@pytest.mark.parametrize(
    ("wanted", "changes", "range_m", "word"),
    [
        (MOVING, {}, 9.0, ""),
        (FAST, {}, 9.0, ""),
        (FAST, {}, 0.4, "wall"),
        (dataclasses.replace(FAST, evading=True), {}, 9.0, "due"),
        (dataclasses.replace(MOVING, evading=True, retreating=True), {}, 9.0, ""),
        (dataclasses.replace(MOVING, retreating=True), {}, 9.0, "due"),
        (MOVING, {"slow": True}, 9.0, "due"),
        (MOVING, {"pose_age_s": 0.21}, 9.0, "word"),
        (MOVING, {"intent_age_s": math.nan}, 9.0, "word"),
        (MOVING, {"ahead": None}, 9.0, "blind"),
        (proposal(velocity=(0.2, 0.0, 0.0), retreating=True), {"ahead": None, "intent_age_s": 9.0}, 9.0, ""),
    ],
)
def test_the_judge_knows_what_was_known(wanted: SetpointProposal, changes: dict[str, Any], range_m: float, word: str) -> None:
    found = undue(wanted, situation(5.0, **changes), range_m)
    assert word in found
    assert bool(found) is bool(word)
