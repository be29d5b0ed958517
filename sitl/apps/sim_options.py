"""The options of `uav-recon sim`: types, defaults, help and checks.

Imports nothing heavy: the help of `uav-recon` loads it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sitl.apps.command_option import CommandOption, check_fields
from sitl.camera.camera_error_scale import scale_of
from uav_recon.app.option_validation import UsageError, mount_pitch_deg
from uav_recon.app.reference_safety import MAX_SPEED_MPS

AUTOPILOTS = ("px4", "ardupilot")
VARIANTS = ("adaptive", "merged", "reconstruct", "explore", "explore-yaw", "explore-then-refine", "evpp", "vpp")
UNCERTAINTIES = ("agreement", "paper", "colour", "information", "product")
POSES = ("stream", "corrected", "slam", "autopilot")
CAMERAS = ("d435i", "wide", "fast", "small")
NOISES = ("d435i", "paper", "kinect", "none")
MAPPERS = ("neural", "depth-only")
MOUNTS = ("fixed:15", "fixed:0", "gimbal")
AUTO = "auto"  # mount: fixed, with a tilt for the size of the room
JOB_GB = 0.8  # memory of a process that flies in lockstep
# of --start and --fence
MAX_COORDINATE_M = 1e5
MAX_YAW_DEG = 360.0

SCENE_PANEL = "Scene"
VEHICLE_PANEL = "Vehicle and autopilot"
CAMERA_PANEL = "Camera"
PLANNER_PANEL = "Mapping and planning"
RUN_PANEL = "Run"

# options that several commands share
AUTOPILOT = CommandOption("Simulated autopilot.", VEHICLE_PANEL, words=AUTOPILOTS)
FIRMWARE = CommandOption(
    "Fly a real firmware instead of the simulated autopilot: the binary of ArduCopter SITL, or bin/px4 of a PX4 build with "
    "SIH. It has its own vehicle dynamics. Needs the matching --autopilot.",
    VEHICLE_PANEL, "PATH",
)  # fmt: skip
RADIUS = CommandOption(
    "Radius of the vehicle in metres, 0.05 to 0.6. Planning clearance and fence inset follow from it.",
    VEHICLE_PANEL, "M", flag="--radius", limits=(0.05, 0.60), unit="metres",
)  # fmt: skip
RANGE_UP = CommandOption(
    "Add a range finder of 4 m that looks up. DEG is the whole angle of its cone, 5 to 60 degrees: 27 is that of a small "
    "time-of-flight sensor. What it finds empty becomes known free space.",
    VEHICLE_PANEL, "DEG", flag="--range-up", limits=(5.0, 60.0), unit="degrees",
)  # fmt: skip
FLOW = CommandOption(
    "Add an optical flow sensor and a range finder of 4 m that look down, and set the autopilot's parameters for them.",
    VEHICLE_PANEL,
)
CAMERA = CommandOption(
    "d435i: colour narrower than depth. wide: one registered RGB-D camera. fast: a d435i at a quarter of its pixels, 6 Hz, no "
    "colour. small: the same with colour. Default: d435i; fast with --mapper depth-only.",
    CAMERA_PANEL, words=CAMERAS,
)  # fmt: skip
MOUNT = CommandOption(
    "Camera mount. DEG is the tilt in degrees, -60 to 60; positive looks down. auto: fixed:10, or less in a small room where "
    "that shows much more of it (`uav-recon check room`).",
    CAMERA_PANEL, "auto|fixed:DEG|gimbal", offered=(AUTO, *MOUNTS),
)  # fmt: skip
POSE = CommandOption(
    "Source of the poses. stream: a simulated tracking system beside the camera. corrected: the same, its drift corrected by a "
    "tracker (localization.correct_drift). slam: the embedded RGB-D SLAM, which has nothing but the images and the IMU of the "
    "camera. autopilot: a tracking system of the autopilot.",
    CAMERA_PANEL, words=POSES,
)  # fmt: skip
CAMERA_ERRORS = CommandOption(
    "Errors of the camera, drawn from the seed: mount, lens and colour calibration, depth scale, delay, rolling shutter, "
    "exposure, IMU noise and lost frames. A factor of 0 to 2 scales all; none: an exact camera. Default: default, which is 1.",
    CAMERA_PANEL, "default|none|FACTOR", offered=("default", "none"),
)  # fmt: skip
VARIANT = CommandOption(
    "Planner. Of the paper (Zeng et al., ICRA 2024): adaptive (V5), merged (V4), reconstruct (V3), explore (V2), explore-yaw "
    "(V1; equals explore with a fixed mount). Its baselines: explore-then-refine, evpp, vpp.",
    PLANNER_PANEL, "NAME", words=VARIANTS,
)  # fmt: skip
VIEWS = CommandOption(
    "View budget: maximum number of keyframes for the mapper. Default: 500; most flights end before, by what a view is worth.",
    PLANNER_PANEL, "N", whole=(4, 5000),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SimOptions:
    """The options as typed; the command line is made of these fields.

    Raises UsageError with one line for a value that cannot be used. What is not typed, such as the model of the camera
    without --camera, is a property.
    """

    scene: Annotated[
        str | None,
        CommandOption(
            "Folder with scene.json, mesh file (.ply .obj .glb .stl; metres, z up), random:SEED for a generated flat, "
            "flat:SEED for one with doors, small:SEED for a room of 6 to 14 m², and others: --list-scenes. "
            "Default: the built-in room.",
            SCENE_PANEL,
            "PATH|random:SEED|flat:SEED|small:SEED",
        ),
    ] = None
    list_scenes: Annotated[bool, CommandOption("List the scenes that can be flown, and exit.", SCENE_PANEL)] = False
    start: Annotated[
        str | None,
        CommandOption(
            "Take-off position in metres and heading in degrees, in the mesh's frame. Required for a mesh file.",
            SCENE_PANEL,
            "X,Y,Z,YAW",
        ),
    ] = None
    fence: Annotated[
        str | None,
        CommandOption(
            "Fence: lower and upper corner in metres, in the mesh's frame. Required where the mesh is open.",
            SCENE_PANEL,
            "X0,Y0,Z0,X1,Y1,Z1",
        ),
    ] = None
    autopilot: Annotated[str, AUTOPILOT] = "px4"
    firmware: Annotated[Path | None, FIRMWARE] = None
    port: Annotated[int, CommandOption("UDP port of the MAVLink link.", VEHICLE_PANEL, "N", whole=(1024, 65535))] = 14540
    radius_m: Annotated[float, RADIUS] = 0.20
    blind_speed_mps: Annotated[
        float,
        CommandOption(
            "Speed limit outside the camera's field of view, 0.1 to 1.2 m/s. Below 1.2 the vehicle yaws into the direction of "
            "travel on long segments. 1.2 disables the limit; flights are then about a third shorter.",
            VEHICLE_PANEL,
            "M/S",
            flag="--blind-speed",
            limits=(0.1, MAX_SPEED_MPS),
            unit="m/s",
        ),
    ] = 0.3
    range_up_deg: Annotated[float | None, RANGE_UP] = None
    flow: Annotated[bool, FLOW] = False
    camera: Annotated[str | None, CAMERA] = None
    mount: Annotated[str, MOUNT] = AUTO
    pose: Annotated[str, POSE] = "stream"
    depth_noise: Annotated[
        str, CommandOption("Noise model of the depth images; none: exact depth.", CAMERA_PANEL, words=NOISES)
    ] = "d435i"
    camera_errors: Annotated[str | None, CAMERA_ERRORS] = None
    calibration: Annotated[
        Path | None,
        CommandOption(
            "Begin from the camera errors that an earlier flight left in FILE, and write them there. Default: begin without, "
            "so that a seed gives one flight.",
            CAMERA_PANEL,
            "FILE",
        ),
    ] = None
    flown_map: Annotated[
        Path | None,
        CommandOption(
            "Find the start of this flight in the map that an earlier flight left in FILE, and leave its own map there.",
            CAMERA_PANEL,
            "FILE",
        ),
    ] = None
    mapper: Annotated[
        str,
        CommandOption(
            "neural: learn the surface. depth-only: surface directly from depth images; quick, without model and recording; "
            "needs --lockstep.",
            PLANNER_PANEL,
            words=MAPPERS,
            renamed=(("stand-in", "depth-only"),),
        ),
    ] = "neural"
    variant: Annotated[str, VARIANT] = "adaptive"
    uncertainty: Annotated[
        str,
        CommandOption(
            "Measure of surface uncertainty for the planner: agreement, paper, colour, information or product.",
            PLANNER_PANEL,
            "NAME",
            words=UNCERTAINTIES,
        ),
    ] = "agreement"
    views: Annotated[int | None, VIEWS] = None
    seed: Annotated[
        int,
        CommandOption("Seed of wind, noise and training. In lockstep, one seed gives one flight.", RUN_PANEL, whole=(0, None)),
    ] = 0
    out: Annotated[Path | None, CommandOption("Flight folder. Default: flights/SCENE-DATE.", RUN_PANEL, "FOLDER")] = None
    lockstep: Annotated[bool, CommandOption("Run in one process on a simulated clock: repeatable and faster.", RUN_PANEL)] = (
        False
    )
    live: Annotated[bool, CommandOption("Open the rerun viewer and show the flight while it runs.", RUN_PANEL)] = False
    json: Annotated[Path | None, CommandOption("Write the report, commit and machine to FILE.", RUN_PANEL, "FILE")] = None

    def __post_init__(self) -> None:
        """Check each value, then values that do not go together. Raises UsageError with one line."""
        check_fields(self)
        if self.scene is not None and not self.scene.strip():
            raise UsageError("--scene is empty: want a folder, a mesh file, or random:SEED and the like (--list-scenes)")
        if self.mapper == "depth-only" and not self.lockstep:
            raise UsageError("--mapper depth-only: needs --lockstep")
        camera_error_scale(self.camera_errors)
        check_mount(self.mount)
        self._check_corners()
        if self.firmware is not None:
            self._check_firmware()

    def _check_corners(self) -> None:
        start, fence = self.start_pose, self.fence_corners
        if start is not None and not abs(start[3]) <= MAX_YAW_DEG:
            raise UsageError(f"--start {self.start}: YAW is {start[3]:g}; want -{MAX_YAW_DEG:g} to {MAX_YAW_DEG:g} degrees")
        if fence is not None and any(low >= high for low, high in zip(fence[:3], fence[3:], strict=True)):
            text = "each number of the upper corner must be larger than that of the lower corner"
            raise UsageError(f"--fence {self.fence}: {text}")

    def _check_firmware(self) -> None:
        if self.lockstep:
            raise UsageError("--firmware: flies in real time only; leave out --lockstep")
        if self.pose == "autopilot":
            raise UsageError("--pose autopilot: needs the simulated autopilot; leave out --firmware")
        if self.range_up_deg is not None:
            raise UsageError("--range-up: needs the simulated autopilot; leave out --firmware")
        if self.mount == "gimbal":
            raise UsageError("--firmware: needs --mount fixed:DEG; the firmware's simulation has no gimbal")
        from sitl.real_firmware.px4 import COMPANION_PORT

        if self.autopilot == "px4" and self.port != COMPANION_PORT:
            raise UsageError(f"--port {self.port}: want {COMPANION_PORT} with a PX4 --firmware; its start script sends there")

    @property
    def start_pose(self) -> tuple[float, float, float, float] | None:
        """Take-off position X, Y, Z (m) and heading (degrees) in the mesh's frame, or None."""
        if self.start is None:
            return None
        x, y, z, yaw_deg = _numbers("--start", "X,Y,Z,YAW", self.start)
        return (x, y, z, yaw_deg)

    @property
    def fence_corners(self) -> tuple[float, float, float, float, float, float] | None:
        """Lower and upper corner of the fence (m) in the mesh's frame, or None."""
        if self.fence is None:
            return None
        x0, y0, z0, x1, y1, z1 = _numbers("--fence", "X0,Y0,Z0,X1,Y1,Z1", self.fence)
        return (x0, y0, z0, x1, y1, z1)

    @property
    def camera_model(self) -> str:
        """Model of the simulated camera."""
        return self.camera or ("d435i" if self.mapper == "neural" else "fast")

    @property
    def camera_error_scale(self) -> float:
        """Scale of the errors of the camera that the seed draws; 0: the exact camera."""
        return camera_error_scale(self.camera_errors)

    @property
    def textured(self) -> bool:
        """True if the flight needs a scene with texture.

        It does if the mapper learns colour, or the camera shows it.
        """
        return self.mapper == "neural" or self.camera_model != "fast"

    @property
    def folder(self) -> Path:
        """The flight folder, absolute.

        Without --out there is none before flight_folder.dated_folder gives one: that is an error of the caller.
        """
        assert self.out is not None, "no flight folder yet"
        return self.out.absolute()


