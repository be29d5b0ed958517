"""The typed config tree. TOML in; unknown key = error; degrees live only here and on screens.

Every field has one line of documentation. All protective numbers stand in [safety], which has no defaults:
whoever flies writes them down.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from uav_recon import config_constraints
from uav_recon.types.link_url import link_address
from uav_recon.types.polygon import Polygon

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Coordinate = Annotated[float, Field(ge=-500.0, le=500.0)]  # m
Vec3 = tuple[Coordinate, Coordinate, Coordinate]


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


Uid = Annotated[str, AfterValidator(_hexadecimal)]
LinkUrl = Annotated[str, AfterValidator(link_address)]
Host = Annotated[str, Field(pattern=r"^\d{1,3}(\.\d{1,3}){3}$")]
VariantName = Literal["adaptive", "merged", "reconstruct", "explore", "explore-yaw", "explore-then-refine", "evpp", "vpp"]
UncertaintyName = Literal["agreement", "paper", "colour", "information", "product"]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
PLAINLY = {"extra_forbidden": "unknown key", "string_pattern_mismatch": "want four numbers with dots between them"}


class ConfigError(Exception):
    """A config that cannot be flown; its text is one line a person can act on."""


class Section(BaseModel):
    """A table of the file: frozen, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SafetyConfig(Section):
    """Protective numbers. No defaults."""

    fence_min_m: Vec3  # lower corner of the fence box, world frame
    fence_max_m: Vec3  # upper corner of the fence box, world frame
    fence_corners_m: tuple[tuple[float, float], ...]  # its floor plan inside that box, x and y in order; [] = the box's own
    fence_inset_m: Annotated[float, Field(ge=0.0, le=2.0)]  # the guard keeps the body's centre this far inside
    max_speed_mps: Annotated[float, Field(gt=0.0, le=3.0)]  # any direction
    max_acceleration_mps2: Annotated[float, Field(gt=0.0, le=5.0)]  # any direction
    max_yaw_rate_degps: Annotated[float, Field(gt=0.0, le=120.0)]  # rotation of the heading
    vehicle_radius_m: Annotated[float, Field(gt=0.0, le=1.0)]  # cylinder around the rotors
    vehicle_height_m: Annotated[float, Field(gt=0.0, le=1.0)]  # cylinder height, body origin in its middle
    stop_clearance_m: Annotated[float, Field(ge=0.05, le=2.0)]  # hull to anything ahead in raw depth: stop there
    fast_clearance_m: Annotated[float, Field(ge=0.05, le=2.0)]  # nearer than this: at most 0.5 m/s towards it
    blind_speed_mps: Annotated[float, Field(gt=0.0, le=3.0)]  # where the camera does not look; max_speed_mps = not asked for
    blind_memory_s: Annotated[float, Field(gt=0.0, le=60.0)]  # ... and only through space seen free so lately
    retreat_speed_mps: Annotated[float, Field(gt=0.0, le=3.0)]  # on the pilot's own way back
    silence_way_m: Annotated[float, Field(gt=0.0, le=5.0)]  # flown since the mission's last pulse, braking included: hold
    intent_timeout_s: Annotated[float, Field(gt=0.0, le=5.0)]  # mission silent for longer: hold
    retreat_timeout_s: Annotated[float, Field(gt=0.0, le=60.0)]  # mission still silent: back along the breadcrumbs
    pose_timeout_s: Annotated[float, Field(gt=0.0, le=1.0)]  # pose older: hold, stop feeding the autopilot
    pose_land_s: Annotated[float, Field(gt=0.0, le=5.0)]  # pose still missing: land
    land_timeout_s: Annotated[float, Field(gt=0.0, le=60.0)]  # mission silent for this long in flight: land
    depth_timeout_s: Annotated[float, Field(gt=0.0, le=1.0)]  # newest depth older: no motion
    depth_retreat_s: Annotated[float, Field(gt=0.0, le=30.0)]  # still none: back along the breadcrumbs
    depth_land_s: Annotated[float, Field(gt=0.0, le=60.0)]  # still none: land

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
            ("retreat_speed_mps", "max_speed_mps"),
        )
        for names in ladders:
            values = [getattr(self, name) for name in names]
            if values != sorted(values):
                raise ValueError(f"{' <= '.join(names)} does not hold for {values}")
        return self

    def fence_plan(self) -> Polygon:
        """The floor plan of the fence. Raises ValueError for one that is open, crosses itself, or has no size."""
        (low_x, low_y, _), (high_x, high_y, _) = self.fence_min_m, self.fence_max_m
        return Polygon(self.fence_corners_m) if self.fence_corners_m else Polygon.box((low_x, low_y), (high_x, high_y))


