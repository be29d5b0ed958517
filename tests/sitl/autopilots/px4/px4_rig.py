"""Simulated PX4 with its scripted companion; all clocks are injected."""

from __future__ import annotations

import copy
import copyreg
import functools
import struct
from typing import Any

from pymavlink.dialects.v20 import common as mavlink
from scripted_companion import Companion

from sitl.autopilots.px4.parameters import Px4Parameters

ARM, FORCE = mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 21196.0


def companion(seed: int = 1, **changes: float) -> Companion:
    p = Px4Parameters.load()
    for name, value in changes.items():
        p.set(name, value)
    return Companion(p, seed)


copyreg.pickle(struct.Struct, lambda s: (struct.Struct, (s.format,)))  # for copies of pymavlink's codec


@functools.lru_cache(maxsize=8)
def taken_off(seed: int) -> Companion:
    """Return a hovering vehicle; flown once per seed, tests get copies."""
    c = companion(seed)
    c.take_off()
    return c


def flying(seed: int = 1, **changes: float) -> Companion:
    c = copy.deepcopy(taken_off(seed))
    for name, value in changes.items():
        c.px4.parameters.set(name, value)
    return c


def seconds_until(c: Companion, happened: Any, at_most: float) -> float:
    before = c.now_s
    assert c.run(at_most, happened), f"did not happen within {at_most} s; texts {c.texts}"
    return c.now_s - before


def converged(c: Companion) -> bool:
    return c.px4.timesync_converged


def position_valid(c: Companion) -> bool:
    return c.px4.estimator.horizontal_valid


def truth_mode(c: Companion) -> str:
    return c.px4.truth().mode
