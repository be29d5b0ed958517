"""Conductor: one step of the mission, top to bottom. The only place where the stages meet."""

from __future__ import annotations

from uav_recon.interfaces import Executor, Journal
from uav_recon.mission.battery.battery_policy import BatteryPolicy
from uav_recon.mission.detection.detectors import (
    DeadPlannerDetector,
    Detector,
    LowBatteryDetector,
    MissingOperatorDetector,
    MissionEvent,
    RefusedTrajectoryDetector,
    Response,
)
from uav_recon.mission.detection.event_observation import EventObserver
from uav_recon.mission.flight_actions import FlightActions
from uav_recon.mission.intake.map_intake import MapIntake
from uav_recon.mission.intake.vehicle_intake import VehicleIntake
from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.log.perception_log import PerceptionLog
from uav_recon.mission.publication.mission_publisher import MissionPublisher
from uav_recon.mission.requests.mission_requests import MissionRequests
from uav_recon.mission.requests.operator_watchdog import OperatorWatchdog
from uav_recon.mission.setup.mission_channels import MissionChannels
from uav_recon.mission.setup.mission_parameters import MissionParameters
from uav_recon.mission.setup.mission_stages import MissionStages
from uav_recon.mission.state_machine import Phase, advance
from uav_recon.mission.survey.keyframe_capture import KeyframeCapture
from uav_recon.mission.survey.survey_limits import SurveyLimits
from uav_recon.mission.trajectory.async_planning import AsyncPlanner
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.mission.trajectory.trajectory_execution import TrajectoryExecutor
from uav_recon.mission.trajectory.view_schedule import ViewSchedule
from uav_recon.types.maps import VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import VehicleState


class Conductor:
    """Flies one mission.

    step() is called at 20 Hz or more and never waits for planning or mapping. requests: what the operator asks for.
    """

    def __init__(
        self,
        stages: MissionStages,
        channels: MissionChannels,
        parameters: MissionParameters,
        executor: Executor,
        journal: Journal,
    ) -> None:
        self._vehicle = channels.vehicle
        self._log = log = MissionLog(journal, parameters.views)
        self._perception_log = PerceptionLog(channels.perception, journal)
        track, schedule = FlightTrack(parameters.camera_pitch_down_rad), ViewSchedule()
        planner = AsyncPlanner(
            stages.planner, stages.motion, stages.retreat, executor, parameters.plan_cost_s, parameters.view_spacing_m
        )
        trajectory_executor = TrajectoryExecutor(stages.motion, track, schedule, log)
        self._actions = actions = FlightActions(stages, channels, parameters, trajectory_executor, planner, log)
        battery = BatteryPolicy(track, actions.home_m, parameters.clearance_m)
        watchdog = OperatorWatchdog(parameters.operator_timeout_s)
        self._detectors: tuple[Detector, ...] = (
            RefusedTrajectoryDetector(track),
            MissingOperatorDetector(watchdog),
            DeadPlannerDetector(planner),
            LowBatteryDetector(battery),
        )
        self.phase = Phase.IDLE
        self.requests = MissionRequests(watchdog, log)
        self._maps = MapIntake(stages, channels, parameters, track)
        self._keyframes = KeyframeCapture(stages, schedule, track, log)
        self._vehicle_intake = VehicleIntake(stages, track, battery, journal)
        self._limits = SurveyLimits(parameters, actions.takeoff, battery, log)
        self._observer = EventObserver(self.requests, self._maps, actions, self._limits)
        self._publisher = MissionPublisher(stages, channels, track, log, watchdog, parameters.camera_pitch_down_rad)

    @property
    def finished(self) -> bool:
        """True if nothing more will be done."""
        return self.phase.finished

    @property
    def map(self) -> VoxelMap | None:
        """The newest map, None before the first depth frame."""
        return self._maps.map

    def step(self, now_s: float) -> None:
        """Run one step: map, events, phase, motion, and the message to the pilot."""
        vehicle = self._vehicle.latest()
        self._rebuild_corrected_map(now_s, vehicle)
        self._map_newest_frame(now_s)
        self._maps.integrate_cone()
        if vehicle is not None:
            self._vehicle_intake.update(now_s, vehicle, self.map)
            for detector in self._detectors:
                for event in detector.detect(now_s, vehicle):
                    self._respond(event, now_s, vehicle)
            self._continue_released(now_s, vehicle)
            self._log.update(self.phase, vehicle, self.requests.start_blocker)
            self._change_phase(advance(self.phase, self._observer.events(now_s, vehicle)), now_s)
            self._act(now_s, vehicle)
        elif self.requests.aborted:  # no vehicle was ever reported, so there is none to land
            self._change_phase(Phase.DONE, now_s)
        self._perception_log.step(now_s)
        self._publisher.publish(now_s, self.phase, self.map)

    def close(self, now_s: float) -> Reason | None:
        """Write the last line of the journal; returns why the flight was aborted.

        It returns None for a completed flight.
        """
        home = self.phase is Phase.DONE and self._actions.landed_at_home and not self._log.aborted
        why = self._log.aborted or self._log.note or Reason(ReasonCode.ENDED_IN_PHASE, (self.phase.value,))
        aborted = None if home else why
        self._perception_log.close()
        self._log.close(now_s, aborted)
        return aborted

    def _rebuild_corrected_map(self, now_s: float, vehicle: VehicleState | None) -> None:
        """After a map correction: rebuild the map, hold, and look round."""
        if self._maps.rebuild_corrected():
            self._log.refusal(now_s, Reason(ReasonCode.MAP_RESTARTED, (self._maps.map_epoch,)))
            self._actions.begin_again(now_s, vehicle, self._maps.map_epoch)

    def _map_newest_frame(self, now_s: float) -> None:
        posed = self._maps.integrate_frame(now_s)
        if posed is not None:
            self._keyframes.capture(now_s, posed, surveying=self.phase is Phase.SURVEY)

    def _respond(self, event: MissionEvent, now_s: float, vehicle: VehicleState) -> None:
        response, reason, requests = event.response, event.reason, self.requests
        about_to_start = requests.started and self.phase is Phase.READY
        if response is Response.LAND or (response is Response.REFUSE_TAKEOFF and about_to_start):
            requests.abort(reason)
        elif response is Response.RETURN:
            requests.return_home(reason)
        elif response is Response.REPLAN:
            self._log.refusal(now_s, reason)
            self._actions.stopped(now_s, vehicle, reason)
        elif response is Response.NOTE:
            self._log.refusal(now_s, reason)
        elif response is Response.NOTE_IN_HOLD and requests.held:
            self._log.note = reason

    def _continue_released(self, now_s: float, vehicle: VehicleState) -> None:
        if self.requests.take_release():
            self._actions.release(self.phase, now_s, vehicle)

    def _change_phase(self, phase: Phase, now_s: float) -> None:
        if phase is self.phase:
            return
        self._log.phase(now_s, phase)
        if phase is Phase.RETURN and not self._log.stop_reason:
            self._log.stop(self._limits.return_reason(now_s, self.requests.return_reason))
        self._actions.enter(phase, now_s)
        self.phase = phase

    def _act(self, now_s: float, vehicle: VehicleState) -> None:
        lost = self._actions.step(self.phase, now_s, vehicle, self.map)
        if lost is not None:
            self.requests.abort(lost)
