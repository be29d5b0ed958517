"""Factory of the stages: the composition root that selects their implementations."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uav_recon import config as configuration
from uav_recon.app import camera_sources, pose_sources
from uav_recon.app.flight_channels import FlightChannels
from uav_recon.clock import InlineExecutor
from uav_recon.config import Config, LinkConfig
from uav_recon.errors import EXIT_CONFIG, UserError
from uav_recon.interfaces import (
    ByteLink,
    CameraRemarks,
    Clock,
    DepthCamera,
    Executor,
    ExposureLocking,
    Journal,
    Mapper,
    PoseSource,
)
from uav_recon.types.maps import GridSpec
from uav_recon.types.reason import Reason
from uav_recon.types.vehicle import FlightPhase, VehicleState

if TYPE_CHECKING:  # each process imports only the stages that it runs
    from uav_recon.autopilot.firmware.profile import FirmwareProfile
    from uav_recon.autopilot.link.navigation import Navigation
    from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
    from uav_recon.autopilot.mavlink.tlog import FrameLog
    from uav_recon.autopilot.parameters.preflight_check import ParameterCheck
    from uav_recon.autopilot.parameters.reader import ParameterEncoding
    from uav_recon.autopilot.pilot.pilot import HullGeometry, Pilot
    from uav_recon.autopilot.pilot.upward_range_finder import RangeFinderModel
    from uav_recon.localization.calibration.camera_mount import Mount
    from uav_recon.localization.consistency.depth_consistency import DepthConsistencyMonitor
    from uav_recon.localization.consistency.reconciled_consistency import ReconciledConsistency
    from uav_recon.localization.correction.odometry_correction import OdometryCorrection
    from uav_recon.localization.fusion.fusion_filter import FusionFilter
    from uav_recon.localization.perception import Perception
    from uav_recon.mapping.keyframe_selection import KeyframeSelection, PlannedViewsOnly
    from uav_recon.mapping.neural.neural_mapper import NeuralMapper
    from uav_recon.mapping.occupancy.occupancy_map import OccupancyMap
    from uav_recon.mapping.recent_view_memory import RecentViewMemory
    from uav_recon.mission.conductor import Conductor
    from uav_recon.mission.mission_setup import MissionParameters
    from uav_recon.motion.speed_limited_planner import SpeedLimitedPlanner
    from uav_recon.planning.camera_frustum import CameraGeometry
    from uav_recon.planning.narrow_passages import NarrowPassagePlanner
    from uav_recon.planning.tour.travel_time import TravelTimeModel
    from uav_recon.recording.rerun_recorder import Recorder
    from uav_recon.recording.timelapse import Timelapse
    from uav_recon.safety.envelope import Envelope
    from uav_recon.safety.failsafe import FailsafeTimeouts
    from uav_recon.safety.guard import GuardBounds
    from uav_recon.safety.recently_seen_space import RecentlySeenSpace

PAD_FILE = "pad_origin.json"  # in the runtime folder
# the column declared free above the hover is wider than planner.clearance_m by this number of voxels: half of one for the
# clearance, and the way from the pad to the nearest voxel centre
COLUMN_VOXELS = 1.25
#: reject: after a longer silence, a pose of the embedded SLAM until more agree with it; a camera loses up to five frames, and
#: two more must fit after a doubt
SLAM_BRIDGED_S = 1.0
NARROW_M = 0.15  #: plan: clearance of the hull on paths to where planner.clearance_m leads no more
INSIDE_M = 0.03  #: plan: a motion stays this much farther inside the fence than the guard requires
#: plan: clearance of the hull on the last possible paths home: the vehicle flew there, even if the map differs
RETREAT_M = 0.10


def load_config(path: Path) -> Config:
    """Read a config. Raises UserError with exit code 78."""
    try:
        return configuration.load(path)
    except configuration.ConfigError as error:
        raise UserError(str(error), EXIT_CONFIG) from None


# -- the pilot ----------------------------------------------------------------------------------------------------------


def make_allow_list_filter(way: LinkConfig, clock: Clock) -> AllowListFilter:
    """Return the filter of senders on the link.

    Raises UserError with exit code 78 for a key or stamps that cannot be used.
    """
    from uav_recon.autopilot.mavlink.allow_list import AllowList, AllowListFilter
    from uav_recon.autopilot.mavlink.signing import KeyFileError, open_signature
    from uav_recon.autopilot.mavlink.signing_timestamps import SigningTimestampsError

    ids, key = AllowList(way.vehicle_system, way.vehicle_component, way.gimbal_component, way.autopilot_uid), way.signing_key
    try:
        return AllowListFilter(ids, open_signature(key, way.signing_link_id, way.signing_stamps, clock) if key else None)
    except (KeyFileError, SigningTimestampsError) as error:
        raise UserError(f"link.{error}", EXIT_CONFIG) from None


def make_pilot(
    config: Config, wires: FlightChannels, link: ByteLink, log: FrameLog, clock: Clock, gate: AllowListFilter | None = None
) -> Pilot:
    """Build the loop next to the autopilot.

    gate: the one that its link already uses, if there is one.
    """
    from uav_recon.autopilot.pilot.pilot import PilotChannels
    from uav_recon.autopilot.pilot.pilot import make_pilot as wire_pilot
    from uav_recon.autopilot.pilot.preflight import Origin
    from uav_recon.safety.guard import Guard

    sight = recently_seen_space(config)
    guard = Guard(envelope(config), guard_bounds(config), sight)
    channels = PilotChannels(
        wires.odom, wires.intent, wires.vehicle, wires.free, wires.nearby, wires.rates, wires.reported, wires.cones
    )
    origin = Origin(config.link.origin_lat_deg, config.link.origin_lon_deg, config.link.origin_alt_m)
    (personality, _), rate_hz = firmware(config.link.autopilot), config.link.setpoint_rate_hz
    parameters = make_parameter_check(config)
    return wire_pilot(
        link, personality, guard, sight, failsafe_timeouts(config), channels, clock, origin, hull_geometry(config), rate_hz,
        log, parameters, gate or make_allow_list_filter(config.link, clock), make_navigation(config),
        range_finder_model(config),
    )  # fmt: skip


def range_finder_model(config: Config) -> RangeFinderModel | None:
    """Return the upward range finder that the operator declares, None without one."""
    from uav_recon.autopilot.pilot.upward_range_finder import RangeFinderModel

    up = config.range_up
    if up.fov_deg is None:
        return None
    return RangeFinderModel(
        fov_rad=math.radians(up.fov_deg), position_body_m=np.array(up.position_body_m), error_share=up.error_share
    )


def make_navigation(config: Config) -> Navigation:
    """Return who tells the autopilot where it is."""
    from uav_recon.autopilot.link.navigation import AutopilotNavigation, CompanionNavigation
    from uav_recon.autopilot.link.reported_poses import LocalPositionPoses, OdometryPoses

    if config.localization.source != "autopilot":
        return CompanionNavigation()
    return AutopilotNavigation(OdometryPoses() if config.localization.autopilot_message == "odometry" else LocalPositionPoses())


def failsafe_timeouts(config: Config) -> FailsafeTimeouts:
    """Return the timeouts of the failsafe, each under its key in [safety]."""
    from uav_recon.safety.failsafe import FailsafeTimeouts

    safety = config.safety
    return FailsafeTimeouts(
        pose_timeout_s=safety.pose_timeout_s,
        pose_land_s=safety.pose_land_s,
        intent_timeout_s=safety.intent_timeout_s,
        retreat_timeout_s=safety.retreat_timeout_s,
        land_timeout_s=safety.land_timeout_s,
        depth_timeout_s=safety.depth_timeout_s,
        depth_retreat_s=safety.depth_retreat_s,
        depth_land_s=safety.depth_land_s,
    )


def guard_bounds(config: Config) -> GuardBounds:
    """Return the guard's limits on ages, speeds and clearances, each under its key in [safety]."""
    from uav_recon.safety.guard import GuardBounds
    from uav_recon.safety.obstacle_speed_limit import Margins

    safety = config.safety
    return GuardBounds(
        pose_timeout_s=safety.pose_timeout_s,
        intent_timeout_s=safety.intent_timeout_s,
        silence_way_m=safety.silence_way_m,
        depth_timeout_s=safety.depth_timeout_s,
        blind_speed_mps=safety.blind_speed_mps,
        blind_fresh_s=safety.blind_fresh_s,
        blind_stale_s=safety.blind_stale_s,
        retreat_speed_mps=safety.retreat_speed_mps,
        margins=Margins(stop_clearance_m=safety.stop_clearance_m, fast_clearance_m=safety.fast_clearance_m),
    )


