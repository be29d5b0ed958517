"""State of the simulated PX4, shared by its message builders and command handlers."""

from __future__ import annotations

from dataclasses import dataclass, field

from sitl.autopilots.autopilot_state import AutopilotState
from sitl.autopilots.px4.commander import Px4Commander, Px4Condition
from sitl.autopilots.px4.flight_tasks import Px4FlightTasks
from sitl.autopilots.px4.timesync import Px4Timesync


@dataclass(slots=True, kw_only=True)
class Px4State(AutopilotState):
    """State of the simulated PX4; owned by Px4."""

    commander: Px4Commander
    flight: Px4FlightTasks
    timesync: Px4Timesync = field(default_factory=Px4Timesync)

    def condition(self) -> Px4Condition:
        """Return the inputs of the commander."""
        distance_m, height_m = self.from_home_m
        return Px4Condition(
            now_s=self.now_s,
            position_valid=self.estimator.horizontal_valid,
            landed=self.flight.landed,
            has_flown=self.flight.has_flown,
            battery=self.battery.fraction,
            distance_from_home_m=distance_m,
            height_above_home_m=height_m,
            rc_lost_s=self.rc_lost_s,
        )