def camera_error_scale(text: str | None) -> float:
    """Return the scale of the camera's errors; None is the option left out. Raises UsageError."""
    try:
        return scale_of(text)
    except ValueError as error:
        raise UsageError(f"--camera-errors {text}: {error}") from None


def check_mount(mount: str) -> None:
    """Check the camera mount. Raises UsageError."""
    if mount != AUTO:
        mount_pitch_deg(mount)


def check_jobs(jobs: int) -> int:
    """Return the number of processes. Raises UsageError if the memory is too small for them."""
    most = max(2, int(memory_gb() / JOB_GB))
    if not 1 <= jobs <= most:
        raise UsageError(f"--jobs {jobs}: want 1 to {most}; each may use {JOB_GB:g} GB of memory")
    return jobs


def memory_gb() -> float:
    """Return the memory of this machine in gigabytes."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9


def _numbers(flag: str, form: str, text: str) -> tuple[float, ...]:
    """Return the numbers of an option, as many as its form names. Raises UsageError."""
    count = len(form.split(","))
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(abs(n) <= MAX_COORDINATE_M for n in numbers):
        raise UsageError(f"{flag} {text}: want {count} numbers {form}, each -{MAX_COORDINATE_M:g} to {MAX_COORDINATE_M:g}")
    return numbers
