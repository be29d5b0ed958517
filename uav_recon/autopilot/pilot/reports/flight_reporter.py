"""Flight reporter: the pilot's newest note, and the messages for people at a ground station."""

from __future__ import annotations

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.pilot.reports.reduced_speed_reporter import ReducedSpeedReporter
from uav_recon.autopilot.pilot.reports.statustext_reporter import StatusTextReporter
from uav_recon.autopilot.pilot.situation.situation import Situation
from uav_recon.types.reason import Reason
from uav_recon.types.vehicle import IN_THE_AIR, FlightPhase


class FlightReporter:
    """Sends notes, causes of a reduced speed, and news of the link and the mission, once each.

    ``note``: the newest reason for what the pilot does or refuses, None for none.
    """

    def __init__(self, link: VehicleLink, situation: Situation) -> None:
        self._link = link
        self._situation = situation
        self._statustext = StatusTextReporter(link)
        self._speed = ReducedSpeedReporter()
        self.note: Reason | None = None

    def say(self, reason: Reason, now_s: float) -> None:
        """Send a reason at once, because a later note may replace it."""
        self._statustext.say(reason, now_s)

    def step(self, phase: FlightPhase, now_s: float) -> None:
        """Send what is new in this phase. Call it every step."""
        if phase is FlightPhase.CONNECTING:
            return
        lost = self._situation.poses.lost or self._situation.poses.wrong  # the failsafe reports these itself
        speed = None if lost else self._speed.update(self._situation.slow_reason, now_s)
        if speed is not None:
            self.say(speed, now_s)
        if phase is FlightPhase.READY:
            return
        in_the_air, mission_news = phase in IN_THE_AIR, self._situation.mission.news
        news = [*self._link.alerts.news(), *([mission_news] if in_the_air and mission_news else [])]
        for reason in news:
            self.say(reason, now_s)
        if in_the_air and news:
            self.note = news[-1]
        self._statustext.step(self.note, now_s)
