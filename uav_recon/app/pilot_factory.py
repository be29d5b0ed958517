"""Factory of the pilot: selects firmware, navigation and the filter of senders."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from uav_recon.app import safety_limits
from uav_recon.app.flight_channels import FlightChannels
from uav_recon.config import Config, LinkConfig
from uav_recon.errors import EXIT_CONFIG, UserError
from uav_recon.interfaces import ByteLink, Clock

if TYPE_CHECKING:  # each process imports only the stages that it runs
    from uav_recon.autopilot.firmware.profile import FirmwareProfile
    from uav_recon.autopilot.link.navigation import Navigation
    from uav_recon.autopilot.link.vehicle_link import VehicleLink
    from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
    from uav_recon.autopilot.mavlink.tlog import FrameLog
    from uav_recon.autopilot.parameters.preflight_check import ParameterCheck
    from uav_recon.autopilot.parameters.reader import ParameterEncoding
    from uav_recon.autopilot.pilot.hull_geometry import HullGeometry
    from uav_recon.autopilot.pilot.pilot import Pilot
    from uav_recon.autopilot.pilot.situation.upward_range_finder import RangeFinderModel


def make_allow_list_filter(config: LinkConfig, clock: Clock) -> AllowListFilter:
    """Return the filter of senders on the link.

    Raises UserError with exit code 78 for a key or stamps that cannot be used.
    """
    from uav_recon.autopilot.mavlink.allow_list import AllowList, AllowListFilter
    from uav_recon.autopilot.mavlink.signing import KeyFileError, open_signature
    from uav_recon.autopilot.mavlink.signing_timestamps import SigningTimestampsError

    allowed = AllowList(config.vehicle_system, config.vehicle_component, config.gimbal_component, config.autopilot_uid)
    key = config.signing_key
    try:
        signature = open_signature(key, config.signing_link_id, config.signing_stamps, clock) if key else None
    except (KeyFileError, SigningTimestampsError) as error:
        raise UserError(f"link.{error}", EXIT_CONFIG) from None
    return AllowListFilter(allowed, signature)


def make_pilot(
    config: Config,
    channels: FlightChannels,
    link: ByteLink,
    log: FrameLog,
    clock: Clock,
    allow_list: AllowListFilter | None = None,
) -> Pilot:
    """Build the loop next to the autopilot.

    allow_list: the filter that its link already uses, if there is one.
    """
    from uav_recon.autopilot.pilot import assembly
    from uav_recon.autopilot.pilot.sequence.preflight import Origin
    from uav_recon.safety.guard import Guard

    seen_space = safety_limits.recently_seen_space(config)
    guard = Guard(safety_limits.envelope(config), safety_limits.guard_bounds(config), seen_space)
    return assembly.make_pilot(
        make_vehicle_link(config, link, log, clock, allow_list or make_allow_list_filter(config.link, clock)),
        guard,
        safety_limits.failsafe_timeouts(config),
        channels,
        clock,
        Origin(config.link.origin_lat_deg, config.link.origin_lon_deg, config.link.origin_alt_m),
        hull_geometry(config),
        setpoint_rate_hz=config.link.setpoint_rate_hz,
        parameters=make_parameter_check(config),
        range_finder=range_finder_model(config),
    )


def make_vehicle_link(config: Config, link: ByteLink, log: FrameLog, clock: Clock, allow_list: AllowListFilter) -> VehicleLink:
    """Build the link to the autopilot on a byte link."""
    from uav_recon.autopilot.link.flow_measurements import STREAMS
    from uav_recon.autopilot.link.frame_exchange import FrameExchange
    from uav_recon.autopilot.link.vehicle_link import VehicleLink
    from uav_recon.autopilot.pilot.situation.upward_range_finder import STREAM

    profile, _ = firmware(config.link.autopilot)
    profile = profile if config.range_up.fov_deg is None else profile.with_stream(*STREAM)
    for stream in STREAMS[config.link.autopilot] if config.flow.enabled else ():
        profile = profile.with_stream(*stream)
    frames = FrameExchange(link, log, allow_list.seal)
    return VehicleLink(frames, allow_list, profile, clock.now_s(), make_navigation(config))


def range_finder_model(config: Config) -> RangeFinderModel | None:
    """Return the upward range finder that the operator declares, None without one."""
    from uav_recon.autopilot.pilot.situation.upward_range_finder import RangeFinderModel

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


def hull_geometry(config: Config) -> HullGeometry:
    """Return the hull and the hover height of the pilot."""
    from uav_recon.autopilot.pilot.hull_geometry import HullGeometry

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
    from uav_recon.autopilot.parameters.parameter_file import ParameterFileError, required
    from uav_recon.autopilot.parameters.preflight_check import ParameterCheck

    try:
        fed = config.localization.source != "autopilot"
        wanted = required(config.link.autopilot, config.link.parameters, fed=fed, flow=config.flow.enabled)
    except ParameterFileError as error:
        raise UserError(f"link.parameters: {error}", EXIT_CONFIG) from None
    return ParameterCheck(wanted, firmware(config.link.autopilot)[1])
