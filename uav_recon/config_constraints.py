"""Constraints between the numbers of a config that a check of each single key cannot find."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any, NamedTuple

_HOLDS: dict[str, Callable[[float, float], bool]] = {
    "at most": lambda value, limit: value <= limit,
    "less than": lambda value, limit: value < limit,
    "at least": lambda value, limit: value >= limit,
}


MAX_VOXELS = 30e6  # a channel of 64 MB takes 33 million


class Constraint(NamedTuple):
    """A relation between a key and a limit.

    key: dotted name of the constrained key.
    must_be: key of _HOLDS, for example "at most".
    limit: the limit as text.
    of: computes the limit from the config.
    rounding: tolerance for the rounding of floating-point sums.
    """

    key: str
    must_be: str
    limit: str
    of: Callable[[Any], float]
    rounding: float = 0.0


def _volume_m3(config: Any) -> float:
    """Return the volume of the mapped box, in cubic metres."""
    safety, around_m = config.safety, 2.0 * config.voxels.margin_m
    x, y, z = (high - low + around_m for low, high in zip(safety.fence_min_m, safety.fence_max_m, strict=True))
    return float(x * y * z)


def _to(key: str, must_be: str, limit: str) -> Constraint:
    return Constraint(key, must_be, limit, attrgetter(limit))


CONSTRAINTS = (
    _to("motion.speed_mps", "at most", "safety.max_speed_mps"),
    _to("motion.tight_speed_mps", "at most", "safety.max_speed_mps"),
    _to("motion.climb_mps", "at most", "safety.max_speed_mps"),
    _to("motion.descent_mps", "at most", "safety.max_speed_mps"),
    _to("motion.acceleration_mps2", "at most", "safety.max_acceleration_mps2"),
    _to("motion.yaw_rate_degps", "at most", "safety.max_yaw_rate_degps"),
    _to("safety.vehicle_radius_m", "at most", "safety.fence_inset_m"),  # otherwise the hull could leave the fence
    _to("voxels.takeoff_radius_m", "at least", "safety.vehicle_radius_m"),  # the hull must fit into the cylinder declared free
    Constraint(
        "planner.clearance_m",  # otherwise the guard would stop planned motion
        "at least",
        "safety.vehicle_radius_m + safety.stop_clearance_m",
        lambda c: c.safety.vehicle_radius_m + c.safety.stop_clearance_m,
        rounding=1e-9,
    ),
    _to("voxels.distance_cap_m", "at least", "planner.clearance_m"),  # otherwise no position would be known to be clear
    Constraint(
        "mission.takeoff_height_m",
        "at most",
        "safety.fence_max_m.2 - safety.fence_inset_m",
        lambda c: c.safety.fence_max_m[2] - c.safety.fence_inset_m,
        rounding=1e-9,
    ),
    Constraint(
        "mission.takeoff_height_m",
        "at least",
        "safety.fence_min_m.2 + safety.fence_inset_m",
        lambda c: c.safety.fence_min_m[2] + c.safety.fence_inset_m,
        rounding=1e-9,
    ),
    Constraint(
        "voxels.resolution_m",  # otherwise the map would fit neither into memory nor into the channels
        "at least",
        "the edge of 30 million voxels from safety.fence_min_m to safety.fence_max_m with voxels.margin_m around",
        lambda c: (_volume_m3(c) / MAX_VOXELS) ** (1 / 3),
        rounding=1e-9,
    ),
    _to("camera.depth_min_m", "less than", "camera.depth_max_m"),
    _to("camera.depth_min_m", "less than", "voxels.max_range_m"),  # otherwise no depth would mark a voxel occupied
    _to("localization.frame_wait_s", "less than", "safety.depth_timeout_s"),  # otherwise depth would be too old when it arrives
    Constraint(
        "localization.rate_hz",  # otherwise each pose would be too old before the next one
        "at least",
        "1 / safety.pose_timeout_s",
        lambda c: 1.0 / c.safety.pose_timeout_s,
        rounding=1e-9,
    ),
)
# checked only if both keys are in the file: the preset gives missing ones
EXPLICIT_KEY_CONSTRAINTS = (_to("planner.shell_min_m", "less than", "planner.shell_max_m"),)


class Requirement(NamedTuple):
    """A condition between settings: a test that returns True if it is violated, and the message."""

    broken: Callable[[Any], bool]
    words: str


REQUIREMENTS = (
    Requirement(
        lambda c: c.link.signing_key is not None and c.link.autopilot == "px4",
        "link.signing_key: signs with link.autopilot ardupilot; PX4 has no signing before 1.18",
    ),
    Requirement(
        lambda c: c.link.url.startswith("udp:") and not c.link.url.startswith("udp:127.") and c.link.peer_host is None,
        "link.peer_host: must name who may speak where link.url listens on a network; without it only udp:127.x is heard",
    ),
    Requirement(
        lambda c: c.camera.source == "recorded" and c.camera.recording is None,
        "camera.recording: must name a flight folder where camera.source is recorded",
    ),
    Requirement(
        lambda c: c.camera.source == "recorded" and c.localization.source not in ("stream", "slam"),
        "localization.source: must be stream (the poses of the recording) or slam where camera.source is recorded",
    ),
    Requirement(
        lambda c: c.recording.live and not c.recording.rerun,
        "recording.live: true wants recording.rerun true",
    ),
)


def first_violation(config: Any) -> str:
    """Return the first violated constraint as one line, or '' if there is none.

    The line names key, value and allowed range. config: the whole tree.
    """
    for key, must_be, limit, of, rounding in (*CONSTRAINTS, *(r for r in EXPLICIT_KEY_CONSTRAINTS if _written(config, r))):
        value, most = attrgetter(key)(config), of(config)
        slack = -rounding if must_be == "at least" else rounding
        if not _HOLDS[must_be](value, most + slack):
            return f"{key} {value:g} must be {must_be} {limit}, which is {most:g}"
    return next((need.words for need in REQUIREMENTS if need.broken(config)), "")


def _written(config: Any, relation: Constraint) -> bool:
    """Return True if both keys are in the file."""
    return all(key.split(".")[1] in config.planner.model_fields_set for key in (relation.key, relation.limit))