def recently_seen_space(config: Config) -> RecentlySeenSpace:
    """Return an empty memory of the space that the camera saw."""
    from uav_recon.safety.recently_seen_space import RecentlySeenSpace

    safety = config.safety
    return RecentlySeenSpace(blind_memory_s=safety.blind_memory_s, vehicle_radius_m=safety.vehicle_radius_m)


def hull_geometry(config: Config) -> HullGeometry:
    """Return the hull and the hover height of the pilot."""
    from uav_recon.autopilot.pilot.pilot import HullGeometry

    return HullGeometry(
        vehicle_radius_m=config.safety.vehicle_radius_m,
        vehicle_height_m=config.safety.vehicle_height_m,
        hover_height_m=config.mission.takeoff_height_m,
        gimbal=config.camera.mount == "gimbal",
    )


def firmware(name: str) -> tuple[FirmwareProfile, ParameterEncoding]:
    """Return the profile of px4 or ardupilot, and its encoding of parameters."""
    from uav_recon.autopilot.firmware.ardupilot import ARDUPILOT
    from uav_recon.autopilot.firmware.px4 import PX4
    from uav_recon.autopilot.parameters.reader import BYTEWISE, NUMERIC

    return {"px4": (PX4, BYTEWISE), "ardupilot": (ARDUPILOT, NUMERIC)}[name]


