"""State of the simulated ArduCopter, shared by its message builders and command handlers."""

from __future__ import annotations

from dataclasses import dataclass, field

from sitl.autopilots.ardupilot.jitter_correction import JitterCorrection
from sitl.autopilots.ardupilot.mode_controllers import ArduPilotModeControllers
from sitl.autopilots.ardupilot.modes import ArduPilotCommander, ArduPilotCondition
from sitl.autopilots.autopilot_state import AutopilotState

_EKF_ACTIVE_S = 10.0  # from boot; before that the attitude is from DCM, and poses are ignored


@dataclass(slots=True, kw_only=True)
class ArduPilotState(AutopilotState):
    """State of the simulated ArduCopter; owned by ArduCopter.

    home_follows: the origin was set while the position was valid, so home can be set.
    """

    commander: ArduPilotCommander
    flight: ArduPilotModeControllers
    capacity_mah: float
    jitter: JitterCorrection = field(default_factory=JitterCorrection)
    home_follows: bool = False

    @property
    def booted_s(self) -> float:
        """Time since boot, s."""
        return self.now_s - self.boot_s

    @property
    def ekf_active(self) -> bool:
        """True once the estimator runs."""
        return self.booted_s >= _EKF_ACTIVE_S

    def settle_home(self) -> None:
        """Set home to the present position while disarmed."""
        if self.home_follows and not self.commander.armed:
            self.home = self.flight.home = self.estimator.position

    def condition(self) -> ArduPilotCondition:
        """Return the inputs of the commander."""
        distance_m, height_m = self.from_home_m
        return ArduPilotCondition(
            now_s=self.now_s,
            booted_s=self.booted_s,
            position_valid=self.estimator.horizontal_valid,
            landed=self.flight.landed,
            has_home=self.home is not None,
            battery_mah=self.battery.fraction * self.capacity_mah,
            distance_from_home_m=distance_m,
            height_above_home_m=height_m,
            rc_lost_s=self.rc_lost_s,
        )
