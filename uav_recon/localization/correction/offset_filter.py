"""Offset of odom against the map, apart from the errors of camera and tracker.

The tracker's pose of the body, in odom as both were on the pad, differs from odom's at the same instant by

    position:  c + s l + t x l + w        l: way from the pad
    attitude:  y z + t + u + R m          R: attitude in odom

c and y are the offset of odom and of its heading. The other side has errors, too: the map is too large by the share s (scale
of depth) and rotated by t (camera off its mount on the pad), the camera is rotated on the body by m, and the tracker has
wandered by w and u. A Kalman filter keeps them apart: c changes with time, at a rate of its own, w and u with the way
flown, the others hardly at all. While c is surely not zero, the others are no longer estimated.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

# elements of the state
OFFSET = slice(0, 3)  # m
YAW = 3  # rad
RATE = slice(4, 7)  # m/s
TURN = slice(7, 10)  # rad
MOUNT = slice(10, 13)  # rad
SCALE = 13
WANDER = slice(14, 17)  # m
WANDER_TURN = slice(17, 20)  # rad
WANDERED = np.arange(WANDER.start, WANDER_TURN.stop)
SIZE = 20

# standard deviations of an honest camera, its tracker and the poses
_MOUNT_RAD = math.radians(0.8)
_SCALE = 0.012
_START_M = 0.01  # of both on the pad
_LEVEL_RAD = math.radians(0.5)
_RATE_MPS = 0.05  # of the drift, and the time in which it changes
_RATE_S = 20.0
_OFFSET_M_S = 0.003  # change of the offset and the heading, per root second
_YAW_RAD_S = math.radians(0.1)
_WANDER_M = 0.03  # of the tracker before new surfaces, per root metre
_WANDER_RAD = math.radians(0.4)
_LEVER_M = 3.0  # a tracker that is off in attitude, which gyro and gravity show, is off in place by this per radian
_WAY_PER_RAD_M = 0.5  # a turn shows new surfaces as a way does
_FIXED_WALK = 1e-4  # per root second: tilt, mount, scale
_REVISIT_VARIANCE = np.array([0.03**2] * 3 + [math.radians(0.5) ** 2] * 3)  # of a registration to surfaces seen before
# of one comparison; those within some seconds are alike
_PLACE_M = 0.018  # where the view determines the place
_LEAST_SHARE = 0.03  # a smaller share of the view counts as this
_ATTITUDE_RAD = math.radians(2.0)
# the mean of the last squared innovations beyond which the source has begun to drift: then its rate may be anything
_DRIFTING = 5.0
_MEAN_OVER = 5
_NEW_RATE_MPS = 0.05
_SURE_SIGMAS = 3.0  # while the offset is surely not zero, the errors of the other side are not estimated by it
_LEAST_M = 1e-3  # of an offset, so that one on the pad is no surprise
_SURPRISE = 25.0  # squared innovation of a place; a larger one is a step of the tracker, since odom makes none


class OffsetFilter:
    """State (20,) and covariance (20, 20), from the pose of the body on the pad on.

    Not thread-safe. ``way_m``: that the body has flown, with its turns.
    """

    def __init__(self, odom_from_body: Pose, stamp_s: float) -> None:
        self._pad_m = odom_from_body.translation_m
        self._before = odom_from_body
        self._stamp_s = stamp_s
        self.way_m = 0.0
        self.state = np.zeros(SIZE)
        self._mean = 0.0
        sigma = np.zeros(SIZE)
        sigma[TURN] = math.hypot(_MOUNT_RAD, _LEVEL_RAD)
        sigma[MOUNT], sigma[SCALE], sigma[WANDER], sigma[RATE] = _MOUNT_RAD, _SCALE, _START_M, _RATE_MPS
        self.covariance = np.diag(sigma**2)

    def update(self, odom_from_body: Pose, tracked: Pose, determined: FloatArray, stamp_s: float) -> None:
        """Compare odom with the tracker's pose of the same instant.

        determined (3, 3): share of the tracker's place that its view has determined, in odom axes.
        """
        self._predict(odom_from_body, stamp_s)
        away_m = odom_from_body.translation_m - self._pad_m
        rows = np.zeros((6, SIZE))
        rows[:3, OFFSET] = rows[:3, WANDER] = np.eye(3)
        rows[:3, SCALE] = away_m
        rows[:3, TURN] = -_cross(away_m)
        rows[5, YAW] = 1.0
        rows[3:, TURN] = rows[3:, WANDER_TURN] = np.eye(3)
        rows[3:, MOUNT] = odom_from_body.rotation()
        turned = (tracked @ odom_from_body.inverse()).rotation_vector()
        off = np.concatenate((tracked.translation_m - odom_from_body.translation_m, turned)) - rows @ self.state
        noise = np.zeros((6, 6))
        noise[:3, :3], noise[3:, 3:] = _place_noise(determined), _ATTITUDE_RAD**2 * np.eye(3)
        spread = self._spread(rows, noise, off)
        gain = np.linalg.solve(spread, rows @ self.covariance).T
        if self._mean > _DRIFTING or self.surprise > _SURE_SIGMAS**2:
            gain[TURN] = gain[MOUNT] = gain[SCALE] = 0.0
        self.state = self.state + gain @ off
        kept = np.eye(SIZE) - gain @ rows
        self.covariance = kept @ self.covariance @ kept.T + gain @ noise @ gain.T

    def _spread(self, rows: FloatArray, noise: FloatArray, off: FloatArray) -> FloatArray:
        """Return the covariance (6, 6) of an innovation off (6,).

        A step of the tracker, or a new drift, is taken into the filter's covariance first.
        """
        spread = rows @ self.covariance @ rows.T + noise
        if _square(off, spread) > _SURPRISE:
            self.covariance[WANDER, WANDER] += np.outer(off[:3], off[:3])
            spread = rows @ self.covariance @ rows.T + noise
        self._mean += (min(_square(off, spread), _SURPRISE) - self._mean) / _MEAN_OVER
        if self._mean > _DRIFTING:
            self.covariance[RATE, RATE] += _NEW_RATE_MPS**2 * np.eye(3)
            spread = rows @ self.covariance @ rows.T + noise
        return np.asarray(spread)

    @property
    def wander(self) -> tuple[FloatArray, FloatArray]:
        """Return what the tracker has wandered (6,), place and turn, and the variances."""
        return self.state[WANDERED].copy(), np.diagonal(self.covariance)[WANDERED].copy()

    def revisit(self, wandered: FloatArray, variance: FloatArray) -> None:
        """Take the tracker's wander (6,) from when it first saw what it sees again.

        variance (6,): both as in wander.
        """
        turned = self.state[WANDER_TURN]
        off = np.repeat((_LEVER_M**2, 1.0), 3) * float(turned @ turned)
        for k, value, sure in zip(WANDERED, wandered, np.maximum(variance + _REVISIT_VARIANCE, off), strict=True):
            now = float(self.covariance[k, k])
            if now <= sure:
                continue
            gain = self.covariance[:, k] * (1.0 - sure / now) / now
            self.state = self.state + gain * (value - self.state[k])
            self.covariance = self.covariance - np.outer(gain, self.covariance[k, :])

    @property
    def surprise(self) -> float:
        """Square of the offset in standard deviations."""
        offset, spread = self.state[OFFSET], self.covariance[OFFSET, OFFSET] + _LEAST_M**2 * np.eye(3)
        return float(offset @ np.linalg.solve(spread, offset))

    def _predict(self, odom_from_body: Pose, stamp_s: float) -> None:
        step_s, self._stamp_s = max(stamp_s - self._stamp_s, 0.0), stamp_s
        moved = self._before.inverse() @ odom_from_body
        way_m = odom_from_body.translation_m - self._before.translation_m
        self._before = odom_from_body
        transition, noise = np.eye(SIZE), np.zeros(SIZE)
        transition[OFFSET, RATE] = step_s * np.eye(3)
        transition[OFFSET, YAW] = -way_m[1], way_m[0], 0.0  # a wrong heading shifts what follows
        transition[RATE, RATE] *= math.exp(-step_s / _RATE_S)
        fresh_m = float(np.linalg.norm(way_m)) + _WAY_PER_RAD_M * float(np.linalg.norm(moved.rotation_vector()))
        transition[WANDER, WANDER_TURN] = -_cross(way_m)
        self.way_m += fresh_m
        noise[OFFSET] = _OFFSET_M_S**2 * step_s
        noise[YAW] = _YAW_RAD_S**2 * step_s
        noise[RATE] = (1.0 - transition[4, 4] ** 2) * _RATE_MPS**2
        noise[WANDER] = _WANDER_M**2 * fresh_m
        noise[WANDER_TURN] = _WANDER_RAD**2 * fresh_m
        noise[TURN] = noise[MOUNT] = noise[SCALE] = _FIXED_WALK**2 * step_s
        self.state = transition @ self.state
        self.covariance = transition @ self.covariance @ transition.T + np.diag(noise)


def _square(off: FloatArray, spread: FloatArray) -> float:
    """Return the squared innovation of the place, in standard deviations."""
    return float(off[:3] @ np.linalg.solve(spread[:3, :3], off[:3]))


def _place_noise(determined: FloatArray) -> FloatArray:
    """Return the covariance (3, 3) of a comparison of places.

    Where the tracker follows odom, it says nothing of it.
    """
    shares, axes = np.linalg.eigh(determined)
    sigma_m = _PLACE_M / np.clip(shares, _LEAST_SHARE, 1.0) ** 2
    return np.asarray(axes @ np.diag(sigma_m**2) @ axes.T)


def _cross(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
