"""Factory of the mission: selects map, planner and motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from uav_recon.app.flight_channels import FlightChannels
from uav_recon.config import Config
from uav_recon.interfaces import Executor, Journal, Mapper
from uav_recon.types.maps import GridSpec

if TYPE_CHECKING:  # each process imports only the stages that it runs
    from uav_recon.mapping.keyframe_selection import KeyframeSelection, PlannedViewsOnly
    from uav_recon.mapping.localizability_map import LocalizabilityMap
    from uav_recon.mapping.occupancy.multiresolution_map import MultiResolutionMap
    from uav_recon.mapping.occupancy.occupancy_map import OccupancyMap
    from uav_recon.mapping.recent_view_memory import RecentViewMemory
    from uav_recon.mission.conductor import Conductor
    from uav_recon.mission.setup.mission_parameters import MissionParameters
    from uav_recon.motion.speed_limited_planner import SpeedLimitedPlanner
    from uav_recon.planning.camera_frustum import CameraGeometry
    from uav_recon.planning.fallback_planner import FallbackPlanner
    from uav_recon.planning.tour.travel_time import TravelTimeModel

# the column declared free above the hover is wider than planner.clearance_m by this number of voxels: half of one for the
# clearance, and the way from the pad to the nearest voxel centre
COLUMN_VOXELS = 1.25
ABOVE_M = 0.12  #: plan: clearance above and below the hull
PASSAGE_M = 0.12  #: plan: clearance of the hull in a narrow passage
PASSAGE_ERROR_M = 0.025  # clearance that a fine map shows too little: its voxels with surface begin before the surface
HOMEWARD_M = 0.15  #: plan: clearance of the hull on a path home where planner.clearance_m leads no more
INSIDE_M = 0.03  #: plan: a motion stays this much farther inside the fence than the guard requires
#: plan: clearance of the hull on the last possible paths home: the vehicle flew there, even if the map differs
RETREAT_M = 0.10


def make_conductor(
    config: Config,
    channels: FlightChannels,
    mapper: Mapper,
    executor: Executor,
    journal: Journal,
    timer: Callable[[], float],
) -> Conductor:
    """Return the mission with every stage warm."""
    from uav_recon.mission.conductor import Conductor
    from uav_recon.mission.setup.mission_stages import MissionStages

    config = with_preset(config)
    voxels, planner, parameters = make_occupancy_map(config), make_planner(config, timer), mission_parameters(config)
    motion, retreat = (make_motion(config, kept_m) for kept_m in (parameters.clearance_m, parameters.clear_radius_m))
    budget, sight = make_keyframe_selection(config, voxels.grid), make_recent_view_memory(config)
    localizability = make_localizability_map(config, voxels.grid) if is_perception_aware(config) else None
    stages = MissionStages(voxels, budget, mapper, planner, motion, retreat, sight, localizability)
    return Conductor(stages, channels, parameters, executor, journal)


def mission_parameters(config: Config) -> MissionParameters:
    """Return the numbers of the mission; the config must have the values of its preset."""
    from uav_recon.mission.setup.mission_parameters import MissionParameters

    mission, clearance_m = config.mission, config.planner.clearance_m
    return MissionParameters(
        views=mission.views,
        survey_views=mission.survey_views,
        view_spacing_m=config.planner.view_spacing_m or math.inf,
        takeoff_height_m=mission.takeoff_height_m,
        takeoff_radius_m=config.voxels.takeoff_radius_m,
        takeoff_top_m=config.voxels.takeoff_top_m or 0.0,
        takeoff_top_radius_m=clearance_m + COLUMN_VOXELS * config.voxels.resolution_m,
        vehicle_height_m=config.safety.vehicle_height_m,
        clear_radius_m=min(config.safety.vehicle_radius_m + RETREAT_M, clearance_m),
        camera_pitch_down_rad=math.radians(config.camera.pitch_down_deg),
        max_flight_s=mission.max_flight_s,
        plan_cost_s=mission.plan_cost_s,
        clearance_m=clearance_m,
        operator_timeout_s=mission.operator_timeout_s or math.inf,
    )


def make_occupancy_map(config: Config) -> MultiResolutionMap:
    """Return the occupancy map over the fence and a margin beyond it."""
    from uav_recon.mapping.occupancy.multiresolution_map import FINE_RANGE_M, FINE_RESOLUTION_M, MultiResolutionMap
    from uav_recon.mapping.occupancy.occupancy_map import DepthSensor, OccupancyMap
    from uav_recon.planning.free_space.flyable_space import height_measure

    safety, voxels, camera = config.safety, config.voxels, config.camera
    margin = np.full(3, voxels.margin_m)
    grid = GridSpec.covering(np.array(safety.fence_min_m) - margin, np.array(safety.fence_max_m) + margin, voxels.resolution_m)
    sensor = DepthSensor(camera.depth_min_m, camera.depth_noise_px, camera.baseline_m)
    fence = safety.fence_min_m, safety.fence_max_m
    half_m = safety.vehicle_height_m / 2
    heights = height_measure(config.planner.clearance_m, half_m, ABOVE_M, voxels.resolution_m)
    fine_heights = height_measure(passage_clearance_m(config), half_m, ABOVE_M - PASSAGE_ERROR_M, FINE_RESOLUTION_M)

    def fine(grid: GridSpec, map_epoch: int) -> OccupancyMap:
        range_m = min(FINE_RANGE_M, voxels.max_range_m)
        return OccupancyMap(
            grid, sensor, range_m, *fence, voxels.distance_cap_m, map_epoch, heights=fine_heights
        )  # fmt: skip

    coarse = OccupancyMap(grid, sensor, voxels.max_range_m, *fence, voxels.distance_cap_m, heights=heights)
    return MultiResolutionMap(coarse, fine)


def with_preset(config: Config) -> Config:
    """Return the config with the values of the planner's preset.

    Applying it twice changes nothing.
    """
    from uav_recon.planning.presets import derived

    low_m, high_m = np.array(config.safety.fence_min_m), np.array(config.safety.fence_max_m)
    return config.model_copy(update={"planner": derived(config.planner, low_m, high_m, camera_geometry(config))})


def make_planner(config: Config, timer: Callable[[], float]) -> FallbackPlanner:
    """Return the config's planner, with ways home of less clearance."""
    from uav_recon.planning.fallback_planner import FallbackPlanner
    from uav_recon.planning.view_planner import ViewPlanner

    safety = config.safety
    above_m = safety.vehicle_height_m / 2 + ABOVE_M
    least_m = np.array([config.planner.clearance_m, config.planner.clearance_m, above_m])
    inset_m = np.maximum(least_m, safety.fence_inset_m)  # never plan what the guard would refuse
    usual = ViewPlanner(
        config.planner, np.array(safety.fence_min_m), np.array(safety.fence_max_m), camera_geometry(config),
        travel_time_model(config), timer, inset_m, passage_clearance_m(config),
    )  # fmt: skip
    home_m = [safety.vehicle_radius_m + max(one_m, safety.stop_clearance_m) for one_m in (HOMEWARD_M, RETREAT_M)]
    return FallbackPlanner(
        usual, tuple(min(one_m, config.planner.clearance_m) for one_m in home_m), max(home_m[0], safety.fence_inset_m), timer
    )


