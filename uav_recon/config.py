"""The typed configuration tree: one section per TOML table, one comment per key.

An unknown key is an error. Degrees are used only here and in displayed values; the program uses radians. All protective
numbers are in [safety], which has no defaults: the operator must write them down.
"""

from __future__ import annotations

import ipaddress
import re
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from uav_recon import atomic_file, config_constraints
from uav_recon.types.link_url import link_address
from uav_recon.types.polygon import Polygon

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Coordinate = Annotated[float, Field(ge=-500.0, le=500.0)]  # metres
NearCoordinate = Annotated[float, Field(ge=-1.0, le=1.0)]  # metres from the body's origin
LAX = Field(strict=False)  # a list for a tuple, or text for a path: TOML has neither
Vec3 = Annotated[tuple[Coordinate, Coordinate, Coordinate], LAX]
BodyVec3 = Annotated[tuple[NearCoordinate, NearCoordinate, NearCoordinate], LAX]
Corners = Annotated[tuple[Annotated[tuple[float, float], LAX], ...], LAX]
File = Annotated[Path, LAX]  # or a folder


def _hexadecimal(text: str) -> str:
    if not text:
        return ""
    try:
        number = int(text, 16)
    except ValueError:
        number = 0
    if number <= 0:
        raise ValueError("want a number in hex, greater than 0")
    return f"{number:x}"


def _topic_name(text: str) -> str:
    if not re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", text):
        raise ValueError("want a full topic name, such as /camera/imu: letters, digits, _ and /")
    return text


def _ipv4_address(text: str) -> str:
    try:
        return str(ipaddress.IPv4Address(text))
    except ValueError:
        raise ValueError("want four numbers of 0 to 255 with dots between them") from None


Uid = Annotated[str, AfterValidator(_hexadecimal)]
LinkUrl = Annotated[str, AfterValidator(link_address)]
TopicName = Annotated[str, AfterValidator(_topic_name)]
Host = Annotated[str, AfterValidator(_ipv4_address)]
VariantName = Literal["adaptive", "merged", "reconstruct", "explore", "explore-yaw", "explore-then-refine", "evpp", "vpp"]
UncertaintyName = Literal["agreement", "paper", "colour", "information", "product"]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
ERROR_TEXT = {
    "extra_forbidden": "unknown key",
    "float_type": "want a number",
    "int_type": "want an integer",
    "bool_type": "want true or false",
}


class ConfigError(Exception):
    """A config that cannot be used. The message is one line that states what to correct."""


