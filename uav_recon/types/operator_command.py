"""Commands of the operator, and how they reach the mission."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class OperatorCommand(Enum):
    """A command of a human operator.

    Sticks and switches of the transmitter are not among them: they always take precedence, in the autopilot itself.
    """

    START = "start"  # on the ground: take off and begin; while holding in flight: continue
    HOLD = "hold"  # hold position until the next command
    RETURN = "return"  # fly home and land there
    LAND = "land"  # land here, now


@dataclass(frozen=True, slots=True)
class GivenCommand:
    """A command that the pilot has accepted, for the mission to follow.

    stamp_s: companion's monotonic clock.
    """

    stamp_s: float
    order: OperatorCommand
