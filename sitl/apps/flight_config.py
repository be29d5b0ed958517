"""The product's config and the simulator's options that the options of `uav-recon sim` give."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from sitl.apps.sim_options import AUTO, SimOptions
from sitl.apps.world_process import WorldOptions
from sitl.camera.d435i import Model, Noise
from sitl.scene.scene import HULL_HEIGHT_M, Scene, free_height_m
from sitl.world.flow_sensor import FLOW_MOUNT_M, RANGE_MOUNT_M
from sitl.world.range_finder import MOUNT_M
from uav_recon.app.option_validation import mount_pitch_deg
from uav_recon.app.reference_safety import REFERENCE_SAFETY
from uav_recon.app.room_check import advise
from uav_recon.config import Config, ConfigError, parse
from uav_recon.errors import EXIT_CONFIG, UserError
from uav_recon.planning.mount_visibility import USUAL_DEG

# from hull, and from body centre, to space not known free, in a plan
HULL_MARGIN_M = 0.20
SMALLEST_CLEARANCE_M = 0.35
COLUMN_MARGIN_M = 0.10  # beyond the planning clearance, round the column above the pad that the operator sees to be free
COLUMN_TOP_M = 0.05  # below the ceiling: half a voxel
FENCE_MARGIN_M = 0.10  # between hull and fence, for position errors of the vehicle
NOISE_PX = {"d435i": 0.04, "paper": 0.004, "kinect": 0.02, "none": 0.001}  # rms disparity error at 424 pixels


@dataclass(frozen=True)
class FlightLimits:
    """Limits of a pose source: keys of [safety], which replace the reference, and of [motion]."""

    safety: dict[str, float] = field(default_factory=dict)
    motion: dict[str, float] = field(default_factory=dict)


# the embedded SLAM needs a camera that looks ahead, and knows its place for a second past a bare wall: it turns past it in half
# of that
LIMITS_BY_SOURCE = {
    "slam": FlightLimits(
        safety={"blind_fresh_s": 0.0, "blind_stale_s": 0.1, "max_yaw_rate_degps": 100.0},
        motion={"yaw_rate_degps": 80.0, "yaw_acceleration_degps2": 200.0},
    )
}


def mount_pitch_down_deg(mount: str) -> float | None:
    """Return the tilt of a mount in degrees, None for a gimbal.

    AUTO has the usual tilt until the room is known.
    """
    return USUAL_DEG if mount == AUTO else mount_pitch_deg(mount)


def fitted_mount(options: SimOptions, scene: Scene) -> str:
    """Return the mount of the options; for AUTO, the one that fits the scene's size."""
    if options.mount != AUTO:
        return options.mount
    advice = advise(flight_config(options, scene, Path("/run")))
    return f"fixed:{USUAL_DEG if advice is None else advice.recommended_deg:g}"


def world_options(options: SimOptions, runtime: Path) -> WorldOptions:
    """Return the options of the simulator."""
    return WorldOptions(
        scene=options.scene, start=options.start_pose, fence=options.fence_corners, seed=options.seed,
        autopilot=options.autopilot, mount_pitch_down_deg=mount_pitch_down_deg(options.mount), radius_m=options.radius_m,
        depth_noise=cast("Noise", options.depth_noise), camera=cast("Model", options.camera_model), port=options.port,
        stream=str(runtime / "camera.stream"), truth=str(options.folder / "truth.npz"),
        firmware=None if options.firmware is None else str(options.firmware.absolute()),
        camera_errors=options.camera_error_scale, onboard_poses=options.pose == "autopilot",
        range_up_deg=options.range_up_deg, flow=options.flow,
    )  # fmt: skip


def flow_section(flow: bool) -> dict[str, dict[str, object]]:
    """Return the product's section [flow] for the module that looks down, nothing without it."""
    if not flow:
        return {}
    mounts = {"position_body_m": list(FLOW_MOUNT_M), "range_position_body_m": list(RANGE_MOUNT_M)}
    return {"flow": {"enabled": True, **mounts}}


def flight_config(options: SimOptions, scene: Scene, runtime: Path) -> Config:
    """Return the product's config for this flight. Raises UserError with exit code 78."""
    pitch_down_deg = mount_pitch_down_deg(options.mount)
    noise_px = NOISE_PX[options.depth_noise] / (2.0 if options.camera_model in ("fast", "small") else 1.0)
    clearance_m = max(SMALLEST_CLEARANCE_M, options.radius_m + HULL_MARGIN_M)
    limits = LIMITS_BY_SOURCE.get(options.pose, FlightLimits())
    tree = {
        "safety": {
            **REFERENCE_SAFETY,
            "fence_min_m": [float(x) for x in scene.fence_min],
            "fence_max_m": [float(x) for x in scene.fence_max],
            "fence_inset_m": options.radius_m + FENCE_MARGIN_M,
            "vehicle_radius_m": options.radius_m,
            "vehicle_height_m": HULL_HEIGHT_M,
            "blind_speed_mps": options.blind_speed_mps,
            **limits.safety,
        },
        "link": {"autopilot": options.autopilot, "url": f"udp:127.0.0.1:{options.port}"},
        "camera": {
            "source": "stream",
            "mount": "gimbal" if pitch_down_deg is None else "fixed",
            "pitch_down_deg": pitch_down_deg or 0.0,
            "depth_noise_px": noise_px,
        },
        "localization": {
            "source": "stream" if options.pose == "corrected" else options.pose,
            "correct_drift": options.pose == "corrected",
            "pad_heading_deg": math.degrees(scene.start_yaw_rad),
            **({} if options.calibration is None else {"calibration": str(options.calibration.absolute())}),
            **({} if options.flown_map is None else {"flown_map": str(options.flown_map.absolute())}),
        },
        "voxels": {"takeoff_top_m": max(free_height_m(scene, clearance_m + COLUMN_MARGIN_M) - COLUMN_TOP_M, 0.1)},
        "range_up": {} if options.range_up_deg is None else {"fov_deg": options.range_up_deg, "position_body_m": list(MOUNT_M)},
        **flow_section(options.flow),
        "mapper": {"seed": options.seed, "uncertainty": options.uncertainty},
        "planner": {
            "variant": options.variant,
            "clearance_m": clearance_m,
        },
        "motion": limits.motion,
        "mission": {"autostart": True} | ({} if options.views is None else {"views": options.views}),
        "recording": {"folder": str(options.folder), "live": options.live, "rerun": options.mapper == "neural" or options.live},
        "runtime": {"folder": str(runtime)},
    }
    try:
        return parse(tree, "sim")
    except ConfigError as error:
        raise UserError(str(error), EXIT_CONFIG) from None