class Section(BaseModel):
    """A table of the file. It is frozen, and an unknown key is an error.

    So is text, or true, in place of a number.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class SafetyConfig(Section):
    """Protective numbers, without defaults."""

    fence_min_m: Vec3  # lower corner of the fence box, world frame
    fence_max_m: Vec3  # upper corner of the fence box, world frame
    fence_corners_m: Corners  # floor plan inside the box, corners (x, y) in order; [] = the whole box
    fence_inset_m: Annotated[float, Field(ge=0.0, le=2.0)]  # distance that the guard keeps from the fence to the body's centre
    max_speed_mps: Annotated[float, Field(gt=0.0, le=3.0)]  # speed limit in any direction
    max_acceleration_mps2: Annotated[float, Field(gt=0.0, le=5.0)]  # acceleration limit in any direction
    max_yaw_rate_degps: Annotated[float, Field(gt=0.0, le=120.0)]  # yaw rate limit
    vehicle_radius_m: Annotated[float, Field(gt=0.0, le=1.0)]  # radius of the cylinder around the rotors
    vehicle_height_m: Annotated[float, Field(gt=0.0, le=1.0)]  # height of that cylinder, body origin at mid-height
    stop_clearance_m: Annotated[float, Field(ge=0.05, le=2.0)]  # obstacle in raw depth closer to the hull: stop
    fast_clearance_m: Annotated[float, Field(ge=0.05, le=2.0)]  # obstacle closer to the hull: at most 0.5 m/s towards it
    blind_speed_mps: Annotated[float, Field(gt=0.0, le=3.0)]  # limit outside the camera's field of view; max_speed_mps = off
    blind_fresh_s: Annotated[float, Field(ge=0.0, le=10.0)]  # outside the view: full speed through space seen free within it
    blind_stale_s: Annotated[float, Field(gt=0.0, le=30.0)]  # seen longer ago than this: blind_speed_mps; even fall in between
    blind_memory_s: Annotated[float, Field(gt=0.0, le=60.0)]  # outside the view: only through space seen free within this time
    retreat_speed_mps: Annotated[float, Field(gt=0.0, le=3.0)]  # speed limit on the pilot's own retreat
    silence_way_m: Annotated[float, Field(gt=0.0, le=5.0)]  # path since the last mission message, with braking, longer: hold
    intent_timeout_s: Annotated[float, Field(gt=0.0, le=5.0)]  # mission silent for longer: hold
    retreat_timeout_s: Annotated[float, Field(gt=0.0, le=60.0)]  # mission silent for longer: retreat along the breadcrumbs
    pose_timeout_s: Annotated[float, Field(gt=0.0, le=1.0)]  # pose older: hold, stop sending poses to the autopilot
    pose_land_s: Annotated[float, Field(gt=0.0, le=5.0)]  # pose missing for longer: land
    land_timeout_s: Annotated[float, Field(gt=0.0, le=60.0)]  # mission silent for longer, in flight: land
    depth_timeout_s: Annotated[float, Field(gt=0.0, le=1.0)]  # newest depth older: no motion
    depth_retreat_s: Annotated[float, Field(gt=0.0, le=30.0)]  # depth missing for longer: retreat along the breadcrumbs
    depth_land_s: Annotated[float, Field(gt=0.0, le=60.0)]  # depth missing for longer: land

    @model_validator(mode="after")
    def _fence_is_a_box(self) -> SafetyConfig:
        for low, high, axis in zip(self.fence_min_m, self.fence_max_m, "xyz", strict=True):
            if not high - low > 2 * self.fence_inset_m:
                raise ValueError(f"fence_max_m.{axis} {high} must exceed fence_min_m.{axis} {low} by twice the inset")
        return self

    @model_validator(mode="after")
    def _plan_is_a_polygon(self) -> SafetyConfig:
        try:
            plan = self.fence_plan()
        except ValueError as error:
            raise ValueError(f"fence_corners_m: {error}") from None
        for x, y in plan.corners_m:
            (low_x, low_y, _), (high_x, high_y, _) = self.fence_min_m, self.fence_max_m
            if not (low_x <= x <= high_x and low_y <= y <= high_y):
                raise ValueError(f"fence_corners_m: ({x:g}, {y:g}) lies outside the box of fence_min_m and fence_max_m")
        if not plan.room_m((0.0, 0.0), (0.0, 0.0)) >= self.fence_inset_m:
            raise ValueError(f"the fence does not hold the take-off place (0, 0) with {self.fence_inset_m:g} m around it")
        return self

    @model_validator(mode="after")
    def _ladder_leads_down(self) -> SafetyConfig:
        ladders = (
            ("intent_timeout_s", "retreat_timeout_s", "land_timeout_s"),
            ("depth_timeout_s", "depth_retreat_s", "depth_land_s"),
            ("pose_timeout_s", "pose_land_s"),
            ("stop_clearance_m", "fast_clearance_m"),
            ("blind_speed_mps", "max_speed_mps"),
            ("blind_fresh_s", "blind_stale_s", "blind_memory_s"),
            ("retreat_speed_mps", "max_speed_mps"),
        )
        for names in ladders:
            values = [getattr(self, name) for name in names]
            if values != sorted(values):
                raise ValueError(f"{' <= '.join(names)} does not hold for {values}")
        return self

    def fence_plan(self) -> Polygon:
        """Return the floor plan of the fence.

        Raises ValueError if the polygon is open, crosses itself, or has no area.
        """
        (low_x, low_y, _), (high_x, high_y, _) = self.fence_min_m, self.fence_max_m
        return Polygon(self.fence_corners_m) if self.fence_corners_m else Polygon.box((low_x, low_y), (high_x, high_y))


class LinkConfig(Section):
    """The MAVLink connection to the autopilot."""

    autopilot: Literal["px4", "ardupilot"] = "px4"  # firmware of the autopilot
    url: LinkUrl = "udp:127.0.0.1:14540"  # udp:HOST:PORT (listens there) or serial:DEVICE:BAUD
    peer_host: Host | None = None  # only UDP peer accepted; unset: this machine only
    vehicle_system: Annotated[int, Field(ge=1, le=232)] = 1  # MAVLink system id of the vehicle; others are ignored; 233 is ours
    vehicle_component: Annotated[int, Field(ge=1, le=255)] = 1  # MAVLink component id of its autopilot
    gimbal_component: Annotated[int, Field(ge=1, le=255)] = 154  # component id of its gimbal, accepted for gimbal angles only
    autopilot_uid: Uid = ""  # hardware id in hex, as reported in AUTOPILOT_VERSION; unset: any autopilot
    signing_key: File | None = None  # key file, mode 0600: 32 bytes or a passphrase; rejects unsigned frames; ArduPilot only
    signing_link_id: Annotated[int, Field(ge=0, le=255)] = 1  # link id of our signed frames; unique per link and key
    signing_stamps: File = Path("/var/lib/uav_recon/signing.json")  # used timestamps: prevents replay after a restart
    parameters: File | None = None  # file of required vehicle parameters; unset: the one of firmware_params/ for this autopilot
    setpoint_rate_hz: Annotated[float, Field(ge=10.0, le=100.0)] = 30.0  # rate of the setpoints sent
    origin_lat_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = 47.3977  # latitude of the origin sent to the autopilot
    origin_lon_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 8.5456  # its longitude; any location works indoors
    origin_alt_m: Annotated[float, Field(ge=-500.0, le=9000.0)] = 488.0  # its height above the ellipsoid


class CameraConfig(Section):
    """The camera and its mount on the body."""

    source: Literal["stream", "realsense", "recorded", "ros2"] = "realsense"  # stream = through a memory-mapped file
    stream: File = Path("camera.stream")  # stream file, in the runtime directory unless absolute
    recording: File | None = None  # for "recorded": a flight folder; for "realsense": a RealSense recording
    mount: Literal["fixed", "gimbal"] = "fixed"  # gimbal = pitch is set through MAVLink
    position_body_m: BodyVec3 = (0.10, 0.0, 0.0)  # position of the depth imager on the body
    pitch_down_deg: Annotated[float, Field(ge=-60.0, le=60.0)] = 15.0  # tilt of a fixed mount, positive looks down
    roll_deg: Annotated[float, Field(ge=-10.0, le=10.0)] = 0.0  # roll of a fixed mount about its optical axis, right down
    yaw_deg: Annotated[float, Field(ge=-10.0, le=10.0)] = 0.0  # yaw of a fixed mount, positive looks left
    delay_s: Annotated[float, Field(ge=-0.1, le=0.2)] = 0.0  # frames are older than their stamp by this
    depth_scale: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.0  # share by which depths are too large
    gimbal_limit_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 60.0  # gimbal pitch limit, up and down
    horizontal_fov_deg: Annotated[float, Field(gt=10.0, lt=170.0)] = 87.0  # of the depth image
    vertical_fov_deg: Annotated[float, Field(gt=10.0, lt=170.0)] = 58.0  # of the depth image
    depth_min_m: Annotated[float, Field(gt=0.0, le=10.0)] = 0.3  # shorter depths are ignored
    depth_max_m: Annotated[float, Field(gt=0.0, le=20.0)] = 6.0  # longer depths are ignored
    depth_noise_px: Annotated[float, Field(gt=0.0, le=1.0)] = 0.04  # rms disparity error in pixels of the delivered depth image
    baseline_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.05  # stereo baseline


class LocalizationConfig(Section):
    """Fusion of delayed poses into continuous odometry."""

    # stream = through the camera stream; slam = embedded SLAM; ros2: see [ros2]; autopilot = it navigates by itself
    source: Literal["stream", "slam", "ros2", "autopilot"] = "stream"
    autopilot_message: Literal["local_position", "odometry"] = "local_position"  # source autopilot: the message with its poses
    rate_hz: Annotated[float, Field(ge=20.0, le=200.0)] = 30.0  # rate of the odometry output
    origin: Literal["pad", "source"] = "pad"  # of the world: the body on the take-off pad, or the pose source's own origin
    pad_heading_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 0.0  # origin pad: of the body, from the x axis of the fence
    pose_lost_s: Annotated[float, Field(gt=0.0, le=2.0)] = 0.5  # no pose for longer: quality 0
    frame_wait_s: Annotated[float, Field(ge=0.0, le=0.5)] = 0.2  # max. time a frame waits for the next pose
    correct_drift: bool = False  # source not slam: correct a drift of the poses by a tracker beside them (docs/pose-sources)
    calibration: File | None = None  # file of the camera's errors: written in flight, read by the next; unset: none is kept
    flown_map: File | None = None  # file of the tracker's map: written at rest after a flight, found again by the next one


class Ros2Config(Section):
    """ROS 2 topics, read over DDS without a ROS installation."""

    domain: Annotated[int, Field(ge=0, le=232)] = 0  # DDS domain, ROS_DOMAIN_ID of the publishers
    reliability: Literal["best_effort", "reliable"] = "best_effort"  # best_effort hears both kinds of publishers
    pose_topic: TopicName = "/odom"  # poses of base_link (FLU) in odom (z up)
    pose_type: Literal["odometry", "pose"] = "odometry"  # nav_msgs/Odometry, or geometry_msgs/PoseStamped
    depth_topic: TopicName = "/camera/aligned_depth_to_color/image_raw"  # Image, 16UC1 (mm) or 32FC1 (m), registered to colour
    rgb_topic: TopicName = "/camera/color/image_raw"  # Image, rgb8 or bgr8
    info_topic: TopicName = "/camera/color/camera_info"  # CameraInfo of both images
    imu_topic: TopicName | None = None  # Imu in the axes of base_link (FLU); unset: none


class VoxelConfig(Section):
    """The occupancy map."""

    resolution_m: Annotated[float, Field(ge=0.05, le=0.3)] = 0.1  # voxel edge
    max_range_m: Annotated[float, Field(gt=0.0, le=20.0)] = 5.0  # longer depths only clear voxels, up to this range
    distance_cap_m: Annotated[float, Field(gt=0.0, le=5.0)] = 1.1  # the distance field saturates here
    takeoff_radius_m: Annotated[float, Field(gt=0.0, le=5.0)] = 0.6  # cylinder above the pad that is declared free
    takeoff_top_m: Annotated[float, Field(gt=0.0, le=100.0)] | None = None  # free to this height over the pad; unset: hover
    margin_m: Annotated[float, Field(ge=0.0, le=1.0)] = 0.3  # map beyond the fence, so that walls there are mapped


class RangeUpConfig(Section):
    """A range finder of the autopilot that looks up along the body's z axis."""

    fov_deg: Annotated[float, Field(gt=4.0, le=60.0)] | None = None  # whole angle of its cone; unset: there is no such sensor
    position_body_m: BodyVec3 = (0.0, 0.0, 0.05)  # its position on the body
    error_share: Annotated[float, Field(gt=0.0, le=0.2)] = 0.02  # rms error as a share of the range


