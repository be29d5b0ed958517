"""Faults of the inertial sensor: missing, scaled, offset or frozen samples, vibration."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from sitl.faults.injectors.base import Injector, StreamedImuSample
from sitl.faults.mavlink_proxy import DelayedItems

Change = Callable[[StreamedImuSample, np.random.Generator], StreamedImuSample]


class ImuSilence(Injector):
    """No inertial sample for a while."""

    def __init__(self, for_s: float = 1e9) -> None:
        self._for_s = for_s

    def imu(self, since_s: float, sample: StreamedImuSample) -> DelayedItems[StreamedImuSample]:
        """Drop the sample until for_s."""
        return [] if since_s < self._for_s else [(0.0, sample)]


class AlteredImu(Injector):
    """Wrong inertial values for a while; time stamps and order stay correct."""

    def __init__(self, change: Change, from_s: float = 0.0, for_s: float = 1e9) -> None:
        self._change = change
        self._from_s = from_s
        self._until_s = from_s + for_s
        self._rng = np.random.default_rng(7)

    def imu(self, since_s: float, sample: StreamedImuSample) -> DelayedItems[StreamedImuSample]:
        """Change the sample while the fault lasts."""
        acts = self._from_s <= since_s < self._until_s
        return [(0.0, self._change(sample, self._rng) if acts else sample)]


class FrozenImu(Injector):
    """Values of the first sample of the fault, repeated under new time stamps."""

    def __init__(self, gyro: bool = True, accelerometer: bool = True) -> None:
        self._gyro = gyro
        self._accelerometer = accelerometer
        self._kept: StreamedImuSample | None = None

    def imu(self, since_s: float, sample: StreamedImuSample) -> DelayedItems[StreamedImuSample]:
        """Replace the values of the sensors that are frozen."""
        self._kept = self._kept or sample
        gyro = self._kept if self._gyro else sample
        force = self._kept if self._accelerometer else sample
        return [(0.0, StreamedImuSample(sample.stamp_s, gyro.gyro_radps, force.specific_force_mps2))]


def scaled_force(factor: float) -> Change:
    """Return a change that scales the specific force, as a clipping accelerometer does."""
    return lambda sample, _: dataclasses.replace(sample, specific_force_mps2=sample.specific_force_mps2 * factor)


def offset_force(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Change:
    """Return a change that adds an offset to the specific force, in m/s^2, body axes."""
    offset = np.array([x, y, z])
    return lambda sample, _: dataclasses.replace(sample, specific_force_mps2=sample.specific_force_mps2 + offset)


def offset_gyro(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Change:
    """Return a change that adds an offset to the angular rate, in rad/s, body axes."""
    offset = np.array([x, y, z])
    return lambda sample, _: dataclasses.replace(sample, gyro_radps=sample.gyro_radps + offset)


def clipped_gyro(limit_degps: float) -> Change:
    """Return a change that clips each axis of the angular rate at plus and minus limit_degps."""
    limit = np.radians(limit_degps)
    return lambda sample, _: dataclasses.replace(sample, gyro_radps=np.clip(sample.gyro_radps, -limit, limit))


def vibration(sigma_mps2: float) -> Change:
    """Return a change that adds white noise to the specific force, per axis and sample."""

    def change(sample: StreamedImuSample, rng: np.random.Generator) -> StreamedImuSample:
        noise = rng.normal(0.0, sigma_mps2, 3)
        return dataclasses.replace(sample, specific_force_mps2=sample.specific_force_mps2 + noise)

    return change
