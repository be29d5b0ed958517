"""What an operator may ask for, and how it reaches the mission."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class OperatorCommand(Enum):
    """A human's wish. Sticks and switches of the transmitter are not among them: they always win, without asking us."""

    START = "start"  # on the ground: take off and begin; held in the air: go on
    HOLD = "hold"  # stay where it is until told otherwise
    RETURN = "return"  # fly home and land there
    LAND = "land"  # land here, now


@dataclass(frozen=True, slots=True)
class GivenCommand:
    """An order that the pilot has accepted, for the mission to follow. stamp_s: companion's monotonic clock."""

    stamp_s: float
    order: OperatorCommand