class FlowConfig(Section):
    """An optical flow sensor and a range finder of the autopilot that look down along body z."""

    enabled: bool = False  # true: they are fitted, and set up as firmware_params/README.md says
    position_body_m: BodyVec3 = (0.0, 0.0, -0.05)  # position of the flow sensor on the body
    range_position_body_m: BodyVec3 = (0.0, 0.0, -0.05)  # position of the range finder on the body


class MapperConfig(Section):
    """The neural surface."""

    steps_per_view: Annotated[int, Field(ge=1, le=200)] = 20  # training steps after each new view
    idle_steps_hz: Annotated[float, Field(ge=0.0, le=1000.0)] = 40.0  # max. training steps per second between views
    polish_steps: Annotated[int, Field(ge=0, le=20000)] = 1500  # training steps after landing
    mesh_voxel_m: Annotated[float, Field(ge=0.005, le=0.1)] = 0.02  # voxel edge of the final mesh
    surface_voxel_m: Annotated[float, Field(ge=0.01, le=0.2)] = 0.05  # spacing of the surface elements sent to the planner
    uncertainty: UncertaintyName = "agreement"  # uncertainty measure of the elements, see `uav-recon bench uncertainty`
    seed: Annotated[int, Field(ge=0)] = 0  # seed of random sampling
    prior_model: File | None = None  # ONNX model that predicts normals or depth from colour, for rays without a normal