def make_parameter_check(config: Config) -> ParameterCheck:
    """Return the check of the vehicle's parameters before arming.

    Raises UserError with exit code 78 for a file that cannot be used.
    """
    from uav_recon.autopilot.parameters.parameter_file import PARAMETER_FILES, ParameterFileError, load
    from uav_recon.autopilot.parameters.preflight_check import ParameterCheck

    try:
        file = config.link.parameters or PARAMETER_FILES[config.link.autopilot]
        wanted = load(file, fed=config.localization.source != "autopilot")
    except ParameterFileError as error:
        raise UserError(f"link.parameters: {error}", EXIT_CONFIG) from None
    return ParameterCheck(wanted, firmware(config.link.autopilot)[1])


def envelope(config: Config) -> Envelope:
    """Return the guard's fence and limits.

    Raises UserError if the fence does not contain the take-off column.
    """
    from uav_recon.safety.envelope import Envelope, Fence

    safety = config.safety
    fence = Fence(
        plan=safety.fence_plan(), floor_m=safety.fence_min_m[2], ceiling_m=safety.fence_max_m[2], inset_m=safety.fence_inset_m
    )
    try:
        return Envelope(
            fence=fence,
            max_speed_mps=safety.max_speed_mps,
            max_acceleration_mps2=safety.max_acceleration_mps2,
            max_yaw_rate_radps=math.radians(safety.max_yaw_rate_degps),
        )
    except ValueError as error:
        raise UserError(f"safety: {error}", EXIT_CONFIG) from None


# -- perception ---------------------------------------------------------------------------------------------------------


