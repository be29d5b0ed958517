"""What every simulated autopilot carries: clock, estimator, gimbal, battery, origin and home."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from sitl.autopilots.ekf import Estimator
from sitl.geometry.quaternion import Vec3
from sitl.world.battery import Battery
from sitl.world.gimbal import Gimbal


@dataclass(slots=True, kw_only=True)
class AutopilotState:
    """now_s is the world's clock, boot_s the instant on it at which the autopilot booted."""

    estimator: Estimator
    gimbal: Gimbal
    now_s: float = 0.0
    boot_s: float = 0.0
    battery: Battery = field(default_factory=Battery)
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

    @property
    def rc_lost_s(self) -> float:
        """How long the transmitter has been silent; 0 while it is heard."""
        return max(0.0, self.now_s - self.rc_lost_at_s)

    @property
    def from_home_m(self) -> tuple[float, float]:
        """Horizontal distance from home and height above it; NaN without a home."""
        if self.home is None:
            return math.nan, math.nan
        p, h = self.estimator.position, self.home
        return math.hypot(p[0] - h[0], p[1] - h[1]), h[2] - p[2]