class PlannerConfig(Section):
    """The paper's parameters (table I).

    The preset gives the value of each key that is not in the file.
    """

    variant: VariantName = "adaptive"  # V5, V4, V3, V2, V1 of the paper, and its baselines
    preset: Literal["auto", "bhxhp", "rosser", "convoy"] = "auto"  # auto: derived from the fence box and the camera
    shell_min_m: Annotated[float, Field(gt=0.0, le=20.0)] = 0.8  # d_r, min. distance from a viewpoint to its task
    shell_max_m: Annotated[float, Field(gt=0.0, le=20.0)] = 2.5  # d_f, max. distance from a viewpoint to its task
    clearance_m: Annotated[float, Field(ge=0.3, le=1.0)] = 0.35  # d_s, body centre to any voxel not known free
    local_radius_m: Annotated[float, Field(gt=0.0, le=100.0)] = 2.0  # R_loc, radius of the local surface around the vehicle
    cluster_radius_m: Annotated[float, Field(gt=0.0, le=20.0)] = 1.1  # R_clu, radius of a surface cluster
    max_reconstruct_tasks: Annotated[int, Field(ge=1, le=100)] = 10  # N_rec, max. surface tasks per plan
    min_visible: Annotated[int, Field(ge=1, le=100000)] = 20  # N_min, min. visible elements of a surface view
    near_distance_m: Annotated[float, Field(gt=0.0, le=100.0)] = 1.5  # d_near, path length up to which a frontier is near
    near_count: Annotated[int, Field(ge=0, le=100000)] = 3  # explore only, if more frontiers than this are near ...
    near_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.2  # ... and their share of all frontiers is larger than this
    horizon_m: Annotated[float, Field(gt=0.0, le=100.0)] = 5.0  # L_exec, path length after which the tour is cut
    view_spacing_m: Annotated[float, Field(ge=0.05, le=100.0)] | None = None  # l_res, view spacing; unset: where surface is new
    end_factor: Annotated[float, Field(ge=1.0, le=10.0)] = 3.0  # alpha, factor on R_loc, N_rec, L_exec when no frontier is left
    downsample: Annotated[int, Field(ge=1, le=50)] = 5  # N_down, use every N-th surface element
    worth_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.3  # min. share of the best gain per second of surface tasks
    perception_aware: bool | None = None  # prefer views that show where the vehicle is; unset: with the embedded SLAM


