"""Flight actions: take-off, survey and return home, one at a time, as the phase says."""

from __future__ import annotations

from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.return_home.landing_site import LandingSite
from uav_recon.mission.return_home.return_home import ReturnHome
from uav_recon.mission.setup.mission_channels import MissionChannels
from uav_recon.mission.setup.mission_parameters import MissionParameters
from uav_recon.mission.setup.mission_stages import MissionStages
from uav_recon.mission.state_machine import Phase
from uav_recon.mission.survey.survey import Survey
from uav_recon.mission.takeoff import Takeoff
from uav_recon.mission.trajectory.async_planning import AsyncPlanner
from uav_recon.mission.trajectory.trajectory_execution import TrajectoryExecutor
from uav_recon.types.maps import VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.vehicle import VehicleState


class FlightActions:
    """Runs the action of the present phase, and tells the actions what interrupts them.

    home_m: position (3,) over the pad. landed_at_home: the landing began over the landing position of the way home.
    """

    def __init__(
        self,
        stages: MissionStages,
        channels: MissionChannels,
        parameters: MissionParameters,
        executor: TrajectoryExecutor,
        planner: AsyncPlanner,
        log: MissionLog,
    ) -> None:
        site = LandingSite(parameters.takeoff_height_m, -parameters.vehicle_height_m / 2, parameters.clear_radius_m)
        self._executor = executor
        self.home_m = site.home
        self.takeoff = Takeoff(executor, stages.motion, parameters.takeoff_height_m)
        self.survey = Survey(stages, channels, parameters, executor, planner, log)
        self.return_home = ReturnHome(executor, planner, log, site)
        self.landed_at_home = False

    def at_rest(self, now_s: float) -> bool:
        """Return True if the trajectory is flown and its views are taken."""
        return self._executor.at_rest(now_s)

    def step(self, phase: Phase, now_s: float, vehicle: VehicleState, voxels: VoxelMap | None) -> Reason | None:
        """Act in this phase; return why the vehicle has to land where it is, None for nothing."""
        if phase is Phase.TAKEOFF:
            self.takeoff.step(now_s, vehicle)
        elif voxels is None:
            return None
        elif phase is Phase.SURVEY:
            self.survey.step(now_s, vehicle, voxels)
        elif phase in (Phase.RETURN, Phase.RETREAT):
            self.return_home.step(now_s, vehicle, voxels, along_breadcrumbs=phase is Phase.RETREAT)
            return self.return_home.lost
        return None

    def enter(self, phase: Phase, now_s: float) -> None:
        """Begin a phase: brake if it begins at rest, and drop the requests of the one before."""
        if phase in (Phase.HOLD, Phase.RETURN, Phase.RETREAT):
            self._executor.brake(now_s)
        elif phase is Phase.LANDING:
            self.landed_at_home = self.return_home.has_arrived(now_s)
        self.survey.interrupt()
        self.return_home.interrupt()

    def stopped(self, now_s: float, vehicle: VehicleState, reason: Reason) -> None:
        """Hold where the guard has stopped the vehicle, and plan again."""
        self._executor.hold(now_s, vehicle)
        self.survey.stopped(now_s, reason)
        self.return_home.replan(vehicle.world_from_body.translation_m)

    def begin_again(self, now_s: float, vehicle: VehicleState | None, map_epoch: int) -> None:
        """Hold and look round, because the map is new."""
        self._executor.map_epoch = map_epoch
        self.survey.begin_again()
        self.return_home.begin_again()
        if vehicle is not None and self._executor.track.trajectory is not None:
            self._executor.hold(now_s, vehicle)

    def release(self, phase: Phase, now_s: float, vehicle: VehicleState) -> None:
        """Continue after a hold from where the pilot held the vehicle: off the trajectory."""
        if phase is Phase.HOLD:
            self._executor.hold(now_s, vehicle)
        elif phase is Phase.TAKEOFF:
            self.takeoff.begin_again()
