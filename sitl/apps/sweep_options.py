"""The options of `uav-recon sweep`.

Imports nothing heavy: the help of `uav-recon` loads it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from sitl.apps import sim_options
from sitl.apps.command_option import CommandOption, check_fields
from sitl.apps.sim_options import AUTOPILOTS, RADIUS, VARIANTS, camera_error_scale, check_jobs, check_mount
from uav_recon.app.option_validation import UsageError, readable

RANDOM = "random"  # name of a scene: a new flat for each seed; so does every other of KINDS
BUILT_IN = "built-in"  # name of a scene: the room of `sim`
BOTH = "both"
BOTH_AUTOPILOTS = CommandOption("Simulated autopilot.", words=(*AUTOPILOTS, BOTH))
JOBS = CommandOption("Parallel processes; each uses one core.", whole=(1, 256))


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """The options as typed; the command line is made of these fields.

    Raises UsageError with one line for a value that cannot be used. Lists are properties.
    """

    flights: Annotated[int, CommandOption("Number of flights.", whole=(1, 100000))] = 500
    seed0: Annotated[int, CommandOption("First seed.", whole=(0, None))] = 0
    scenes: Annotated[
        str,
        CommandOption(
            "Scenes: random, flat, small, ... (a new one for each seed; `sim --list-scenes`), random:SEED, built-in, "
            "folders, mesh files.",
            metavar="S,S,...",
        ),
    ] = RANDOM
    radii: Annotated[str, CommandOption("Radii of the vehicle in metres, 0.05 to 0.6.", metavar="M,M,...")] = "0.20"
    variants: Annotated[str, CommandOption("Planner variants; see `sim --help`.", metavar="V,V,...", offered=VARIANTS)] = (
        "adaptive"
    )
    mount: Annotated[
        str,
        CommandOption(
            "Camera mounts: fixed:DEG, gimbal, or auto, as `sim` without one.",
            metavar="M,M,...",
            offered=sim_options.MOUNT.offered,
        ),
    ] = "fixed:15"
    autopilot: Annotated[str, BOTH_AUTOPILOTS] = "px4"
    pose: Annotated[str, sim_options.POSE.described("Source of the poses; see `sim --help`.")] = "stream"
    camera: Annotated[str, sim_options.CAMERA.described("Simulated camera; see `sim --help`.")] = "fast"
    camera_errors: Annotated[str | None, sim_options.CAMERA_ERRORS.unpanelled()] = None
    range_up_deg: Annotated[
        float | None, sim_options.RANGE_UP.described("Add a range finder that looks up; see `sim --help`.")
    ] = None
    flow: Annotated[bool, sim_options.FLOW.described("Add an optical flow sensor that looks down; see `sim --help`.")] = False
    views: Annotated[int | None, sim_options.VIEWS.described("View budget. Default: as `sim`.")] = None
    jobs: Annotated[int, JOBS] = 2
    json: Annotated[
        Path | None,
        CommandOption("Results file. Flights that it already contains are not repeated.", metavar="FILE"),
    ] = None
    truth: Annotated[
        bool, CommandOption("Also measure explored fraction and recall. Adds up to a minute for each new scene.")
    ] = False

    def __post_init__(self) -> None:
        """Check each value. Raises UsageError with one line."""
        low_m, high_m = RADIUS.limits or (0.0, 0.0)
        if not all(low_m <= radius_m <= high_m for radius_m in self.radii_m):
            raise UsageError(f"--radii {self.radii}: want {low_m} to {high_m} metres")
        if not set(self.variant_names) <= set(VARIANTS):
            raise UsageError(f"--variants {self.variants}: want some of {', '.join(VARIANTS)}")
        check_fields(self)
        for mount in self.mounts:
            check_mount(mount)
        camera_error_scale(self.camera_errors)
        check_jobs(self.jobs)
        for name in self.scene_names:
            _check_scene(name)

    @property
    def scene_names(self) -> tuple[str, ...]:
        """The scenes, in the order of their flights."""
        return tuple(self.scenes.split(","))

    @property
    def radii_m(self) -> tuple[float, ...]:
        """The radii of the vehicle in metres. Raises UsageError."""
        try:
            return tuple(float(word) for word in self.radii.split(","))
        except ValueError:
            raise UsageError(f"--radii {self.radii}: want numbers in metres, separated by commas") from None

    @property
    def variant_names(self) -> tuple[str, ...]:
        """The planner variants."""
        return tuple(self.variants.split(","))

    @property
    def mounts(self) -> tuple[str, ...]:
        """The camera mounts."""
        return tuple(self.mount.split(","))

    @property
    def autopilots(self) -> tuple[str, ...]:
        """The simulated autopilots."""
        return AUTOPILOTS if self.autopilot == BOTH else (self.autopilot,)


def _check_scene(name: str) -> None:
    """Check the name of a scene. Raises UsageError if there is none of that name."""
    from sitl.scene.scene import GENERATED, is_generated
    from sitl.scene.scene_kinds import KINDS

    with readable(f"--scenes {name}"):
        there = Path(name).exists()
    seed = name.partition(":")[2] if is_generated(name) else ""
    seeded = [word for word, kind in KINDS.items() if kind.number == "SEED"]  # another scene for each seed
    if not (name in (*seeded, BUILT_IN) or seed.isdecimal() or (name and there)):
        names = ", ".join((*seeded, GENERATED, BUILT_IN))
        raise UsageError(f"--scenes {name}: no such scene; want {names}, a folder or a mesh file")
