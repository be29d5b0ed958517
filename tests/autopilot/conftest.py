"""A vehicle in the air, flown up once for all who want one."""

from __future__ import annotations

import copy

import pytest
from flight_rig import ARM, MODE, Rig

SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"
ORDERS = (SETPOINT, f"COMMAND_LONG {MODE}", f"COMMAND_LONG {ARM}")


@pytest.fixture(scope="module")
def flown_up() -> Rig:
    rig = Rig()
    rig.airborne()
    return rig


@pytest.fixture
def hovering(flown_up: Rig) -> Rig:
    return copy.deepcopy(flown_up)
