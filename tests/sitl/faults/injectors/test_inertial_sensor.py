"""Faults of the inertial sensor, alone and through the fault stream."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sitl.faults.fault import Fault
from sitl.faults.fault_director import FaultDirector
from sitl.faults.injectors.base import Injector, StreamedImuSample
from sitl.faults.injectors.delayed import Delayed
from sitl.faults.injectors.inertial_sensor import (
    AlteredImu,
    FrozenImu,
    ImuSilence,
    offset_force,
    scaled_force,
    vibration,
)
from sitl.faults.mavlink_proxy import DelayedItems


class Written:
    """Camera stream that keeps the inertial samples."""

    def __init__(self) -> None:
        self.samples: list[StreamedImuSample] = []

    def write_imu(self, stamp_s: float, gyro_radps: NDArray[np.float64], specific_force_mps2: NDArray[np.float64]) -> None:
        self.samples.append(StreamedImuSample(stamp_s, gyro_radps, specific_force_mps2))


def sample(stamp_s: float = 10.0) -> StreamedImuSample:
    return StreamedImuSample(stamp_s, np.array([0.1, 0.2, stamp_s]), np.array([1.0, 0.0, 9.8]))


def one(injector: Injector, since_s: float, stamp_s: float = 10.0) -> StreamedImuSample:
    late = injector.imu(since_s, sample(stamp_s))
    assert len(late) == 1
    assert late[0][0] == 0.0
    return late[0][1]


def test_samples_stop_and_come_back() -> None:
    silence = ImuSilence(0.5)
    assert silence.imu(0.4, sample()) == []
    assert len(silence.imu(0.6, sample())) == 1


def test_force_is_scaled_and_offset_while_the_fault_lasts() -> None:
    scaled = AlteredImu(scaled_force(0.5), from_s=1.0, for_s=2.0)
    np.testing.assert_allclose(one(scaled, 0.9).specific_force_mps2, [1.0, 0.0, 9.8])
    np.testing.assert_allclose(one(scaled, 1.0).specific_force_mps2, [0.5, 0.0, 4.9])
    np.testing.assert_allclose(one(scaled, 3.1).specific_force_mps2, [1.0, 0.0, 9.8])
    off = AlteredImu(offset_force(x=2.0, z=-1.0))
    np.testing.assert_allclose(one(off, 5.0).specific_force_mps2, [3.0, 0.0, 8.8])
    np.testing.assert_allclose(one(off, 5.0).gyro_radps, [0.1, 0.2, 10.0])


@pytest.mark.parametrize(("gyro", "accelerometer"), [(True, True), (True, False), (False, True)])
def test_frozen_sensors_repeat_their_first_values(gyro: bool, accelerometer: bool) -> None:
    frozen = FrozenImu(gyro, accelerometer)
    one(frozen, 0.0, stamp_s=10.0)
    moved = StreamedImuSample(11.0, np.array([0.5, 0.5, 0.5]), np.array([2.0, 2.0, 2.0]))
    ((_, later),) = frozen.imu(1.0, moved)
    assert later.stamp_s == 11.0
    assert (later.gyro_radps[2] == 10.0) == gyro
    assert (later.specific_force_mps2[2] == 9.8) == accelerometer


def test_vibration_is_white_with_the_given_sigma() -> None:
    shaking = AlteredImu(vibration(3.0))
    forces = np.array([one(shaking, 0.0).specific_force_mps2 for _ in range(2000)])
    np.testing.assert_allclose(forces.std(axis=0), 3.0, rtol=0.1)
    np.testing.assert_allclose(forces.mean(axis=0), [1.0, 0.0, 9.8], atol=0.3)


class Slow(Injector):
    """Fault that delays each sample by 0.1 s."""

    def imu(self, since_s: float, sample: StreamedImuSample) -> DelayedItems[StreamedImuSample]:
        return [(0.1, sample)]


def faulty_stream(injector: Injector) -> tuple[FaultDirector, Any, Written]:
    """A fault director whose fault has begun, its stream, and what reaches the writer."""
    written = Written()
    world: Any = SimpleNamespace(stream=written)
    director = FaultDirector([Fault("B1", [injector])], seed=1)
    director.enter(world, None, 0.0)
    director._begin_fault(director._faults[0], 0.0)
    return director, world.stream, written


def test_the_stream_passes_drops_and_delays_inertial_samples() -> None:
    _, stream, written = faulty_stream(Injector())
    stream.write_imu(1.0, np.zeros(3), np.ones(3))
    assert [each.stamp_s for each in written.samples] == [1.0]
    _, stream, written = faulty_stream(Delayed(ImuSilence(), 5.0, "silent"))
    stream.write_imu(1.0, np.zeros(3), np.ones(3))
    assert len(written.samples) == 1
    _, stream, written = faulty_stream(ImuSilence())
    stream.write_imu(1.0, np.zeros(3), np.ones(3))
    assert written.samples == []
    director, stream, written = faulty_stream(Slow())
    stream.write_imu(1.0, np.zeros(3), np.ones(3))
    assert written.samples == []
    director.context.now_s = 0.2
    stream.release(0.2)
    assert [each.stamp_s for each in written.samples] == [1.0]
