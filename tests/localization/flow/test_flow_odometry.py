"""Flow odometry against flights whose path is known in closed form (flow_flights)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from flow_flights import Array, Flight, still, straight
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.localization.flow.flow_odometry import FlowOdometry
from uav_recon.localization.flow.flow_samples import FlowGeometry
from uav_recon.localization.flow.measured_motion import MeasuredMotion
from uav_recon.types.flow import FlowReadings
from uav_recon.types.pose import Pose

SENSOR = {"noise_mps": 0.05, "bias_mps": 0.01, "range_noise_m": 0.02, "gyro_bias_radps": 0.002}
MOUNT = {"flow_m": (0.05, 0.02, -0.05), "range_m": (0.08, 0.0, -0.05)}


def odometry(flight: Flight, readings: FlowReadings | None = None, camera_gyro: bool = True) -> FlowOdometry:
    """The estimator after a flight; delay_s 0.03 is what it assumes of a sensor that it has not learned."""
    geometry = FlowGeometry(np.array(flight.flow_m), np.array(flight.range_m))
    found = FlowOdometry(geometry, flight.turned if camera_gyro else None)
    found.add(flight.readings() if readings is None else readings)
    return found


def part(readings: FlowReadings, from_s: float, to_s: float) -> FlowReadings:
    flow = (readings.stamps_s > from_s) & (readings.stamps_s <= to_s)
    down = (readings.range_stamps_s > from_s) & (readings.range_stamps_s <= to_s)
    return FlowReadings(
        readings.stamps_s[flow], readings.intervals_s[flow], readings.flow_rad[flow], readings.gyro_rad[flow],
        readings.quality[flow], readings.range_stamps_s[down], readings.ranges_m[down],
    )  # fmt: skip


def error_m(found: FlowOdometry, flight: Flight, from_s: float, to_s: float) -> Array:
    motion = found.moved(from_s, to_s, flight.pose(from_s))
    assert motion is not None
    off_m = motion.displacement_odom_m - (flight.pose(to_s).translation_m - flight.pose(from_s).translation_m)
    beam = np.linalg.eigh(motion.covariance_m2)[1][:, 2]  # along it little is measured
    return np.asarray(off_m - beam * (beam @ off_m))


def errors_m(found: FlowOdometry, flight: Flight, duration_s: float = 1.0, start_s: float = 2.0) -> Array:
    starts = np.arange(start_s, flight.duration_s - duration_s - 1.0, 0.37).tolist()
    return np.array([error_m(found, flight, at_s, at_s + duration_s) for at_s in starts])


@pytest.mark.parametrize("camera_gyro", [True, False], ids=["camera's gyro", "own gyro"])
def test_a_perfect_sensor_gives_the_motion(camera_gyro: bool) -> None:
    """With a lever arm of each sensor, turns, climbs and tilts: millimetres remain of the interpolation."""
    flight = Flight(delay_s=0.03, duration_s=12.0, flow_m=(0.1, 0.05, -0.08), range_m=(-0.1, 0.02, -0.05))
    readings = flight.readings()
    if not camera_gyro:  # its interval has the stamps of the flow, which is late: both as the camera's gyro would say
        turns = np.array([flight.turned(s - i, s) for s, i in zip(readings.stamps_s, readings.intervals_s, strict=True)])
        readings = replace(readings, gyro_rad=turns)
    error = errors_m(odometry(flight, readings, camera_gyro), flight)
    assert np.linalg.norm(error, axis=1).max() < 0.004


def test_a_turn_on_the_spot_is_no_motion() -> None:
    """The sensor moves by its lever arm of 20 cm, and the flow by the turn itself: over 10 cm a second, and the body not."""
    flight = Flight(
        path=still, flow_m=(0.15, 0.1, -0.1), range_m=(-0.1, 0.02, -0.05), delay_s=0.03, duration_s=10.0, yaw=lambda t: 1.0 * t,
        tilt=lambda t: np.stack([0.15 * np.sin(2 * t), 0.12 * np.sin(3 * t)], axis=1),
    )  # fmt: skip
    assert np.abs(errors_m(odometry(flight), flight)).max() < 0.002
    elsewhere = replace(flight, flow_m=(0.0, 0.0, 0.0))
    wrong = FlowOdometry(FlowGeometry(np.array(elsewhere.flow_m), np.array(elsewhere.range_m)), flight.turned)
    wrong.add(flight.readings())
    assert np.linalg.norm(errors_m(wrong, flight), axis=1).max() > 0.1, "the lever arm counts here"


def test_a_cheap_sensor_is_right_to_two_centimetres_a_second() -> None:
    """Noise 5 cm/s at 15 Hz, bias 1 cm/s per axis, scale 3 % and delay 50 ms, learned from a track that is right to 5 mm."""
    flight = Flight(duration_s=40.0, scale=1.03, delay_s=0.05, **SENSOR, **MOUNT)  # type: ignore[arg-type]
    found, readings, rng = odometry(flight, part(flight.readings(), 0.0, 0.1)), flight.readings(), np.random.default_rng(3)
    error, normalised = [], []
    for k in range(3, round(flight.duration_s / 0.05) - 2):
        now_s = 0.05 * k
        found.add(part(readings, now_s - 1.0, now_s))
        pose = flight.pose(now_s)
        found.add_reference(now_s, Pose(pose.quat_wxyz, pose.translation_m + rng.normal(0.0, 0.005, 3)), 0.005)
        if k % 5 or now_s < 20.0:
            continue
        from_s, to_s = now_s - 1.12, now_s - 0.12
        motion = found.moved(from_s, to_s, flight.pose(from_s))
        assert motion is not None
        off = motion.displacement_odom_m - (flight.pose(to_s).translation_m - flight.pose(from_s).translation_m)
        error.append(off)
        normalised.append(off[:2] @ np.linalg.solve(motion.covariance_m2[:2, :2], off[:2]))
    rms_m = np.sqrt(np.mean(np.sum(np.array(error)[:, :2] ** 2, axis=1)))
    assert rms_m < 0.025
    assert 0.4 < np.mean(normalised) < 3.0, "two degrees of freedom"
    assert found.errors.scale == pytest.approx(1.03, abs=0.01)
    assert found.errors.delay_s == pytest.approx(0.05, abs=0.008)
    assert abs(found.errors.scale - 1.03) < 3.0 * found.errors.scale_sigma < 0.04
    assert abs(found.errors.delay_s - 0.05) < 3.0 * found.errors.delay_sigma_s < 0.025


@pytest.mark.parametrize(("scale", "delay_s"), [(0.9, 0.1), (1.15, 0.0), (1.0, 0.08)])
def test_scale_and_delay_are_learned(scale: float, delay_s: float) -> None:
    flight = Flight(duration_s=30.0, scale=scale, delay_s=delay_s, **SENSOR, **MOUNT)  # type: ignore[arg-type]
    found = odometry(flight)
    for now_s in np.arange(1.0, 29.0, 0.1).tolist():
        found.add_reference(now_s, flight.pose(now_s), 0.002)
    assert found.errors.scale == pytest.approx(scale, abs=0.02)
    assert found.errors.delay_s == pytest.approx(delay_s, abs=0.015)


def test_a_hover_teaches_nothing_and_a_jump_of_the_track_little() -> None:
    hovering = Flight(path=still, duration_s=20.0, yaw=lambda t: 0.0 * t, **SENSOR)  # type: ignore[arg-type]
    found = odometry(hovering)
    for now_s in np.arange(1.0, 19.0, 0.1).tolist():
        found.add_reference(now_s, hovering.pose(now_s), 0.002)
    assert abs(found.errors.scale - 1.0) < 0.02
    assert found.errors.scale_sigma > 0.03
    flight = Flight(duration_s=20.0, delay_s=0.03, **SENSOR)  # type: ignore[arg-type]
    found = odometry(flight)
    for now_s in np.arange(1.0, 19.0, 0.1).tolist():
        pose = flight.pose(now_s)
        jump_m = np.array([1.0, 0.5, 0.0]) * math.floor(now_s / 3.0)
        found.add_reference(now_s, Pose(pose.quat_wxyz, pose.translation_m + jump_m), 0.002)
    assert found.errors.scale == pytest.approx(1.0, abs=0.02)
    assert found.errors.delay_s == pytest.approx(0.03, abs=0.02)


@pytest.mark.parametrize("image_rad", [0.0, 0.36])
def test_a_table_below_is_no_motion_up_or_sideways(image_rad: float) -> None:
    """A table of 70 cm under a flight at 1.2 m: the nearer surface moves 2.4 times as fast through the image."""
    flight = Flight(path=straight, edge_m=4.0, table_m=0.7, image_rad=image_rad, delay_s=0.03)
    found = odometry(flight)
    error = errors_m(found, flight, 2.0)
    assert np.linalg.norm(error[:, :2], axis=1).max() < (0.08 if image_rad else 0.005)
    crossing, beside = found.moved(9.0, 11.0, flight.pose(9.0)), found.moved(4.0, 6.0, flight.pose(4.0))
    assert crossing is not None
    assert beside is not None
    assert crossing.covariance_m2[0, 0] > beside.covariance_m2[0, 0] + 0.03**2, "flow and range may see different surfaces"


def change(readings: FlowReadings, from_s: float, to_s: float, **values: float | Array) -> FlowReadings:
    """Readings with other values in a time."""
    when = (readings.stamps_s > from_s) & (readings.stamps_s <= to_s)
    fields = {name: getattr(readings, name).copy() for name in values}
    for name, value in values.items():
        fields[name][when] = value
    return replace(readings, **fields)


def answer(flight: Flight, readings: FlowReadings, from_s: float = 5.0, to_s: float = 6.0) -> MeasuredMotion | None:
    return odometry(flight, readings).moved(from_s, to_s, flight.pose(from_s))


def test_what_cannot_be_trusted_gives_no_motion() -> None:
    flight = Flight(duration_s=9.0, delay_s=0.03)
    readings = flight.readings()
    assert answer(flight, readings) is not None
    assert answer(flight, change(readings, 4.0, 7.0, quality=0.0)) is None, "a covered lens"
    assert answer(flight, change(readings, 4.0, 7.0, quality=0.05)) is None, "a floor without texture"
    saturated = replace(readings, flow_rad=readings.flow_rad + 8.0 / flight.rate_hz)
    assert answer(flight, saturated) is None, "saturated"
    assert answer(flight, part(readings, 0.0, 5.5)) is None, "later than the newest reading"
    assert answer(flight, part(readings, 5.5, 9.0)) is None, "before the first reading"
    assert answer(flight, readings, 6.0, 6.0) is None
    gone = FlowReadings(
        readings.stamps_s,
        readings.intervals_s,
        readings.flow_rad,
        readings.gyro_rad,
        readings.quality,
        np.empty(0),
        np.empty(0),
    )
    assert answer(flight, gone) is None, "no range"


def test_a_frozen_sensor_gives_no_motion_while_the_body_turns() -> None:
    tilting = Flight(path=still, duration_s=9.0, tilt=lambda t: np.stack([0.2 * np.sin(2 * t), 0.0 * t], axis=1))
    readings = tilting.readings()
    assert answer(tilting, readings) is not None
    assert answer(tilting, change(readings, 4.0, 7.0, flow_rad=np.array([0.002, 0.001]))) is None
    resting = Flight(path=still, duration_s=9.0, yaw=lambda t: 0.0 * t)
    assert answer(resting, change(resting.readings(), 4.0, 7.0, flow_rad=0.0)) is not None, "at rest all readings are equal"


def test_single_false_readings_are_left_out() -> None:
    flight = Flight(duration_s=9.0, delay_s=0.03)
    readings = flight.readings()
    for at_s in (5.2, 5.6):
        readings = change(readings, at_s - 0.04, at_s + 0.04, flow_rad=0.15)
    assert np.linalg.norm(error_m(odometry(flight, readings), flight, 5.0, 6.0)) < 0.02


def test_a_short_gap_is_bridged_with_a_larger_covariance() -> None:
    flight = Flight(duration_s=9.0, delay_s=0.03)
    readings = flight.readings()
    whole, gap = answer(flight, readings), answer(flight, change(readings, 5.2, 5.7, quality=0.0))
    assert whole is not None
    assert gap is not None
    assert gap.covariance_m2[0, 0] > whole.covariance_m2[0, 0] + 0.035**2
    assert np.linalg.norm(gap.displacement_odom_m - whole.displacement_odom_m) < 0.04
    assert answer(flight, change(readings, 5.1, 5.9, quality=0.0)) is None, "too long"


def test_noise_that_the_readings_show_counts() -> None:
    """A sensor three times as noisy as a good one says so by its readings; single gaps do not keep it from learning."""
    flight = Flight(duration_s=30.0, delay_s=0.03, scale=1.05, noise_mps=0.15)
    readings = flight.readings()
    quality = readings.quality.copy()
    quality[::15] = 0.0
    found = odometry(flight, replace(readings, quality=quality))
    for now_s in np.arange(1.0, 29.0, 0.1).tolist():
        found.add_reference(now_s, flight.pose(now_s), 0.002)
    assert found.errors.scale == pytest.approx(1.05, abs=0.03)
    normalised = []
    for from_s in np.arange(2.0, 28.0, 0.5).tolist():
        motion = found.moved(from_s, from_s + 1.0, flight.pose(from_s))
        assert motion is not None
        off = motion.displacement_odom_m - (flight.pose(from_s + 1.0).translation_m - flight.pose(from_s).translation_m)
        normalised.append(off[:2] @ np.linalg.solve(motion.covariance_m2[:2, :2], off[:2]))
    assert 0.7 < np.mean(normalised) < 4.0, "two degrees of freedom"


def test_a_poor_picture_is_noisier() -> None:
    flight = Flight(duration_s=9.0, delay_s=0.03)
    good, poor = answer(flight, flight.readings()), answer(flight, change(flight.readings(), 0.0, 9.0, quality=0.12))
    assert good is not None
    assert poor is not None
    assert poor.covariance_m2[0, 0] > good.covariance_m2[0, 0] + 0.03**2


def test_a_second_gyro_takes_over_and_the_first_one_returns() -> None:
    """The camera's samples come 30 ms late, and none of four seconds; the flow sensor's own gyro is 0.2 rad/s wrong."""
    flight = Flight(duration_s=14.0, delay_s=0.03)
    readings = flight.readings()
    readings = replace(readings, gyro_rad=readings.gyro_rad + 0.2 * readings.intervals_s[:, None])
    now_s = 0.0

    def turned(from_s: float, to_s: float) -> Array | None:
        return None if 4.0 < to_s < 8.0 or to_s > now_s - 0.03 else flight.turned(from_s, to_s)

    found = FlowOdometry(FlowGeometry(np.zeros(3), np.zeros(3)), turned)
    for now_s in np.arange(0.5, 14.0, 0.1).tolist():
        found.add(part(readings, now_s - 1.0, now_s))
    off_m = [float(np.linalg.norm(error_m(found, flight, from_s, from_s + 1.0)[:2])) for from_s in (2.0, 5.0, 9.0, 11.0)]
    assert max(off_m[0], *off_m[2:]) < 0.01
    assert 0.1 < off_m[1] < 0.5
    blind = FlowOdometry(FlowGeometry(np.zeros(3), np.zeros(3)), None)
    blind.add(Flight(duration_s=12.0, own_gyro=False).readings())
    assert blind.moved(5.0, 6.0, flight.pose(5.0)) is None, "no gyro at all"


@settings(max_examples=20, deadline=None)
@given(yaw=st.floats(-3.1, 3.1), split=st.floats(0.2, 0.8), shift=st.floats(-50.0, 50.0))
def test_motions_turn_with_odom_and_add_up(yaw: float, split: float, shift: float) -> None:
    found, flight = SHARED
    turn = Pose.from_yaw(yaw, np.array([shift, -shift, 3.0]))
    start, middle_s = flight.pose(5.0), 5.0 + split
    whole, turned = found.moved(5.0, 6.0, start), found.moved(5.0, 6.0, turn @ start)
    first, second = found.moved(5.0, middle_s, start), found.moved(middle_s, 6.0, flight.pose(middle_s))
    assert whole is not None
    assert turned is not None
    assert first is not None
    assert second is not None
    rotation = turn.rotation()
    np.testing.assert_allclose(turned.displacement_odom_m, rotation @ whole.displacement_odom_m, atol=1e-9)
    np.testing.assert_allclose(turned.covariance_m2, rotation @ whole.covariance_m2 @ rotation.T, atol=1e-9)
    np.testing.assert_allclose(first.displacement_odom_m + second.displacement_odom_m, whole.displacement_odom_m, atol=2e-3)
    for motion in (whole, first, second):
        assert np.linalg.eigvalsh(motion.covariance_m2).min() > 0.0
        np.testing.assert_allclose(motion.covariance_m2, motion.covariance_m2.T, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.data())
def test_no_reading_raises_or_gives_numbers_that_are_not_finite(data: st.DataObject) -> None:
    flight = SHARED[1]
    readings = SHORT
    number = st.one_of(st.floats(allow_nan=True, allow_infinity=True, width=32), st.floats(-1.0, 1.0))
    fields = {}
    for name in ("intervals_s", "flow_rad", "gyro_rad", "quality", "ranges_m"):
        values = getattr(readings, name).copy()
        for _ in range(data.draw(st.integers(0, 3))):
            values.flat[data.draw(st.integers(0, values.size - 1))] = data.draw(number)
        fields[name] = values
    found = odometry(flight, replace(readings, **fields), camera_gyro=data.draw(st.booleans()))
    motion = found.moved(1.0, 2.0, flight.pose(1.0))
    if motion is not None:
        assert np.isfinite(motion.displacement_odom_m).all()
        assert np.isfinite(motion.covariance_m2).all()


_FLIGHT = Flight(duration_s=9.0, delay_s=0.03)
SHARED = (odometry(_FLIGHT), _FLIGHT)
SHORT = _FLIGHT.readings(3.0)


def climbing(t: Array) -> Array:
    """Positions (N, 3) of a climb by 0.1 m/s."""
    return np.stack([0.0 * t, 0.0 * t, 1.2 + 0.1 * t], axis=1)


def test_ranges_show_the_climb_of_a_body_that_hovers() -> None:
    """What is below has a slope: the ranges of a body on its way show less."""
    hovering, moving = Flight(duration_s=9.0, path=climbing), Flight(duration_s=9.0, path=straight)
    up, level = answer(hovering, hovering.readings(), 5.0, 5.2), answer(moving, moving.readings(), 5.0, 5.2)
    assert up is not None
    assert level is not None
    assert up.displacement_odom_m[2] == pytest.approx(0.02, abs=0.02)
    assert up.covariance_m2[2, 2] < 0.04**2
    assert level.covariance_m2[2, 2] > 0.1**2