class MotionConfig(Section):
    """Limits of planned motion, within the limits of the guard.

    Motion blur: during an exposure, a point at blur_distance_m that moves across the view shifts in the image by focal_px *
    exposure_s * (turning + speed / blur_distance_m) pixels. At a view this stays below blur_px.
    """

    speed_mps: Annotated[float, Field(ge=0.05, le=3.0)] = 1.0  # speed in open space
    tight_speed_mps: Annotated[float, Field(ge=0.05, le=3.0)] = 0.7  # speed where the clearance is the planning distance
    climb_mps: Annotated[float, Field(ge=0.05, le=3.0)] = 0.6  # climb speed, below the autopilot's MPC_Z_VEL_MAX_UP, WP_SPD_UP
    descent_mps: Annotated[float, Field(ge=0.05, le=3.0)] = 0.4  # descent speed, below its MPC_Z_VEL_MAX_DN, WP_SPD_DN
    acceleration_mps2: Annotated[float, Field(ge=0.05, le=5.0)] = 1.2  # along and across the path
    run_on_s: Annotated[float, Field(ge=0.0, le=5.0)] = 1.3  # time the autopilot may fly on without setpoints and hit nothing
    yaw_rate_degps: Annotated[float, Field(ge=1.0, le=120.0)] = 45.0  # yaw rate
    yaw_acceleration_degps2: Annotated[float, Field(ge=1.0, le=1000.0)] = 90.0  # yaw acceleration
    smoothing_s: Annotated[float, Field(gt=0.0, le=5.0)] = 0.4  # total width of the smoothing filter that bounds the jerk
    blur_px: Annotated[float, Field(ge=0.1, le=1000.0)] = 2.0  # max. image shift during the exposure of a view
    exposure_s: Annotated[float, Field(gt=0.0, le=0.1)] = 0.008  # exposure time in indoor light
    focal_px: Annotated[float, Field(gt=0.0, le=5000.0)] = 460.0  # focal length of the kept images
    blur_distance_m: Annotated[float, Field(ge=0.1, le=20.0)] = 1.5  # typical distance to the surface

    def at_most(self, speed_mps: float) -> MotionConfig:
        """Return a copy with all speeds limited to ``speed_mps``."""
        names = ("speed_mps", "tight_speed_mps", "climb_mps", "descent_mps")
        return self.model_copy(update={name: min(getattr(self, name), speed_mps) for name in names})


