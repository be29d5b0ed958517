"""Status of the flight for an operator: a few lines of text, or JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from uav_recon import json_codec
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.pose import StampedPose
from uav_recon.types.reason import codes_of, text_of
from uav_recon.types.vehicle import FlightPhase, MissionProgress, VehicleState


@dataclass(frozen=True, slots=True)
class Status:
    """Status of the flight.

    None: not known. Ages in seconds; position in the world frame, metres.

    pilot: its phase; mission: its phase, or "silent". note: the pilot's newest reason as text, or what the mission waits for on
    the ground, note_codes: its codes; refusals: number of proposals that the guard has rejected. max_speed_mps: reduced speed
    limit, None if it is not reduced; slow_reason: why as text, slow_codes: its codes. perception: what perception has rejected,
    counts by reason; perception_newest, perception_newest_s: the newest rejected depth frame and its age. origin:
    where the take-off pad is, if not at the pose source's origin, or that it is awaited. camera: its streams, and what is wrong
    with it, as texts; camera_codes: their codes. calibration: whether the errors of the camera began from those of an earlier
    flight. correction: of the odometry, for a drift of the pose source. earlier_map: where this flight began in the map of an
    earlier one, or that it was not found there.
    """

    pilot: str
    mission: str
    mode: str | None = None
    armed: bool | None = None
    battery: float | None = None
    position_m: tuple[float, float, float] | None = None
    pose_quality: int | None = None
    pose_age_s: float | None = None
    views: int | None = None
    views_budget: int | None = None
    explored_m3: float | None = None
    path_m: float | None = None
    refusals: int | None = None
    note: str = ""
    note_codes: tuple[str, ...] = ()
    max_speed_mps: float | None = None
    slow_reason: str = ""
    slow_codes: tuple[str, ...] = ()
    perception: Mapping[str, int] = field(default_factory=dict)
    perception_newest: str = ""
    perception_newest_s: float | None = None
    origin: str = ""
    camera: tuple[str, ...] = ()
    camera_codes: tuple[str, ...] = ()
    calibration: str = ""
    correction: str = ""
    earlier_map: str = ""

    @staticmethod
    def of(
        now_s: float,
        vehicle: VehicleState | None,
        pose: StampedPose | None,
        progress: MissionProgress | None,
        mission_receives: bool,
        perception: PerceptionStatus | None = None,
    ) -> Status:
        """Return the status from the newest value of each channel.

        Numbers that are not finite count as not known.
        """
        if vehicle is None:
            return Status("starting", "silent")
        x, y, z = (_finite(v, 2) for v in vehicle.world_from_body.translation_m.tolist())
        mission, mode_known = progress if mission_receives else None, bool(vehicle.mode)
        note = vehicle.note or (mission.note if mission is not None and vehicle.phase is FlightPhase.READY else None)
        return Status(
            pilot=vehicle.phase.value,
            mission=mission.phase if mission is not None else "starting" if mission_receives else "silent",
            mode=vehicle.mode if mode_known else None,
            armed=vehicle.armed if mode_known else None,
            battery=_finite(vehicle.battery_fraction, 2),
            position_m=None if pose is None or x is None or y is None or z is None else (x, y, z),
            pose_quality=None if pose is None else pose.quality,
            pose_age_s=None if pose is None else _finite(now_s - pose.stamp_s, 2),
            views=None if mission is None else mission.views,
            views_budget=None if mission is None else mission.views_budget,
            explored_m3=None if mission is None else _finite(mission.explored_m3, 1),
            path_m=None if mission is None else _finite(mission.path_length_m, 1),
            refusals=vehicle.refusals,
            note=text_of(note),
            note_codes=codes_of(note),
            max_speed_mps=_finite(vehicle.max_speed_mps, 2),
            slow_reason=text_of(vehicle.slow_reason),
            slow_codes=codes_of(vehicle.slow_reason),
            perception={} if perception is None else perception.counts(),
            perception_newest="" if perception is None else text_of(perception.newest),
            perception_newest_s=None if perception is None else _finite(now_s - perception.newest_s, 1),
            origin="" if perception is None else text_of(perception.origin),
            camera=() if perception is None else tuple(text_of(reason) for reason in perception.camera),
            camera_codes=() if perception is None else tuple(reason.code.value for reason in perception.camera),
            calibration="" if perception is None else text_of(perception.kept),
            correction="" if perception is None else text_of(perception.correction),
            earlier_map="" if perception is None else text_of(perception.earlier_map),
        )

    @staticmethod
    def from_json(tree: Any) -> Status:
        """Return the status from the output of as_json. Raises ValueError for anything else."""
        try:
            return json_codec.from_tree(Status, tree)
        except ValueError as error:
            raise ValueError(f"not a status: {error}") from None

    def as_json(self) -> dict[str, Any]:
        """Return the status as a dict for a line of JSON."""
        return dict(json_codec.to_tree(self))

    def lines(self) -> list[str]:
        """Return the status as lines for a person."""
        known = {
            "pilot": self.pilot,
            "mission": self.mission,
            "mode": None if self.mode is None else f"{self.mode}, {'ARMED' if self.armed else 'disarmed'}",
            "battery": None if self.battery is None else f"{self.battery:.0%}",
            "position": None if self.position_m is None else "x {:.2f}  y {:.2f}  z {:.2f} m".format(*self.position_m),
            "pose": None if self.pose_quality is None else f"quality {self.pose_quality}, {_age(self.pose_age_s)} old",
            "views": None if self.views is None else f"{self.views} of {self.views_budget}",
            "explored": None if self.explored_m3 is None else f"{self.explored_m3:.1f} m³ on {self.path_m or 0.0:.1f} m",
            "speed": None if self.max_speed_mps is None else f"at most {self.max_speed_mps:.2f} m/s: {self.slow_reason}",
            "refused": f"{self.refusals} by the guard" if self.refusals else None,
            "note": self.note or None,
            "origin": self.origin or None,
            "calibr.": self.calibration or None,
            "corrected": self.correction or None,
            "flown map": self.earlier_map or None,
            "rejected": self._rejected(),
        }
        lines = [f"{name:9} {value if value is not None else '-'}" for name, value in known.items()]
        return [*lines, *(f"{'camera':9} {text.removeprefix('camera ').removeprefix('streams: ')}" for text in self.camera)]

    def _rejected(self) -> str | None:
        """Return what perception rejected, most frequent first; None for nothing."""
        counts = sorted(self.perception.items(), key=lambda item: (-item[1], item[0]))
        newest = f"; newest {self.perception_newest_s:.0f} s ago: {self.perception_newest}" if self.perception_newest else ""
        return "perception: " + ", ".join(f"{count} {name}" for name, count in counts) + newest if counts else None


def _age(age_s: float | None) -> str:
    return "?" if age_s is None else f"{age_s:.2f} s"


def _finite(value: float, digits: int) -> float | None:
    return round(value, digits) if math.isfinite(value) else None
