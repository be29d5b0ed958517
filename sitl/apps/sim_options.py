"""The options of `uav-recon sim`, validated, and the product config that they give."""

from __future__ import annotations

import itertools
import math
import os
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast, get_args

from sitl.apps.world_process import WorldOptions
from sitl.camera.camera_errors import scale_of
from sitl.camera.d435i import Model, Noise
from sitl.real_firmware.px4 import COMPANION_PORT as PX4_PORT
from sitl.scene.scene import HULL_HEIGHT_M, Scene, free_height_m
from sitl.world.range_finder import MOUNT_M
from uav_recon.app.option_validation import OUTPUTS, UsageError, mount_pitch_deg, readable, require_writable_folder
from uav_recon.app.room_check import advise
from uav_recon.config import Config, ConfigError, UncertaintyName, VariantName, parse
from uav_recon.errors import EXIT_CONFIG, UserError
from uav_recon.localization.calibration.kept_calibration import is_calibration
from uav_recon.planning.mount_visibility import USUAL_DEG

__all__ = ["SimOptions", "UsageError"]

NOISES = ("d435i", "paper", "kinect", "none")
CAMERAS = ("d435i", "wide", "fast", "small")
MAPPERS = ("neural", "depth-only")
OLD_NAMES = {"stand-in": "depth-only"}  # of a mapper: still accepted
VARIANTS = get_args(VariantName)
UNCERTAINTIES = get_args(UncertaintyName)
POSES = ("stream", "corrected", "slam", "autopilot")
AUTOPILOTS = ("px4", "ardupilot")
BUILT_IN_VIEWS = 60
SCENE_VIEWS = 120
RADIUS_M = 0.20
RADII_M = (0.05, 0.60)
# from hull, and from body centre, to space not known free, in a plan
HULL_MARGIN_M = 0.20
SMALLEST_CLEARANCE_M = 0.35
MAX_MPS = 1.2
AUTO = "auto"  # mount: fixed, with a tilt for the size of the room
# of --start and --fence
MAX_COORDINATE_M = 1e5
MAX_YAW_DEG = 360.0
BLIND_MPS = 0.3  # default speed limit outside the camera's view; MAX_MPS disables it
SLOWEST_MPS = 0.1  # its minimum
BLIND_MEMORY_S = 60.0  # space above and below a fixed camera's view was mostly seen more than 10 s ago
COLUMN_MARGIN_M = 0.10  # beyond the planning clearance, round the column above the pad that the operator sees to be free
COLUMN_TOP_M = 0.05  # below the ceiling: half a voxel
FENCE_MARGIN_M = 0.10  # between hull and fence, for position errors of the vehicle
RANGE_UP_DEG = (5.0, 60.0)  # whole angle of the cone of a range finder that looks up
JOB_GB = 0.8  # memory of a process that flies in lockstep
NOISE_PX = {"d435i": 0.04, "paper": 0.004, "kinect": 0.02, "none": 0.001}  # rms disparity error at 424 pixels


@dataclass(frozen=True)
class FlightLimits:
    """Limits that a pose source needs.

    fresh_s, stale_s: outside the view, full speed up to the first age of the last free sight, blind_speed_mps from the second
    on. max_yaw_rate_degps: of the guard. motion: of the config.
    """

    fresh_s: float = 3.0
    stale_s: float = 10.0
    max_yaw_rate_degps: float = 60.0
    motion: dict[str, float] = field(default_factory=dict)


# the embedded SLAM needs a camera that looks ahead, and knows its place for a second past a bare wall: it turns past it in half
# of that
LIMITS_BY_SOURCE = {"slam": FlightLimits(0.0, 0.1, 100.0, {"yaw_rate_degps": 80.0, "yaw_acceleration_degps2": 200.0})}


