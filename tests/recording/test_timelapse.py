"""Surface states of a flight are saved rarely and completely.

Each has the time at which it was new.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uav_recon.channels import FileChannel, MemoryChannel
from uav_recon.clock import ManualClock
from uav_recon.recording.timelapse import PERIOD_S, SURFACES, Timelapse, load_states
from uav_recon.types.maps import SurfaceElements


def elements(revision: int, count: int = 100, extent_m: float = 8.0) -> SurfaceElements:
    random = np.random.default_rng(revision)
    normal = random.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return SurfaceElements(random.uniform(-extent_m / 2, extent_m / 2, (count, 3)), normal, np.ones(count), revision)


class Flight:
    """Surface channel, clock and subscriber, stepped ten times a second."""

    def __init__(self, folder: Path) -> None:
        self.clock = ManualClock(1000.0)
        self.wire = MemoryChannel(SurfaceElements)
        self.timelapse = Timelapse(folder, self.wire, self.clock)

    def fly(self, seconds: float, publish_every: int = 0) -> None:
        for k in range(round(10 * seconds)):
            if publish_every and k % publish_every == 0:
                self.wire.publish(elements(self.wire.sequence() + 1))
            self.clock.advance_to(self.clock.now_s() + 0.1)
            self.timelapse.step()


def test_at_most_one_state_in_three_seconds_and_the_last_one_always(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    flight.fly(20.0, publish_every=4)
    flight.timelapse.close()
    states = load_states(tmp_path)
    stamps_s = np.array([state.stamp_s for state in states])
    assert 7 <= len(states) <= 8
    assert (np.diff(stamps_s)[:-1] > PERIOD_S - 0.5).all()  # saved every PERIOD_S; each was new up to 0.4 s before
    assert states[0].revision == 1 and states[-1].revision == 50


def test_the_stamp_is_the_time_at_which_the_state_was_new(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    flight.fly(1.0)
    flight.wire.publish(elements(1))
    flight.fly(1.0)
    flight.wire.publish(elements(2))  # not due yet
    flight.fly(4.0)
    assert [round(state.stamp_s - 1000.0, 3) for state in load_states(tmp_path)] == [1.1, 2.1]


def test_a_surface_is_read_back_within_a_millimetre_and_half_a_degree(tmp_path: Path) -> None:
    flight, told = Flight(tmp_path), elements(7, 5000, extent_m=60.0)
    flight.wire.publish(told)
    flight.fly(0.1)
    (state,) = load_states(tmp_path)
    assert state.revision == 7
    assert np.abs(state.position_world - told.position_world).max() <= 0.0005 + 1e-9
    assert np.allclose(np.linalg.norm(state.normal_world, axis=1), 1.0)
    assert np.einsum("nc,nc->n", state.normal_world, told.normal_world).min() > np.cos(np.radians(0.5))


def test_a_large_hall_is_stored_more_coarsely(tmp_path: Path) -> None:
    flight, told = Flight(tmp_path), elements(1, 500, extent_m=500.0)
    flight.wire.publish(told)
    flight.fly(0.1)
    (state,) = load_states(tmp_path)
    assert 0.0005 < np.abs(state.position_world - told.position_world).max() < 0.005


def test_an_empty_surface_is_a_state_too(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    flight.wire.publish(elements(1, 0))
    flight.fly(0.1)
    (state,) = load_states(tmp_path)
    assert state.position_world.shape == state.normal_world.shape == (0, 3)


def test_a_value_of_an_earlier_flight_in_the_channel_is_not_saved(tmp_path: Path) -> None:
    wire = FileChannel(tmp_path / "surface.channel", SurfaceElements, 1 << 20)
    wire.publish(elements(90))
    clock = ManualClock(5.0)
    timelapse = Timelapse(tmp_path, FileChannel(tmp_path / "surface.channel", SurfaceElements, 1 << 20), clock)
    timelapse.step()
    assert load_states(tmp_path) == []
    wire.publish(elements(1))
    timelapse.close()
    assert [state.revision for state in load_states(tmp_path)] == [1]


def test_a_second_subscriber_continues_the_numbers_of_the_first(tmp_path: Path) -> None:
    for _ in range(2):  # the first subscriber was killed
        flight = Flight(tmp_path)
        flight.wire.publish(elements(1))
        flight.fly(0.1)
    assert sorted(path.name for path in (tmp_path / SURFACES).iterdir()) == ["00000.npz", "00001.npz"]


def test_a_truncated_or_damaged_state_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    flight = Flight(tmp_path)
    flight.fly(7.0, publish_every=1)
    whole = len(load_states(tmp_path))
    data = (tmp_path / SURFACES / "00000.npz").read_bytes()
    (tmp_path / SURFACES / "00001.npz").write_bytes(data[: len(data) // 2])
    for at in range(100, len(data), 200):
        (tmp_path / SURFACES / "00002.npz").write_bytes(
            data[:at] + bytes(b ^ 0x55 for b in data[at : at + 40]) + data[at + 40 :]
        )
        assert len(load_states(tmp_path)) in (whole - 2, whole - 1)  # left out, or readable despite the damage, but no crash
    (tmp_path / SURFACES / "00002.npz").unlink()
    (tmp_path / SURFACES / "00009.npz.part").write_bytes(data[:10])  # killed while writing
    assert len(load_states(tmp_path)) == whole - 2
    assert "00001.npz cannot be read" in caplog.text


def test_a_write_error_loses_states_and_logs_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    flight = Flight(tmp_path)
    (tmp_path / SURFACES).rmdir()
    flight.fly(10.0, publish_every=5)
    assert load_states(tmp_path) == []
    assert caplog.text.count("states of the surface are being lost") == 1
    (tmp_path / SURFACES).mkdir()
    flight.fly(4.0, publish_every=5)
    assert load_states(tmp_path)


def test_a_flight_without_states_is_read_as_empty(tmp_path: Path) -> None:
    assert load_states(tmp_path) == []