class MissionConfig(Section):
    """The task of the flight."""

    views: Annotated[int, Field(ge=4, le=5000)] = 500  # max. keyframes; most flights end before, see planner.worth_share
    takeoff_height_m: Annotated[float, Field(ge=0.5, le=3.0)] = 1.1  # height of the body above the pad
    survey_views: Annotated[int, Field(ge=0, le=36)] = 8  # keyframes of the first turn on the spot
    max_flight_s: Positive = 900.0  # return home after this time
    plan_cost_s: Annotated[float, Field(ge=0.0, le=5.0)] = 0.1  # declared planning time on a simulated clock
    autostart: bool = False  # true: arm and fly as soon as the pilot is READY, without a command
    operator_timeout_s: Annotated[float, Field(ge=10.0, le=600.0)] | None = None  # operator silent for longer: home; unset: off


class RecordingConfig(Section):
    """Outputs of the flight."""

    folder: File = Path("/var/lib/uav_recon/flights")  # folder of the flight folders
    rerun: bool = True  # write flight.rrd
    live: bool = False  # stream to a viewer on this machine


class RuntimeConfig(Section):
    """Files through which the processes communicate."""

    folder: File = Path("/run/uav_recon")  # channels and stream files
    operator: File = Path("operator.socket")  # socket of the operator commands, in the folder unless absolute


class Config(Section):
    """The whole configuration."""

    model_config = ConfigDict(strict=False)

    safety: SafetyConfig
    link: LinkConfig = LinkConfig()
    camera: CameraConfig = CameraConfig()
    localization: LocalizationConfig = LocalizationConfig()
    ros2: Ros2Config = Ros2Config()
    voxels: VoxelConfig = VoxelConfig()
    range_up: RangeUpConfig = RangeUpConfig()
    flow: FlowConfig = FlowConfig()
    mapper: MapperConfig = MapperConfig()
    planner: PlannerConfig = PlannerConfig()
    motion: MotionConfig = MotionConfig()
    mission: MissionConfig = MissionConfig()
    recording: RecordingConfig = RecordingConfig()
    runtime: RuntimeConfig = RuntimeConfig()

    @model_validator(mode="after")
    def _everything_fits_together(self) -> Config:
        fault = config_constraints.first_violation(self)
        if fault:
            raise ValueError(fault)
        return self


def load(path: Path) -> Config:
    """Read a TOML file.

    Raises ConfigError with one line that names file, key, value and allowed range.
    """
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None
    except ValueError:
        raise ConfigError(f"{path}: not TOML: a number has too many digits") from None
    except RecursionError:
        raise ConfigError(f"{path}: not TOML: nested too deeply") from None
    return parse(tree, str(path))


def parse(tree: dict[str, Any], source: str) -> Config:
    """Validate a tree. Raises ConfigError with one line for the first error."""
    try:
        return Config.model_validate(tree)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) if str(part).isprintable() else repr(part) for part in first["loc"])
        value = first.get("input")
        shown = "" if isinstance(value, dict) or value is None else f" (got {_shown(value)})"
        fault = ERROR_TEXT.get(first["type"], first["msg"].removeprefix("Value error, "))
        raise ConfigError(f"{source}: {where}{where and ': '}{fault[0].lower()}{fault[1:]}{shown}") from None


def save(config: Config, path: Path) -> None:
    """Write the effective config as TOML. Raises OSError; see replace_text."""
    replace_text(path, tomli_w.dumps(config.model_dump(mode="json", exclude_none=True)))


def replace_text(path: Path, text: str) -> None:
    """Replace a file atomically, also across a loss of power; its mode stays.

    Raises OSError, for example on a full disk, and then leaves the old file.
    """
    file = path.resolve()
    if file.exists() and not file.is_file():
        file.write_text(text, encoding="utf-8")
        return
    atomic_file.replace(file, text.encode(), durable=True)


def _shown(value: object) -> str:
    try:
        return repr(value)
    except ValueError:  # Python prints no number of more than 4300 digits
        return "a very large number"
