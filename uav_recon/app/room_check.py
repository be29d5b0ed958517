"""Mount that fits a room: `uav-recon check room`, and the default of the simulator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from uav_recon.app import config_file
from uav_recon.app.option_validation import UsageError, mount_pitch_deg
from uav_recon.config import CameraConfig, Config, PlannerConfig
from uav_recon.errors import EXIT_FAILURE
from uav_recon.planning.mount_visibility import MIN_IMPROVEMENT, TILTS_DEG, DepthView, RoomVisibility, Size, VisibleShares

_SIDES_M = (0.5, 100.0)
GIMBAL = "gimbal"


@dataclass(frozen=True, slots=True)
class MountAdvice:
    """Share of a room that a mount shows, and the recommended tilt with its share.

    tilt_deg: None for a gimbal.
    """

    tilt_deg: float | None
    share: float
    recommended_deg: float
    recommended_share: float

    @property
    def fits(self) -> bool:
        """Return True if no other tilt shows much more."""
        return self.recommended_share < self.share + MIN_IMPROVEMENT


def check_room(size: str, config: Path | None, mount: str | None, clearance_m: float | None) -> int:
    """Print the share of a room of size LxWxH that each tilt shows, and return the exit code.

    It is 1 if another tilt is recommended. mount and clearance_m override those of the config. Raises UsageError.
    """
    size_m, known = _size(size), None if config is None else config_file.load_config(config)
    camera, kept_m = _camera(known), clearance_m or (PlannerConfig() if known is None else known.planner).clearance_m
    tilt_deg = mount_pitch_deg(mount) if mount else None if camera.mount == GIMBAL else camera.pitch_down_deg
    try:
        sight = RoomVisibility(size_m, kept_m, _view(camera))
    except ValueError as error:
        raise UsageError(str(error)) from None
    console, advice = Console(), _advice(sight, tilt_deg)
    named = " x ".join(f"{length:g}" for length in size_m)
    console.print(f"room of {named} m, {kept_m:g} m kept from walls and ceiling; shares of what a gimbal sees", highlight=False)
    console.print(_table(sight, advice), highlight=False)
    console.print(advice_text(advice), highlight=False, soft_wrap=True)
    return 0 if advice.fits else EXIT_FAILURE


def advise(config: Config) -> MountAdvice | None:
    """Return the advice for the fence box and the camera of a config.

    None for a box without space to fly.
    """
    low_m, high_m = config.safety.fence_min_m, config.safety.fence_max_m
    size_m = (high_m[0] - low_m[0], high_m[1] - low_m[1], high_m[2] - low_m[2])
    camera = config.camera
    try:
        sight = RoomVisibility(size_m, config.planner.clearance_m, _view(camera))
    except ValueError:
        return None
    return _advice(sight, None if camera.mount == GIMBAL else camera.pitch_down_deg)


def advice_text(advice: MountAdvice) -> str:
    """Return the advice as one sentence."""
    if advice.tilt_deg is None:
        return "a gimbal sees all of it"
    seen = f"a tilt of {advice.tilt_deg:g}° shows {advice.share:.2f} of the room"
    if advice.fits:
        return f"{seen}: it fits"
    better = f"{advice.recommended_deg:g}° would show {advice.recommended_share:.2f}"
    return f"{seen}, {better}: set camera.pitch_down_deg = {advice.recommended_deg:g}, or use a gimbal"


def _advice(sight: RoomVisibility, tilt_deg: float | None) -> MountAdvice:
    best_deg = sight.recommended_deg()
    share = 1.0 if tilt_deg is None else sight.shares(math.radians(tilt_deg)).room
    return MountAdvice(tilt_deg, share, best_deg, sight.shares(math.radians(best_deg)).room)


def _table(sight: RoomVisibility, advice: MountAdvice) -> Table:
    table = Table("mount", "room", "floor", "walls", "ceiling", "", box=None)
    tilts = sorted({*TILTS_DEG, *(() if advice.tilt_deg is None else (advice.tilt_deg,))}, reverse=True)
    for tilt_deg in tilts:
        named = {"this mount": tilt_deg == advice.tilt_deg, "recommended": _is_best(tilt_deg, advice)}
        notes = ", ".join(note for note, holds in named.items() if holds)
        table.add_row(f"fixed:{tilt_deg:g}", *_figures(sight.shares(math.radians(tilt_deg))), notes)
    table.add_row(GIMBAL, *_figures(VisibleShares(1.0, 1.0, 1.0, 1.0)), "this mount" if advice.tilt_deg is None else "")
    return table


def _is_best(tilt_deg: float, advice: MountAdvice) -> bool:
    return tilt_deg == (advice.tilt_deg if advice.fits and advice.tilt_deg is not None else advice.recommended_deg)


def _figures(shares: VisibleShares) -> tuple[str, ...]:
    return tuple(f"{share:.2f}" for share in (shares.room, shares.floor, shares.walls, shares.ceiling))


def _camera(config: Config | None) -> CameraConfig:
    return CameraConfig() if config is None else config.camera


def _view(camera: CameraConfig) -> DepthView:
    return DepthView(
        vertical_fov_rad=math.radians(camera.vertical_fov_deg), near_m=camera.depth_min_m, ahead_m=camera.position_body_m[0]
    )


def _size(text: str) -> Size:
    try:
        sides = tuple(float(word) for word in text.replace("×", "x").split("x"))
    except ValueError:
        sides = ()
    if len(sides) != 3 or not all(_SIDES_M[0] <= side <= _SIDES_M[1] for side in sides):
        raise UsageError(f"SIZE {text}: want length x width x height in metres, such as 4x3x2.5, each {_SIDES_M[0]:g} to 100")
    return sides[0], sides[1], sides[2]