def passage_clearance_m(config: Config) -> float:
    """Return the clearance of the body's centre in a narrow passage."""
    return min(config.safety.vehicle_radius_m + PASSAGE_M - PASSAGE_ERROR_M, config.planner.clearance_m)


def travel_time_model(config: Config) -> TravelTimeModel:
    """Return the planner's model of travel times, for the yaw policy of motion."""
    from uav_recon.motion.yaw_policy import YawAlongPath, yaw_policy_of
    from uav_recon.planning.tour.travel_time import YawThenFly, YawWhileFlying

    yaw_policy, pace = yaw_policy_of(config), (config.motion.speed_mps, math.radians(config.motion.yaw_rate_degps))
    if isinstance(yaw_policy, YawAlongPath):
        return YawThenFly(*pace, yaw_policy.blind_speed_mps, yaw_policy.max_offset_rad, yaw_policy.vertical_tangent)
    return YawWhileFlying(*pace)


def camera_geometry(config: Config) -> CameraGeometry:
    """Return the geometry of the config's depth camera for the planner."""
    from uav_recon.planning.camera_frustum import RANGE_SHARE, CameraGeometry

    camera = config.camera
    low, high = (camera.pitch_down_deg,) * 2 if camera.mount == "fixed" else (-camera.gimbal_limit_deg, camera.gimbal_limit_deg)
    return CameraGeometry(
        hfov_rad=math.radians(camera.horizontal_fov_deg),
        vfov_rad=math.radians(camera.vertical_fov_deg),
        position_body_m=np.array(camera.position_body_m),
        pitch_min_rad=math.radians(low),
        pitch_max_rad=math.radians(high),
        range_m=config.voxels.max_range_m * RANGE_SHARE,
        near_m=camera.depth_min_m,
    )


