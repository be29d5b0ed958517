"""What goes wrong in a flight, and when: what a row of the table amounts to once its flight has a number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sitl.faults.injectors.base import Injector

STANDS_S = 2.0


@dataclass(frozen=True)
class Onset:
    """When a trouble begins: at a random instant between these seconds after the climb is over, and then as soon as the
    vehicle is flown at speed_mps or more. at_boot: at once. after_s counts from the boot where at_boot is set. seeing: where
    the camera looks, which sees what stands in the hull's way only if that way leads ahead. view_m: only where nothing stands
    before the camera, level, for so far. away_m: only so far from the pad.
    """

    after_s: tuple[float, float] = (2.0, 8.0)
    speed_mps: float = 0.4
    at_boot: bool = False
    seeing: bool = False
    view_m: float = 0.0
    away_m: float = 0.0

    def wait_s(self, share: float) -> float:
        """Of the instants between, the one that the dice chose: share, 0 to 1."""
        early_s, late_s = self.after_s
        return early_s + (late_s - early_s) * share


@dataclass(frozen=True)
class Fault:
    """What goes wrong in a flight of a row, when it begins, how long the flight is watched from then on, and how long (s) once
    the motors stand.
    """

    row: str
    injectors: Sequence[Injector]
    onset: Onset = Onset()
    longest_s: float = 60.0
    stands_s: float = STANDS_S