def make_perception(
    config: Config,
    wires: FlightChannels,
    clock: Clock,
    stopped: Callable[[], bool] = lambda: False,
    compile_ahead: Callable[[], None] = lambda: None,
    writer: Executor | None = None,
) -> Perception:
    """Build the loop next to the camera. compile_ahead() is called once there is a camera.

    writer: writes the camera's errors beside the loop; None: on the clock of a simulation.

    Raises UserError if there is no camera; with exit code 0 if stopped() becomes true while it waits for one.
    """
    from uav_recon.localization.calibration.camera_mount import FixedMount, GimbalMount
    from uav_recon.localization.pad_origin import PadOrigin

    camera = camera_sources.open_camera(config, clock, stopped)
    mount = (
        FixedMount(camera_sources.tilted_camera(config))
        if config.camera.mount == "fixed"
        else GimbalMount(np.array(config.camera.position_body_m), wires.vehicle)
    )
    if isinstance(camera, ExposureLocking):
        camera.lock_exposure(lambda: _flight_is_near(wires.vehicle.latest()))
    remarks = camera.remarks if isinstance(camera, CameraRemarks) else tuple
    compile_ahead()
    camera, poses = pose_sources.open_poses(pose_sources.SourceContext(config, wires, clock, camera, mount))
    pad = None
    if config.localization.origin == "pad" and config.camera.source != "recorded":
        heading_rad = math.radians(config.localization.pad_heading_deg)
        poses = pad = PadOrigin(poses, wires.vehicle, config.runtime.folder / PAD_FILE, heading_rad=heading_rad)
    return connect_perception(
        config, wires, clock, camera, poses, mount,
        origin=lambda: None if pad is None else pad.reason, remarks=remarks, writer=writer,
    )  # fmt: skip


def connect_perception(
    config: Config,
    wires: FlightChannels,
    clock: Clock,
    camera: DepthCamera,
    poses: PoseSource,
    mount: Mount,
    *,
    origin: Callable[[], Reason | None] = lambda: None,
    remarks: Callable[[], tuple[Reason, ...]] = tuple,
    writer: Executor | None = None,
) -> Perception:
    """Build the stages of perception on an open camera and an open pose source.

    origin: where the take-off pad is, if not at the pose source's origin. remarks: of the camera. writer: writes the kept
    calibration.
    """
    from uav_recon.localization.calibration.kept_calibration import KeptCalibration
    from uav_recon.localization.correction.odometry_correction import NoCorrection
    from uav_recon.localization.fusion.fusion_filter import FusionFilter
    from uav_recon.localization.perception import Perception

    tracks = config.localization.source == "slam"  # the poses come from the frames themselves
    bridged_s = SLAM_BRIDGED_S if tracks else 0.0
    fusion = FusionFilter(pose_lost_s=config.localization.pose_lost_s, bridged_s=bridged_s)
    rate_hz, wait_s = config.localization.rate_hz, config.localization.frame_wait_s
    file = config.localization.calibration
    kept = KeptCalibration(file, camera_sources.mount_text(config), writer or InlineExecutor(clock)) if file else None
    return Perception(
        camera, poses, fusion, mount, wires.odom, wires.frames, wires.nearby, wires.perception, clock, rate_hz, wait_s,
        origin=origin, remarks=remarks, rates=wires.rates, kept=kept, consistency=_consistency(config),
        correction=_tracked_correction(fusion) if corrects_drift(config) else NoCorrection(),
    )  # fmt: skip


def _consistency(config: Config) -> DepthConsistencyMonitor | ReconciledConsistency:
    """Return the comparison of depth with earlier views.

    Poses that come from the frames themselves contain the errors of their mount.
    """
    from uav_recon.localization.consistency.depth_consistency import DepthConsistencyMonitor
    from uav_recon.localization.consistency.reconciled_consistency import ReconciledConsistency

    if corrects_drift(config):
        return ReconciledConsistency()
    return DepthConsistencyMonitor(corrects=config.localization.source != "slam")


