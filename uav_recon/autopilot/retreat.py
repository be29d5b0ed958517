"""The way back without a mission: where the vehicle has been, slowly, nose first."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose
from uav_recon.types.trajectory import Setpoint, Trajectory

IDENTIFIER = -2  # of the pilot's own trajectory; a mission counts from one

_APART_M = 0.2
_MOST = 5000  # a kilometre
_STEP_S = 0.05
_SMOOTH_S = 0.4  # width of each of two box averages: speed over width bounds the acceleration
_SHARE = 0.9  # of the speed allowed: what sampling adds
_TURNING = 2  # times slower until the nose points where it goes: over where it came from a moment ago
_TURN_RADPS = 0.7


class Breadcrumbs:
    """Places (odom, m) where the vehicle was in flight, and the way back along them."""

    def __init__(self) -> None:
        self._crumbs: list[FloatArray] = []

    def drop(self, odom_from_body: Pose) -> None:
        """Note where the vehicle is."""
        place, crumbs = odom_from_body.translation_m, self._crumbs
        if len(crumbs) < _MOST and (not crumbs or math.hypot(*(place - crumbs[-1]).tolist()) > _APART_M):
            crumbs.append(place)

    def forget(self) -> None:
        """Odom itself jumped: these places are others now."""
        self._crumbs.clear()

    def way_back(
        self, rest: Setpoint, height_m: float, start_s: float, speed_mps: float, map_epoch: int, nose_first: bool
    ) -> Trajectory:
        """From rest back to the first crumb at a height or above it, at rest there; just a hold if there is none.

        nose_first: turned to where it goes, so that depth sees the way; otherwise the heading is kept. Loops are cut out, and
        so is the part that an earlier way back has flown. Corners are rounded by two box averages, so place, velocity and
        heading stay continuous.
        """
        places = [rest.position_m, *self._from_the_pad(height_m)]
        corners, i = [], 0
        while i < len(places):
            corners.append(places[i])
            near = [j for j in range(i + 1, len(places)) if np.linalg.norm(places[j] - places[i]) <= 1.5 * _APART_M]
            i = near[-1] if near else i + 1
        return flown(np.array(corners), rest, start_s, speed_mps, map_epoch, nose_first, IDENTIFIER)

    def _from_the_pad(self, height_m: float) -> list[FloatArray]:
        """Newest first, without the climb."""
        climbed = next((n for n, crumb in enumerate(self._crumbs) if crumb[2] >= height_m), len(self._crumbs))
        return self._crumbs[climbed:][::-1]


def flown(
    corners: FloatArray, rest: Setpoint, start_s: float, most_mps: float, map_epoch: int, nose_first: bool, identifier: int
) -> Trajectory:
    """Corners (N, 3) a little below most_mps, slower while it turns towards the first leg, smoothed. It goes at once: who
    waits for the turn begins late.
    """
    speed_mps = _SHARE * most_mps
    along_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    samples_m = np.append(np.arange(0.0, along_m[-1], speed_mps * _STEP_S), along_m[-1])
    line = np.column_stack([np.interp(samples_m, along_m, corners[:, n]) for n in range(3)])
    bearings = _bearings(line, rest.yaw_rad) if nose_first else [rest.yaw_rad] * len(line)
    turning = int(abs(math.remainder(bearings[0] - rest.yaw_rad, math.tau)) / (_TURN_RADPS * _STEP_S))
    slow_m = np.arange(0.0, along_m[-1], speed_mps * _STEP_S / _TURNING)[:turning]
    if len(slow_m):
        samples_m = np.concatenate([slow_m, samples_m[samples_m > slow_m[-1]]])
        line = np.column_stack([np.interp(samples_m, along_m, corners[:, n]) for n in range(3)])
        bearings = _bearings(line, rest.yaw_rad)
    rows = np.column_stack([line, _followed(bearings, rest.yaw_rad)])
    box = round(_SMOOTH_S / _STEP_S)
    padded = np.vstack([np.repeat(rows[:1], 2 * box, axis=0), rows, np.repeat(rows[-1:], 2 * box, axis=0)])
    weights = np.convolve(np.ones(box) / box, np.ones(box) / box)
    smooth = np.column_stack([np.convolve(padded[:, n], weights, mode="valid") for n in range(4)])
    rate, change = np.zeros_like(smooth), np.zeros_like(smooth)
    rate[1:-1] = (smooth[2:] - smooth[:-2]) / (2 * _STEP_S)
    change[1:-1] = np.diff(smooth, 2, axis=0) / _STEP_S**2
    pitch = np.full(len(smooth), rest.camera_pitch_down_rad)
    return Trajectory(
        start_s, _STEP_S, smooth[:, :3], rate[:, :3], change[:, :3], smooth[:, 3], rate[:, 3], pitch, np.zeros(0),
        map_epoch, identifier,
    )  # fmt: skip


def _bearings(line: FloatArray, yaw_rad: float) -> list[float]:
    """Where each place of a line (M, 3) has the next; as before where the way is steep, or over."""
    out = []
    for x, y, z in np.diff(line, axis=0).tolist():
        yaw_rad = math.atan2(y, x) if math.hypot(x, y) > abs(z) else yaw_rad
        out.append(yaw_rad)
    return [*out, yaw_rad]


def _followed(bearings: list[float], yaw_rad: float) -> list[float]:
    """Headings after these bearings, unwrapped, turning no faster than _TURN_RADPS."""
    out, most_rad = [], _TURN_RADPS * _STEP_S
    for bearing in bearings:
        yaw_rad += min(max(math.remainder(bearing - yaw_rad, math.tau), -most_rad), most_rad)
        out.append(yaw_rad)
    return out
