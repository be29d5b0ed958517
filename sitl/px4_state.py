"""The parts of the simulated PX4 that its messages and commands look at together."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from sitl.battery import Battery
from sitl.estimator import Estimator
from sitl.gimbal import Gimbal
from sitl.px4_flight import Flight
from sitl.px4_modes import Commander, Condition
from sitl.rotation import Vec3
from sitl.timesync import TimeSync


@dataclass(slots=True)
class State:
    """Owned by Px4; now_s is the world's clock, boot_s the instant on it at which the autopilot booted."""

    commander: Commander
    estimator: Estimator
    flight: Flight
    gimbal: Gimbal
    now_s: float = 0.0
    boot_s: float = 0.0
    battery: Battery = field(default_factory=Battery)
    timesync: TimeSync = field(default_factory=TimeSync)
    origin: tuple[int, int, int] | None = None  # degE7, degE7, mm
    home: Vec3 | None = None  # local NED
    rc_lost_at_s: float = math.inf

    @property
    def boot_us(self) -> int:
        """The autopilot's clock."""
        return round((self.now_s - self.boot_s) * 1e6)

    @property
    def boot_ms(self) -> int:
        """The autopilot's clock, as most messages carry it."""
        return self.boot_us // 1000 & 0xFFFFFFFF

    def condition(self) -> Condition:
        """What the commander judges by."""
        p = self.estimator.position
        home = self.home or (math.nan, math.nan, math.nan)
        return Condition(
            now_s=self.now_s,
            position_valid=self.estimator.horizontal_valid,
            landed=self.flight.landed,
            has_flown=self.flight.has_flown,
            battery=self.battery.fraction,
            distance_from_home_m=math.hypot(p[0] - home[0], p[1] - home[1]),
            height_above_home_m=home[2] - p[2],
            rc_lost_s=max(0.0, self.now_s - self.rc_lost_at_s),
        )
