"""Survey limits: what ends a survey: no task left, the views, the flight time, the charge."""

from __future__ import annotations

from uav_recon.mission.battery.battery_policy import BatteryPolicy
from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.setup.mission_parameters import MissionParameters
from uav_recon.mission.takeoff import Takeoff
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


class SurveyLimits:
    """The limits of one survey and how much of each is left."""

    def __init__(self, parameters: MissionParameters, takeoff: Takeoff, battery: BatteryPolicy, log: MissionLog) -> None:
        self._parameters = parameters
        self._takeoff = takeoff
        self._log = log
        self.battery = battery

    @property
    def nothing_left(self) -> bool:
        """True if the survey has a reason to stop: no task is left, or no plan could be flown."""
        return bool(self._log.stop_reason)

    @property
    def views_left(self) -> int:
        """Number of keyframes that the mapper may still get."""
        return self._log.views_left

    @property
    def max_flight_s(self) -> float:
        """Flight time after which the vehicle goes home."""
        return self._parameters.max_flight_s

    def flight_s(self, now_s: float) -> float:
        """Return the time since the take-off; -inf before it."""
        return now_s - self._takeoff.begun_s

    def return_reason(self, now_s: float, requested: Reason | None) -> Reason:
        """Return why the vehicle goes home: a spent limit, or a requested return, or the battery."""
        if self.views_left <= 0:
            return Reason(ReasonCode.VIEWS_SPENT, (self._parameters.views,))
        if self.flight_s(now_s) > self.max_flight_s:
            return Reason(ReasonCode.TIME_SPENT, (self.max_flight_s,))
        return requested or self.battery.return_reason()