class LinkConfig(Section):
    """The way to the autopilot."""

    autopilot: Literal["px4", "ardupilot"] = "px4"  # firmware personality
    url: LinkUrl = "udp:127.0.0.1:14540"  # udp:HOST:PORT (listens there) or serial:DEVICE:BAUD
    peer_host: Host | None = None  # who may be at the other end of udp; unset: this machine alone
    vehicle_system: Annotated[int, Field(ge=1, le=244)] = 1  # MAVLink system id of the vehicle; 245 is ours; no other is heard
    vehicle_component: Annotated[int, Field(ge=1, le=255)] = 1  # of its autopilot
    gimbal_component: Annotated[int, Field(ge=1, le=255)] = 154  # of its gimbal: heard about its own angle
    autopilot_uid: Uid = ""  # of its hardware, in hex, as AUTOPILOT_VERSION tells it; unset: whoever answers
    signing_key: Path | None = None  # file, 0600: 32 bytes or a passphrase; signed frames alone count then. ArduPilot only
    signing_link_id: Annotated[int, Field(ge=0, le=255)] = 1  # of our frames; each link that shares the key has its own
    signing_stamps: Path = Path("/var/lib/uav_recon/signing.json")  # what was signed when: no restart makes a frame good again
    parameters: Path | None = None  # file of what the vehicle must have; unset: that of firmware_params/ for this autopilot
    setpoint_rate_hz: Annotated[float, Field(ge=10.0, le=100.0)] = 30.0  # setpoints on the wire
    origin_lat_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = 47.3977  # origin handed to the autopilot
    origin_lon_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 8.5456  # any place will do indoors
    origin_alt_m: Annotated[float, Field(ge=-500.0, le=9000.0)] = 488.0  # height above the ellipsoid


class CameraConfig(Section):
    """Which camera, and how it sits on the body."""

    source: Literal["stream", "realsense", "recorded"] = "realsense"  # stream = any outside camera by memory-mapped file
    stream: Path = Path("camera.stream")  # stream file, inside the runtime directory unless absolute
    recording: Path | None = None  # "recorded": a flight folder; "realsense": a RealSense recording
    mount: Literal["fixed", "gimbal"] = "fixed"  # gimbal = pitch driven through MAVLink
    position_body_m: Vec3 = (0.10, 0.0, 0.0)  # depth imager on the body
    pitch_down_deg: Annotated[float, Field(ge=-60.0, le=60.0)] = 15.0  # tilt of a fixed mount, positive looks down
    gimbal_limit_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 60.0  # gimbal range, both ways
    horizontal_fov_deg: Annotated[float, Field(gt=10.0, lt=170.0)] = 87.0  # of the depth image
    vertical_fov_deg: Annotated[float, Field(gt=10.0, lt=170.0)] = 58.0  # of the depth image
    depth_min_m: Annotated[float, Field(gt=0.0, le=10.0)] = 0.3  # nearer returns are not believed
    depth_max_m: Annotated[float, Field(gt=0.0, le=20.0)] = 6.0  # farther returns are not believed
    depth_noise_px: Annotated[float, Field(gt=0.0, le=1.0)] = 0.04  # rms disparity error in pixels of the delivered depth image
    baseline_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.05  # stereo baseline


class LocalizationConfig(Section):
    """From late poses to steady odometry."""

    rate_hz: Annotated[float, Field(ge=20.0, le=200.0)] = 30.0  # odom output
    pose_lost_s: Annotated[float, Field(gt=0.0, le=2.0)] = 0.5  # no pose for longer: quality 0
    frame_wait_s: Annotated[float, Field(ge=0.0, le=0.5)] = 0.2  # longest wait of a frame for the pose after it


