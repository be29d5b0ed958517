"""Conductor: one step of the mission, top to bottom. The only place where the stages meet."""

from __future__ import annotations

import numpy as np

from uav_recon.interfaces import Clock, Executor, Journal
from uav_recon.mission.async_planning import AsyncPlanner
from uav_recon.mission.battery_policy import BatteryPolicy
from uav_recon.mission.detectors import (
    DeadPlannerDetector,
    Detector,
    LowBatteryDetector,
    MapCorrectionDetector,
    MissingOperatorDetector,
    MissionEvent,
    RefusedTrajectoryDetector,
    Response,
)
from uav_recon.mission.events import Facts, observe
from uav_recon.mission.flight_track import FlightTrack
from uav_recon.mission.landing_site import LandingSite
from uav_recon.mission.map_publisher import MapPublisher
from uav_recon.mission.mission_log import MissionLog
from uav_recon.mission.mission_setup import MissionChannels, MissionParameters, MissionStages
from uav_recon.mission.operator_watchdog import OperatorWatchdog
from uav_recon.mission.perception_log import PerceptionLog
from uav_recon.mission.return_home import ReturnHome
from uav_recon.mission.speed_limit_log import SpeedLimitLog
from uav_recon.mission.state_machine import Phase, advance
from uav_recon.mission.survey import Survey
from uav_recon.mission.takeoff import Takeoff
from uav_recon.mission.trajectory_execution import TrajectoryExecutor
from uav_recon.mission.view_schedule import ViewSchedule
from uav_recon.types.camera import PosedFrame
from uav_recon.types.maps import VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal, Intent
from uav_recon.types.vehicle import VehicleState

FRAME_TIMEOUT_S = 1.0  #: hold: no depth frame for longer: the map ahead is not renewed
VIEW_LATE_S = 0.6  #: plan: a view is given up if no frame came within this time
PROGRESS_PERIOD_S = 0.2  #: internal: interval of the progress report
_CALLED_HOME = Reason(ReasonCode.OPERATOR_RETURN)


