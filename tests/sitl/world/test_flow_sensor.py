"""The simulated module that looks down: flow and range in scenes worked out by hand."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sitl.geometry.quaternion import IDENTITY, Quat, Vec3, from_euler, from_yaw, multiply, rotate
from sitl.scene.scene import Scene
from sitl.world.floor_texture import FloorTexture
from sitl.world.flow_sensor import (
    FLOW_MAX_RADPS,
    FLOW_MOUNT_M,
    RANGE_M,
    RANGE_MOUNT_M,
    FlowMeasurement,
    FlowSensorErrors,
    SimulatedFlowModule,
)

FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
STEP_S = 0.004
EXACT = FlowSensorErrors()
FLOOR_Z = -0.1
HEIGHT_M = 1.2  # of the flow sensor above the floor
BODY_Z = FLOOR_Z + HEIGHT_M - FLOW_MOUNT_M[2]

Path = Callable[[float], tuple[Vec3, Quat]]


def sheet(z: float, x: tuple[float, float] = (-20.0, 20.0), y: tuple[float, float] = (-20.0, 20.0)) -> NDArray[np.float32]:
    """Return a level rectangle."""
    return np.array([(x[0], y[0], z), (x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z)], np.float32)


FLOOR = sheet(FLOOR_Z)


def module(*sheets: NDArray[np.float32], seed: int = 1, errors: FlowSensorErrors | None = EXACT) -> SimulatedFlowModule:
    vertices = np.concatenate(sheets)
    faces = np.concatenate([FACES + 4 * i for i in range(len(sheets))]).astype(np.int32)
    grey = np.full((len(vertices), 3), 128, np.uint8)
    scene = Scene("sheets", vertices, faces, grey, 0.0, np.full(3, -9.0), np.full(3, 9.0), np.zeros(3))
    return SimulatedFlowModule(scene, seed, errors)


def flown(sensor: SimulatedFlowModule, path: Path, seconds: float = 1.0) -> list[FlowMeasurement]:
    """Return the measurements on a path."""
    found: list[FlowMeasurement] = []
    for tick in range(round(seconds / STEP_S)):
        position, quat = path(tick * STEP_S)
        sensor.step(tick * STEP_S, position, quat)
        if sensor.flow is not None and (not found or sensor.flow is not found[-1]):
            found.append(sensor.flow)
    return found


def rates(found: list[FlowMeasurement]) -> tuple[float, float]:
    """Return the mean flow about x and y, rad/s."""
    used = [m for m in found if m.quality > 0]
    return (
        statistics.mean(m.flow_rad[0] / m.interval_s for m in used),
        statistics.mean(m.flow_rad[1] / m.interval_s for m in used),
    )


def straight(velocity_flu: Vec3, z: float = BODY_Z, yaw_rad: float = 0.0) -> Path:
    north = rotate(from_yaw(yaw_rad), velocity_flu)
    return lambda t: ((north[0] * t, north[1] * t, z + north[2] * t), from_yaw(yaw_rad))


@pytest.mark.parametrize("yaw_rad", [0.0, 0.9, -2.5])
def test_one_metre_per_second_forward_at_1_2_metres_is_0_83_rad_per_second_about_y(yaw_rad: float) -> None:
    about_x, about_y = rates(flown(module(FLOOR), straight((1.0, 0.0, 0.0), yaw_rad=yaw_rad)))
    assert about_y == pytest.approx(1.0 / 1.2, rel=1e-3)
    assert about_x == pytest.approx(0.0, abs=1e-3)


def test_motion_to_the_right_is_negative_about_x_and_a_climb_is_none() -> None:
    about_x, about_y = rates(flown(module(FLOOR), straight((0.0, -0.6, 0.0))))  # -y of FLU is +Y of FRD
    assert (about_x, about_y) == pytest.approx((-0.5, 0.0), abs=1e-3)
    climb = rates(flown(module(FLOOR), straight((0.0, 0.0, 0.3))))
    assert climb == pytest.approx((0.0, 0.0), abs=1e-3)


def turning(rate_frd: Vec3) -> Path:
    """Return a path that turns about the flow sensor, whose position stays fixed."""
    x, y, z = rate_frd

    def path(t: float) -> tuple[Vec3, Quat]:
        quat = from_euler(x * t, -y * t, -z * t)  # roll is about the same axis in FLU, pitch and yaw about opposite ones
        offset = rotate(quat, FLOW_MOUNT_M)
        return ((-offset[0], -offset[1], FLOOR_Z + HEIGHT_M - offset[2]), quat)

    return path


@pytest.mark.parametrize("rate", [0.5, -0.5])
def test_a_roll_or_pitch_about_the_sensor_is_the_flow_of_its_gyro(rate: float) -> None:
    roll, pitch = flown(module(FLOOR), turning((rate, 0.0, 0.0)), 0.4), flown(module(FLOOR), turning((0.0, rate, 0.0)), 0.4)
    assert rates(roll) == pytest.approx((rate, 0.0), abs=0.01)
    assert rates(pitch) == pytest.approx((0.0, rate), abs=0.01)
    for measured in (*roll, *pitch):
        assert measured.flow_rad == pytest.approx(measured.gyro_rad[:2], abs=1e-6)


def test_a_turn_about_the_vertical_is_no_flow_but_a_turn_of_the_gyro() -> None:
    found = flown(module(FLOOR), turning((0.0, 0.0, 0.8)))
    assert rates(found) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert found[-1].gyro_rad[2] / found[-1].interval_s == pytest.approx(0.8, rel=1e-3)


def test_a_turn_about_the_body_moves_the_sensor_on_its_lever_arm() -> None:
    """0.03 m ahead and 0.02 m to the right: a turn of 2 rad/s to the right moves it 0.06 m/s right and 0.04 m/s back."""
    found = flown(module(FLOOR), lambda t: ((0.0, 0.0, BODY_Z), from_yaw(-2.0 * t)))
    about_x, about_y = rates(found)
    assert about_x == pytest.approx(-0.06 / 1.2, rel=0.05)
    assert about_y == pytest.approx(-0.04 / 1.2, rel=0.05)


def test_the_flow_steps_smoothly_at_the_edge_of_a_table() -> None:
    """The flow grows from 1/1.2 to 1/0.6 rad/s over the width of the view, in steps of a fraction."""
    sensor = module(FLOOR, sheet(FLOOR_Z + 0.6, x=(1.0, 9.0)), errors=replace(EXACT, rate_hz=25.0))
    found = [m.flow_rad[1] / m.interval_s for m in flown(sensor, straight((1.0, 0.0, 0.0)), 2.0)]
    assert found[2] == pytest.approx(1.0 / 1.2, rel=0.01)
    assert found[-2] == pytest.approx(1.0 / 0.6, rel=0.01)
    between = [rate for rate in found if 0.9 < rate < 1.6]
    assert len(between) >= 3
    assert max(b - a for a, b in itertools.pairwise(found)) < 0.4


def test_in_a_climb_a_near_table_ahead_moves_backwards_in_the_view() -> None:
    """Two of five columns see it at 0.6 m, two see the floor behind at 1.2 m: 0.3 tan 21° 0.2 m/s (1 / 0.6 - 1 / 1.2)."""
    sensor = module(FLOOR, sheet(FLOOR_Z + 0.6, x=(FLOW_MOUNT_M[0] + 0.05, 9.0)))
    about_x, about_y = rates(flown(sensor, straight((0.0, 0.0, 0.2)), 0.12))
    assert (about_x, about_y) == pytest.approx((0.0, 0.3 * math.tan(math.radians(21.0)) * 0.2 * (1 / 0.6 - 1 / 1.2)), abs=1e-3)


def test_a_saturated_sensor_reports_its_limit_without_quality() -> None:
    fast = flown(module(FLOOR), straight((4.0, 0.0, 0.0), z=FLOOR_Z + 0.3 - FLOW_MOUNT_M[2]), 0.5)
    assert {m.quality for m in fast} == {0}
    assert fast[-1].flow_rad[1] / fast[-1].interval_s == pytest.approx(FLOW_MAX_RADPS)
    slow = flown(module(FLOOR), straight((0.3, 0.0, 0.0)), 0.5)
    assert min(m.quality for m in slow) > 20


@pytest.mark.parametrize(("height_m", "sees"), [(0.07, False), (0.10, True), (3.9, True), (4.2, False)])
def test_it_sees_between_8_centimetres_and_4_metres(height_m: float, sees: bool) -> None:
    found = flown(module(FLOOR), straight((0.1, 0.0, 0.0), z=FLOOR_Z + height_m - FLOW_MOUNT_M[2]), 0.3)
    assert all((m.quality > 0) is sees for m in found)
    if not sees:
        assert all(m.flow_rad == (0.0, 0.0) for m in found)


def test_above_nothing_there_is_no_flow() -> None:
    found = flown(module(sheet(FLOOR_Z, x=(5.0, 6.0))), straight((1.0, 0.0, 0.0)), 0.5)
    assert {(m.quality, m.flow_rad) for m in found} == {(0, (0.0, 0.0))}


def test_the_quality_falls_in_the_dark() -> None:
    def quality(light: float) -> float:
        sensor = module(FLOOR)
        sensor.light = light
        return statistics.mean(m.quality for m in flown(sensor, straight((0.2, 0.0, 0.0))))

    assert quality(0.5) == quality(1.0) > 1.8 * quality(0.2)
    assert quality(0.0) == 0


def test_a_tenth_of_the_floor_has_poor_texture_in_patches() -> None:
    x, y = np.meshgrid(np.arange(-15.0, 15.0, 0.1), np.arange(-15.0, 15.0, 0.1))
    flat = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, FLOOR_Z)])
    shares = []
    for seed in range(8):
        texture = FloorTexture(seed).at(flat).reshape(x.shape)
        assert 0.0 <= texture.min() < texture.max() <= 1.0
        assert np.abs(np.diff(texture, axis=1)).max() < 0.45, "smooth over 10 cm"
        shares.append(float((texture < 0.25).mean()))
    assert 0.03 < statistics.mean(shares) < 0.15
    assert not np.array_equal(FloorTexture(1).at(flat), FloorTexture(2).at(flat))


def test_the_noise_is_5_centimetres_per_second_at_15_hertz_and_1_2_metres() -> None:
    errors = replace(EXACT, noise_rad=FlowSensorErrors.drawn(1).noise_rad, rate_hz=15.0)
    found = flown(module(FLOOR, errors=errors), lambda _: ((0.0, 0.0, BODY_Z), IDENTITY), 60.0)
    speed = [m.flow_rad[1] / m.interval_s * 1.2 for m in found]
    assert 0.05 < statistics.stdev(speed) < 0.12, "more on a floor with less than full texture"
    assert statistics.mean(speed) == pytest.approx(0.0, abs=0.01)


def test_scale_bias_and_gyro_bias_add_up() -> None:
    errors = replace(EXACT, scale=1.05, bias_radps=(0.01, -0.02), gyro_bias_radps=(0.1, 0.2, 0.3))
    found = flown(module(FLOOR, errors=errors), straight((0.6, 0.0, 0.0)))
    assert rates(found) == pytest.approx((0.01, 0.525 - 0.02), abs=1e-3)
    assert [angle / found[0].interval_s for angle in found[0].gyro_rad] == pytest.approx([0.1, 0.2, 0.3])


def test_a_reading_is_late_by_the_delay_that_its_time_contains() -> None:
    def path(t: float) -> tuple[Vec3, Quat]:
        return ((max(t - 0.5, 0.0), 0.0, BODY_Z), IDENTITY)  # starts at 0.5 s

    found = flown(module(FLOOR, errors=replace(EXACT, delay_s=0.032, rate_hz=25.0)), path)
    for measured in found:
        end_s = measured.read_s - 0.032
        moved_s = max(0.0, end_s - max(0.5, end_s - measured.interval_s))
        assert measured.flow_rad[1] == pytest.approx(moved_s / 1.2, abs=2e-3)


def test_the_sensors_of_many_flights_have_the_errors_of_their_data_sheet() -> None:
    drawn = [FlowSensorErrors.drawn(seed) for seed in range(400)]
    assert statistics.stdev(e.scale for e in drawn) == pytest.approx(0.03, rel=0.15)
    assert statistics.stdev(e.bias_radps[0] for e in drawn) == pytest.approx(0.0083, rel=0.15)
    delays_s, rates_hz = [e.delay_s for e in drawn], [e.rate_hz for e in drawn]
    assert (min(delays_s), max(delays_s)) == pytest.approx((0.010, 0.040), abs=1e-3)
    assert (min(rates_hz), max(rates_hz)) == pytest.approx((15.0, 25.0), abs=0.2)
    assert FlowSensorErrors.drawn(7) == FlowSensorErrors.drawn(7)


def test_two_per_cent_of_the_readings_are_lost() -> None:
    errors = replace(EXACT, dropout_share=FlowSensorErrors.drawn(1).dropout_share, rate_hz=25.0)
    found = flown(module(FLOOR, errors=errors), lambda _: ((0.0, 0.0, BODY_Z), IDENTITY), 80.0)
    lost = [m for m in found if m.quality == 0]
    assert 0.01 < len(lost) / len(found) < 0.03


def test_a_seed_gives_one_sensor() -> None:
    def ten(seed: int) -> list[FlowMeasurement]:
        return flown(module(FLOOR, seed=seed, errors=None), straight((0.3, 0.1, 0.0)), 0.6)

    assert ten(3) == ten(3)
    assert ten(3) != ten(4)


# -- range --------------------------------------------------------------------------------------------------------


def at_range(height_m: float) -> Vec3:
    return (0.0, 0.0, FLOOR_Z + height_m - RANGE_MOUNT_M[2])


def test_the_range_is_along_the_axis_and_grows_with_the_tilt() -> None:
    sensor = module(FLOOR)
    assert sensor.true_range_m(at_range(1.2), IDENTITY) == pytest.approx(1.2, abs=1e-3)
    leaning = multiply(from_yaw(0.7), from_euler(0.3, 0.0, 0.0))
    offset = rotate(leaning, RANGE_MOUNT_M)
    assert sensor.true_range_m((0.0, 0.0, FLOOR_Z + 1.2 - offset[2]), leaning) == pytest.approx(1.2 / math.cos(0.3), rel=0.02)


def test_the_range_steps_smoothly_at_the_edge_of_a_table() -> None:
    sensor = module(FLOOR, sheet(FLOOR_Z + 0.7, x=(0.0, 9.0)))
    found = [sensor.true_range_m((x, 0.0, at_range(1.2)[2]), IDENTITY) for x in np.arange(-0.4, 0.4, 0.01)]
    assert (found[0], found[-1]) == pytest.approx((1.2, 0.5), abs=1e-3)
    assert max(a - b for a, b in itertools.pairwise(found)) < 0.25
    assert sum(0.55 < one < 1.15 for one in found) >= 3


def test_the_range_has_one_per_cent_and_5_millimetres_of_noise_at_20_hertz() -> None:
    sensor, read = module(FLOOR), {}
    for tick in range(15000):
        sensor.step(tick * STEP_S, at_range(2.0), IDENTITY)
        assert sensor.distance is not None
        read[sensor.distance.read_s] = sensor.distance.range_m
    assert len(read) == pytest.approx(1200, abs=2)
    assert statistics.mean(read.values()) == pytest.approx(2.0, abs=0.003)
    assert statistics.stdev(read.values()) == pytest.approx(math.hypot(0.02, 0.005), rel=0.1)


@pytest.mark.parametrize(("height_m", "limit_m"), [(5.0, RANGE_M[1]), (0.01, RANGE_M[0])])
def test_out_of_range_is_not_valid_and_reads_as_the_limit(height_m: float, limit_m: float) -> None:
    sensor = module(FLOOR)
    sensor.step(0.0, at_range(height_m), IDENTITY)
    assert sensor.distance is not None
    assert (sensor.distance.valid, sensor.distance.range_m, sensor.valid_distance) == (False, limit_m, None)