class VoxelConfig(Section):
    """Occupancy map."""

    resolution_m: Annotated[float, Field(ge=0.05, le=0.3)] = 0.1  # voxel edge
    max_range_m: Annotated[float, Field(gt=0.0, le=20.0)] = 5.0  # depth beyond it frees up to it, but marks nothing
    distance_cap_m: Annotated[float, Field(gt=0.0, le=5.0)] = 1.1  # the distance field saturates here
    takeoff_radius_m: Annotated[float, Field(gt=0.0, le=5.0)] = 0.6  # the operator's word: free to above take-off height
    margin_m: Annotated[float, Field(ge=0.0, le=1.0)] = 0.3  # map beyond the fence, to see its walls


class MapperConfig(Section):
    """Neural surface."""

    steps_per_view: Annotated[int, Field(ge=1, le=200)] = 20  # training steps after each new view
    idle_steps_hz: Annotated[float, Field(ge=0.0, le=1000.0)] = 40.0  # at most so many steps a second between views
    polish_steps: Annotated[int, Field(ge=0, le=20000)] = 1500  # after landing
    mesh_voxel_m: Annotated[float, Field(ge=0.005, le=0.1)] = 0.02  # final mesh
    surface_voxel_m: Annotated[float, Field(ge=0.01, le=0.2)] = 0.05  # elements handed to the planner
    uncertainty: UncertaintyName = "agreement"  # what elements carry; `uav-recon bench uncertainty` compares them
    seed: int = 0  # random sampling
    prior_model: Path | None = None  # ONNX file that sees normals or depth in a colour picture; for rays without a normal


class PlannerConfig(Section):
    """The paper's parameters (table I). What the preset gives is used for each key that is not written down."""

    variant: VariantName = "adaptive"  # V5, V4, V3, V2, V1 of the paper, and its baselines
    preset: Literal["auto", "bhxhp", "rosser", "convoy"] = "auto"  # auto: from the fence box and the camera
    shell_min_m: Annotated[float, Field(gt=0.0, le=20.0)] = 0.8  # d_r, nearest viewpoint to a task
    shell_max_m: Annotated[float, Field(gt=0.0, le=20.0)] = 2.5  # d_f, farthest
    clearance_m: Annotated[float, Field(ge=0.3, le=1.0)] = 0.35  # d_s, body centre to anything not known free
    local_radius_m: Annotated[float, Field(gt=0.0, le=100.0)] = 2.0  # R_loc
    cluster_radius_m: Annotated[float, Field(gt=0.0, le=20.0)] = 1.1  # R_clu
    max_reconstruct_tasks: Annotated[int, Field(ge=1, le=100)] = 10  # N_rec
    min_visible: Annotated[int, Field(ge=1, le=100000)] = 20  # N_min
    near_distance_m: Annotated[float, Field(gt=0.0, le=100.0)] = 1.5  # d_near
    near_count: Annotated[int, Field(ge=0, le=100000)] = 3  # explore if more frontiers than this are near ...
    near_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.2  # ... and their share is larger
    horizon_m: Annotated[float, Field(gt=0.0, le=100.0)] = 5.0  # L_exec
    view_spacing_m: Annotated[float, Field(ge=0.05, le=100.0)] | None = None  # l_res; unset: on the way where surface is new
    end_factor: Annotated[float, Field(ge=1.0, le=10.0)] = 3.0  # alpha, once no frontier is left
    downsample: Annotated[int, Field(ge=1, le=50)] = 5  # N_down
    worth_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.05  # of the best gain per second so far: flown for no less


