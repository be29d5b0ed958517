"""Event observation: collects the facts of a step and returns their events."""

from __future__ import annotations

from uav_recon.mission.events import Event, Facts, observe
from uav_recon.mission.flight_actions import FlightActions
from uav_recon.mission.intake.map_intake import MapIntake
from uav_recon.mission.requests.mission_requests import MissionRequests
from uav_recon.mission.survey.survey_limits import SurveyLimits
from uav_recon.types.vehicle import VehicleState

FRAME_TIMEOUT_S = 1.0  #: hold: no depth frame for longer: the map ahead is not renewed


class EventObserver:
    """Observer of one mission; changes nothing."""

    def __init__(self, requests: MissionRequests, map_intake: MapIntake, actions: FlightActions, limits: SurveyLimits) -> None:
        self._requests = requests
        self._map_intake = map_intake
        self._actions = actions
        self._limits = limits

    def events(self, now_s: float, vehicle: VehicleState) -> frozenset[Event]:
        """Return every event of this step."""
        return observe(self.facts(now_s, vehicle))

    def facts(self, now_s: float, vehicle: VehicleState) -> Facts:
        """Return the facts of this step, once map, vehicle and requests are up to date."""
        requests, actions, limits, battery = self._requests, self._actions, self._limits, self._limits.battery
        return Facts(
            vehicle=vehicle,
            start=requests.startable and self._map_intake.map is not None,
            abort=requests.aborted,
            at_rest=actions.at_rest(now_s),
            took_off=actions.takeoff.risen,
            frame_age_s=now_s - self._map_intake.frame_s,
            frame_timeout_s=FRAME_TIMEOUT_S,
            nothing_left=limits.nothing_left,
            views_left=limits.views_left,
            flight_s=limits.flight_s(now_s),
            max_flight_s=limits.max_flight_s,
            arrived=actions.return_home.has_arrived(now_s),
            no_way_home=actions.return_home.no_path,
            battery_low=battery.must_return,
            battery_lost=battery.lost,
            hold=requests.held,
            go_home=bool(requests.return_reason),
        )
