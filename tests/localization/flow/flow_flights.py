"""Flights over a floor with a table, and what a flow sensor, a range finder and a gyro measure there.

Nothing here is shared with the product: the path is given in closed form, turns are differences of attitudes, and flow is the
mean over the rays of an image of what each point below moves against the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from uav_recon.types.flow import FlowReadings
from uav_recon.types.pose import Pose

Array = NDArray[np.float64]
FINE_S = 0.002
GRAVITY = 9.81


def lively(t: Array) -> Array:
    """Positions (N, 3) of a path that starts, stops and turns: up to 0.7 m/s, 1.2 m up."""
    x = 0.9 * np.sin(0.7 * t) + 0.15 * np.sin(1.9 * t)
    y = 0.7 * np.sin(0.5 * t + 1.0) + 0.12 * np.sin(2.3 * t)
    return np.stack([x, y, 1.2 + 0.2 * np.sin(0.4 * t)], axis=1)


def straight(t: Array) -> Array:
    """Positions (N, 3) of a path along x with 0.4 m/s, 1.2 m up."""
    return np.stack([0.4 * t, 0.05 * np.sin(t), np.full_like(t, 1.2)], axis=1)


def still(t: Array) -> Array:
    """Positions (N, 3) of a body that stays 1.2 m above the floor."""
    return np.tile([0.0, 0.0, 1.2], (len(t), 1))


@dataclass
class Flight:
    """A flight and its sensors; every error is chosen by the test.

    edge_m: from this x on there is a table of table_m. tilt, yaw: extra angles in rad over time. image_rad: half angle of the
    flow sensor's image.
    """

    path: Callable[[Array], Array] = lively
    duration_s: float = 20.0
    rate_hz: float = 15.0
    scale: float = 1.0
    delay_s: float = 0.0
    noise_mps: float = 0.0
    bias_mps: float = 0.0
    flow_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    range_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    range_noise_m: float = 0.0
    edge_m: float = math.inf
    table_m: float = 0.0
    image_rad: float = 0.0
    tilt: Callable[[Array], Array] = lambda t: np.zeros((len(t), 2))
    yaw: Callable[[Array], Array] = lambda t: 0.3 * np.sin(0.6 * t)
    own_gyro: bool = True
    gyro_bias_radps: float = 0.0
    quality: float = 0.8
    seed: int = 1
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    def positions(self, t: Array) -> Array:
        return self.path(t)

    def attitudes(self, t: Array) -> Rotation:
        """The body leans into its acceleration, as a quadrotor does, and turns."""
        h = 1e-3
        acceleration = (self.path(t + h) - 2.0 * self.path(t) + self.path(t - h)) / h**2
        yaw, extra = self.yaw(t), self.tilt(t)
        forward = acceleration[:, 0] * np.cos(yaw) + acceleration[:, 1] * np.sin(yaw)
        left = -acceleration[:, 0] * np.sin(yaw) + acceleration[:, 1] * np.cos(yaw)
        pitch, roll = np.arctan(forward / GRAVITY) + extra[:, 1], -np.arctan(left / GRAVITY) + extra[:, 0]
        return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1))

    def pose(self, at_s: float) -> Pose:
        t = np.array([at_s])
        return Pose(self.attitudes(t).as_quat(scalar_first=True)[0], self.positions(t)[0])

    def turned(self, from_s: float, to_s: float) -> Array:
        """The camera's gyro."""
        pair = self.attitudes(np.array([from_s, to_s]))
        return np.asarray((pair[0].inv() * pair[1]).as_rotvec() + self.gyro_bias_radps * (to_s - from_s))

    def _distances(self, origins: Array, directions: Array) -> Array:
        """Ranges (N,) along rays: to the table where they meet its top, else to the floor."""
        floor = -origins[:, 2] / directions[:, 2]
        table = (self.table_m - origins[:, 2]) / directions[:, 2]
        on_table = origins[:, 0] + table * directions[:, 0] >= self.edge_m
        return np.where(on_table, table, floor)

    def _flow_radps(self, t: Array) -> Array:
        """Flow (N, 2) at instants: mean over the rays of the image, in body axes."""
        h = 1e-4
        before, now, after = self.attitudes(t - h), self.attitudes(t), self.attitudes(t + h)
        rate = (before.inv() * after).as_rotvec() / (2 * h)
        lever = np.array(self.flow_m)
        moved = self.positions(t + h) + after.apply(lever) - self.positions(t - h) - before.apply(lever)
        velocity = now.inv().apply(moved / (2 * h))
        origins = self.positions(t) + now.apply(lever)
        side = np.tan(self.image_rad) * np.array([-0.8, 0.0, 0.8]) if self.image_rad else np.zeros(1)
        nearness = np.zeros(len(t))
        for x in side:
            for y in side:
                ray = np.array([x, y, -1.0])
                nearness += 1.0 / (self._distances(origins, now.apply(ray)) * len(side) ** 2)
        return np.stack([rate[:, 0] + velocity[:, 1] * nearness, rate[:, 1] - velocity[:, 0] * nearness], axis=1)

    def readings(self, until_s: float | None = None) -> FlowReadings:
        """All readings up to an instant."""
        interval_s, end_s = 1.0 / self.rate_hz, self.duration_s if until_s is None else until_s
        ends: Array = np.arange(1, int(end_s * self.rate_hz), dtype=np.float64) * interval_s
        inner = (np.arange(round(interval_s / FINE_S)) + 0.5) / round(interval_s / FINE_S)
        fine = (ends[:, None] - interval_s + inner * interval_s).ravel()
        flow = self._flow_radps(fine).reshape(len(ends), -1, 2).mean(axis=1)
        height = self.positions(ends)[:, 2:3] - np.where(self.positions(ends)[:, :1] >= self.edge_m, self.table_m, 0.0)
        flow = self.scale * flow + (self._rng.normal(0.0, 1.0, flow.shape) * self.noise_mps + self.bias_mps) / height
        turns = np.array([self.turned(end - interval_s, end) for end in ends])
        down = self.attitudes(ends).apply([0.0, 0.0, -1.0])
        origins = self.positions(ends) + self.attitudes(ends).apply(self.range_m)
        ranges = self._distances(origins, down) + self._rng.normal(0.0, 1.0, len(ends)) * self.range_noise_m
        return FlowReadings(
            stamps_s=ends + self.delay_s,
            intervals_s=np.full(len(ends), interval_s),
            flow_rad=flow * interval_s,
            gyro_rad=turns if self.own_gyro else np.full((len(ends), 3), math.nan),
            quality=np.full(len(ends), self.quality),
            range_stamps_s=ends,
            ranges_m=ranges,
        )