class MotionConfig(Section):
    """Limits of planned motion; inside the guard's.

    Sharp images: during an exposure a point at blur_distance_m, passed across, moves over the image by
    focal_px * exposure_s * (turning + speed / blur_distance_m) pixels; at a view that stays below blur_px.
    """

    speed_mps: Annotated[float, Field(ge=0.05, le=3.0)] = 1.0  # in the open
    tight_speed_mps: Annotated[float, Field(ge=0.05, le=3.0)] = 0.7  # where clearance is the planning distance
    climb_mps: Annotated[float, Field(ge=0.05, le=3.0)] = 0.6  # upwards, inside the autopilot's MPC_Z_VEL_MAX_UP, WP_SPD_UP
    descent_mps: Annotated[float, Field(ge=0.05, le=3.0)] = 0.4  # downwards, inside the autopilot's MPC_Z_VEL_MAX_DN, WP_SPD_DN
    acceleration_mps2: Annotated[float, Field(ge=0.05, le=5.0)] = 1.2  # along and across
    run_on_s: Annotated[float, Field(ge=0.0, le=5.0)] = 1.3  # room for flying on, at each speed, unheard by the autopilot
    yaw_rate_degps: Annotated[float, Field(ge=1.0, le=120.0)] = 45.0  # rotation
    yaw_acceleration_degps2: Annotated[float, Field(ge=1.0, le=1000.0)] = 90.0  # rotation
    smoothing_s: Annotated[float, Field(gt=0.0, le=5.0)] = 0.4  # total width of the smoothing that bounds the jerk
    blur_px: Annotated[float, Field(ge=0.1, le=1000.0)] = 2.0  # most that the image may move during the exposure of a view
    exposure_s: Annotated[float, Field(gt=0.0, le=0.1)] = 0.008  # of the camera in indoor light
    focal_px: Annotated[float, Field(gt=0.0, le=5000.0)] = 460.0  # of the images that are kept
    blur_distance_m: Annotated[float, Field(ge=0.1, le=20.0)] = 1.5  # at which surfaces are looked at

    def at_most(self, speed_mps: float) -> MotionConfig:
        """The same, nowhere faster than that."""
        names = ("speed_mps", "tight_speed_mps", "climb_mps", "descent_mps")
        return self.model_copy(update={name: min(getattr(self, name), speed_mps) for name in names})


class MissionConfig(Section):
    """What to do with the flight."""

    views: Annotated[int, Field(ge=4, le=5000)] = 120  # keyframes given to the mapper, at most; frontiers before surface
    takeoff_height_m: Annotated[float, Field(ge=0.5, le=3.0)] = 1.1  # body above the pad
    survey_views: Annotated[int, Field(ge=0, le=36)] = 8  # keyframes of the first look round
    max_flight_s: Positive = 900.0  # then it returns
    plan_cost_s: Annotated[float, Field(ge=0.0, le=5.0)] = 0.1  # declared planning cost on a simulated clock
    autostart: bool = False  # true: arm and fly as soon as the pilot is READY; nobody is asked
    operator_timeout_s: Annotated[float, Field(ge=10.0, le=600.0)] | None = None  # of silence: home; unset: nobody need attend


class RecordingConfig(Section):
    """What the flight leaves behind."""

    folder: Path = Path("/var/lib/uav_recon/flights")  # flight folder
    rerun: bool = True  # write flight.rrd
    live: bool = False  # stream to a viewer on this machine


class RuntimeConfig(Section):
    """Where processes meet."""

    folder: Path = Path("/run/uav_recon")  # channels and stream files
    operator: Path = Path("operator.socket")  # where the pilot hears the operator, inside the folder unless absolute


class Config(Section):
    """The whole tree."""

    safety: SafetyConfig
    link: LinkConfig = LinkConfig()
    camera: CameraConfig = CameraConfig()
    localization: LocalizationConfig = LocalizationConfig()
    voxels: VoxelConfig = VoxelConfig()
    mapper: MapperConfig = MapperConfig()
    planner: PlannerConfig = PlannerConfig()
    motion: MotionConfig = MotionConfig()
    mission: MissionConfig = MissionConfig()
    recording: RecordingConfig = RecordingConfig()
    runtime: RuntimeConfig = RuntimeConfig()

    @model_validator(mode="after")
    def _everything_fits_together(self) -> Config:
        fault = config_constraints.fault_of(self)
        if fault:
            raise ValueError(fault)
        return self


def load(path: Path) -> Config:
    """Read a TOML file. Raises ConfigError with one line naming file, key, value and range."""
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None
    except RecursionError:
        raise ConfigError(f"{path}: not TOML: nested too deeply") from None
    return parse(tree, str(path))


def parse(tree: dict[str, Any], source: str) -> Config:
    """Check a tree. Raises ConfigError with one line for the first fault."""
    try:
        return Config.model_validate(tree)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        value = first.get("input")
        shown = "" if isinstance(value, dict) or value is None else f" (got {value!r})"
        fault = PLAINLY.get(first["type"], first["msg"].removeprefix("Value error, "))
        raise ConfigError(f"{source}: {where}{where and ': '}{fault[0].lower()}{fault[1:]}{shown}") from None


def save(config: Config, path: Path) -> None:
    """Write the effective config."""
    path.write_text(tomli_w.dumps(config.model_dump(mode="json", exclude_none=True)), encoding="utf-8")
