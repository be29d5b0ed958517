"""Options of the commands that read a recording."""

from __future__ import annotations

import math

from uav_recon.app.option_validation import UsageError
from uav_recon.sensors.recordings.bag_messages import BagTopics
from uav_recon.sensors.recordings.detection import ReadOptions

MAX_DEPTH_M = 20.0
DEPTH_UNIT_M = (0.00001, 1.0)  # metres a unit of a depth image: of 16 bits at 0.65 m, and of float in metres


def topics(depth: str | None, colour: str | None, pose: str | None, imu: str | None, pose_of: str) -> BagTopics:
    """Return the topics that the user names. Raises UsageError."""
    if pose_of not in ("camera", "body"):
        raise UsageError(f"--pose-of {pose_of}: want camera or body")
    return BagTopics(depth, colour, pose, imu, pose_of)


def read_options(
    depth_range_m: tuple[float, float], intrinsics: str | None, named: BagTopics, depth_unit_m: float | None = None
) -> ReadOptions:
    """Return the options of the reader. Raises UsageError."""
    low_m, high_m = depth_range_m
    if not 0.0 < low_m < high_m <= MAX_DEPTH_M:
        raise UsageError(f"--depth-range {low_m:g} {high_m:g}: want 0 < MIN < MAX <= {MAX_DEPTH_M:g} metres")
    require_depth_unit(depth_unit_m)
    if intrinsics is None:
        return ReadOptions(low_m, high_m, None, named, depth_unit_m)
    try:
        fx, fy, cx, cy = (float(word) for word in intrinsics.split(","))
    except ValueError:
        raise UsageError(f"--intrinsics {intrinsics}: want four numbers FX,FY,CX,CY in pixels") from None
    if not (all(map(math.isfinite, (fx, fy, cx, cy))) and fx > 0 and fy > 0):
        raise UsageError(f"--intrinsics {intrinsics}: FX and FY must be positive")
    return ReadOptions(low_m, high_m, (fx, fy, cx, cy), named, depth_unit_m)


def require_depth_unit(depth_unit_m: float | None) -> None:
    """Raise UsageError for a depth unit outside the range; None is the unit of the format."""
    low_m, high_m = DEPTH_UNIT_M
    if depth_unit_m is not None and not low_m <= depth_unit_m <= high_m:
        raise UsageError(f"--depth-unit {depth_unit_m:g}: want {low_m:.5f} to {high_m:g} metres per unit of the depth images")