class Conductor:
    """Flies one mission.

    step() is called at 20 Hz or more and never waits for planning or mapping.
    """

    def __init__(
        self,
        stages: MissionStages,
        channels: MissionChannels,
        parameters: MissionParameters,
        executor: Executor,
        journal: Journal,
        clock: Clock,
    ) -> None:
        self._stages = stages
        self._channels = channels
        self._parameters = parameters
        self._clock = clock
        self._log = MissionLog(journal, parameters.views)
        self._perception_log = PerceptionLog(channels.perception, journal)
        self._captures = ViewSchedule(VIEW_LATE_S)
        self._track = FlightTrack(parameters.camera_pitch_down_rad)
        self._executor = TrajectoryExecutor(stages.motion, self._track, self._captures, self._log)
        self._ascent = Takeoff(self._executor, stages.motion, parameters.takeoff_height_m)
        planner = AsyncPlanner(
            stages.planner, stages.motion, stages.retreat, executor, parameters.plan_cost_s, parameters.view_spacing_m
        )
        self._survey = Survey(stages, channels, parameters, self._executor, planner, self._log)
        site = LandingSite(parameters.takeoff_height_m, -parameters.vehicle_height_m / 2, parameters.clear_radius_m)
        self._homeward = ReturnHome(self._executor, planner, self._log, site)
        self._battery = BatteryPolicy(self._track, site.home, parameters.clearance_m)
        self._operator_watchdog = OperatorWatchdog(parameters.operator_timeout_s)
        self._map_correction = MapCorrectionDetector(channels.correction)
        self._speed_limit = SpeedLimitLog(journal)
        self._detectors: tuple[Detector, ...] = (
            RefusedTrajectoryDetector(self._track),
            MissingOperatorDetector(self._operator_watchdog),
            DeadPlannerDetector(planner),
            LowBatteryDetector(self._battery),
        )
        self.phase = Phase.IDLE
        self.map: VoxelMap | None = None
        self._frame_sequence = 0
        self._frame_s = -np.inf
        self._cone_sequence = 0
        self._map_publisher = MapPublisher(channels)
        self._reported_s = -np.inf
        self._go_home: Reason | None = None  # the reason to go home, whichever other reasons there are
        self._start = self._abort = self._hold = self._released = self._arrived = False
        half_m, top_m = (
            parameters.vehicle_height_m / 2,
            parameters.takeoff_height_m + parameters.clear_radius_m,
        )  # home is clear above too
        stages.voxels.declare_free(np.zeros(3), parameters.takeoff_radius_m, -half_m, top_m)
        if parameters.takeoff_top_m > top_m:
            stages.voxels.declare_free(np.zeros(3), parameters.takeoff_top_radius_m, top_m, parameters.takeoff_top_m)

    @property
    def finished(self) -> bool:
        """True if nothing more will be done."""
        return self.phase in (Phase.DONE, Phase.YIELDED)

    def request_start(self) -> None:
        """Start the flight: by the operator's command or by autostart."""
        self._start = True

    def request_hold(self) -> None:
        """Hold position until resume() or request_return(); the mission's own events wait."""
        self._hold = True

    def request_return(self, why: Reason = _CALLED_HOME) -> None:
        """Fly home and land; never taken back."""
        self._go_home = self._go_home or why
        self.resume()

    def resume(self) -> None:
        """Continue after a hold; without one nothing changes."""
        self._released = self._released or self._hold
        self._hold = False

    def request_abort(self, reason: Reason) -> None:
        """Land now; never taken back."""
        self._abort = True
        self._log.aborted = self._log.aborted or reason

    def step(self) -> None:
        """Run one step: map, events, phase, motion, and the message to the pilot."""
        now_s = self._clock.now_s()
        vehicle = self._channels.vehicle.latest()
        self._rebuild_corrected_map(now_s, vehicle)
        self._map_newest_frame(now_s)
        self._map_newest_cone()
        if vehicle is not None:
            self._follow(now_s, vehicle)
            for detector in self._detectors:
                for event in detector.detect(now_s, vehicle):
                    self._respond(event, now_s, vehicle)
            self._continue_released(now_s, vehicle)
            self._log.update(self.phase, vehicle, self._operator_watchdog.missing if self._start else None)
            self._change_phase(advance(self.phase, observe(self._facts(now_s, vehicle))), now_s)
            self._act(now_s, vehicle)
        elif self._abort:  # no vehicle was ever reported, so there is none to land
            self._change_phase(Phase.DONE, now_s)
        self._perception_log.step(now_s)
        self._publish(now_s)

    # -- map ----------------------------------------------------------------------------------------------------------

    def _rebuild_corrected_map(self, now_s: float, vehicle: VehicleState | None) -> None:
        """After a map correction: hold, rebuild the map, and look round.

        Positions where the vehicle flew are free.
        """
        correction = self._map_correction.detect()
        if correction is None:
            return
        self._executor.map_epoch = correction.map_epoch
        self._stages.voxels.reset(correction.map_epoch)
        half_m = self._parameters.vehicle_height_m / 2
        for crumb in self._track.breadcrumbs:
            z_m = float(crumb[2])
            self._stages.voxels.declare_free(crumb, self._parameters.clear_radius_m, z_m - half_m, z_m + half_m)
        self._stages.mapper.repose(correction)
        self._log.refusal(now_s, Reason(ReasonCode.MAP_RESTARTED, (correction.map_epoch,)))
        self.map = self._stages.voxels.snapshot()
        self._survey.begin_again()
        self._homeward.begin_again()
        if vehicle is not None and self._track.trajectory is not None:
            self._executor.hold(now_s, vehicle)

    def _map_newest_frame(self, now_s: float) -> None:
        sequence = self._channels.frames.sequence()
        posed = self._channels.frames.latest() if sequence != self._frame_sequence else None
        if posed is None:
            return
        self._frame_sequence = sequence
        if posed.map_epoch != self._executor.map_epoch:
            return  # its pose does not fit the map, so it is ignored
        self._frame_s = now_s
        if posed.unsure:
            return  # it would draw surfaces where none are
        self._stages.voxels.integrate(posed)
        views = self._stages.recent_views.add(posed)
        if views is not None:
            self._stages.motion.set_recent_views(views)
            self._stages.retreat.set_recent_views(views)
        self.map = self._stages.voxels.snapshot()
        promised = self._captures.take(posed.frame.stamp_s) and self._track.is_on_track(now_s)
        if self._log.views_left > 0 and (promised or self._worth_a_view(posed)) and self._stages.mapper.add(posed):
            self._stages.budget.keep(posed)
            self._log.view(posed)

    def _map_newest_cone(self) -> None:
        """Free what the upward range finder found empty. The first map needs a depth frame."""
        sequence = self._channels.cones.sequence()
        cone = self._channels.cones.latest() if sequence != self._cone_sequence else None
        self._cone_sequence = sequence
        if cone is None or self.map is None or cone.map_epoch != self._executor.map_epoch:
            return
        if self._stages.voxels.integrate_cone(cone):
            self.map = self._stages.voxels.snapshot()

    def _worth_a_view(self, posed: PosedFrame) -> bool:
        """Return True if a frame shows enough that is new.

        Views of the look round and of the tasks are taken in any case.
        """
        return self.phase is Phase.SURVEY and self._stages.budget.worth(
            posed, self._log.views_left, explored=self._log.explored
        )

    # -- respond ------------------------------------------------------------------------------------------------------

    def _follow(self, now_s: float, vehicle: VehicleState) -> None:
        """Record the vehicle's position, speed limit and charge."""
        self._track.follow(vehicle)
        self._stages.motion.allow(vehicle.max_speed_mps)
        self._stages.retreat.allow(vehicle.max_speed_mps)
        self._speed_limit.update(vehicle)
        self._battery.update(now_s, vehicle, self.map)

    def _respond(self, event: MissionEvent, now_s: float, vehicle: VehicleState) -> None:
        response, reason = event.response, event.reason
        if response is Response.LAND or (response is Response.REFUSE_TAKEOFF and self._start and self.phase is Phase.READY):
            self.request_abort(reason)
        elif response is Response.RETURN:
            self.request_return(reason)
        elif response is Response.REPLAN:
            self._log.refusal(now_s, reason)
            self._executor.hold(now_s, vehicle)
            self._survey.stopped(now_s, reason)
            self._homeward.replan(vehicle.world_from_body.translation_m)
        elif response is Response.NOTE:
            self._log.refusal(now_s, reason)
        elif response is Response.NOTE_IN_HOLD and self._hold:
            self._log.note = reason

    def _continue_released(self, now_s: float, vehicle: VehicleState) -> None:
        """Continue after a hold from where the pilot held the vehicle, which is not on the track."""
        if self._released and self.phase is Phase.HOLD:
            self._executor.hold(now_s, vehicle)
        elif self._released and self.phase is Phase.TAKEOFF:
            self._ascent.begin_again()
        self._released = False

    # -- decide -------------------------------------------------------------------------------------------------------

    def _facts(self, now_s: float, vehicle: VehicleState) -> Facts:
        return Facts(
            vehicle=vehicle,
            start=self._start and self.map is not None and not self._operator_watchdog.missing,
            abort=self._abort,
            at_rest=self._executor.at_rest(now_s),
            took_off=self._ascent.risen,
            frame_age_s=now_s - self._frame_s,
            frame_timeout_s=FRAME_TIMEOUT_S,
            nothing_left=bool(self._log.stop_reason),
            views_left=self._log.views_left,
            flight_s=now_s - self._ascent.begun_s,
            max_flight_s=self._parameters.max_flight_s,
            arrived=self._homeward.has_arrived(now_s),
            no_way_home=self._homeward.no_path,
            charge=self._battery.left,
            charge_needed=self._battery.required_charge,
            charge_lost=self._battery.lost,
            hold=self._hold,
            go_home=bool(self._go_home),
        )

    def _change_phase(self, phase: Phase, now_s: float) -> None:
        if phase is self.phase:
            return
        self._log.phase(now_s, phase)
        if phase is Phase.RETURN:
            self._log.stop_reason = self._log.stop_reason or self._why_return(now_s)
        if phase in (Phase.HOLD, Phase.RETURN, Phase.RETREAT):
            self._executor.brake(now_s)
        elif phase is Phase.LANDING:
            self._arrived = self._homeward.has_arrived(now_s)
        self.phase = phase
        self._survey.interrupt()
        self._homeward.interrupt()

    def _why_return(self, now_s: float) -> Reason:
        why = self._go_home or self._battery.why()
        if self._log.views_left <= 0:
            why = Reason(ReasonCode.VIEWS_SPENT, (self._parameters.views,))
        elif now_s - self._ascent.begun_s > self._parameters.max_flight_s:
            why = Reason(ReasonCode.TIME_SPENT, (self._parameters.max_flight_s,))
        self._log.note = why
        return why.with_detail(Reason(ReasonCode.FRONTIERS_IN_LAST_PLAN, (self._log.frontiers,)))

    # -- act ----------------------------------------------------------------------------------------------------------

    def _act(self, now_s: float, vehicle: VehicleState) -> None:
        if self.phase is Phase.TAKEOFF:
            self._ascent.step(now_s, vehicle)
        elif self.map is None:
            return
        elif self.phase is Phase.SURVEY:
            self._survey.step(now_s, vehicle, self.map)
        elif self.phase in (Phase.RETURN, Phase.RETREAT):
            self._homeward.step(now_s, vehicle, self.map, along_breadcrumbs=self.phase is Phase.RETREAT)
            if self._homeward.lost:
                self.request_abort(self._homeward.lost)

    # -- publish ------------------------------------------------------------------------------------------------------

    def _publish(self, now_s: float) -> None:
        grounded = self.phase in (Phase.IDLE, Phase.READY, Phase.DONE, Phase.YIELDED)
        goal = Goal.STANDBY if grounded else Goal.LAND if self.phase is Phase.LANDING else Goal.FLY
        self._map_publisher.free(now_s, self.map, self._track.trajectory)
        operator, told = self._operator_watchdog, self._log.aborted or self._operator_watchdog.note
        self._channels.intent.publish(Intent(now_s, goal, self._track.trajectory, told, bool(operator.lost)))
        self._map_publisher.maps(now_s, self.map, self._stages.mapper, last=self.finished)
        if now_s - self._reported_s >= PROGRESS_PERIOD_S or self.finished:
            self._reported_s = now_s
            explored_m3, track = self._stages.voxels.explored_m3(), self._track
            progress = self._log.progress(
                now_s, self.phase, explored_m3, track.path_length_m, track.position_world, self.finished
            )
            self._channels.progress.publish(progress)

    def close(self) -> Reason | None:
        """Write the last line of the journal; returns why the flight was aborted.

        It returns None for a completed flight.
        """
        home = self.phase is Phase.DONE and self._arrived and not self._log.aborted
        why = self._log.aborted or self._log.note or Reason(ReasonCode.ENDED_IN_PHASE, (self.phase.value,))
        aborted = None if home else why
        self._perception_log.close()
        self._log.close(self._clock.now_s(), aborted)
        return aborted
