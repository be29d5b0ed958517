"""The way back without a mission: where the vehicle has been, slowly, nose first."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose
from uav_recon.types.trajectory import Setpoint, Trajectory

IDENTIFIER = -2  # of the pilot's own trajectory; a mission counts from one

_APART_M = 0.2
_MAX = 5000  # a kilometre; beyond it the older half is forgotten
_LONGEST_S = 60.0  # of a way: a retreat ends in a landing after land_timeout_s, which is no longer than this
_STEP_S = 0.05
_SMOOTH_S = 0.4  # width of each of two box averages: speed over width bounds the acceleration
_SHARE = 0.9  # of the speed allowed: what sampling adds
_TURNING = 2  # times slower until the nose points where it goes: over where it came from a moment ago
_TURN_RADPS = 0.7


class Breadcrumbs:
    """Places (odom, m) where the vehicle was in flight, and the way back along them."""

    def __init__(self) -> None:
        self._places_m, self._count = np.empty((_MAX, 3)), 0  # oldest first

    def drop(self, odom_from_body: Pose) -> None:
        """Note where the vehicle is."""
        place_m, places_m, count = odom_from_body.translation_m, self._places_m, self._count
        if count and math.hypot(*(place_m - places_m[count - 1]).tolist()) <= _APART_M:
            return
        if count == _MAX:
            count = _MAX // 2
            places_m[:count] = places_m[_MAX - count :]
        places_m[count] = place_m
        self._count = count + 1

    def forget(self) -> None:
        """Odom itself jumped: these places are others now."""
        self._count = 0

    def way_back(
        self, rest: Setpoint, height_m: float, start_s: float, speed_mps: float, map_epoch: int, nose_first: bool
    ) -> Trajectory:
        """From rest back towards the first crumb at a height or above it, as far as can be flown before it lands, at rest
        there; just a hold if there is none.

        nose_first: turned to where it goes, so that depth sees the way; otherwise the heading is kept. Loops are cut out, and
        so is the part that an earlier way back has flown. Corners are rounded by two box averages, so place, velocity and
        heading stay continuous. It is made within a turn of the pilot's loop, so what it costs does not grow with the flight.
        """
        corners = self._corners(rest.position_m, height_m, _SHARE * speed_mps * _LONGEST_S)
        return flown(corners, rest, start_s, speed_mps, map_epoch, nose_first, IDENTIFIER)

    def _corners(self, place_m: FloatArray, height_m: float, max_m: float) -> FloatArray:
        """From a place (3,), newest first, without loops and without the climb, until they are max_m long: (N, 3)."""
        places_m = self._places_m[: self._count]
        high = places_m[:, 2] >= height_m
        places_m = places_m[int(np.argmax(high)) if high.any() else len(places_m) :]
        corners, left_m = [place_m], max_m
        while len(places_m) and left_m > 0.0:
            off_m = places_m - place_m
            near = np.einsum("ij,ij->i", off_m, off_m) <= (1.5 * _APART_M) ** 2
            oldest = int(np.argmax(near)) if near.any() else len(places_m) - 1
            left_m -= math.hypot(*off_m[oldest].tolist())
            place_m, places_m = places_m[oldest], places_m[:oldest]
            corners.append(place_m)
        return np.array(corners)


def flown(
    corners: FloatArray, rest: Setpoint, start_s: float, max_speed_mps: float, map_epoch: int, nose_first: bool, identifier: int
) -> Trajectory:
    """Corners (N, 3) a little below max_speed_mps, slower while it turns towards the first leg, smoothed. It goes at once: who
    waits for the turn begins late.
    """
    speed_mps = _SHARE * max_speed_mps
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
    out, max_rad = [], _TURN_RADPS * _STEP_S
    for bearing in bearings:
        yaw_rad += min(max(math.remainder(bearing - yaw_rad, math.tau), -max_rad), max_rad)
        out.append(yaw_rad)
    return out