@dataclass(frozen=True)
class SimOptions:
    """The validated options. mount_pitch_down_deg None: gimbal. start: X, Y, Z (m), yaw (deg)."""

    scene: str | None
    start: tuple[float, float, float, float] | None
    fence: tuple[float, float, float, float, float, float] | None
    views: int
    seed: int
    out: Path
    autopilot: str
    variant: str
    mount: str
    mount_pitch_down_deg: float | None
    depth_noise: str
    camera: str
    mapper: str
    radius_m: float
    lockstep: bool
    live: bool
    port: int
    uncertainty: str
    firmware: Path | None  # binary of a real firmware, in place of the simulated autopilot
    blind_speed_mps: float
    pose: str  # source of the poses
    camera_errors: float  # scale of the errors of the camera that the seed draws; 0: the exact camera
    calibration: Path | None = None  # file of the camera's errors, read and written; None: the flight begins without
    range_up_deg: float | None = None  # angle of the cone of a range finder that looks up; None: there is none
    dated: bool = False  # the flight folder was not given: it has the date, and is made by this process alone

    @staticmethod
    def parse(
        *, scene: str | None = None, start: str | None = None, fence: str | None = None, views: int | None = None,
        seed: int = 0, out: Path | None = None, autopilot: str = "px4", variant: str = "adaptive",
        mount: str = "fixed:15", depth_noise: str = "d435i", camera: str | None = None, mapper: str = "neural",
        radius: float = RADIUS_M, lockstep: bool = False, live: bool = False, port: int = 14540,
        uncertainty: str = "agreement", firmware: Path | None = None, blind_speed: float = BLIND_MPS,
        camera_errors: str | None = None, pose: str = "stream", calibration: Path | None = None,
        range_up: float | None = None,
    ) -> SimOptions:  # fmt: skip
        """Validate the options of the command line. Raises UsageError with one line."""
        mapper = OLD_NAMES.get(mapper, mapper)
        if scene is not None and not scene.strip():
            raise UsageError("--scene is empty: want a folder, a mesh file, random:SEED or small:SEED")
        chosen = camera or ("d435i" if mapper == "neural" else "fast")
        for name, value, allowed in (
            ("autopilot", autopilot, AUTOPILOTS), ("variant", variant, VARIANTS), ("depth-noise", depth_noise, NOISES),
            ("camera", chosen, CAMERAS), ("mapper", mapper, MAPPERS), ("uncertainty", uncertainty, UNCERTAINTIES),
            ("pose", pose, POSES),
        ):  # fmt: skip
            if value not in allowed:
                raise UsageError(f"--{name} {value}: want one of {', '.join(allowed)}")
        if mapper == "depth-only" and not lockstep:
            raise UsageError("--mapper depth-only: needs --lockstep")
        if not RADII_M[0] <= radius <= RADII_M[1]:
            raise UsageError(f"--radius {radius}: want {RADII_M[0]} to {RADII_M[1]} metres")
        if not SLOWEST_MPS <= blind_speed <= MAX_MPS:
            raise UsageError(f"--blind-speed {blind_speed}: want {SLOWEST_MPS} to {MAX_MPS} m/s")
        check_range_up(range_up)
        check_calibration(calibration)
        if firmware is not None:
            _check_firmware(firmware, autopilot, mount, port, lockstep, pose, range_up)
        s = _numbers("start", "X,Y,Z,YAW", start, 4)
        f = _numbers("fence", "X0,Y0,Z0,X1,Y1,Z1", fence, 6)
        if s is not None and not abs(s[3]) <= MAX_YAW_DEG:
            raise UsageError(f"--start {start}: YAW is {s[3]:g}; want -{MAX_YAW_DEG:g} to {MAX_YAW_DEG:g} degrees")
        if f is not None and any(f[i] >= f[i + 3] for i in range(3)):
            raise UsageError(f"--fence {fence}: each number of the upper corner must be larger than that of the lower corner")
        stem = "room" if scene is None else Path(scene).stem.replace(":", "-")
        folder = out or Path("flights") / f"{stem}-{time.strftime('%Y%m%d-%H%M%S')}"
        return SimOptions(
            scene=scene,
            start=None if s is None else (s[0], s[1], s[2], s[3]),
            fence=None if f is None else (f[0], f[1], f[2], f[3], f[4], f[5]),
            views=views if views is not None else BUILT_IN_VIEWS if scene is None else SCENE_VIEWS,
            seed=seed, out=folder.absolute(), autopilot=autopilot, variant=variant, mount=mount,
            mount_pitch_down_deg=USUAL_DEG if mount == AUTO else mount_pitch_deg(mount),
            depth_noise=depth_noise, camera=chosen, mapper=mapper, radius_m=radius,
            lockstep=lockstep, live=live, port=port, uncertainty=uncertainty,
            firmware=None if firmware is None else firmware.absolute(), blind_speed_mps=blind_speed,
            pose=pose, camera_errors=camera_error_scale(camera_errors), dated=out is None,
            calibration=None if calibration is None else calibration.absolute(), range_up_deg=range_up,
        )  # fmt: skip

    @property
    def textured(self) -> bool:
        """True if the flight needs a scene with texture.

        It does if the mapper learns colour, or the camera shows it.
        """
        return self.mapper == "neural" or self.camera != "fast"

    def with_mount_for(self, scene: Scene) -> SimOptions:
        """Return the options with the mount that fits the scene's size, if AUTO was given."""
        if self.mount != AUTO:
            return self
        advice = advise(self.config(scene, Path("/run")))
        tilt_deg = USUAL_DEG if advice is None else advice.recommended_deg
        return replace(self, mount=f"fixed:{tilt_deg:g}", mount_pitch_down_deg=tilt_deg)

    def check_folder(self) -> None:
        """Check the flight folder before the work.

        Raises UsageError if it cannot be made or already contains a file that a flight would replace.
        """
        with readable(f"--out {self.out}"):
            if taken := next((name for name in OUTPUTS if (self.out / name).exists()), None):
                raise UsageError(f"--out {self.out}: already contains {taken}; name another folder")
            there = next(folder for folder in (self.out, *self.out.parents) if folder.exists())
            if not there.is_dir():
                raise UsageError(f"--out {self.out}: cannot be written ({there} is not a folder)")
            if not os.access(there, os.W_OK | os.X_OK):
                raise UsageError(f"--out {self.out}: cannot be written ({there}: permission denied)")

    def with_own_folder(self) -> SimOptions:
        """Return the options with a dated folder that no other process uses.

        It is made here, with a number behind the date if needed. A folder that was given stays as it is. Raises UsageError if
        it cannot be made.
        """
        if not self.dated:
            return self
        self.check_folder()
        for number in itertools.count(1):
            folder = self.out if number == 1 else self.out.with_name(f"{self.out.name}-{number}")
            try:
                folder.mkdir(parents=True)
            except FileExistsError:
                continue
            except OSError as error:
                raise UsageError(f"--out {folder}: cannot be written ({error.strerror})") from None
            return replace(self, out=folder)
        raise AssertionError

    def make_folder(self) -> None:
        """Make the flight folder.

        Raises UsageError; see check_folder.
        """
        self.check_folder()
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            (self.out / "logs").mkdir(exist_ok=True)
        except OSError as error:
            raise UsageError(f"--out {self.out}: cannot be written ({error.strerror})") from None

    def world(self, runtime: Path) -> WorldOptions:
        """Return the options of the simulator."""
        return WorldOptions(
            scene=self.scene, start=self.start, fence=self.fence, seed=self.seed, autopilot=self.autopilot,
            mount_pitch_down_deg=self.mount_pitch_down_deg, radius_m=self.radius_m,
            depth_noise=cast("Noise", self.depth_noise), camera=cast("Model", self.camera), port=self.port,
            stream=str(runtime / "camera.stream"),
            truth=str(self.out / "truth.npz"), firmware=None if self.firmware is None else str(self.firmware),
            camera_errors=self.camera_errors, onboard_poses=self.pose == "autopilot", range_up_deg=self.range_up_deg,
        )  # fmt: skip

    def config(self, scene: Scene, runtime: Path) -> Config:
        """Return the product's config for this flight. Raises UserError with exit code 78."""
        gimbal = self.mount_pitch_down_deg is None
        noise_px = NOISE_PX[self.depth_noise] / (2.0 if self.camera in ("fast", "small") else 1.0)
        clearance_m = max(SMALLEST_CLEARANCE_M, self.radius_m + HULL_MARGIN_M)
        limits = LIMITS_BY_SOURCE.get(self.pose, FlightLimits())
        tree = {
            "safety": {
                "fence_min_m": [float(x) for x in scene.fence_min],
                "fence_max_m": [float(x) for x in scene.fence_max],
                "fence_corners_m": [],
                "fence_inset_m": self.radius_m + FENCE_MARGIN_M,
                "max_speed_mps": MAX_MPS,
                "max_acceleration_mps2": 2.0,
                "max_yaw_rate_degps": limits.max_yaw_rate_degps,
                "vehicle_radius_m": self.radius_m,
                "vehicle_height_m": HULL_HEIGHT_M,
                "stop_clearance_m": 0.1,
                "fast_clearance_m": 0.4,
                "blind_speed_mps": self.blind_speed_mps,
                "blind_fresh_s": limits.fresh_s,
                "blind_stale_s": limits.stale_s,
                "blind_memory_s": BLIND_MEMORY_S,
                "retreat_speed_mps": 0.3,
                "silence_way_m": 0.45,
                "intent_timeout_s": 0.5,
                "retreat_timeout_s": 5.0,
                "pose_timeout_s": 0.25,
                "pose_land_s": 0.7,
                "land_timeout_s": 20.0,
                "depth_timeout_s": 0.3,
                "depth_retreat_s": 3.0,
                "depth_land_s": 10.0,
            },
            "link": {"autopilot": self.autopilot, "url": f"udp:127.0.0.1:{self.port}"},
            "camera": {
                "source": "stream",
                "mount": "gimbal" if gimbal else "fixed",
                "pitch_down_deg": self.mount_pitch_down_deg or 0.0,
                "depth_noise_px": noise_px,
            },
            "localization": {
                "source": "stream" if self.pose == "corrected" else self.pose,
                "correct_drift": self.pose == "corrected",
                "pad_heading_deg": math.degrees(scene.start_yaw_rad),
                **({} if self.calibration is None else {"calibration": str(self.calibration)}),
            },
            "voxels": {"takeoff_top_m": max(free_height_m(scene, clearance_m + COLUMN_MARGIN_M) - COLUMN_TOP_M, 0.1)},
            "range_up": {} if self.range_up_deg is None else {"fov_deg": self.range_up_deg, "position_body_m": list(MOUNT_M)},
            "mapper": {"seed": self.seed, "uncertainty": self.uncertainty},
            "planner": {
                "variant": self.variant,
                "clearance_m": clearance_m,
            },
            "motion": limits.motion,
            "mission": {"views": self.views, "autostart": True},
            "recording": {"folder": str(self.out), "live": self.live, "rerun": self.mapper == "neural" or self.live},
            "runtime": {"folder": str(runtime)},
        }
        try:
            return parse(tree, "sim")
        except ConfigError as error:
            raise UserError(str(error), EXIT_CONFIG) from None


