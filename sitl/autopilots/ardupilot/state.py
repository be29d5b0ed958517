"""The parts of the simulated ArduCopter that its messages and commands look at together."""

from __future__ import annotations

from dataclasses import dataclass, field

from sitl.autopilots.ardupilot.jitter_correction import JitterCorrection
from sitl.autopilots.ardupilot.mode_controllers import ArduPilotModeControllers
from sitl.autopilots.ardupilot.modes import ArduPilotCommander, ArduPilotCondition
from sitl.autopilots.autopilot_state import AutopilotState

_EKF_ACTIVE_S = 10.0  # from boot; until then attitude is DCM's, and poses are not looked at


@dataclass(slots=True, kw_only=True)
class ArduPilotState(AutopilotState):
    """Owned by ArduCopter. home_follows: the origin came when there was a position to make a home of."""

    commander: ArduPilotCommander
    flight: ArduPilotModeControllers
    capacity_mah: float
    jitter: JitterCorrection = field(default_factory=JitterCorrection)
    home_follows: bool = False

    @property
    def booted_s(self) -> float:
        """Since boot."""
        return self.now_s - self.boot_s

    @property
    def ekf_active(self) -> bool:
        """Whether the estimator runs yet."""
        return self.booted_s >= _EKF_ACTIVE_S

    def settle_home(self) -> None:
        """Home is where it stands, until it is armed."""
        if self.home_follows and not self.commander.armed:
            self.home = self.flight.home = self.estimator.position

    def condition(self) -> ArduPilotCondition:
        """What the commander judges by."""
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
