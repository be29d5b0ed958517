"""Retreat without a mission: slowly along the breadcrumbs of the flight, nose first."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose
from uav_recon.types.trajectory import Setpoint, Trajectory

IDENTIFIER = -2  # identifier of the pilot's own trajectory; a mission counts from one

_APART_M = 0.2  #: internal: distance between breadcrumbs
_MAX = 5000  #: internal: stored breadcrumbs, a kilometre; beyond it the older half is dropped
_LONGEST_S = 60.0  #: retreat: longest path: a retreat ends in a landing after land_timeout_s, which is not longer than this
STEP_S = 0.05  #: internal: interval of the samples of a path back
_SMOOTH_S = 0.4  #: retreat: width of each of two box averages over a path back: speed over width bounds the acceleration
_SHARE = 0.9  # share of the allowed speed: sampling adds the rest
_TURNING = 2  #: retreat: slower by this factor until the nose points ahead: until then it flies where it has just been
_TURN_RADPS = 0.7  #: retreat: yaw rate with which the nose turns ahead


class Breadcrumbs:
    """Positions (odom, m) of the vehicle in flight, and the path back along them."""

    def __init__(self) -> None:
        # oldest first
        self._places_m = np.empty((_MAX, 3))
        self._count = 0

    def drop(self, odom_from_body: Pose) -> None:
        """Record the vehicle's position."""
        place_m, places_m, count = odom_from_body.translation_m, self._places_m, self._count
        if count and math.hypot(*(place_m - places_m[count - 1]).tolist()) <= _APART_M:
            return
        if count == _MAX:
            count = _MAX // 2
            places_m[:count] = places_m[_MAX - count :]
        places_m[count] = place_m
        self._count = count + 1

    def forget(self) -> None:
        """Forget all positions after a jump of odom."""
        self._count = 0

    def way_back(
        self, rest: Setpoint, height_m: float, start_s: float, speed_mps: float, map_epoch: int, nose_first: bool
    ) -> Trajectory:
        """Return a trajectory from rest back towards the first crumb at a height or above it.

        It covers the part that can be flown before the landing, and ends at rest; it is a hold if there is no crumb.

        nose_first: turn into the direction of flight, so that depth sees the path; otherwise the heading is kept. Loops are cut
        out, and so is the part that an earlier path back has flown. Corners are rounded by two box averages, so position,
        velocity and heading are continuous. It is computed within a step of the pilot's loop, so its cost does not grow with
        the flight.
        """
        corners = self._corners(rest.position_m, height_m, _SHARE * speed_mps * _LONGEST_S)
        return flown(corners, rest, start_s, speed_mps, map_epoch, nose_first, IDENTIFIER)

    def _corners(self, place_m: FloatArray, height_m: float, max_m: float) -> FloatArray:
        """Return corners (N, 3) from a position (3,), newest first, without loops and the climb.

        They end at a length of max_m.
        """
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
    """Return a smoothed trajectory along corners (N, 3) at a little below max_speed_mps.

    It is slower while it turns towards the first leg. It starts at once: waiting for the turn would delay it.
    """
    speed_mps = _SHARE * max_speed_mps
    along_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    samples_m = np.append(np.arange(0.0, along_m[-1], speed_mps * STEP_S), along_m[-1])
    line = np.column_stack([np.interp(samples_m, along_m, corners[:, n]) for n in range(3)])
    bearings = _bearings(line, rest.yaw_rad) if nose_first else [rest.yaw_rad] * len(line)
    turning = int(abs(math.remainder(bearings[0] - rest.yaw_rad, math.tau)) / (_TURN_RADPS * STEP_S))
    slow_m = np.arange(0.0, along_m[-1], speed_mps * STEP_S / _TURNING)[:turning]
    if len(slow_m):
        samples_m = np.concatenate([slow_m, samples_m[samples_m > slow_m[-1]]])
        line = np.column_stack([np.interp(samples_m, along_m, corners[:, n]) for n in range(3)])
        bearings = _bearings(line, rest.yaw_rad)
    return smoothed(np.column_stack([line, _followed(bearings, rest.yaw_rad)]), rest, start_s, map_epoch, identifier)


def smoothed(
    rows: FloatArray,
    rest: Setpoint,
    start_s: float,
    map_epoch: int,
    identifier: int,
    turn_smooth_s: float = _SMOOTH_S,
    smooth_s: float = _SMOOTH_S,
) -> Trajectory:
    """Return a trajectory that begins and ends at rest, with its corners rounded.

    rows (M, 4): positions and unwrapped headings, STEP_S apart. smooth_s: time over which corners are rounded.
    turn_smooth_s: the same of the headings, no more; with less they lead the positions.
    """
    box, turn_box = round(smooth_s / STEP_S), round(turn_smooth_s / STEP_S)
    padded = np.vstack([np.repeat(rows[:1], 2 * box, axis=0), rows, np.repeat(rows[-1:], 2 * box, axis=0)])
    weights = [_rounding(box)] * 3 + [np.pad(_rounding(turn_box), (0, 2 * (box - turn_box)))]
    smooth = np.column_stack([np.convolve(padded[:, n], weights[n], mode="valid") for n in range(4)])
    rate, change = np.zeros_like(smooth), np.zeros_like(smooth)
    rate[1:-1] = (smooth[2:] - smooth[:-2]) / (2 * STEP_S)
    change[1:-1] = np.diff(smooth, 2, axis=0) / STEP_S**2
    pitch = np.full(len(smooth), rest.camera_pitch_down_rad)
    return Trajectory(
        start_s, STEP_S, smooth[:, :3], rate[:, :3], change[:, :3], smooth[:, 3], rate[:, 3], pitch, np.zeros(0),
        map_epoch, identifier,
    )  # fmt: skip


def _rounding(box: int) -> FloatArray:
    """Return the weights (2 box - 1,) of two averages over box samples."""
    return np.convolve(np.ones(box) / box, np.ones(box) / box)


def _bearings(line: FloatArray, yaw_rad: float) -> list[float]:
    """Return the bearing from each position of a line (M, 3) to the next.

    It is the one before where the path is steep, or at its end.
    """
    out = []
    for x, y, z in np.diff(line, axis=0).tolist():
        yaw_rad = math.atan2(y, x) if math.hypot(x, y) > abs(z) else yaw_rad
        out.append(yaw_rad)
    return [*out, yaw_rad]


def _followed(bearings: list[float], yaw_rad: float) -> list[float]:
    """Return headings that follow these bearings, unwrapped, no faster than _TURN_RADPS."""
    out, max_rad = [], _TURN_RADPS * STEP_S
    for bearing in bearings:
        yaw_rad += min(max(math.remainder(bearing - yaw_rad, math.tau), -max_rad), max_rad)
        out.append(yaw_rad)
    return out
