"""The simulated range finder that looks up: distances in scenes worked out by hand, and its messages."""

from __future__ import annotations

import math
import statistics
from typing import Any

import numpy as np
import pytest
from ardupilot_rig import Copilot
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink
from scripted_companion import Companion

from sitl.geometry.quaternion import IDENTITY, Quat
from sitl.scene.scene import Scene
from sitl.world.range_finder import RANGE_M, SimulatedUpwardRangeFinder, cone_directions

FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
FOV_RAD = math.radians(27.0)
BODY_M = (0.2, -0.1, 1.0)


def sheet(z: float, x: tuple[float, float] = (-20.0, 20.0), y: tuple[float, float] = (-20.0, 20.0)) -> NDArray[np.float32]:
    """Return a level rectangle."""
    return np.array([(x[0], y[0], z), (x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z)], np.float32)


def finder(*sheets: NDArray[np.float32], seed: int = 1) -> SimulatedUpwardRangeFinder:
    vertices = np.concatenate(sheets)
    faces = np.concatenate([FACES + 4 * i for i in range(len(sheets))]).astype(np.int32)
    grey = np.full((len(vertices), 3), 128, np.uint8)
    scene = Scene("sheets", vertices, faces, grey, 0.0, np.full(3, -9.0), np.full(3, 9.0), np.zeros(3))
    return SimulatedUpwardRangeFinder(scene, seed, FOV_RAD)


def pitched(angle_rad: float) -> Quat:
    """Return enu_from_flu of a body that leans about y, its top towards +x."""
    return (math.cos(angle_rad / 2), 0.0, math.sin(angle_rad / 2), 0.0)


def test_a_level_ceiling_is_its_height_above_the_sensor() -> None:
    assert finder(sheet(3.0)).nearest_m(BODY_M, IDENTITY) == pytest.approx(1.95, abs=1e-3)


def test_the_nearest_surface_in_the_cone_counts_and_none_beside_it() -> None:
    reach_m = 0.95 * math.tan(FOV_RAD / 2)
    inside = sheet(2.0, x=(0.2 + reach_m - 0.04, 2.0))
    beside = sheet(2.0, x=(0.2 + reach_m + 0.04, 2.0))
    assert finder(sheet(3.0), inside).nearest_m(BODY_M, IDENTITY) < 1.0
    assert finder(sheet(3.0), beside).nearest_m(BODY_M, IDENTITY) == pytest.approx(1.95, abs=1e-3)


def test_the_cone_leans_with_the_body() -> None:
    aside = sheet(2.0, x=(0.2 + 0.3, 0.2 + 0.5))
    assert finder(sheet(3.0), aside).nearest_m(BODY_M, pitched(0.4)) < 1.2
    assert finder(sheet(3.0), aside).nearest_m(BODY_M, pitched(-0.4)) > 1.5
    assert finder(sheet(3.0)).nearest_m(BODY_M, pitched(math.pi)) == math.inf, "upside down it sees no ceiling"


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.1, 0.0), (0.0, -0.1), (0.05, 0.07)])
@pytest.mark.parametrize("fov_rad", [0.1, FOV_RAD, 1.0])
def test_the_rays_fill_a_cone_around_its_axis(tilt: tuple[float, float], fov_rad: float) -> None:
    rays = cone_directions(fov_rad, tilt)
    axis = np.array([*tilt, 1.0]) / math.sqrt(1.0 + tilt[0] ** 2 + tilt[1] ** 2)
    off = np.arccos(np.clip(rays @ axis, -1.0, 1.0))
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)
    assert off.max() == pytest.approx(fov_rad / 2)
    neighbours = np.sort(np.arccos(np.clip(rays @ rays.T, -1.0, 1.0)), axis=1)[:, 1]
    assert neighbours.max() < 0.013


def test_it_measures_fifteen_times_a_second_with_two_per_cent_of_noise() -> None:
    sensor = finder(sheet(3.0))
    readings: dict[float, float] = {}
    for tick in range(50 * 40):
        sensor.step(tick * 0.02, BODY_M, IDENTITY)
        readings[sensor.measured_s] = sensor.range_m
    assert len(readings) == pytest.approx(600, abs=2)
    assert statistics.mean(readings.values()) == pytest.approx(1.95, abs=0.01)
    assert statistics.stdev(readings.values()) == pytest.approx(0.039, rel=0.15)


def test_a_ceiling_out_of_range_reads_as_the_maximum() -> None:
    sensor = finder(sheet(9.0))
    sensor.step(0.0, BODY_M, IDENTITY)
    assert sensor.range_m == RANGE_M[1]


def test_a_seed_gives_one_sensor() -> None:
    def five(seed: int) -> list[float]:
        sensor = finder(sheet(3.0), seed=seed)
        found = []
        for tick in range(5):
            sensor.step(tick * 0.1, BODY_M, IDENTITY)
            found.append(sensor.range_m)
        return found

    assert five(1) == five(1)
    assert five(1) != five(2)


def told(c: Any, rate_hz: float | None) -> list[Any]:
    """Return the DISTANCE_SENSOR messages of two seconds below a ceiling, requested at a rate."""
    c.autopilot.mount_range_finder(finder(sheet(2.05)))
    c.keep = {"DISTANCE_SENSOR"}
    if rate_hz is not None:
        c.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 132, 1e6 / rate_hz)
    c.run(2.0)
    return list(c.messages)


def test_px4_sends_each_measurement_once_with_its_own_time() -> None:
    messages = told(Companion(), 30.0)
    assert 26 <= len(messages) <= 31
    assert len({m.time_boot_ms for m in messages}) == len(messages)
    one = messages[-1]
    assert (one.orientation, one.min_distance, one.max_distance) == (24, 5, 400)
    assert one.current_distance == pytest.approx(200, abs=20)
    assert (one.horizontal_fov, one.signal_quality) == (0.0, 0)
    silent = Companion()
    silent.keep = {"DISTANCE_SENSOR"}
    silent.run(1.0)
    assert silent.messages == []


def test_ardupilot_sends_the_newest_measurement_on_request_again_and_again() -> None:
    assert told(Copilot(), None) == []
    messages = told(Copilot(), 50.0)
    assert len(messages) > 60
    assert len({m.current_distance for m in messages}) < 35
    assert {m.orientation for m in messages} == {24}