def corrects_drift(config: Config) -> bool:
    """Return whether a tracker runs beside the pose source.

    The poses of the embedded SLAM are those of the tracker.
    """
    return config.localization.correct_drift and config.localization.source != "slam"


def _tracked_correction(fusion: FusionFilter) -> OdometryCorrection:
    from uav_recon.localization.correction.odometry_correction import TrackedCorrection
    from uav_recon.localization.slam import slam_tracker

    slam_tracker.warm_up()
    return TrackedCorrection(fusion.odom_at)


def _flight_is_near(vehicle: VehicleState | None) -> bool:
    """Return True from the request to arm until the motors have stopped."""
    return vehicle is not None and (vehicle.armed or vehicle.phase is FlightPhase.ARMING)


# -- the mission --------------------------------------------------------------------------------------------------------


def make_occupancy_map(config: Config) -> OccupancyMap:
    """Return the occupancy map over the fence and a margin beyond it."""
    from uav_recon.mapping.occupancy.occupancy_map import DepthSensor, OccupancyMap

    safety, voxels, camera = config.safety, config.voxels, config.camera
    margin = np.full(3, voxels.margin_m)
    grid = GridSpec.covering(np.array(safety.fence_min_m) - margin, np.array(safety.fence_max_m) + margin, voxels.resolution_m)
    sensor = DepthSensor(camera.depth_min_m, camera.depth_noise_px, camera.baseline_m)
    return OccupancyMap(grid, sensor, voxels.max_range_m, safety.fence_min_m, safety.fence_max_m, voxels.distance_cap_m)


def with_preset(config: Config) -> Config:
    """Return the config with the values of the planner's preset.

    Applying it twice changes nothing.
    """
    from uav_recon.planning.presets import derived

    low_m, high_m = np.array(config.safety.fence_min_m), np.array(config.safety.fence_max_m)
    return config.model_copy(update={"planner": derived(config.planner, low_m, high_m, camera_geometry(config))})


def make_planner(config: Config, timer: Callable[[], float]) -> NarrowPassagePlanner:
    """Return the config's planner, with narrow passages for what it does not reach."""
    from uav_recon.planning.narrow_passages import NarrowPassagePlanner
    from uav_recon.planning.view_planner import ViewPlanner

    safety = config.safety
    inset_m = max(config.planner.clearance_m, safety.fence_inset_m)  # never plan what the guard would refuse
    usual = ViewPlanner(
        config.planner, np.array(safety.fence_min_m), np.array(safety.fence_max_m), camera_geometry(config),
        travel_time_model(config), timer, inset_m,
    )  # fmt: skip
    min_m = (safety.vehicle_radius_m + max(m, safety.stop_clearance_m) for m in (NARROW_M, RETREAT_M))
    narrow_m, homeward_m = (min(m, config.planner.clearance_m) for m in min_m)
    return NarrowPassagePlanner(usual, narrow_m, homeward_m, max(narrow_m, safety.fence_inset_m), timer)


def travel_time_model(config: Config) -> TravelTimeModel:
    """Return the planner's model of travel times, for the yaw policy of motion."""
    from uav_recon.motion.yaw_policy import YawAlongPath, yaw_policy_of
    from uav_recon.planning.tour.travel_time import YawThenFly, YawWhileFlying

    gaze, pace = yaw_policy_of(config), (config.motion.speed_mps, math.radians(config.motion.yaw_rate_degps))
    if isinstance(gaze, YawAlongPath):
        return YawThenFly(*pace, gaze.blind_speed_mps, gaze.off_rad, gaze.upright)
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
        config, clearance_m, np.array(safety.fence_min_m) + inset_m, np.array(safety.fence_max_m) - inset_m
    )


