"""The parts of the simulated PX4 that its messages and commands look at together."""

from __future__ import annotations

from dataclasses import dataclass, field

from sitl.autopilots.autopilot_state import Board
from sitl.autopilots.px4.commander import Commander, Condition
from sitl.autopilots.px4.flight_tasks import Flight
from sitl.autopilots.px4.timesync import TimeSync


@dataclass(slots=True, kw_only=True)
class State(Board):
    """Owned by Px4."""

    commander: Commander
    flight: Flight
    timesync: TimeSync = field(default_factory=TimeSync)

    def condition(self) -> Condition:
        """What the commander judges by."""
        distance_m, height_m = self.from_home_m
        return Condition(
            now_s=self.now_s,
            position_valid=self.estimator.horizontal_valid,
            landed=self.flight.landed,
            has_flown=self.flight.has_flown,
            battery=self.battery.fraction,
            distance_from_home_m=distance_m,
            height_above_home_m=height_m,
            rc_lost_s=self.rc_lost_s,
        )