def check_jobs(jobs: int) -> int:
    """Return the number of processes. Raises UsageError if the memory is too small for them."""
    most = max(2, int(memory_gb() / JOB_GB))
    if not 1 <= jobs <= most:
        raise UsageError(f"--jobs {jobs}: want 1 to {most}; each may use {JOB_GB:g} GB of memory")
    return jobs


def camera_error_scale(text: str | None) -> float:
    """Return the scale of the camera's errors; None is the option left out. Raises UsageError."""
    try:
        return scale_of(text)
    except ValueError as error:
        raise UsageError(f"--camera-errors {text}: {error}") from None


def memory_gb() -> float:
    """Return the memory of this machine in gigabytes."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9


def check_range_up(fov_deg: float | None) -> None:
    """Check the cone of a range finder that looks up. Raises UsageError."""
    if fov_deg is not None and not RANGE_UP_DEG[0] <= fov_deg <= RANGE_UP_DEG[1]:
        raise UsageError(f"--range-up {fov_deg:g}: want {RANGE_UP_DEG[0]:g} to {RANGE_UP_DEG[1]:g} degrees")


def check_calibration(file: Path | None) -> None:
    """Check the file of the camera's errors before the flight.

    It need not exist. Raises UserError with exit code 2.
    """
    if file is None:
        return
    with readable(f"--calibration {file}"):
        if file.is_dir():
            raise UsageError(f"--calibration {file}: is a folder")
        if not file.parent.is_dir():
            raise UsageError(f"--calibration {file}: folder {file.parent} does not exist")
        if file.exists() and not (file.is_file() and is_calibration(file)):
            raise UsageError(f"--calibration {file}: not a calibration file")
    require_writable_folder("--calibration", file.parent)


def check_program(firmware: Path) -> None:
    """Check a firmware binary. Raises UsageError if it cannot be started."""
    with readable(f"--firmware {firmware}"):
        folder, there = firmware.is_dir(), firmware.is_file()
    if not there:
        raise UsageError(f"--firmware {firmware}: {'is a folder; want the binary in it' if folder else 'no such file'}")
    if not os.access(firmware, os.X_OK):
        raise UsageError(f"--firmware {firmware}: not executable")


def _check_firmware(
    firmware: Path, autopilot: str, mount: str, port: int, lockstep: bool, pose: str, range_up: float | None
) -> None:
    """Check a firmware with the other options. Raises UsageError if it cannot fly with them."""
    check_program(firmware)
    if lockstep:
        raise UsageError("--firmware: flies in real time only; leave out --lockstep")
    if pose == "autopilot":
        raise UsageError("--pose autopilot: needs the simulated autopilot; leave out --firmware")
    if range_up is not None:
        raise UsageError("--range-up: needs the simulated autopilot; leave out --firmware")
    if mount == "gimbal":
        raise UsageError("--firmware: needs --mount fixed:DEG; the firmware's simulation has no gimbal")
    if autopilot == "px4" and port != PX4_PORT:
        raise UsageError(f"--port {port}: want {PX4_PORT} with a PX4 --firmware; its start script sends there")


def _numbers(name: str, form: str, text: str | None, count: int) -> tuple[float, ...] | None:
    """Return the numbers of an option, None if it is not given. Raises UsageError."""
    if text is None:
        return None
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(abs(n) <= MAX_COORDINATE_M for n in numbers):
        raise UsageError(f"--{name} {text}: want {count} numbers {form}, each -{MAX_COORDINATE_M:g} to {MAX_COORDINATE_M:g}")
    return numbers
