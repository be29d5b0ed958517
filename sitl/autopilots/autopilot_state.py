"""State of a simulated autopilot: clock, commander, control, estimator, gimbal, battery.

Also origin and home.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol

from sitl.autopilots.ekf import Estimator
from sitl.autopilots.position_controller import ControlSetpoint
from sitl.geometry.quaternion import Vec3
from sitl.world.battery import Battery
from sitl.world.flow_sensor import SimulatedFlowModule
from sitl.world.gimbal import Gimbal
from sitl.world.range_finder import SimulatedUpwardRangeFinder


class CommanderInterface(Protocol):
    """Commander: flight mode, arming state and failsafes."""

    armed: bool
    failsafes: list[str]

    @property
    def mode(self) -> IntEnum:
        """The current flight mode."""
        ...


class FlightControlInterface(Protocol):
    """Flight control: the setpoint of the controller and the land detector."""

    active: ControlSetpoint

    @property
    def landed(self) -> bool:
        """True if the land detector reports that the vehicle has landed."""
        ...

    def disable_land_detector(self) -> None:
        """Disable the land detector: no landing is detected any more."""
        ...


@dataclass(slots=True, kw_only=True)
class AutopilotState:
    """State common to both autopilots. now_s and boot_s (time of boot) are on the world clock."""

    commander: CommanderInterface
    flight: FlightControlInterface
    estimator: Estimator
    gimbal: Gimbal
    now_s: float = 0.0
    boot_s: float = 0.0
    battery: Battery = field(default_factory=Battery)
    range_finder: SimulatedUpwardRangeFinder | None = None
    flow_module: SimulatedFlowModule | None = None
    origin: tuple[int, int, int] | None = None  # degE7, degE7, mm
    home: Vec3 | None = None  # local NED
    rc_lost_at_s: float = math.inf

    @property
    def boot_us(self) -> int:
        """Time since boot, µs: the autopilot's clock."""
        return round((self.now_s - self.boot_s) * 1e6)

    @property
    def boot_ms(self) -> int:
        """Time since boot, ms, as an unsigned 32-bit number, as in most messages."""
        return self.boot_us // 1000 & 0xFFFFFFFF

    @property
    def rc_lost_s(self) -> float:
        """Time (s) since the last signal of the RC transmitter was received; 0 while it is received."""
        return max(0.0, self.now_s - self.rc_lost_at_s)

    @property
    def from_home_m(self) -> tuple[float, float]:
        """Horizontal distance from home and height above it, m; NaN without a home."""
        if self.home is None:
            return math.nan, math.nan
        p, h = self.estimator.position, self.home
        return math.hypot(p[0] - h[0], p[1] - h[1]), h[2] - p[2]