def make_motion(config: Config, clearance_m: float) -> SpeedLimitedPlanner:
    """Return the motion planner inside the guard's fence.

    It is slow while the guard's speed limit is that of a retreat.
    """
    from uav_recon.motion.speed_limited_planner import SpeedLimitedPlanner

    safety, inset_m = config.safety, config.safety.fence_inset_m + INSIDE_M
    return SpeedLimitedPlanner.of(
        config, clearance_m, np.array(safety.fence_min_m) + inset_m, np.array(safety.fence_max_m) - inset_m,
        passage_clearance_m(config),
    )  # fmt: skip


def make_recent_view_memory(config: Config) -> RecentViewMemory:
    """Return the mission's memory of the views that raise the speed limit outside the view."""
    from uav_recon.mapping.recent_view_memory import RecentViewMemory
    from uav_recon.safety.sight_speed_limit import longest_memory_s

    return RecentViewMemory(longest_memory_s(config.safety.blind_memory_s), np.array(config.camera.position_body_m))


def is_perception_aware(config: Config) -> bool:
    """Return True if views are preferred that show where the vehicle is."""
    aware = config.planner.perception_aware
    return config.localization.source == "slam" if aware is None else aware


def make_localizability_map(config: Config, grid: GridSpec) -> LocalizabilityMap:
    """Return the map of surface by which the camera tells where it is."""
    from uav_recon.mapping.localizability_map import LocalizabilityMap

    return LocalizabilityMap(grid, camera_geometry(config).eye)


def make_keyframe_selection(config: Config, grid: GridSpec) -> KeyframeSelection | PlannedViewsOnly:
    """Return the selection of keyframes beside the planned views, within the view budget."""
    from uav_recon.mapping.keyframe_selection import KeyframeSelection, PlannedViewsOnly

    if config.planner.view_spacing_m is not None:
        return PlannedViewsOnly()
    safety, camera = config.safety, config.camera
    low, high = np.array(safety.fence_min_m), np.array(safety.fence_max_m)
    return KeyframeSelection(grid, low, high, camera.depth_noise_px, camera.baseline_m)


def warm_up(config: Config) -> None:
    """Compile every kernel of the mission process before the drone may be READY."""
    from uav_recon.planning import view_planner as planner

    warm_up_map(config)
    planner.warm_up(config.planner.variant)
    warm_up_motion(config)


def warm_up_map(config: Config) -> None:
    """Compile the kernels of the occupancy map and of the keyframe selection."""
    voxels = make_occupancy_map(config)
    voxels.warm_up()
    make_keyframe_selection(config, voxels.grid).warm_up()
    make_recent_view_memory(config).warm_up()
    make_localizability_map(config, voxels.grid).warm_up()


def warm_up_motion(config: Config) -> None:
    """Compile the kernels of motion planning."""
    make_motion(config, config.planner.clearance_m).warm_up()