def make_recent_view_memory(config: Config) -> RecentViewMemory:
    """Return the mission's memory of the views that raise the speed limit outside the view."""
    from uav_recon.mapping.recent_view_memory import RecentViewMemory

    return RecentViewMemory(config.safety.blind_stale_s, np.array(config.camera.position_body_m))


def make_keyframe_selection(config: Config, voxels: OccupancyMap) -> KeyframeSelection | PlannedViewsOnly:
    """Return the selection of keyframes beside the planned views, within the view budget."""
    from uav_recon.mapping.keyframe_selection import KeyframeSelection, PlannedViewsOnly

    if config.planner.view_spacing_m is not None:
        return PlannedViewsOnly()
    safety, camera = config.safety, config.camera
    low, high = np.array(safety.fence_min_m), np.array(safety.fence_max_m)
    return KeyframeSelection(voxels.grid, low, high, camera.depth_noise_px, camera.baseline_m)


def make_neural_mapper(config: Config) -> NeuralMapper:
    """Return the neural field of the mapper. Raises UserError if its prior model cannot be used."""
    from uav_recon.mapping.neural.keyframes.normal_prior import PriorError
    from uav_recon.mapping.neural.neural_mapper import NeuralMapper

    safety, camera = config.safety, config.camera
    low, high = np.array(safety.fence_min_m), np.array(safety.fence_max_m)
    try:
        return NeuralMapper(config.mapper, low, high, camera.depth_noise_px, camera.baseline_m)
    except PriorError as error:
        raise UserError(str(error), EXIT_CONFIG) from None


def make_conductor(
    config: Config,
    wires: FlightChannels,
    mapper: Mapper,
    executor: Executor,
    journal: Journal,
    clock: Clock,
    timer: Callable[[], float],
) -> Conductor:
    """Return the mission with every stage warm."""
    from uav_recon.mission.conductor import Conductor
    from uav_recon.mission.mission_setup import MissionChannels, MissionStages

    config = with_preset(config)
    voxels, planner, orders = make_occupancy_map(config), make_planner(config, timer), mission_parameters(config)
    channels = MissionChannels(
        wires.frames, wires.vehicle, wires.intent, wires.progress, wires.voxels, wires.surface, wires.plan,
        wires.correction, wires.free, wires.perception, wires.cones,
    )  # fmt: skip
    motion, retreat = (make_motion(config, kept_m) for kept_m in (orders.clearance_m, orders.clear_radius_m))
    budget, sight = make_keyframe_selection(config, voxels), make_recent_view_memory(config)
    stages = MissionStages(voxels, budget, mapper, planner, motion, retreat, sight)
    return Conductor(stages, channels, orders, executor, journal, clock)


def mission_parameters(config: Config) -> MissionParameters:
    """Return the numbers of the mission; the config must have the values of its preset."""
    from uav_recon.mission.mission_setup import MissionParameters

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
    make_keyframe_selection(config, voxels).warm_up()
    make_recent_view_memory(config).warm_up()


def warm_up_motion(config: Config) -> None:
    """Compile the kernels of motion planning."""
    make_motion(config, config.planner.clearance_m).warm_up()


def make_recorder(config: Config, wires: FlightChannels, flight: Path, clock: Clock) -> Recorder | Timelapse:
    """Return the recorder that writes flight.rrd and the growth of the surface.

    If recording.rerun is off, only the latter is written.
    """
    from uav_recon.recording.timelapse import Timelapse

    if not config.recording.rerun:
        return Timelapse(flight, wires.surface, clock)
    from uav_recon.recording.rerun_recorder import Recorder, RecorderChannels

    channels = RecorderChannels(
        wires.odom, wires.frames, wires.vehicle, wires.intent, wires.progress, wires.voxels, wires.surface, wires.plan
    )
    fence = np.array([config.safety.fence_min_m, config.safety.fence_max_m])
    return Recorder(flight, channels, clock, fence, live=config.recording.live)
